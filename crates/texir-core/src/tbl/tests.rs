//! A room whose walls shine in a known pattern, seen by cameras through primary hits.

use std::path::Path;
use std::sync::Arc;

use glam::{Mat4, Vec2, Vec3};

use super::connectivity::Connectivity;
use super::*;
use crate::camera::Projection;
use crate::capture::Split;
use crate::cpu::CpuBackend;
use crate::image_io::write_rgb;
use crate::inpaint;
use crate::mesh::Mesh;
use crate::progress::Silent;
use crate::raster::{Mask, Rgb, mean_of_channels, mean_pixel};
use crate::surface::SurfacePoint;

const SIZE: [usize; 2] = [384, 256];
const ROOM: Vec3 = Vec3::new(4.0, 3.0, 2.5);

/// A quad from `corner` along two edges, seen from the side of a × b, in one of 3×2 cells of the atlas.
fn quad(mesh: &mut Mesh, cell: u32, corner: Vec3, a: Vec3, b: Vec3) {
    let base = mesh.positions.len() as u32;
    let origin = Vec2::new((cell % 3) as f32 / 3.0, (cell / 3) as f32 / 2.0) + 8.0 / SIZE[0] as f32;
    let extent = Vec2::new(1.0 / 3.0, 0.5) - 16.0 / SIZE[0] as f32;
    for (u, v) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
        mesh.positions.push(corner + a * u + b * v);
        mesh.normals.push(a.cross(b).normalize());
        mesh.uvs.push(origin + extent * Vec2::new(u, v));
    }
    mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
}

/// A closed room, its faces pointing inwards.
pub(crate) fn room() -> Mesh {
    let (x, y, z) = (Vec3::X * ROOM.x, Vec3::Y * ROOM.y, Vec3::Z * ROOM.z);
    let mut mesh = Mesh::default();
    quad(&mut mesh, 0, Vec3::ZERO, x, y);
    quad(&mut mesh, 1, z, y, x);
    quad(&mut mesh, 2, Vec3::ZERO, z, x);
    quad(&mut mesh, 3, y, x, z);
    quad(&mut mesh, 4, Vec3::ZERO, y, z);
    quad(&mut mesh, 5, x, z, y);
    mesh
}

/// Radiance of the walls: a smooth pattern, 70 cm from crest to crest.
fn pattern(p: Vec3) -> [f32; 3] {
    let wave = |phase: f32| 1.0 + 0.4 * ((p.x + 1.3 * p.y + 0.7 * p.z + phase) * std::f32::consts::TAU / 1.25).sin();
    [wave(0.0), wave(0.2), wave(0.5)]
}

pub(crate) fn panorama(position: Vec3, yaw: f32) -> Camera {
    // Turned upright: the camera's +Y is the room's +Z.
    let upright = Mat4::from_rotation_z(yaw) * Mat4::from_rotation_x(std::f32::consts::FRAC_PI_2);
    let world_from_camera = Mat4::from_translation(position) * upright;
    Camera { projection: Projection::Equirectangular, width: 512, height: 256, world_from_camera }
}

fn pinhole(position: Vec3, towards: Vec3) -> Camera {
    let back = (position - towards).normalize();
    let right = Vec3::Z.cross(back).normalize();
    let axes = [right.extend(0.0), back.cross(right).extend(0.0), back.extend(0.0), position.extend(1.0)];
    let world_from_camera = Mat4::from_cols(axes[0], axes[1], axes[2], axes[3]);
    let projection = Projection::Pinhole { fx: 150.0, fy: 160.0, cx: 121.0, cy: 97.0 };
    Camera { projection, width: 240, height: 200, world_from_camera }
}

fn cameras() -> Vec<Camera> {
    let centre = ROOM / 2.0;
    vec![
        panorama(Vec3::new(1.2, 1.1, 1.3), 0.7),
        panorama(Vec3::new(2.9, 1.9, 1.2), 2.9),
        pinhole(centre, Vec3::new(4.0, 1.0, 1.0)),
        pinhole(centre, Vec3::new(0.0, 2.0, 1.5)),
    ]
}

/// The image that a camera sees where the surface shines as `radiance(position, direction to the camera)`.
fn photograph(scene: &Arc<Scene>, camera: &Camera, radiance: impl Fn(Vec3, Vec3) -> [f32; 3]) -> Rgb {
    let hits = CpuBackend::new(scene.clone()).primary(camera, camera.rows()).unwrap();
    let pixel = |i: usize| {
        let (x, y) = ((i % camera.width) as f32 + 0.5, (i / camera.width) as f32 + 0.5);
        let direction = camera.direction(x, y);
        radiance(camera.position() + direction * hits[i].t, -direction)
    };
    Rgb::new(camera.width, camera.height, (0..hits.len()).map(pixel).collect()).unwrap()
}

fn fuse_images(scene: &Arc<Scene>, cameras: &[Camera], images: &[Rgb], options: &TblOptions) -> Tbl {
    fused(scene, cameras, |i| Ok(Photo::new(images[i].clone(), None)), options).unwrap()
}

/// What [`fuse`] makes of images in an atlas of [`SIZE`].
fn fused(
    scene: &Arc<Scene>,
    cameras: &[Camera],
    load: impl FnMut(usize) -> Result<Photo>,
    options: &TblOptions,
) -> Result<Tbl> {
    let mut backend = CpuBackend::new(scene.clone());
    let atlas = Atlas::new(&mut backend, SIZE)?;
    fuse(&mut backend, &atlas, cameras, load, options, &Silent)
}

/// Mean relative error of the texels that `kind` covers.
fn error(scene: &Arc<Scene>, tbl: &Tbl, kind: Coverage, truth: impl Fn(Vec3) -> [f32; 3]) -> f32 {
    let atlas = Atlas::new(&mut CpuBackend::new(scene.clone()), SIZE).unwrap();
    let errors: Vec<f32> = atlas
        .texels
        .iter()
        .zip(&atlas.points)
        .filter(|&(&t, _)| tbl.coverage.data[t as usize] == kind)
        .map(|(&t, p)| {
            let (got, expected) = (tbl.radiance.data[t as usize], truth(p.position.into()));
            (0..3).map(|c| (got[c] - expected[c]).abs() / expected[c]).sum::<f32>() / 3.0
        })
        .collect();
    assert!(!errors.is_empty(), "no texel is {kind:?}");
    errors.iter().sum::<f32>() / errors.len() as f32
}

#[test]
fn a_pattern_on_the_walls_comes_back_and_half_a_pixel_matters() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let cameras = cameras();
    let take = |camera: &Camera| photograph(&scene, camera, |p, _| pattern(p));
    let images: Vec<Rgb> = cameras.iter().map(take).collect();
    let tbl = fuse_images(&scene, &cameras, &images, &TblOptions::default());
    let right = error(&scene, &tbl, Coverage::Seen, pattern);
    assert!(right < 0.006, "mean relative error {right}");
    // Negative control: the pixels' values taken half a pixel further right and down.
    let shifted: Vec<Rgb> = cameras
        .iter()
        .map(|camera| {
            let between = |i: usize| {
                let (x, y) = ((i % camera.width) as f32 + 1.0, (i / camera.width) as f32 + 1.0);
                let direction = camera.direction(x, y);
                // The room is convex and closed: the ray leaves it through the nearest of its planes.
                let position = camera.position();
                let exits = ((ROOM - position) / direction).max(-position / direction);
                pattern(position + direction * exits.min_element())
            };
            Rgb::new(camera.width, camera.height, (0..camera.pixels()).map(between).collect()).unwrap()
        })
        .collect();
    let wrong =
        error(&scene, &fuse_images(&scene, &cameras, &shifted, &TblOptions::default()), Coverage::Seen, pattern);
    assert!(wrong > 3.0 * right && wrong > 0.015, "half a pixel changes {right} to {wrong} only");
}

#[test]
fn each_projection_alone_brings_the_pattern_back() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    for camera in cameras() {
        let image = photograph(&scene, &camera, |p, _| pattern(p));
        let tbl = fuse_images(&scene, &[camera], &[image], &TblOptions::default());
        let off = error(&scene, &tbl, Coverage::Seen, pattern);
        assert!(off < 0.01, "mean relative error {off} from {:?}", camera.projection);
    }
}

#[test]
fn a_highlight_that_moves_with_the_camera_is_left_out() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let positions = [[0.7, 0.6], [3.3, 0.7], [0.8, 2.4], [3.2, 2.3], [2.0, 1.5], [1.3, 1.6], [2.7, 1.2]];
    let cameras: Vec<Camera> =
        positions.map(|[x, y]| Camera { width: 256, height: 128, ..panorama(Vec3::new(x, y, 1.3), x) }).into();
    // A mirror-like spot on the floor where the ray to the camera is nearly perpendicular.
    let glossy =
        |p: Vec3, to_camera: Vec3| pattern(p).map(|l| if to_camera.z > 0.9 && p.z < 0.01 { l * 5.0 } else { l });
    let images: Vec<Rgb> = cameras.iter().map(|c| photograph(&scene, c, glossy)).collect();
    let robust =
        error(&scene, &fuse_images(&scene, &cameras, &images, &TblOptions::default()), Coverage::Seen, pattern);
    // Negative control: a blend that believes every view.
    let gullible = TblOptions { tolerance: 1e6, ..TblOptions::default() };
    let plain = error(&scene, &fuse_images(&scene, &cameras, &images, &gullible), Coverage::Seen, pattern);
    assert!(robust < 0.01, "mean relative error {robust}");
    assert!(plain > 5.0 * robust, "without rejection the error is {plain}, with it {robust}");
}

#[test]
fn what_no_view_sees_is_inpainted_from_around_and_flagged() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    // Every face shines in its own brightness; the one pinhole sees parts of some.
    const LIT: [f32; 6] = [0.5, 0.8, 1.1, 1.4, 1.7, 2.0];
    let faces = |p: Vec3| {
        let planes = [p.z, ROOM.z - p.z, p.y, ROOM.y - p.y, p.x, ROOM.x - p.x];
        let nearest = (0..6).min_by(|&a, &b| planes[a].total_cmp(&planes[b])).unwrap();
        [LIT[nearest]; 3]
    };
    let camera = pinhole(ROOM / 2.0, Vec3::new(4.0, 1.5, 1.0));
    let image = photograph(&scene, &camera, |p, _| faces(p));
    let tbl = fuse_images(&scene, &[camera], &[image], &TblOptions::default());
    let atlas = Atlas::new(&mut CpuBackend::new(scene.clone()), SIZE).unwrap();
    let coverage = |texel: u32| tbl.coverage.data[texel as usize];
    let texels = || atlas.texels.iter().copied().zip(atlas.points.iter().map(|p| p.triangle as usize / 2));
    assert!(texels().all(|(texel, _)| coverage(texel) != Coverage::Outside));
    // A face of which a part is seen is filled with its own brightness, and never with its neighbour's.
    let seen: Vec<bool> =
        (0..6).map(|f| texels().any(|(t, face)| face == f && coverage(t) == Coverage::Seen)).collect();
    assert!(seen.contains(&true) && seen.contains(&false));
    let of_seen_faces = || texels().filter(|&(_, face)| seen[face]);
    assert!(of_seen_faces().any(|(texel, _)| coverage(texel) == Coverage::Inpainted));
    for (texel, face) in of_seen_faces() {
        let got = tbl.radiance.data[texel as usize][0];
        assert!((got - LIT[face]).abs() < 1e-3, "face {face} has {got} where {:?}", coverage(texel));
    }
    assert!(tbl.radiance.data.iter().flatten().all(|v| v.is_finite()));
}

/// Mean relative error of the seen ceiling texels that lie in the lamp, 5 cm and more from its rim.
fn inside_lamp(scene: &Arc<Scene>, tbl: &Tbl, radiance: f32, lamp: impl Fn(Vec3) -> bool) -> f32 {
    let atlas = Atlas::new(&mut CpuBackend::new(scene.clone()), SIZE).unwrap();
    let inside = |p: Vec3| [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y].iter().all(|way| lamp(p + 0.05 * *way));
    let seen = |texel: u32| tbl.coverage.data[texel as usize] == Coverage::Seen;
    let texels = atlas.texels.iter().zip(&atlas.points).filter(|(t, p)| seen(**t) && inside(p.position.into()));
    let errors: Vec<f32> = texels.map(|(t, _)| (tbl.radiance.data[*t as usize][0] / radiance - 1.0).abs()).collect();
    assert!(!errors.is_empty(), "no texel of the lamp is seen");
    errors.iter().sum::<f32>() / errors.len() as f32
}

#[test]
fn lamps_keep_their_radiance_and_are_not_spread_to_what_is_unseen() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    // A lamp panel in the ceiling, a part of which a wide photo shows.
    let lamp = |p: Vec3| p.z > ROOM.z - 0.01 && (p.x - 2.0).abs() < 0.5 && (p.y - 1.5).abs() < 0.4;
    let shine = |p: Vec3| if lamp(p) { [5000.0; 3] } else { [0.5; 3] };
    let camera = pinhole(Vec3::new(2.0, 0.2, 0.5), Vec3::new(2.0, 1.9, 2.5));
    let image = filtered_photograph(&scene, &camera, |p, _| shine(p));
    let tbl = fuse_images(&scene, &[camera], &[image], &TblOptions::default());
    let off = inside_lamp(&scene, &tbl, 5000.0, lamp);
    assert!(off < 0.02, "the lamp's radiance is off by {off}");
    assert!(error(&scene, &tbl, Coverage::Inpainted, |_| [0.5; 3]) < 1e-3);
}

/// A photograph whose pixels are means over their area.
fn filtered_photograph(scene: &Arc<Scene>, camera: &Camera, radiance: impl Fn(Vec3, Vec3) -> [f32; 3]) -> Rgb {
    const FACTOR: usize = 8;
    let fine = photograph(scene, &camera.supersampled(FACTOR), radiance);
    let mean = |i: usize| {
        let (x, y) = (i % camera.width * FACTOR, i / camera.width * FACTOR);
        let part = |k: usize| Vec3::from(*fine.at(x + k % FACTOR, y + k / FACTOR));
        ((0..FACTOR * FACTOR).map(part).sum::<Vec3>() / (FACTOR * FACTOR) as f32).to_array()
    };
    Rgb::new(camera.width, camera.height, (0..camera.pixels()).map(mean).collect()).unwrap()
}

#[test]
fn a_lamp_as_small_as_a_pixel_keeps_its_power_and_does_not_glow() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    // 30 cm of ceiling, where a pixel is 20 to 30 cm wide.
    let centre = Vec3::new(1.5, 1.2, ROOM.z);
    let lamp = |p: Vec3| p.z > ROOM.z - 0.01 && (p - centre).abs().truncate().max_element() < 0.15;
    let shine = |p: Vec3, _: Vec3| if lamp(p) { [100.0; 3] } else { [0.5; 3] };
    let coarse = |x, y, yaw| Camera { width: 64, height: 32, ..panorama(Vec3::new(x, y, 0.5), yaw) };
    let cameras = [coarse(1.2, 1.1, 0.7), coarse(2.9, 1.9, 2.9), coarse(0.8, 2.1, 1.7), coarse(2.2, 0.6, 0.1)];
    let images = cameras.map(|camera| filtered_photograph(&scene, &camera, shine));
    let mut backend = CpuBackend::new(scene.clone());
    let atlas = Atlas::new(&mut backend, SIZE).unwrap();
    // Of the ceiling around the lamp: Σ radiance · area beyond the ceiling's own, against the lamp's, and the strongest
    // glow 10 cm beside it.
    let measure = |radiance: &dyn Fn(usize) -> f32| {
        let (mut power, mut truth, mut glow) = (0.0, 0.0, 0.0f32);
        for (i, point) in atlas.points.iter().enumerate().filter(|(_, point)| point.triangle / 2 == 1) {
            let p = Vec3::from(point.position);
            power += radiance(i) - 0.5;
            truth += if lamp(p) { 99.5 } else { 0.0 };
            if (p - centre).abs().truncate().max_element() > 0.25 {
                glow = glow.max(radiance(i));
            }
        }
        (power / truth, glow)
    };
    let tbl = fuse_images(&scene, &cameras, &images, &TblOptions::default());
    let (power, glow) = measure(&|i| tbl.radiance.data[atlas.texels[i] as usize][0]);
    assert!((power - 1.0).abs() < 0.06, "the lamp has {power} of its power");
    assert!(glow < 0.6, "beside the lamp the ceiling shines with {glow}");
    // Negative control: views that are only blended.
    let options = TblOptions::default();
    let fusion = Fusion { scene: &scene, atlas: &atlas, cameras: &cameras, options: &options, progress: &Silent };
    let mut load = |i: usize| Ok(Photo::new(images[i].clone(), None));
    let blended = fusion.blend(&mut backend, &mut load, &atlas.points).unwrap();
    let (power, glow) = measure(&|i| blended[i].map_or(0.5, |radiance| radiance[0]));
    assert!((power - 1.0).abs() > 0.1 || glow > 2.0, "a blend alone has {power} of the power and glows with {glow}");
}

#[test]
fn the_unseen_half_of_a_dark_rim_does_not_shine_with_the_face() {
    // A face of 20 cm and its rim, round in 16 flat sides, of two triangles each.
    const SIDES: u32 = 16;
    let mut mesh = Mesh::default();
    let at = |side: u32, z: f32| {
        let (sin, cos) = (side as f32 * std::f32::consts::TAU / SIDES as f32).sin_cos();
        Vec3::new(0.1 * cos, 0.1 * sin, z)
    };
    for side in 0..SIDES {
        for corners in [
            [at(side, 0.0), at(side, 0.02), at(side + 1, 0.0)],
            [at(side + 1, 0.0), at(side, 0.02), at(side + 1, 0.02)],
        ] {
            mesh.triangles.push([0, 1, 2].map(|k| mesh.positions.len() as u32 + k));
            mesh.positions.extend(corners);
        }
    }
    for side in 0..SIDES {
        mesh.triangles.push([0, 1, 2].map(|k| mesh.positions.len() as u32 + k));
        mesh.positions.extend([Vec3::ZERO, at(side, 0.0), at(side + 1, 0.0)]);
    }
    let connectivity = Connectivity::new(&mesh);
    let rim = connectivity.part(0);
    assert!((0..2 * SIDES).all(|t| connectivity.part(t) == rim), "the rim is one part");
    assert!(
        (2 * SIDES..3 * SIDES)
            .all(|t| connectivity.part(t) == connectivity.part(2 * SIDES) && connectivity.part(t) != rim)
    );
    // One texel in each triangle. Of the rim, the first quarter is seen.
    let point = |triangle: u32| SurfacePoint { position: [0.0; 3], triangle, normal: [0.0; 3], index: triangle };
    let count = mesh.triangles.len();
    let atlas = Atlas {
        width: count,
        height: 1,
        texels: (0..count as u32).collect(),
        points: (0..count as u32).map(point).collect(),
        inside: vec![true; count],
    };
    let shining = |seen_of_rim: usize| {
        let seen: Vec<bool> = (0..count).map(|t| t < seen_of_rim || t >= 2 * SIDES as usize).collect();
        let mut radiance: Vec<[f32; 3]> =
            (0..count).map(|t| if t >= 2 * SIDES as usize { [50.0; 3] } else { [0.1; 3] }).collect();
        unseen::shine(&mesh, &connectivity, &atlas, 1.0, &seen, &mut radiance);
        radiance[..2 * SIDES as usize].iter().filter(|radiance| radiance[0] > 1.0).count()
    };
    assert_eq!(shining(SIDES as usize / 2), 0);
    // Negative control: of a rim that nobody sees, nothing tells that it is not the face's.
    assert_eq!(shining(0), 2 * SIDES as usize);
}

#[test]
fn what_is_behind_a_lamp_in_one_noisy_view_and_dark_in_others_does_not_shine() {
    // A wall, and half a metre before it a lamp, in other places of it for each camera.
    let mut mesh = Mesh::default();
    quad(&mut mesh, 0, Vec3::ZERO, Vec3::X * 4.0, Vec3::Z * 2.5);
    quad(&mut mesh, 1, Vec3::new(0.0, -3.0, 0.0), Vec3::X * 4.0, Vec3::Y * 3.0);
    quad(&mut mesh, 2, Vec3::new(1.9, -0.5, 1.2), Vec3::X * 0.2, Vec3::Z * 0.2);
    let scene = Arc::new(Scene::new(mesh).unwrap());
    let lamp = |p: Vec3| (p - Vec3::new(2.0, -0.5, 1.3)).abs().max_element() < 0.2;
    let shine = |p: Vec3, _: Vec3| if lamp(p) { [100.0; 3] } else { [0.5; 3] };
    let place = |k: usize| Vec3::new(0.5 + 0.25 * k as f32, -2.0, 1.0 + 0.2 * (k % 3) as f32);
    let cameras: Vec<Camera> = (0..12).map(|k| Camera { width: 256, height: 128, ..panorama(place(k), 0.3) }).collect();
    // Images are off by up to 20 %.
    let noisy = |(view, camera): (usize, &Camera)| {
        let mut image = filtered_photograph(&scene, camera, shine);
        image.data.iter_mut().enumerate().for_each(|(i, pixel)| {
            let noise = crate::rng::hash2(i as u32, view as u32) as f32 / u32::MAX as f32 - 0.5;
            *pixel = pixel.map(|v| v * (1.0 + 0.4 * noise));
        });
        image
    };
    let images: Vec<Rgb> = cameras.iter().enumerate().map(noisy).collect();
    let mut backend = CpuBackend::new(scene.clone());
    let atlas = Atlas::new(&mut backend, SIZE).unwrap();
    let is_wall = |texel: usize| atlas.points[texel].triangle < 4;
    let tbl = fuse_images(&scene, &cameras, &images, &TblOptions::default());
    let value = |i: usize| tbl.radiance.data[atlas.texels[i] as usize][0];
    let shining = (0..atlas.points.len()).filter(|&i| is_wall(i) && value(i) > 1.0).count();
    let lamp: Vec<f32> = (0..atlas.points.len()).filter(|&i| !is_wall(i)).map(value).collect();
    let power = lamp.iter().sum::<f32>() / lamp.len() as f32 / 100.0;
    assert!((power - 1.0).abs() < 0.03, "the lamp has {power} of its power");
    // Negative control: only what is beside the lamp is looked at.
    let options = TblOptions::default();
    let fusion = Fusion { scene: &scene, atlas: &atlas, cameras: &cameras, options: &options, progress: &Silent };
    let mut load = |i: usize| Ok(Photo::new(images[i].clone(), None));
    let blended = fusion.blend(&mut backend, &mut load, &atlas.points).unwrap();
    let limit = inpaint::source_limit(&blended);
    let bright: Vec<bool> = blended.iter().map(|b| b.is_some_and(|b| mean_of_channels(b) > limit)).collect();
    let mut looks = source_pixels::SourcePixels::of(cameras.len());
    let at: Vec<usize> = (0..bright.len()).filter(|&t| bright[t]).collect();
    looks.add(&fusion, &mut backend, &mut load, &at).unwrap();
    let once = sources::explained(&fusion, &looks, &blended, (&bright, &Connectivity::new(scene.mesh())));
    let mistaken = once.texels.iter().zip(&once.radiance).filter(|(t, r)| is_wall(**t as usize) && r.x > limit).count();
    assert!(mistaken > 5 && shining == 0, "{shining} texels of the wall shine, {mistaken} without reviews");
}

#[test]
fn a_source_shines_on_its_unseen_sides_and_no_further() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let atlas = Atlas::new(&mut CpuBackend::new(scene.clone()), SIZE).unwrap();
    let face = |point: &SurfacePoint| point.triangle / 2;
    // The floor shines, the ceiling does not, and nobody has seen the walls.
    let seen: Vec<bool> = atlas.points.iter().map(|point| face(point) < 2).collect();
    let known = |point: &SurfacePoint| [[5.0; 3], [0.1; 3], [0.0; 3]][face(point).min(2) as usize];
    let mut radiance: Vec<_> = atlas.points.iter().map(known).collect();
    unseen::shine(scene.mesh(), &Connectivity::new(scene.mesh()), &atlas, 1.0, &seen, &mut radiance);
    for (point, radiance) in atlas.points.iter().zip(&radiance).filter(|(point, _)| face(point) > 1) {
        let at_floor = scene.mesh().corners(point.triangle).iter().filter(|corner| corner.z == 0.0).count() == 2;
        assert_eq!((radiance[0] - 5.0).abs() < 0.01, at_floor, "triangle {}", point.triangle);
    }
    // A floor half of which is dark is no source.
    let mut radiance: Vec<_> = atlas.points.iter().map(known).collect();
    radiance.iter_mut().zip(&seen).step_by(2).filter(|(_, seen)| **seen).for_each(|(light, _)| *light = [0.1; 3]);
    unseen::shine(scene.mesh(), &Connectivity::new(scene.mesh()), &atlas, 1.0, &seen, &mut radiance);
    assert!(atlas.points.iter().zip(&radiance).all(|(point, radiance)| face(point) < 2 || *radiance == [0.0; 3]));
}

#[test]
fn parts_of_a_lamp_across_a_crack_shine_as_all_that_is_seen_of_it() {
    // A strip of floor that is seen, its continuation behind a crack of 3 mm with other vertices, and a table 20 cm on.
    let mut mesh = Mesh::default();
    let (across, up) = (Vec3::Y * 0.2, Vec3::X * 0.2);
    quad(&mut mesh, 0, Vec3::ZERO, up, across);
    quad(&mut mesh, 1, Vec3::new(0.203, 0.0, 0.0), up, across * 0.35);
    quad(&mut mesh, 2, Vec3::new(0.203, 0.07, 0.0), up, across * 0.65);
    quad(&mut mesh, 3, Vec3::new(0.6, 0.0, 0.0), up, across);
    let scene = Arc::new(Scene::new(mesh).unwrap());
    let atlas = Atlas::new(&mut CpuBackend::new(scene.clone()), SIZE).unwrap();
    let face = |point: &SurfacePoint| point.triangle / 2;
    let seen: Vec<bool> = atlas.points.iter().map(|point| face(point) == 0).collect();
    // Beside the crack, what is seen is darker: a tenth of the strip.
    let strip = |point: &SurfacePoint| if point.position[0] > 0.18 { 2.0 } else { 10.0 };
    let mut radiance: Vec<_> =
        atlas.points.iter().zip(&seen).map(|(point, seen)| [if *seen { strip(point) } else { 0.0 }; 3]).collect();
    unseen::shine(scene.mesh(), &Connectivity::new(scene.mesh()), &atlas, 1.0, &seen, &mut radiance);
    for (point, radiance) in atlas.points.iter().zip(&radiance) {
        match face(point) {
            0 => assert_eq!(radiance[0], strip(point)),
            3 => assert_eq!(radiance[0], 0.0),
            face => assert!((radiance[0] - 9.2).abs() < 0.2, "part {face} shines with {}", radiance[0]),
        }
    }
}

#[test]
fn what_others_filled_with_a_lamps_light_is_filled_anew() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let mut backend = CpuBackend::new(scene.clone());
    let atlas = Atlas::new(&mut backend, SIZE).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("view.exr");
    let camera = pinhole(ROOM / 2.0, Vec3::new(4.0, 1.5, 1.0));
    crate::image_io::write_rgb(&path, &photograph(&scene, &camera, |_, _| [0.5; 3])).unwrap();
    let view = View::new("view".into(), camera, crate::capture::Split::Train, path);
    let seen = fuse_images(&scene, &[camera], &[view.load_image(&Silent).unwrap()], &TblOptions::default());
    // What the view does not see was filled by someone else: dimly in one half of the room, with a lamp's light in the
    // other.
    let mut given = seen.clone();
    let dim = |p: Vec3| p.y < 1.5;
    for (&t, point) in atlas.texels.iter().zip(&atlas.points) {
        if given.coverage.data[t as usize] == Coverage::Inpainted {
            given.radiance.data[t as usize] = if dim(point.position.into()) { [0.7; 3] } else { [50.0; 3] };
        }
    }
    let resolved = resolve_sources(&mut backend, &atlas, &given, &[view], &Silent).unwrap();
    let mut filled = [0; 2];
    for (&t, point) in atlas.texels.iter().zip(&atlas.points) {
        if resolved.coverage.data[t as usize] == Coverage::Inpainted {
            let [got, ..] = resolved.radiance.data[t as usize];
            filled[usize::from(dim(point.position.into()))] += 1;
            match dim(point.position.into()) {
                true => assert_eq!(got, 0.7),
                false => assert!((0.499..0.701).contains(&got), "filled with {got}"),
            }
        }
    }
    assert!(filled.iter().all(|texels| *texels > 10), "{filled:?} texels were looked at");
}

#[test]
fn what_pixels_show_to_be_dark_does_not_shine_although_no_texel_of_it_is_seen() {
    // A window pane on a wall, and a reveal that stands out 20 cm at its right, seen at angles that are not blended.
    let mut mesh = room();
    mesh.triangles.truncate(8);
    mesh.positions.truncate(16);
    mesh.normals.truncate(16);
    mesh.uvs.truncate(16);
    let corner = Vec3::new(3.9, 1.0, 0.8);
    quad(&mut mesh, 4, corner, Vec3::Z, Vec3::Y);
    quad(&mut mesh, 5, corner + Vec3::Y, Vec3::Z, -0.2 * Vec3::X);
    let scene = Arc::new(Scene::new(mesh).unwrap());
    let mut backend = CpuBackend::new(scene.clone());
    let atlas = Atlas::new(&mut backend, SIZE).unwrap();
    let pane = |p: Vec3| (p.x - 3.9).abs() < 1e-3 && p.y < 2.0;
    let cameras = [[1.2, 1.4], [1.5, 1.6], [0.8, 1.5], [1.4, 1.3]].map(|[x, y]| Camera {
        width: 128,
        height: 64,
        ..panorama(Vec3::new(x, y, 1.3), x)
    });
    let shine = |p: Vec3, _: Vec3| if pane(p) { [20.0; 3] } else { [0.5; 3] };
    let images = cameras.map(|camera| filtered_photograph(&scene, &camera, shine));
    let options = TblOptions { min_cosine: 0.5, ..TblOptions::default() };
    let tbl = fuse_images(&scene, &cameras, &images, &options);
    let texels = |face: u32| {
        let of_face = move |(_, point): &(&u32, &SurfacePoint)| point.triangle / 2 == face;
        atlas.texels.iter().zip(&atlas.points).filter(of_face).map(|(&t, _)| t as usize)
    };
    let mean = |radiance: Vec<f32>| radiance.iter().sum::<f32>() / radiance.len() as f32;
    let of_pane = mean(texels(4).map(|t| tbl.radiance.data[t][0]).collect());
    assert!((of_pane / 20.0 - 1.0).abs() < 0.05, "the pane shines with {of_pane}");
    let unseen: Vec<usize> = texels(5).filter(|&t| tbl.coverage.data[t] == Coverage::Inpainted).collect();
    assert!(unseen.len() > texels(5).count() / 2, "{} texels of the reveal are unseen", unseen.len());
    let of_reveal = mean(unseen.iter().map(|&t| tbl.radiance.data[t][0]).collect());
    assert!(of_reveal < 1.0, "the reveal shines with {of_reveal}");
}

#[test]
fn the_gutter_repeats_the_chart_and_counts_as_outside() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let camera = panorama(ROOM / 2.0, 0.0);
    let image = Rgb::filled(camera.width, camera.height, [0.7; 3]);
    for gutter in [0, 3] {
        let options = TblOptions { gutter, ..TblOptions::default() };
        let tbl = fuse_images(&scene, &[camera], std::slice::from_ref(&image), &options);
        let lit = tbl.radiance.data.iter().zip(&tbl.coverage.data);
        let lit_outside = lit.filter(|(l, c)| **c == Coverage::Outside && l[0] > 0.0);
        assert_eq!(lit_outside.clone().count() > 0, gutter > 0);
        assert!(lit_outside.clone().all(|(l, _)| (l[0] - 0.7).abs() < 1e-5));
    }
}

#[test]
fn the_result_does_not_depend_on_the_order_of_views_or_the_run() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let mut cameras = cameras();
    let images: Vec<Rgb> = cameras.iter().map(|c| photograph(&scene, c, |p, _| pattern(p))).collect();
    let options = TblOptions::default();
    let first = fuse_images(&scene, &cameras[2..], &images[2..], &options);
    assert_eq!(first, fuse_images(&scene, &cameras[2..], &images[2..], &options));
    let forward = fuse_images(&scene, &cameras, &images, &options);
    cameras.reverse();
    let images: Vec<Rgb> = images.into_iter().rev().collect();
    let backward = fuse_images(&scene, &cameras, &images, &options);
    for (a, b) in forward.radiance.data.iter().zip(&backward.radiance.data) {
        assert!((0..3).all(|c| (a[c] - b[c]).abs() <= 1e-5 * a[c]), "{a:?} against {b:?}");
    }
}

#[test]
fn unusable_input_is_an_error() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let inside = panorama(ROOM / 2.0, 0.0);
    let fails = |camera: Camera, image: Rgb, options: TblOptions, says: &str| {
        let result = fused(&scene, &[camera], |_| Ok(Photo::new(image.clone(), None)), &options);
        let error = result.unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    };
    let grey = Rgb::filled(512, 256, [0.5; 3]);
    let options = TblOptions::default();
    fails(inside, Rgb::filled(8, 8, [0.5; 3]), options, "pixels");
    fails(panorama(ROOM * 3.0, 0.0), grey.clone(), options, "sees the mesh");
    fails(inside, grey.map(|_| [f32::NAN; 3]), options, "sees the mesh");
    fails(inside, grey, TblOptions { quantile: 1.5, ..options }, "TblOptions::quantile is 1.5");
}

/// Cameras in the corners and the middle of the room.
fn many_cameras() -> Vec<Camera> {
    let positions = [[0.7, 0.6], [3.3, 0.7], [0.8, 2.4], [3.2, 2.3], [2.0, 1.5]];
    positions.map(|[x, y]| Camera { width: 256, height: 128, ..panorama(Vec3::new(x, y, 1.3), x) }).into()
}

/// Paints a box of 20 × 25 pixels into an image; returns its pixels.
fn paint(image: &mut Rgb, radiance: [f32; 3]) -> Vec<usize> {
    let pixels: Vec<usize> = (0..20 * 25).map(|i| (55 + i / 20) * image.width + 100 + i % 20).collect();
    pixels.iter().for_each(|&pixel| image.data[pixel] = radiance);
    pixels
}

#[test]
fn somebody_who_walks_by_leaves_no_ghost() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let cameras = many_cameras();
    let images: Vec<Rgb> = cameras.iter().map(|c| photograph(&scene, c, |p, _| pattern(p))).collect();
    let options = TblOptions::default();
    let largest = |images: &[Rgb], options: &TblOptions| {
        let tbl = fuse_images(&scene, &cameras, images, options);
        let atlas = Atlas::new(&mut CpuBackend::new(scene.clone()), SIZE).unwrap();
        let off = |(texel, point): (&u32, &SurfacePoint)| {
            (tbl.radiance.data[*texel as usize][0] / pattern(point.position.into())[0]).ln().abs()
        };
        atlas.texels.iter().zip(&atlas.points).map(off).fold(0.0, f32::max)
    };
    let empty = largest(&images, &options);
    for radiance in [[0.1; 3], [3.0; 3]] {
        let mut images = images.clone();
        paint(&mut images[4], radiance);
        let robust = largest(&images, &options);
        assert!(robust < empty + 0.05, "a box of {radiance:?} changes a texel by {robust}; without it: {empty}");
        // Negative control: a blend that believes every view. (Something dark in one of many takes little in any case.)
        if radiance[0] > 1.0 {
            let plain = largest(&images, &TblOptions { tolerance: 1e6, quantile: 0.0, ..options });
            assert!(
                plain > 0.3 && plain > empty + 0.03,
                "without rejection it changes a texel by {plain}, without the box by {empty}"
            );
        }
    }
}

#[test]
fn masks_are_obeyed_but_hide_no_light() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let lamp = |p: Vec3| p.z > ROOM.z - 0.01 && (p.x - 2.0).abs() < 0.5 && (p.y - 1.5).abs() < 0.4;
    let shine = |p: Vec3| if lamp(p) { [50.0; 3] } else { pattern(p) };
    // One camera: nothing outvotes the rig that stands in its picture.
    let camera = panorama(Vec3::new(1.4, 1.2, 1.3), 0.3);
    let mut image = filtered_photograph(&scene, &camera, |p, _| shine(p));
    let unmasked_lamp = image.map(|radiance| radiance[0] < 10.0);
    let rig = paint(&mut image, [0.02, 0.01, 0.01]);
    let mut unmasked = unmasked_lamp.clone();
    rig.iter().for_each(|&pixel| unmasked.data[pixel] = false);
    let tbl = |mask: Option<Mask>| {
        let load = |_| Ok(Photo::new(image.clone(), mask.clone()));
        fused(&scene, &[camera], load, &TblOptions::default()).unwrap()
    };
    let dark = |tbl: &Tbl| {
        let seen = tbl.coverage.data.iter().zip(&tbl.radiance.data).filter(|(c, _)| **c == Coverage::Seen);
        seen.filter(|(_, radiance)| radiance[0] < 0.3).count()
    };
    let with = tbl(Some(unmasked));
    assert_eq!(dark(&with), 0);
    // Negative control: a mask that forgets the rig.
    assert!(dark(&tbl(Some(unmasked_lamp))) > 100);
    let off = inside_lamp(&scene, &with, 50.0, lamp);
    assert!(off < 0.05, "the masked lamp's radiance is off by {off}");
}

#[test]
fn exposures_come_back_and_leave_no_seam() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let cameras = many_cameras();
    let gains: [[f32; 3]; 5] = [[1.9, 1.7, 1.8], [0.6, 0.6, 0.7], [1.0, 1.1, 0.9], [0.4, 0.5, 0.4], [1.3, 1.3, 1.5]];
    // A highlight that moves with the camera must not be taken for exposure.
    let glossy =
        |p: Vec3, to_camera: Vec3| pattern(p).map(|l| if to_camera.z > 0.9 && p.z < 0.01 { l * 5.0 } else { l });
    let exposed = |(camera, gain): (&Camera, &[f32; 3])| {
        photograph(&scene, camera, glossy).map(|l| std::array::from_fn(|c| l[c] * gain[c]))
    };
    let images: Vec<Rgb> = cameras.iter().zip(&gains).map(exposed).collect();
    let load = |i: usize| Ok(Photo::new(images[i].clone(), None));
    let factors = exposure::solve_photos(&mut CpuBackend::new(scene.clone()), &cameras, load, &Silent).unwrap();
    let middle: [f32; 3] = std::array::from_fn(|c| {
        let mut of_channel: Vec<f32> = gains.iter().map(|gain| gain[c]).collect();
        of_channel.sort_by(f32::total_cmp);
        of_channel[2]
    });
    for c in 0..3 {
        for (gain, factor) in gains.iter().zip(&factors) {
            let off = (gain[c] * factor[c] / middle[c]).ln();
            assert!(off.abs() < 0.01, "channel {c} of {gain:?} is off by {off} after {factor:?}");
        }
    }
    let corrected = |(image, factor): (&Rgb, &[f32; 3])| image.map(|l| std::array::from_fn(|c| l[c] * factor[c]));
    let corrected: Vec<Rgb> = images.iter().zip(&factors).map(corrected).collect();
    let truth = |p: Vec3| std::array::from_fn(|c| pattern(p)[c] * middle[c]);
    let of = |images: &[Rgb]| {
        error(&scene, &fuse_images(&scene, &cameras, images, &TblOptions::default()), Coverage::Seen, truth)
    };
    let (with, without) = (of(&corrected), of(&images));
    assert!(with < 0.015 && without > 0.1, "mean relative error {with} with exposures solved, {without} without");
}

#[test]
fn what_is_reflected_at_grazing_angles_is_no_exposure() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    // One shows the floor alone, most of it at grazing angles, and two show all of it from above.
    let cameras = [
        panorama(Vec3::new(2.0, 1.5, 1.3), 0.3),
        pinhole(Vec3::new(1.0, 1.5, 0.2), Vec3::new(2.0, 1.5, -0.5)),
        panorama(Vec3::new(2.5, 1.0, 1.5), 0.7),
    ];
    let glossy = |p: Vec3, to_camera: Vec3| {
        let to_wall = p.min(ROOM - p);
        let cosine = to_camera[to_wall.min_position()].abs();
        pattern(p).map(|l| l * (1.0 + (1.0 - cosine).powi(5)))
    };
    let brighter = |min_cosine: f32| {
        let load = |i: usize| Ok(Photo::new(photograph(&scene, &cameras[i], glossy), None));
        let mut backend = CpuBackend::new(scene.clone());
        let texels = exposure::sightings(&mut backend, &cameras, load, min_cosine, &Silent).unwrap();
        let [above, along, again] = exposure::exposures(&texels, 3).unwrap()[..] else { panic!("three views") };
        [along[0] - above[0], again[0] - above[0]]
    };
    let told = brighter(exposure::MIN_COSINE);
    assert!(told.iter().all(|by| by.abs() < 0.04), "views that are exposed alike differ by {told:?}");
    // Negative control.
    let by_all = brighter(0.1);
    assert!(by_all[0] > 0.1 && by_all[1].abs() < 0.04, "{by_all:?}");
}

/// Cameras moved by so many metres and radians, each another way.
fn out_of_place(cameras: &[Camera], metres: f32, radians: f32) -> Vec<Camera> {
    let moved = |(i, camera): (usize, &Camera)| {
        let way =
            |phase: f32| Vec3::new((i as f32 + phase).sin(), (2.3 * i as f32 + phase).cos(), (1.7 * i as f32).sin());
        let turn = glam::Quat::from_scaled_axis(way(0.5).normalize() * radians);
        let motion = Mat4::from_rotation_translation(turn, way(0.0).normalize() * metres);
        Camera { world_from_camera: camera.world_from_camera * motion, ..*camera }
    };
    cameras.iter().enumerate().map(moved).collect()
}

/// How far cameras are from where they should be, metres and radians, in the mean.
fn off(cameras: &[Camera], truth: &[Camera]) -> (f32, f32) {
    let pairs = || cameras.iter().zip(truth);
    let shift: f32 = pairs().map(|(a, b)| a.position().distance(b.position())).sum();
    let turn = |a: &Camera, b: &Camera| {
        let [a, b] = [a, b].map(|c| glam::Quat::from_mat4(&c.world_from_camera));
        a.angle_between(b)
    };
    (shift / truth.len() as f32, pairs().map(|(a, b)| turn(a, b)).sum::<f32>() / truth.len() as f32)
}

/// Cameras that are refined by what their images show.
fn refined(scene: &Arc<Scene>, cameras: &[Camera], images: &[Rgb]) -> Vec<Camera> {
    let picture = |(camera, image): (&Camera, &Rgb)| {
        pose::Picture::new(*camera, &image.map(|radiance| mean_of_channels(*radiance)), 1.0)
    };
    let pictures: Vec<_> = cameras.iter().zip(images).map(picture).collect();
    let mut backend = CpuBackend::new(scene.clone());
    let points: Vec<SurfacePoint> = pose::points(&mut backend).unwrap().into_iter().step_by(6).collect();
    let refined = pose::refine_pictures(&mut backend, &pictures, &points, 6, &Silent).unwrap();
    refined.into_iter().map(|picture| picture.camera).collect()
}

#[test]
fn small_errors_of_poses_are_lessened() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let truth = many_cameras();
    let images: Vec<Rgb> = truth.iter().map(|c| photograph(&scene, c, |p, _| pattern(p))).collect();
    // .7 pixels.
    let cameras = out_of_place(&truth, 0.02, 1_f32.to_radians());
    for exposure in [1.0, 2.0] {
        // The first view's, which is no motion.
        let mut exposed = images.clone();
        exposed[0] = images[0].map(|l| l.map(|l| exposure * l));
        let (before, after) = (off(&cameras, &truth), off(&refined(&scene, &cameras, &exposed), &truth));
        assert!(
            after.0 < 0.5 * before.0 && after.1 < 0.5 * before.1,
            "poses were off by {before:?}, are by {after:?} at an exposure of {exposure}"
        );
    }
}

#[test]
fn views_that_are_in_place_stay_where_they_are() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let truth = many_cameras();
    let images: Vec<Rgb> = truth.iter().map(|c| photograph(&scene, c, |p, _| pattern(p))).collect();
    let cameras = |off: f32| -> Vec<Camera> {
        let all = out_of_place(&truth, 0.0, off);
        truth.iter().enumerate().map(|(i, camera)| if i == 3 { all[i] } else { *camera }).collect()
    };
    let pixel = truth[0].pixel_angle();
    // The third of a pixel is no more than what highlights move views by.
    assert!(refined(&scene, &cameras(0.3 * pixel), &images) == cameras(0.3 * pixel));
    let found = refined(&scene, &cameras(2.0 * pixel), &images);
    let others = [0, 1, 2, 4];
    assert!(others.iter().all(|&i| found[i] == truth[i]), "they moved as well");
    let left = off(&found[3..4], &truth[3..4]).1;
    assert!(left < 0.2 * pixel, "{left}, pixels are {pixel} wide");
}

#[test]
fn views_of_plain_walls_stay_where_they_are() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let truth = many_cameras();
    // White but for a lamp, of which pixels show the rim more or less.
    let lamp = |p: Vec3| if p.z > ROOM.z - 0.01 && p.distance(Vec3::new(2.0, 1.5, ROOM.z)) < 0.3 { 20.0 } else { 0.2 };
    let photographs = |paint: &dyn Fn(Vec3) -> [f32; 3]| -> Vec<Rgb> {
        truth.iter().map(|camera| photograph(&scene, camera, |p, _| paint(p))).collect()
    };
    let cameras = out_of_place(&truth, 0.02, 1_f32.to_radians());
    let plain = photographs(&|p| [lamp(p); 3]);
    assert!(refined(&scene, &truth, &plain) == truth);
    assert!(refined(&scene, &cameras, &plain) == cameras, "a lamp does not tell where the walls are");
    // Negative control: on walls that are painted, the same errors are seen.
    let painted = photographs(&|p| pattern(p).map(|l| l * lamp(p)));
    assert!(off(&refined(&scene, &cameras, &painted), &truth).1 < 0.5 * off(&cameras, &truth).1);
}

#[test]
fn poses_that_are_off_by_many_pixels_are_found() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let truth: Vec<Camera> = many_cameras().iter().map(|camera| camera.supersampled(2)).collect();
    // What is 8 cm wide from crest to crest is seen in 4 to 16 pixels.
    let detailed = |p: Vec3| {
        let (wide, narrow) = (pattern(p), pattern(15.0 * p));
        std::array::from_fn(|c| wide[c] * narrow[c])
    };
    let images: Vec<Rgb> = truth.iter().map(|c| photograph(&scene, c, |p, _| detailed(p))).collect();
    let cameras = out_of_place(&truth, 0.03, 4_f32.to_radians());
    let after = off(&refined(&scene, &cameras, &images), &truth);
    // At a metre, for the shift; in pixels of one width, 5.4 of 5.7 are left.
    let pixel = truth[0].pixel_angle();
    assert!(after.0 < 0.5 * pixel && after.1 < 0.5 * pixel, "poses are off by {after:?}, pixels are {pixel} wide");
}

#[test]
fn views_that_are_out_of_place_are_told_of() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let views = written(&scene, folder.path(), 1.0);
    let told = |cameras: &[Camera]| {
        let posed = |(view, camera): (&View, &Camera)| View { camera: *camera, ..view.clone() };
        let views: Vec<View> = views.iter().zip(cameras).map(posed).collect();
        pose::out_of_place(&mut CpuBackend::new(scene.clone()), &views, &Silent).unwrap()
    };
    let truth = many_cameras();
    assert_eq!(told(&truth), [None; 5]);
    // A fifth of a pixel, of 1.4°.
    assert_eq!(told(&out_of_place(&truth, 0.0, 0.3_f32.to_radians())), [None; 5]);
    // 2.1 pixels.
    let cameras = out_of_place(&truth, 0.0, 3_f32.to_radians());
    let pixels = told(&cameras);
    assert!(pixels.iter().all(|pixels| pixels.is_some_and(|pixels| (0.7..2.8).contains(&pixels))), "{pixels:?}");
    // One alone is told of most, though five views are few to tell which it is.
    let one = told(&[&truth[..4], &cameras[4..]].concat());
    assert!(one[4].is_some_and(|most| one[..4].iter().flatten().all(|pixels| *pixels < 0.6 * most)), "{one:?}");
}

#[test]
fn blur_is_told_from_reflections_and_exposure() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let cameras = many_cameras();
    // 17 cm from crest to crest, a floor that mirrors, and exposures that differ.
    let fine = |p: Vec3, to_camera: Vec3| {
        let gloss = if to_camera.z > 0.8 && p.z < 0.01 { 1.5 } else { 1.0 };
        pattern(p * 4.0).map(|l| gloss * l)
    };
    let photo = |(i, camera): (usize, &Camera)| {
        let image = photograph(&scene, &camera.supersampled(4), fine).reduced(4, mean_pixel);
        image.map(|l| l.map(|l| l * (1.0 + 0.1 * i as f32)))
    };
    let sharp: Vec<Rgb> = cameras.iter().enumerate().map(photo).collect();
    let spread = |image: &Rgb| {
        let along = |image: &Rgb, dx: f64, dy: f64| {
            let read = |i: usize, k: f64| {
                let place = glam::DVec2::new((i % image.width) as f64 + 0.5, (i / image.width) as f64 + 0.5);
                image.data[image.around(place + k * glam::DVec2::new(dx, dy), true)[0].0]
            };
            let of_pixel = |i| {
                let [a, b, c] = [read(i, -1.0), read(i, 0.0), read(i, 1.0)];
                [0, 1, 2].map(|k| (a[k] + 10.0 * b[k] + c[k]) / 12.0)
            };
            Rgb { data: (0..image.data.len()).map(of_pixel).collect(), ..*image }
        };
        along(&along(image, 1.0, 0.0), 0.0, 1.0)
    };
    let blurred: Vec<Rgb> = sharp.iter().map(spread).collect();
    let measure = |images: &[Rgb], cameras: &[Camera]| {
        let load = |i: usize| Ok(Photo::new(images[i].clone(), None));
        blur::measure_photos(&mut CpuBackend::new(scene.clone()), cameras, load, &Silent).unwrap()
    };
    let [before, after] = [&sharp, &blurred].map(|images| measure(images, &cameras).unwrap());
    assert!(before < 0.03 && (after - 1.0 / 6.0).abs() < 0.03, "{before} of sharp images, {after} of blurred ones");
    assert_eq!(measure(&sharp[..1], &cameras[..1]), None);
    // Noise is no blur, where there is a pattern and where there is none.
    let noisy = |image: &Rgb, seed: u32| {
        let random = |i: usize, k: u32| crate::rng::hash2(seed + i as u32, k) as f32 / u32::MAX as f32;
        let of_pixel = |(i, l): (usize, &[f32; 3])| l.map(|l| l * (1.0 + 0.2 * (random(i, 0) - 0.5)));
        Rgb { data: image.data.iter().enumerate().map(of_pixel).collect(), ..*image }
    };
    let plain: Vec<Rgb> = cameras.iter().map(|camera| photograph(&scene, camera, |_, _| [1.0; 3])).collect();
    for images in [sharp, plain] {
        let noisy: Vec<Rgb> = (0..).zip(&images).map(|(i, image)| noisy(image, i << 20)).collect();
        let measured = measure(&noisy, &cameras);
        assert!(measured.is_none_or(|blur| blur < blur::SHARP), "{measured:?} of noisy images");
    }
}

/// Views of the room's pattern on disk, times `factor`.
fn written(scene: &Arc<Scene>, folder: &Path, factor: f32) -> Vec<View> {
    let view = |(i, camera): (usize, &Camera)| {
        // Exposures that differ, so that there is something to be solved.
        let gain = factor * [1.0, 1.6, 0.7, 1.2, 0.9][i];
        let image = photograph(scene, camera, |p, _| pattern(p)).map(|l| l.map(|l| l * gain));
        let path = folder.join(format!("{i} of {factor:e}.exr"));
        write_rgb(&path, &image).unwrap();
        View::new(i.to_string(), *camera, Split::Train, path)
    };
    many_cameras().iter().enumerate().map(view).collect()
}

#[test]
fn light_may_be_in_any_unit() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let solved = |exponent: i32| {
        let factor = f32::powi(2.0, exponent);
        let views = written(&scene, folder.path(), factor);
        let mut backend = CpuBackend::new(scene.clone());
        let exposures = exposure::solve(&mut backend, &views, &Silent).unwrap();
        let poses = pose::refine(&mut backend, &views[..2], &Silent).unwrap();
        let built = build(&mut backend, &views, [64, 64], &TblOptions::default(), &Silent).unwrap();
        let radiance: Vec<[f32; 3]> = built.radiance.data.iter().map(|l| l.map(|l| l / factor)).collect();
        (exposures, poses, radiance)
    };
    let usual = solved(0);
    assert!(usual.0.iter().any(|factor| (factor[0] - 1.0).abs() > 0.1), "there is something to be solved");
    for exponent in [-20, 10] {
        assert!(solved(exponent) == usual, "in a unit of 2^{exponent}");
    }
}

#[test]
fn exposures_of_views_that_show_nothing_alike_are_an_error() {
    let scene = Arc::new(Scene::new(room()).unwrap());
    let folder = tempfile::tempdir().unwrap();
    let views = written(&scene, folder.path(), 1.0);
    let error = exposure::solve(&mut CpuBackend::new(scene), &views[..1], &Silent).unwrap_err().to_string();
    assert!(error.contains("no surface is seen by two views"), "{error}");
}
