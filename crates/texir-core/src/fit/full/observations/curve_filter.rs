//! Denoises specular curves: each becomes a weighted mean over blocks of its view that reflect nearly the same.
//!
//! A curve's noise counts as misfit, most at small roughness, so that everything would come out too rough. From one
//! block of a flat surface to another what is reflected turns by the angle between the view rays, and by parallax:
//! their distance over that to what is reflected (as irradiance caching spaces its records: Ward, Rubinstein and Clear,
//! "A Ray Tracing Solution for Diffuse Interreflection", 1988). Where both together are small beside a lobe, whose
//! width goes with α = r², they show the same: at every node a curve becomes the mean of those around it, weighted by
//! exp(−½ (turn/(width · α))²).

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use crate::backend::ShadePoint;
use crate::fit::full::observations::blocks::{Blocks, Patch};
use crate::real::V3;
use crate::scene::Scene;
use crate::scene::trace::Trace;
use crate::specular_table::{Curve, NODES, PackedCurve, node};

/// How far around a block others are asked, radians: 4.2°.
const REACH: f32 = 0.074;
/// Bound of the kernel's σ as a share of the search radius: little is cut off.
const WIDEST: f32 = 0.6;
/// Weights below this count for nothing.
const NEGLIGIBLE: f32 = 1e-3;
/// How far the rays that measure the distance of what is reflected lean from the mirror direction.
const LEAN: f32 = 0.5;
/// Nothing is nearer than this, metres.
const NEAREST: f32 = 0.01;

/// A block, as far as it decides what it reflects.
#[derive(Clone, Copy, Debug)]
pub struct ReflectionPatch {
    /// The surface.
    pub patch: Patch,
    /// Unit direction in which the camera sees it.
    pub direction: Vec3,
    /// Harmonic mean distance of what it reflects, metres.
    pub distance: f32,
}

impl ReflectionPatch {
    /// Of the surface at a shading point.
    pub fn new(scene: &Scene, patch: Patch, point: &ShadePoint) -> Self {
        let (normal, view) = (Vec3::from(point.normal), Vec3::from(point.view));
        let mirrored = 2.0 * normal.dot(view) * normal - view;
        let (across, along) = mirrored.any_orthonormal_pair();
        let leaning = [across, -across, along, -along].map(|side| mirrored + LEAN * side);
        let (mut nearness, mut rays) = (0.0, 0.0);
        for direction in std::iter::once(mirrored).chain(leaning).map(Vec3::normalize) {
            if direction.dot(normal) > 0.0 {
                let hit = Trace::<f32>::closest(scene, V3::of(point.position), V3::of(direction.to_array()));
                nearness += hit.map_or(0.0, |hit| hit.t.max(NEAREST).recip());
                rays += 1.0;
            }
        }
        let distance = if nearness > 0.0 { rays / nearness } else { f32::INFINITY };
        Self { patch, direction: -view, distance }
    }

    /// By how much what `other` reflects is turned, radians.
    fn turn(&self, other: &Self) -> f32 {
        let parallax = self.patch.position.distance(other.patch.position) / self.distance.min(other.distance);
        self.direction.distance(other.direction) + parallax
    }
}

/// The filtered curves of a view's blocks. `angle` is the edge of a block, radians, `width` the kernel's σ as a share
/// of α.
pub fn filter(
    curves: &[Curve],
    blocks: &Blocks,
    reflections: &[ReflectionPatch],
    angle: f32,
    width: f32,
) -> Vec<PackedCurve> {
    if width == 0.0 {
        return curves.iter().map(PackedCurve::from).collect();
    }
    let reach = (REACH / angle).round().max(1.0) as usize;
    let widest = WIDEST * reach as f32 * angle;
    let sigma: [f32; NODES] = std::array::from_fn(|k| (width * node(k) * node(k)).min(widest));
    let sharpness = sigma.map(|of| 0.5 / (of * of));
    // And 1, whose sum is that of the weights.
    let radiance = |curve: &Curve| std::array::from_fn(|k| Vec3::from(curve.at_node(k)).extend(1.0));
    let radiance: Vec<[Vec4; NODES]> = curves.par_iter().map(radiance).collect();
    let mean = |block: usize| {
        let mut sums = radiance[block];
        for other in blocks.around(block, reach).filter(|&other| other != block) {
            if !reflections[block].patch.like(&reflections[other].patch) {
                continue;
            }
            let turn = reflections[block].turn(&reflections[other]);
            // From rough to smooth kernels get narrower, below those that are all of the widest.
            let (mut of, mut weight) = (0.0, 0.0);
            for k in (0..NODES).rev() {
                if sharpness[k] != of {
                    of = sharpness[k];
                    weight = (-of * turn * turn).exp();
                }
                if weight < NEGLIGIBLE {
                    break;
                }
                sums[k] += weight * radiance[other][k];
            }
        }
        PackedCurve::new(sums.map(|sum| (sum.truncate() / sum.w).to_array()))
    };
    (0..curves.len()).into_par_iter().map(mean).collect()
}

#[cfg(test)]
mod tests {
    use glam::Mat4;

    use super::*;
    use crate::camera::{Camera, Projection};
    use crate::fit::full::observations::blocks::group_pixels;
    use crate::fit::full::observations::squares::Squares;
    use crate::rng::hash2;

    const WIDTH: usize = 32;
    const ANGLE: f32 = 0.02;

    fn photo() -> Camera {
        let projection = Projection::Pinhole { fx: 50.0, fy: 50.0, cx: 16.0, cy: 16.0 };
        Camera { projection, width: WIDTH, height: WIDTH, world_from_camera: Mat4::IDENTITY }
    }

    /// A wall two metres before the camera, of blocks of one pixel.
    fn wall(class: impl Fn(usize) -> u16, distance: f32) -> (Blocks, Vec<ReflectionPatch>) {
        let reflections: Vec<ReflectionPatch> = (0..WIDTH * WIDTH)
            .map(|p| {
                let [x, z] = [p % WIDTH, p / WIDTH].map(|i| (i as f32 - 15.5) * ANGLE);
                let direction = Vec3::new(x, 1.0, z);
                let patch = Patch { position: 2.0 * direction, normal: -Vec3::Y, class: class(p), mixed: false };
                ReflectionPatch { patch, direction: direction.normalize(), distance }
            })
            .collect();
        let patches: Vec<Patch> = reflections.iter().map(|m| m.patch).collect();
        let squares = Squares::new(&photo(), photo().pixel_angle());
        (group_pixels(&(0..WIDTH * WIDTH).collect::<Vec<_>>(), &patches, squares), reflections)
    }

    fn packed(curves: &[Curve]) -> Vec<PackedCurve> {
        curves.iter().map(PackedCurve::from).collect()
    }

    /// 1 and noise of ±0.5 at every node.
    fn noisy() -> Vec<Curve> {
        let noise = |p: usize| hash2(p as u32, 7) as f32 / u32::MAX as f32 - 0.5;
        (0..WIDTH * WIDTH).map(|p| Curve::new([[1.0 + noise(p); 3]; NODES])).collect()
    }

    /// Root mean square distance from 1 at a node.
    fn error(curves: &[PackedCurve], k: usize) -> f32 {
        let squares = curves.iter().map(|curve| (curve.at_node(k)[0] - 1.0).powi(2));
        (squares.sum::<f32>() / curves.len() as f32).sqrt()
    }

    #[test]
    fn rough_lobes_lose_their_noise_and_mirrors_keep_their_picture() {
        let (blocks, reflections) = wall(|_| 1, 100.0);
        let curves = noisy();
        let filtered = filter(&curves, &blocks, &reflections, ANGLE, 0.3);
        let alone = packed(&curves);
        assert!(error(&filtered, NODES - 1) < 0.3 * error(&alone, NODES - 1), "{}", error(&filtered, NODES - 1));
        assert!(filtered.iter().zip(&alone).all(|(a, b)| a.at_node(0) == b.at_node(0)));
        assert_eq!(filter(&curves, &blocks, &reflections, ANGLE, 0.0), alone);
    }

    #[test]
    fn what_is_near_is_not_smeared() {
        let curves = noisy();
        let left = |distance: f32| {
            let (blocks, reflections) = wall(|_| 1, distance);
            error(&filter(&curves, &blocks, &reflections, ANGLE, 0.3), NODES / 2)
        };
        let alone = error(&packed(&curves), 0);
        assert!(left(0.02) > 0.99 * alone, "{}", left(0.02));
        assert!(left(100.0) < 0.8 * alone, "{}", left(100.0));
    }

    #[test]
    fn other_classes_lend_nothing() {
        let (blocks, reflections) = wall(|p| (p % WIDTH < WIDTH / 2).into(), 100.0);
        let step: Vec<Curve> =
            (0..WIDTH * WIDTH).map(|p| Curve::new([[f32::from(u8::from(p % WIDTH < WIDTH / 2)); 3]; NODES])).collect();
        assert_eq!(filter(&step, &blocks, &reflections, ANGLE, 0.3), packed(&step));
    }
}
