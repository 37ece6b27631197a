//! Light sources: texels that send out more than they can reflect.

use crate::atlas::Atlas;
use crate::backend::Backend;
use crate::capture::View;
use crate::error::Result;
use crate::progress::Progress;
use crate::raster::{Mask, Raster, Rgb};
use crate::surface::SurfacePoint;

/// Finds the texels that send out more than an albedo of `ratio` would reflect of what arrives, L > ratio · E/π, and that
/// stand out from the scene, L > ratio · mean L; in luminance (Rec. 709). Where views see such a texel, the median of what
/// they see must pass as well: in the texture, a lamp bleeds into what is seen beside and behind it.
pub fn find(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    (radiance, irradiance): (&Rgb, &Rgb),
    views: &[View],
    ratio: f32,
    progress: &dyn Progress,
) -> Result<Mask> {
    let texels = || atlas.texels.iter().map(|&t| t as usize);
    let mean = texels().map(|t| luminance(&radiance.data[t])).sum::<f32>() / atlas.texels.len() as f32;
    let least: Raster<f32> = irradiance.map(|e| ratio * (luminance(e) * std::f32::consts::FRAC_1_PI).max(mean));
    let mut mask = Mask::filled(radiance.width, radiance.height, false);
    for t in texels() {
        mask.data[t] = luminance(&radiance.data[t]) > least.data[t];
    }
    let candidates: Vec<usize> = (0..atlas.texels.len()).filter(|&i| mask.data[atlas.texels[i] as usize]).collect();
    for (i, mut seen) in candidates.iter().zip(sightings(backend, atlas, &candidates, views, progress)?) {
        if !seen.is_empty() {
            let middle = seen.len() / 2;
            let median = *seen.select_nth_unstable_by(middle, f32::total_cmp).1;
            let texel = atlas.texels[*i] as usize;
            mask.data[texel] = median > least.data[texel];
        }
    }
    Ok(mask)
}

/// Luminances of the pixels that show each of the given texels.
fn sightings(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    texels: &[usize],
    views: &[View],
    progress: &dyn Progress,
) -> Result<Vec<Vec<f32>>> {
    let points: Vec<SurfacePoint> = texels.iter().map(|&i| atlas.points[i]).collect();
    let mut seen = vec![Vec::new(); texels.len()];
    for view in views {
        progress.check()?;
        let image = view.load_image(progress)?;
        for (seen, at) in seen.iter_mut().zip(backend.project(&points, &view.camera)?) {
            if at.distance > 0.0 {
                let [x, y] = at.pixel.map(|c| c.max(0.0) as usize);
                seen.push(luminance(image.at(x.min(image.width - 1), y.min(image.height - 1))));
            }
        }
    }
    Ok(seen)
}

fn luminance(c: &[f32; 3]) -> f32 {
    0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]
}

#[cfg(test)]
mod tests {
    use glam::{Mat4, Vec2, Vec3};

    use super::*;
    use crate::camera::{Camera, Projection};
    use crate::capture::Split;
    use crate::cpu::CpuBackend;
    use crate::image_io::write_rgb;
    use crate::mesh::Mesh;
    use crate::progress::Silent;
    use crate::scene::Scene;

    const SIDE: usize = 8;
    const LAMP: usize = 2 * SIDE + 2;
    const BESIDE: usize = 5 * SIDE + 5;

    #[test]
    fn what_only_the_texture_takes_for_a_lamp_is_none() {
        let square = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
        let mesh = Mesh {
            positions: square.map(|(x, y)| Vec3::new(2.0 * x - 1.0, 2.0 * y - 1.0, 0.0)).to_vec(),
            normals: vec![Vec3::Z; 4],
            uvs: square.map(|(x, y)| Vec2::new(x, y)).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let scene = Scene::new(mesh).unwrap();
        let mut backend = CpuBackend::new(&scene);
        let atlas = Atlas::new(&mut backend, &scene, SIDE, SIDE).unwrap();
        let dim = [0.2; 3];
        let mut truth = Rgb::filled(SIDE, SIDE, dim);
        truth.data[LAMP] = [10.0; 3];
        let mut radiance = truth.clone();
        radiance.data[BESIDE] = [10.0; 3];

        let folder = tempfile::tempdir().unwrap();
        let views = [-0.4, 0.1, 0.5].map(|x| {
            let camera = Camera {
                projection: Projection::Equirectangular,
                width: 128,
                height: 64,
                world_from_camera: Mat4::from_translation(Vec3::new(x, 0.1, 1.0)),
            };
            let hits = backend.primary(&camera).unwrap();
            let seen = |hit: &crate::surface::Hit| match hit {
                hit if hit.is_hit() => truth.data[truth.nearest(hit.uv(&scene.mesh))],
                _ => [0.0; 3],
            };
            let image = folder.path().join(format!("{x}.exr"));
            write_rgb(&image, &Rgb::new(128, 64, hits.iter().map(seen).collect()).unwrap()).unwrap();
            let name = x.to_string();
            let (semantic, mask, room, room_id, albedo, roughness) = (None, None, None, None, None, None);
            View { name, camera, split: Split::Train, image, semantic, mask, room, room_id, albedo, roughness }
        });
        let irradiance = Rgb::filled(SIDE, SIDE, [0.5; 3]);
        let mut found = |views: &[View]| {
            let mask = find(&mut backend, &atlas, (&radiance, &irradiance), views, 3.0, &Silent).unwrap();
            (0..SIDE * SIDE).filter(|&t| mask.data[t]).collect::<Vec<_>>()
        };
        assert_eq!(found(&views), [LAMP]);
        assert_eq!(found(&[]), [LAMP, BESIDE], "without views the texture decides");
    }
}
