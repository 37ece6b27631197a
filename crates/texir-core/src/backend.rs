//! The passes that bake and fit need. The algorithms of this crate call them through [`Backend`] and never see a
//! device.
//!
//! Every pass is a pure function of its arguments and the scene the backend was made for; it takes and returns host
//! slices, so that an algorithm reads as its equations. Two implementations: [`crate::cpu::CpuBackend`] and the WGSL
//! one in `texir-gpu`.

pub mod check;

use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use crate::camera::Camera;
use crate::denoise::Noisy;
use crate::environment::Environment;
use crate::error::Result;
use crate::lights::Lights;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::punctual::PunctualLight;
pub use crate::raster::MAX_RADIANCE;
use crate::raster::Rgb;
use crate::rng::{MORTON_SIDE, hash2, scrambled_morton};
use crate::scene::Scene;
use crate::specular_table::{Curve, STRATA, TableSampling};
use crate::surface::{Hit, SurfacePoint, TexelHit};
use crate::texture::{Footprints, Pyramid, SparseRows};

/// How many samples to draw, and from which stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampling {
    /// Samples per texel or pixel.
    pub samples: u32,
    /// Seed of the run; item `i` draws from the sequence scrambled by `hash(seed, i)`.
    pub seed: u32,
}

/// The most samples of one technique at a point: sums in single precision gain nothing from more.
pub const MAX_SAMPLES: u32 = 1 << 20;

/// How many rays the irradiance gather sends, and where: at most [`MAX_SAMPLES`] of each kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Gather {
    /// Cosine-distributed rays per point, at least 1.
    pub cosine: u32,
    /// Rays per point to the [`Lights`] and to the bright pixels of the environment, half of them to each where there
    /// are both; 0 leaves them to the cosine samples.
    pub light: u32,
    /// Seed of the run.
    pub seed: u32,
    /// What each point draws from.
    pub sequences: Sequences,
}

/// Which stretch of which lattice sequence ([`lattice2`](crate::rng::lattice2)) a gather's points draw.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Sequences {
    /// Every point has its own, shifted by `hash(seed, index)`, and draws its stretch `part`: 0 the first `cosine`
    /// and `light` points, 1 as many after them, and so on. The mean of gathers 0 and 1 is the gather of twice as many
    /// rays.
    Own {
        /// Which stretch.
        part: u32,
    },
    /// The points are texels of a map `width` texels wide, their indices row · width + column. Each block of 32 × 32
    /// shares one sequence, of which its texels draw consecutive stretches in order of a Z curve. A texel's own error
    /// is as with [`Sequences::Own`], but neighbours' errors cancel, which leaves a denoiser less to remove (Ahmed and
    /// Wonka, "Screen-Space Blue-Noise Diffusion of Monte Carlo Sampling Error via Hierarchical Ordering of Pixels",
    /// SIGGRAPH Asia 2020).
    Shared {
        /// Texels in a row, at least 1.
        width: u32,
        /// Which part of its stretch a texel draws: less than `parts`.
        part: u32,
        /// In how many parts its stretch is drawn, at least 1: the mean of the gathers of all parts is the gather of
        /// that many times the rays.
        parts: u32,
    },
}

impl Sequences {
    /// The seed of the sequence that point `number` draws from, in a run of this `seed`, and its stretch of it.
    pub fn of(self, seed: u32, number: u32) -> (u32, u32) {
        match self {
            Self::Own { part } => (hash2(seed, number), part),
            Self::Shared { width, part, parts } => {
                let width = width.max(1);
                let (x, y) = (number % width, number / width);
                let seed = hash2(seed, y / MORTON_SIDE * width.div_ceil(MORTON_SIDE) + x / MORTON_SIDE);
                let along = scrambled_morton([x % MORTON_SIDE, y % MORTON_SIDE], hash2(seed, 0));
                (seed, along.wrapping_mul(parts).wrapping_add(part))
            }
        }
    }
}

impl Gather {
    /// Every point by a sequence of its own.
    pub const fn new(cosine: u32, light: u32, seed: u32) -> Self {
        Self { cosine, light, seed, sequences: Sequences::Own { part: 0 } }
    }

    /// The same rays, at texels of a map `width` texels wide that share their sequences.
    pub const fn shared(self, width: usize) -> Self {
        self.shared_in_parts(width, [0, 1])
    }

    /// `part` of `parts` of the gather of `parts` times the rays at texels of such a map.
    pub const fn shared_in_parts(self, width: usize, [part, parts]: [u32; 2]) -> Self {
        Self { sequences: Sequences::Shared { width: width as u32, part, parts }, ..self }
    }

    /// The rays to lights and those to the bright pixels of the environment, by which of them there are.
    pub fn light_and_sky(&self, lights: bool, sky: bool) -> [u32; 2] {
        match (lights, sky) {
            (true, true) => [self.light - self.light / 2, self.light / 2],
            (lights, sky) => [u32::from(lights) * self.light, u32::from(sky) * self.light],
        }
    }
}

/// What the gather found at one point.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Gathered {
    /// E = ∫ L cosθ dω, linear RGB; cosine included, not divided by π.
    pub irradiance: [f32; 3],
    /// Share of the cosine samples that met the back of a triangle: near 1 for a point inside an object.
    pub back_faces: f32,
}

/// Which derivative with respect to roughness [`Backend::shade`] returns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RoughnessGradient {
    /// Exact for a density held fixed (detached sampling): Σ ψ w L [F0(1−x)+x].
    Exact,
    /// The TexIR authors': sampled directions move with r, the radiance looked up stays; biased.
    Authors,
}

/// What shading needs to know of a pixel, apart from its material.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShadePoint {
    /// Ray origin, off the surface (see [`SurfacePoint`]).
    pub position: [f32; 3],
    /// Index of the item: the pixel's in its view. It chooses the item's samples, so that a subset draws the same.
    pub index: u32,
    /// Unit shading normal, on the camera's side.
    pub normal: [f32; 3],
    /// Unit direction to the camera.
    pub view: [f32; 3],
    /// Irradiance E, cosine included, not divided by π.
    pub irradiance: [f32; 3],
}

impl ShadePoint {
    /// The point that pixel index `pixel` of a view sees, shaded on the camera's side.
    pub fn new(mesh: &Mesh, camera: &Camera, pixel: u32, hit: &Hit, irradiance: [f32; 3]) -> Self {
        let to_camera = -camera.direction_of(pixel as usize);
        let surface = SurfacePoint::new(mesh, hit, Some(to_camera));
        Self {
            position: surface.position,
            index: pixel,
            normal: surface.normal,
            view: to_camera.to_array(),
            irradiance,
        }
    }

    /// Where its rays leave; of no triangle.
    pub fn origin(&self) -> SurfacePoint {
        SurfacePoint { position: self.position, triangle: Hit::NONE, normal: self.normal, index: self.index }
    }

    /// n·v.
    pub fn cosine(&self) -> f32 {
        glam::Vec3::from(self.normal).dot(glam::Vec3::from(self.view))
    }
}

/// The BRDF's parameters at one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Linear RGB in [0, 1].
    pub albedo: [f32; 3],
    /// Perceptual roughness r; α = r².
    pub roughness: f32,
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
}

impl Material {
    /// A dielectric.
    pub fn dielectric(albedo: [f32; 3], roughness: f32) -> Self {
        Self { albedo, roughness, metallic: 0.0 }
    }
}

/// Outgoing radiance of a pixel with what its adjoint needs, so that the backward pass traces no ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shaded {
    /// L_o = a(1−m)E/π + F0⊙A + B.
    pub radiance: [f32; 3],
    /// A = Σ w_s L_s (1−x_s) = ∂L_o/∂F0.
    pub specular_scale: [f32; 3],
    /// ∂L_o/∂r.
    pub roughness_jacobian: [f32; 3],
}

/// Cotangents of a [`Material`]: ∂Loss/∂(each parameter).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MaterialGrad {
    /// ∂Loss/∂albedo.
    pub albedo: [f32; 3],
    /// ∂Loss/∂roughness.
    pub roughness: f32,
    /// ∂Loss/∂metallic.
    pub metallic: f32,
}

/// Where a surface point falls in a view: the result of the projection pass of the TBL.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Projected {
    /// Continuous pixel coordinates (pixel centres at +0.5).
    pub pixel: [f32; 2],
    /// Cosine between the shading normal and the direction to the camera.
    pub cosine: f32,
    /// Distance to the camera, metres; 0 when the point is not visible (outside the image, facing away, or occluded).
    pub distance: f32,
}

/// Disjoint groups of a view's pixels (a class, or a class within a room), fixed for the whole fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Groups {
    /// `groups + 1` offsets into `members`.
    pub offsets: Vec<u32>,
    /// Pixel indices, group by group.
    pub members: Vec<u32>,
    /// Of each group, how many of its first members are the reference set (virtual-highlight pixels), for
    /// [`GroupTarget::Quantile`].
    pub references: Vec<u32>,
}

/// What the members of a group are drawn to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GroupTarget {
    /// The group's mean; the gradient flows through it.
    Mean,
    /// The q-quantile of the group's reference members (linear interpolation), held fixed; only the other members are
    /// drawn to it. Groups without references are left out.
    Quantile(f32),
}

/// A loss and its gradient with respect to the values it was computed from.
#[derive(Clone, Debug, PartialEq)]
pub struct Loss<T> {
    /// The loss.
    pub value: f32,
    /// ∂value/∂input, one per input.
    pub gradient: Vec<T>,
}

/// The passes, for one scene that the backend keeps. Slices are host memory; item order is kept. Points and cameras
/// whose rays would be none are errors that name them.
pub trait Backend {
    /// The adapter or processor that runs the passes: for logs, and to tell apart results that may differ in their
    /// bits.
    fn name(&self) -> String;

    /// The scene that the passes run on.
    fn scene(&self) -> &Arc<Scene>;

    /// Sets the radiance texture that [`Backend::irradiance`], [`Backend::shade`] and [`Backend::specular_tables`] look
    /// up at ray hits (linear RGB, nearest texel), and the lights in it that the first and the last sample. Errors on
    /// radiance outside 0 to [`MAX_RADIANCE`], and on lights of another mesh, and keeps what was set before; an error of
    /// the device leaves no lighting, as two at once may be more than it holds.
    fn set_tbl(&mut self, radiance: &Rgb, lights: &Lights) -> Result<()>;

    /// Sets what rays of [`Backend::irradiance`] and [`Backend::shade`] that miss the mesh see: at first `None`, black.
    /// [`Backend::specular_tables`] ignores it. An error of the device leaves `None`.
    fn set_environment(&mut self, environment: Option<&Environment>) -> Result<()>;

    /// Primary visibility: the closest hit through every pixel centre of some rows of the view. `t` is in metres. Errors
    /// on a camera that fails [`Camera::check`], as [`Backend::project`] does.
    fn primary(&mut self, camera: &Camera, rows: Range<usize>) -> Result<Vec<Hit>>;

    /// Texel map: which surface point each texel in some `rows` of an atlas of `[width, height]` texels is, row by row.
    /// A texel whose centre lies in a triangle takes that point (the lowest triangle index where charts overlap); a
    /// texel that a triangle only touches takes the nearest point of the nearest such triangle (conservative at chart
    /// borders).
    fn texels(&mut self, size: [usize; 2], rows: Range<usize>) -> Result<Vec<Option<TexelHit>>>;

    /// Irradiance at every point: cosine samples and samples of the lights and the bright sky, combined by the balance
    /// heuristic; unbiased for any split. Back faces of lights are black, with [`Lights::one_sided`] all back faces.
    /// Advances `progress` by the rays requested.
    fn irradiance(&mut self, points: &[SurfacePoint], gather: Gather, progress: &dyn Progress)
    -> Result<Vec<Gathered>>;

    /// Irradiance at every point from all `lights` together: one shadow ray per point and light, cosine included, not
    /// divided by π. Advances `progress` by the rays.
    fn punctual(
        &mut self,
        points: &[SurfacePoint],
        lights: &[PunctualLight],
        progress: &dyn Progress,
    ) -> Result<Vec<[f32; 3]>>;

    /// Denoise: the mean of two gathers of irradiance at every point without most of its noise ([`crate::denoise`]). A
    /// result depends on points within about 25 texels, to the bit, unless some neighbourhood holds over 65,000 points:
    /// a GPU then leaves all to the CPU, which rounds differently. `progress` is only polled for cancellation.
    fn denoise(&mut self, noisy: Noisy<'_>, progress: &dyn Progress) -> Result<Vec<[f32; 3]>>;

    /// Projects points into a view and tests visibility through the BVH.
    fn project(&mut self, points: &[SurfacePoint], camera: &Camera) -> Result<Vec<Projected>>;

    /// Shade: diffuse from irradiance + importance-sampled GGX over the TBL, with the Jacobian its adjoint needs.
    /// Lambert's diffuse model and the paper's masking ([`crate::brdf::Masking::Schlick`]), with which paper mode fits;
    /// full mode chooses its own, and [`crate::render::Renderer`] draws with what its textures name. Expects roughness
    /// in (0, 1].
    fn shade(
        &mut self,
        points: &[ShadePoint],
        materials: &[Material],
        sampling: Sampling,
        gradient: RoughnessGradient,
        progress: &dyn Progress,
    ) -> Result<Vec<Shaded>>;

    /// Adjoint of [`Backend::shade`]: from ∂Loss/∂L_o (`d_radiance`) to ∂Loss/∂material, per pixel. Traces no ray.
    fn shade_vjp(
        &mut self,
        points: &[ShadePoint],
        materials: &[Material],
        shaded: &[Shaded],
        d_radiance: &[[f32; 3]],
    ) -> Result<Vec<MaterialGrad>>;

    /// Specular tables: the specular radiance of a surface with normal-incidence reflectance `f0` at every pixel as a
    /// function of roughness, from light samples that are drawn once and weighed at every tabulated roughness; unbiased
    /// at each. A pixel is the mean over its strata. Which samples are drawn does not depend on `f0`. Advances
    /// `progress` by the rays requested.
    fn specular_tables(
        &mut self,
        pixels: &[[ShadePoint; STRATA]],
        f0: f32,
        sampling: TableSampling,
        progress: &dyn Progress,
    ) -> Result<Vec<Curve>>;

    /// Image loss: the mean over pixels and channels of |T(rendered) − T(target)|, T(x) = ln(1+x); 0 without pixels.
    fn radiance_loss(&mut self, rendered: &[[f32; 3]], target: &[[f32; 3]]) -> Result<Loss<[f32; 3]>>;

    /// Mean of |value − target(group)| over the pixels of all groups and over channels; `values` holds `channels`
    /// numbers per pixel. A class counts by its pixels, so that the term keeps its balance with the image loss, which
    /// is a mean over pixels too.
    fn group_loss(
        &mut self,
        values: &[f32],
        channels: usize,
        groups: &Groups,
        target: GroupTarget,
    ) -> Result<Loss<f32>>;

    /// Mip-mapped texture lookup: `channels` interleaved numbers per texel in, the same per footprint, a row each, out.
    fn lookup(
        &mut self,
        pyramid: &Pyramid,
        texture: &[f32],
        channels: usize,
        footprints: &SparseRows,
    ) -> Result<Vec<f32>>;

    /// Transpose of [`Backend::lookup`]: cotangents of the looked-up values back to every texel.
    fn lookup_vjp(
        &mut self,
        pyramid: &Pyramid,
        d_values: &[f32],
        channels: usize,
        footprints: &Footprints,
    ) -> Result<Vec<f32>>;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::lattice2;

    const WIDTH: u32 = 100;
    const SHARED: Sequences = Sequences::Shared { width: WIDTH, part: 0, parts: 1 };
    const SAMPLES: u32 = 64;

    /// The points that texel (x, y) draws.
    fn drawn(sequences: Sequences, seed: u32, [x, y]: [u32; 2]) -> impl Iterator<Item = [f32; 2]> {
        let (seed, stretch) = sequences.of(seed, y * WIDTH + x);
        (0..SAMPLES).map(move |i| lattice2(stretch * SAMPLES + i, [hash2(seed, 1), hash2(seed, 2)]))
    }

    /// Standard deviation over seeds of the share of a disc that the texels of an aligned square find together.
    fn deviation(sequences: Sequences, side: u32) -> f64 {
        let inside = |[u, v]: [f32; 2]| f64::from(u8::from((u - 0.4).powi(2) + (v - 0.6).powi(2) < 0.09));
        let square = |seed: u32| {
            let texels = (0..side * side).map(|i| [64 + i % side, 8 + i / side]);
            let found: f64 = texels.flat_map(|texel| drawn(sequences, seed, texel)).map(inside).sum();
            found / f64::from(side * side * SAMPLES) - 0.09 * std::f64::consts::PI
        };
        ((0..300).map(|seed| square(seed).powi(2)).sum::<f64>() / 300.0).sqrt()
    }

    #[test]
    fn errors_of_texels_that_share_a_sequence_cancel() {
        let (own, shared) = (Sequences::Own { part: 0 }, SHARED);
        let alone = deviation(shared, 1) / deviation(own, 1);
        assert!((0.8..1.25).contains(&alone), "{alone}: one texel is as good as before");
        for side in [2, 4] {
            let ratio = deviation(shared, side) / deviation(own, side);
            assert!(ratio < 1.2 / f64::from(side).sqrt(), "{side}² texels: {ratio}");
        }
    }

    #[test]
    fn the_parts_of_a_stretch_are_all_of_it() {
        let (x, y) = (70, 9);
        let part = |part| drawn(Sequences::Shared { width: WIDTH, part, parts: 2 }, 3, [x, y]);
        let (seed, stretch) = SHARED.of(3, y * WIDTH + x);
        let whole = (0..2 * SAMPLES).map(|i| lattice2(stretch * 2 * SAMPLES + i, [hash2(seed, 1), hash2(seed, 2)]));
        assert!(part(0).chain(part(1)).eq(whole));
        assert!(!part(0).eq(part(1)));
    }

    #[test]
    fn texels_of_a_block_draw_stretches_of_their_own() {
        let block = |seed: u32| -> Vec<(u32, u32)> {
            (0..MORTON_SIDE * MORTON_SIDE)
                .map(|i| SHARED.of(seed, (32 + i / MORTON_SIDE) * WIDTH + 64 + i % MORTON_SIDE))
                .collect()
        };
        let [a, b] = [3, 4].map(block);
        assert!(a.iter().all(|(seed, stretch)| *seed == a[0].0 && *stretch < MORTON_SIDE * MORTON_SIDE));
        let different: std::collections::BTreeSet<u32> = a.iter().map(|(_, stretch)| *stretch).collect();
        assert_eq!(different.len(), a.len());
        let alike = (0..a.len()).filter(|&i| a[i].1 == b[i].1).count();
        assert!(alike < 20, "{alike} texels have the stretch of another seed");
        assert_ne!(a[0].0, SHARED.of(3, 31 * WIDTH + 64).0, "the block above has another sequence");
        assert_ne!(a[0].0, SHARED.of(3, 32 * WIDTH + 63).0, "and so has the one beside it");
    }
}
