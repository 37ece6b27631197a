use glam::{Mat4, Vec2, Vec3};
use rayon::prelude::*;

use super::chart::{Chart, Faces, Frame, Look, Rect, block};
use super::paint::Paint;
use super::random::{Random, Sample};
use super::shell::Wall;
use super::trace::{Vertex, World, around, sample_lobe};
use super::*;
use crate::camera::{Camera, Projection};
use crate::capture::{LoadOptions, Split, load};
use crate::image_io::read_rgb;
use crate::mesh_io::atlas_report;
use crate::progress::Silent;

fn small(seed: u64, rooms: usize) -> Flat {
    Flat::generate(&FlatOptions { seed, rooms, atlas: 512, ..FlatOptions::default() }).unwrap()
}

/// A closed box of 3 × 2 × 2.5 m seen from inside, with one paint, and what `more` puts into it.
fn closed_box(paint: Paint, more: impl Fn(&mut Vec<Chart>)) -> Flat {
    let room = Room { id: 1, kind: RoomKind::Study, lo: Vec2::ZERO, hi: Vec2::new(3.0, 2.0) };
    let look = Look { paint, class: class::WALL, room: 1 };
    let (lines, height) = (vec![0.0, 1.0, 2.0, 3.0], 2.5);
    let mut charts = vec![
        Chart::plane(look, Vec3::ZERO, Vec3::X, Vec3::Y, lines.clone(), vec![0.0, 1.0, 2.0]),
        Chart::plane(look, Vec3::new(0.0, 2.0, height), Vec3::X, -Vec3::Y, lines, vec![0.0, 1.0, 2.0]),
    ];
    for wall in Wall::of(Rect::new(room.lo, room.hi)) {
        let columns = chart::split_lines(wall.length);
        charts.push(Chart::plane(look, wall.origin, wall.right, Vec3::Z, columns, vec![0.0, 1.25, height]));
    }
    more(&mut charts);
    let options =
        FlatOptions { paint: PaintStyle::Plain, roughness_variation: 0.0, atlas: 256, ..FlatOptions::default() };
    atlas::build(charts, vec![room], &options).unwrap()
}

fn panorama(position: Vec3, height: usize) -> Panorama {
    let camera = Camera {
        projection: Projection::Equirectangular,
        width: 2 * height,
        height,
        world_from_camera: Mat4::from_translation(position),
    };
    Panorama { name: "pano".into(), camera, split: Split::Train, room_id: 1 }
}

#[test]
fn charts_share_no_texel_and_keep_their_distance() {
    for (seed, rooms) in [(1, 3), (2, 4), (3, 5)] {
        let flat = small(seed, rooms);
        let report = atlas_report(&flat.mesh, [512; 2]);
        assert_eq!(report.overlapping_fraction, 0.0);
        assert_eq!(report.outside_unit_square_triangles, 0);
        assert!(report.covered_fraction > 0.5, "the atlas is mostly empty: {}", report.covered_fraction);
        for (i, a) in flat.places.iter().enumerate() {
            assert!(a.x + a.width <= 512 && a.y + a.height <= 512);
            for b in &flat.places[..i] {
                let apart =
                    |a0: usize, a1: usize, b0: usize, b1: usize| a1 + atlas::GUTTER <= b0 || b1 + atlas::GUTTER <= a0;
                let clear =
                    apart(a.x, a.x + a.width, b.x, b.x + b.width) || apart(a.y, a.y + a.height, b.y, b.y + b.height);
                assert!(clear, "{a:?} is too near to {b:?}");
            }
        }
    }
}

/// The share of rays, over two bounces from where cameras may stand, that meet nothing, and that meet a back.
fn misses_and_backs(flat: &Flat) -> (f64, f64) {
    let world = World::new(flat).unwrap();
    let options = PanoramaOptions { train: 8, novel: 0, ..PanoramaOptions::default() };
    let (mut rays, mut misses, mut backs) = (0, 0, 0);
    for shot in panoramas(flat, &options, &Silent).unwrap() {
        for i in 0..4096 {
            let mut sample = Sample::new(7, i);
            let [u, v] = sample.pair();
            let (mut origin, mut direction) = (shot.camera.position(), around(Vec3::Z, 1.0 - 2.0 * u, v));
            for _ in 0..2 {
                rays += 1;
                let Some(hit) = world.closest(origin, direction) else {
                    misses += 1;
                    break;
                };
                backs += usize::from(!hit.front);
                let [u, v] = sample.pair();
                // About the face, not the shading normal: of a facetted ball, that lets rays into its inside.
                let face = flat.mesh.face_normal(hit.triangle);
                (origin, direction) = (hit.position, around(face, (1.0 - u).sqrt(), v));
            }
        }
    }
    (misses as f64 / f64::from(rays), backs as f64 / f64::from(rays))
}

#[test]
fn the_flat_is_closed_and_faces_its_free_space() {
    for (seed, rooms) in [(1, 3), (5, 4), (6, 5)] {
        let (misses, backs) = misses_and_backs(&small(seed, rooms));
        assert!(misses < 1e-4, "seed {seed}: {misses} of the rays leave the flat");
        assert!(backs < 2e-4, "seed {seed}: {backs} of the rays meet the inside of something");
    }
    // Negative control: with one triangle of a floor turned over, backs are seen.
    let mut flat = small(1, 3);
    for triangle in &mut flat.mesh.triangles[..40] {
        triangle.swap(1, 2);
    }
    assert!(misses_and_backs(&flat).1 > 1e-3);
}

#[test]
fn truths_are_within_their_ranges_and_labelled() {
    let flat = small(4, 3);
    let labelled: Vec<usize> = (0..flat.semantic.data.len()).filter(|&i| flat.semantic.data[i] != 0).collect();
    assert!(!labelled.is_empty());
    for &i in &labelled {
        assert!(flat.albedo.data[i].iter().all(|a| (0.03..=0.85).contains(a)));
        assert!((0.05..=0.95).contains(&flat.roughness.data[i]));
        assert!((1..=3).contains(&flat.room.data[i]));
    }
    let classes: std::collections::BTreeSet<u16> = flat.semantic.data.iter().copied().collect();
    assert!(classes.len() >= 14, "classes: {classes:?}");
    // Plain paint takes the patterns out of the albedo, not out of the roughness.
    let options = FlatOptions { seed: 4, atlas: 512, paint: PaintStyle::Plain, roughness_variation: 2.0, rooms: 3 };
    let plain = Flat::generate(&options).unwrap();
    let floor: Vec<usize> =
        labelled.into_iter().filter(|&i| flat.semantic.data[i] == class::FLOOR && flat.room.data[i] == 1).collect();
    let distinct = |values: Vec<u32>| values.into_iter().collect::<std::collections::BTreeSet<_>>().len();
    let reds = |flat: &Flat| distinct(floor.iter().map(|&i| flat.albedo.data[i][0].to_bits()).collect());
    assert!(reds(&flat) > 50 && reds(&plain) < 5);
    assert!(distinct(floor.iter().map(|&i| plain.roughness.data[i].to_bits()).collect()) > 50);
}

#[test]
fn options_out_of_range_are_refused() {
    let bad = [
        FlatOptions { rooms: 2, ..FlatOptions::default() },
        FlatOptions { atlas: 130, ..FlatOptions::default() },
        FlatOptions { roughness_variation: f32::NAN, ..FlatOptions::default() },
    ];
    for options in bad {
        assert!(Flat::generate(&options).is_err(), "{options:?}");
    }
    let flat = small(1, 3);
    assert!(panoramas(&flat, &PanoramaOptions { train: 2, ..PanoramaOptions::default() }, &Silent).is_err());
}

#[test]
fn furnace_shows_its_geometric_series() {
    // Everything emits e and reflects a: L = e + a·L, so L = e / (1 − a).
    let (albedo, emission) = (0.6, 0.5);
    let paint = Paint { base: Vec3::splat(albedo), ..Paint::light(Vec3::splat(emission)) };
    let flat = closed_box(paint, |_| ());
    let options = RenderOptions { specular_bounces: 0, pixel_samples: 4, ..RenderOptions::default() };
    let views = render(&flat, &[panorama(Vec3::new(1.2, 0.9, 1.1), 16)], &options, &Silent).unwrap();
    let expected = emission / (1.0 - albedo);
    let pixels = &views[0].image.data;
    let mean = pixels.iter().map(|p| p[1]).sum::<f32>() / pixels.len() as f32;
    assert!((mean / expected - 1.0).abs() < 3e-3, "mean {mean}, expected {expected}");
    for pixel in pixels {
        assert!((pixel[1] / expected - 1.0).abs() < 0.05, "{pixel:?}, expected {expected}");
    }
    assert!(views[0].mask.data.iter().all(|used| !used), "emitters are masked");
}

/// Radiance along a ray by plain path tracing: no irradiance, no emitter sampling, no limit on specular chains.
fn path_traced(world: &World, mut origin: Vec3, mut direction: Vec3, random: &mut Random) -> Vec3 {
    let (mut radiance, mut throughput) = (Vec3::ZERO, Vec3::ONE);
    for _ in 0..24 {
        let Some(hit) = world.closest(origin, direction) else { break };
        radiance += throughput * world.emission(&hit);
        let (view, pick) = (-direction, [random.unit(), random.unit()]);
        // One of the two lobes, the dimmer one less often.
        const DIFFUSE: f32 = 0.85;
        if random.unit() < DIFFUSE {
            direction = around(hit.normal, (1.0 - pick[0]).sqrt(), pick[1]);
            throughput *= world.albedo(hit.uv) / DIFFUSE;
        } else {
            let Vertex { normal, uv, .. } = hit;
            let Some(drawn) = sample_lobe(normal, view, world.roughness(uv), pick) else { break };
            direction = drawn.direction;
            throughput *= drawn.weight / (1.0 - DIFFUSE);
        }
        origin = hit.position;
    }
    radiance
}

#[test]
fn images_agree_with_plain_path_tracing() {
    let lamp = Look { paint: Paint::light(Vec3::new(4.0, 3.0, 2.0)), class: class::LAMP, room: 1 };
    let flat = closed_box(Paint::flat(Vec3::new(0.7, 0.5, 0.3), 0.3), |charts| {
        let frame = Frame::facing(Vec3::new(0.7, 0.5, 0.0), Vec3::Y);
        block(charts, lamp, frame, Vec3::new(0.0, 0.0, 1.2), Vec3::new(0.8, 0.7, 1.6), Faces::ALL);
    });
    let shot = panorama(Vec3::new(2.3, 1.4, 1.0), 8);
    let options = RenderOptions { pixel_samples: 64, ..RenderOptions::default() };
    let view = render(&flat, std::slice::from_ref(&shot), &options, &Silent).unwrap().remove(0);
    let world = World::new(&flat).unwrap();
    let matte = RenderOptions { specular_bounces: 0, ..options };
    let matte = render(&flat, std::slice::from_ref(&shot), &matte, &Silent).unwrap().remove(0);
    let [width, height] = view.image.size();
    // Edges of the lamp would drown the comparison in the noise of their coverage.
    let is_clear = |i: &usize| {
        let (x, y) = (i % width, i / width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        rows.into_iter().all(|y| (0..3).all(|dx| *view.mask.at((x + width + dx - 1) % width, y)))
    };
    let clear: Vec<usize> = (0..width * height).filter(is_clear).collect();
    let sum = |image: &Rgb| clear.iter().map(|&i| Vec3::from(image.data[i])).sum::<Vec3>();
    let (ours, diffuse) = (sum(&view.image), sum(&matte.image));
    let traced: Vec<Vec3> = clear
        .par_iter()
        .map(|&i| {
            const PATHS: usize = 8000;
            let mut random = Random::new(3, i as u32);
            let mut sum = Vec3::ZERO;
            for _ in 0..PATHS {
                let (x, y) = ((i % width) as f32 + random.unit(), (i / width) as f32 + random.unit());
                sum += path_traced(&world, shot.camera.position(), shot.camera.direction(x, y), &mut random);
            }
            sum / PATHS as f32
        })
        .collect();
    let reference: Vec3 = traced.into_iter().sum();
    let error = (ours / reference - 1.0).abs().max_element();
    assert!(error < 0.012, "{ours} against {reference}");
    // Negative control: without specular reflections the difference shows.
    assert!((diffuse / reference - 1.0).abs().max_element() > 0.03, "{diffuse} against {reference}");
}

#[test]
fn a_seed_gives_the_same_images_on_any_number_of_threads() {
    let run = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let flat = Flat::generate(&FlatOptions { seed, atlas: 256, ..FlatOptions::default() }).unwrap();
            let cameras = panoramas(&flat, &PanoramaOptions { height: 8, train: 3, novel: 0, seed }, &Silent).unwrap();
            let options =
                RenderOptions { seed, pixel_samples: 2, light_samples: 2, gather_rays: 4, specular_bounces: 2 };
            let views = render(&flat, &cameras, &options, &Silent).unwrap();
            views.into_iter().map(|view| view.image).collect::<Vec<_>>()
        })
    };
    let first = run(1, 9);
    assert_eq!(first, run(3, 9));
    assert_ne!(first, run(1, 10));
}

#[test]
fn what_is_written_loads_as_a_capture() {
    let flat = Flat::generate(&FlatOptions { atlas: 256, ..FlatOptions::default() }).unwrap();
    let cameras = panoramas(&flat, &PanoramaOptions { height: 8, train: 3, novel: 1, seed: 2 }, &Silent).unwrap();
    let options = RenderOptions { seed: 2, pixel_samples: 1, light_samples: 1, gather_rays: 1, specular_bounces: 1 };
    let views = render(&flat, &cameras, &options, &Silent).unwrap();
    let folder = tempfile::tempdir().unwrap();
    write(&flat, &views, folder.path(), &Silent).unwrap();
    let capture = load(folder.path(), &LoadOptions::default(), &Silent).unwrap();
    assert_eq!(capture.views(Split::Train).count(), 3);
    assert_eq!(capture.views(Split::Novel).count(), 1);
    assert_eq!(capture.mesh.triangles.len(), flat.mesh.triangles.len());
    for t in (0..flat.mesh.triangles.len() as u32).step_by(97) {
        for (read, made) in capture.mesh.corner_uvs(t).into_iter().zip(flat.mesh.corner_uvs(t)) {
            assert!(read.distance(made) < 1e-5, "{read} against {made}");
        }
    }
    assert_eq!(read_rgb(capture.truth.unwrap().albedo).unwrap(), flat.albedo);
    for (view, rendered) in capture.views.iter().zip(&views) {
        assert_eq!(view.load_semantic().unwrap().unwrap(), rendered.semantic);
        assert_eq!(view.load_mask().unwrap().unwrap(), rendered.mask);
        assert!(view.camera.position().distance(rendered.shot.camera.position()) < 1e-5);
    }
}
