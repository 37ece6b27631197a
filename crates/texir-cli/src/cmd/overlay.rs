//! Pictures of the views with the mesh's edges drawn over them: where they lie beside the photo's, pose, scale or mesh
//! is wrong.

use std::path::Path;

use texir_core::backend::Backend;
use texir_core::camera::{Camera, Projection};
use texir_core::capture::View;
use texir_core::image_io::{encode_srgb, write_png_rgb};
use texir_core::mesh::Mesh;
use texir_core::progress::{Progress, Task};
use texir_core::raster::{Raster, Rgb};
use texir_core::surface::Hit;

use crate::failure::Failure;

/// Pictures have at most this many columns.
const WIDTH: usize = 1024;
/// Share of full scale at which the median pixel is shown.
const MEDIAN: f32 = 0.18;
/// Neighbouring pixels whose faces' normals differ by more than this many degrees are on both sides of an edge.
const CREASE_DEGREES: f32 = 20.0;
/// Neighbouring pixels of which one is this many times farther away are on both sides of an edge.
const STEP: f32 = 1.1;
/// Edges are drawn in this colour.
const EDGE: [u8; 3] = [255, 40, 160];

/// Writes one PNG per view to `folder`.
pub fn write(backend: &mut dyn Backend, views: &[View], folder: &Path, progress: &dyn Progress) -> Result<(), Failure> {
    let _task = Task::start(progress, "inspect: overlays", views.len() as u64, "views");
    for view in views {
        progress.check()?;
        let step = view.camera.width.div_ceil(WIDTH);
        let camera = reduced(&view.camera, step);
        let image = shown(&view.load_picture(progress)?, &camera, step);
        let hits = backend.primary(&camera, camera.rows())?;
        let image = with_edges(image, backend.scene().mesh(), &hits);
        write_png_rgb(folder.join(format!("{}.png", view.name)), &image)?;
        progress.advance(1);
    }
    Ok(())
}

/// The camera that sees every `step`th pixel along both axes.
fn reduced(camera: &Camera, step: usize) -> Camera {
    let divided = |v: f32| v / step as f32;
    let projection = match camera.projection {
        Projection::Equirectangular => Projection::Equirectangular,
        Projection::Pinhole { fx, fy, cx, cy } => {
            Projection::Pinhole { fx: divided(fx), fy: divided(fy), cx: divided(cx), cy: divided(cy) }
        }
    };
    let side = |pixels: usize| (pixels / step).max(1);
    Camera { projection, width: side(camera.width), height: side(camera.height), ..*camera }
}

/// The image at the reduced camera's pixels, its median at middle grey.
fn shown(image: &Rgb, camera: &Camera, step: usize) -> Raster<[u8; 3]> {
    let place = |i: usize, pixels: usize| (i * step + step / 2).min(pixels - 1);
    let pixel = |i: usize| *image.at(place(i % camera.width, image.width), place(i / camera.width, image.height));
    let pixels: Vec<[f32; 3]> = (0..camera.pixels()).map(pixel).collect();
    let mut levels: Vec<f32> = pixels.iter().map(|p| p.iter().sum::<f32>() / 3.0).collect();
    levels.sort_by(f32::total_cmp);
    let scale = MEDIAN / levels.get(levels.len() / 2).copied().unwrap_or(1.0).max(f32::MIN_POSITIVE);
    let data = pixels.into_iter().map(|p| p.map(|v| v * scale)).collect();
    encode_srgb(&Raster { width: camera.width, height: camera.height, data })
}

fn with_edges(mut image: Raster<[u8; 3]>, mesh: &Mesh, hits: &[Hit]) -> Raster<[u8; 3]> {
    let width = image.width;
    let edge = |i: usize, j: usize| match (hits.get(i), hits.get(j)) {
        (Some(a), Some(b)) if a.is_hit() && b.is_hit() => {
            let (a_normal, b_normal) = (mesh.face_normal(a.triangle), mesh.face_normal(b.triangle));
            a_normal.dot(b_normal) < CREASE_DEGREES.to_radians().cos() || a.t > STEP * b.t || b.t > STEP * a.t
        }
        (Some(a), Some(b)) => a.is_hit() != b.is_hit(),
        _ => false,
    };
    for (i, pixel) in image.data.iter_mut().enumerate() {
        let right = (i + 1) % width != 0 && edge(i, i + 1);
        if right || edge(i, i + width) {
            *pixel = EDGE;
        }
    }
    image
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reduced_camera_looks_the_same_way() {
        for projection in
            [Projection::Equirectangular, Projection::Pinhole { fx: 900.0, fy: 950.0, cx: 1000.0, cy: 400.0 }]
        {
            let camera = Camera { projection, width: 2048, height: 1024, world_from_camera: glam::Mat4::IDENTITY };
            let small = reduced(&camera, 4);
            assert_eq!((small.width, small.height), (512, 256));
            assert!((small.direction(100.0, 50.0) - camera.direction(400.0, 200.0)).length() < 1e-6);
        }
    }

    #[test]
    fn edges_are_where_normals_turn_or_depth_jumps() {
        let corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]];
        let mesh = Mesh {
            positions: corners.map(|p| glam::IVec3::from(p).as_vec3()).to_vec(),
            triangles: vec![[0, 1, 2], [0, 1, 3]],
            ..Mesh::default()
        };
        let hit = |triangle, t| Hit { triangle, u: 0.0, v: 0.0, t };
        let hits = [hit(0, 1.0), hit(0, 1.05), hit(0, 1.5), hit(1, 1.5), hit(Hit::NONE, 0.0), hit(Hit::NONE, 0.0)];
        let grey = Raster::filled(6, 1, [9; 3]);
        let drawn: Vec<bool> = with_edges(grey, &mesh, &hits).data.iter().map(|p| *p == EDGE).collect();
        assert_eq!(drawn, [false, true, true, true, false, false]);
    }
}
