//! What a fit has in memory, and how the resolution of the views follows from what it may have.

use std::collections::BTreeMap;

use bytesize::ByteSize;

use crate::atlas::{Atlas, DEFAULT_SIDE};
use crate::capture::View;
use crate::error::{Error, Result};
use crate::fit::settings::{FitSettings, Mode};
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::scene::Scene;
use crate::tbl;

/// Pixels of all views together per valid texel, at most: finer images know nothing more about the texels.
const PIXELS_PER_TEXEL: u64 = 4;
/// Bytes of the program itself, with its libraries and what its allocator keeps to itself.
const PROGRAM: u64 = 100_000_000;
/// Multiple of the required reduction up to which a divisor of a panorama's size is sought.
const FARTHEST: usize = 4;

/// Bytes that a texel of the atlas (valid or not) and a pixel take, as measured.
fn bytes_of(settings: &FitSettings) -> (u64, u64) {
    match settings.mode {
        // Four channels of parameters, gradients, two moments, lighting and irradiance, with mips; footprints of about
        // 12 taps per sub-pixel, both ways.
        Mode::Paper => (150, (settings.paper.footprint_samples * settings.paper.footprint_samples) as u64 * 192),
        // Points, neighbours, lighting, and votes, or later albedo with solver vectors; a footprint of 8 taps, a curve,
        // costs by roughness, solver vectors. A first round has costs under two models, and a quarter of the curves;
        // without one, the last has both. Where metals are sought, other curves and costs are added.
        Mode::Full => {
            let two_models = if settings.full.alternations == 0 { 50 } else { 0 };
            let metals = if settings.full.metallic.enabled { 170 } else { 0 };
            (200, 350 + two_models + metals)
        }
    }
}

/// Bytes that a fit needs: an estimate, good to a tenth in full mode and to a third in paper mode.
pub fn needed(settings: &FitSettings, [width, height]: [usize; 2], pixels: u64, mesh: &Mesh) -> ByteSize {
    let (texel, pixel) = bytes_of(settings);
    ByteSize(PROGRAM + (width * height) as u64 * texel + pixels * pixel + Scene::memory(mesh))
}

/// Columns and rows of the atlas of a fit: `settings.atlas_size`, else those of the HDR texture that the capture brings
/// (`given`), else [`tbl::default_side`], as far as its textures leave half of the memory to views.
pub fn atlas_size(settings: &FitSettings, given: Option<[usize; 2]>, views: &[View], mesh: &Mesh) -> [usize; 2] {
    match (settings.atlas_size, given) {
        (0, Some(given)) => given,
        (0, None) => {
            let size = [tbl::default_side(views); 2];
            let textures = needed(settings, size, 0, mesh).0;
            if 2 * textures <= settings.max_memory.0 { size } else { [DEFAULT_SIDE; 2] }
        }
        (side, _) => [side; 2],
    }
}

/// The views as the fit reads them: reduced by the least factor that leaves at most four pixels per texel in all and
/// keeps to `settings.max_memory`; then as many as the rest allows at the next finer factor that divides them. Errors
/// when the textures alone exceed it.
pub fn affordable(
    views: &[View],
    (mesh, atlas): (&Mesh, &Atlas),
    settings: &FitSettings,
    progress: &dyn Progress,
) -> Result<Vec<View>> {
    let (size, limit) = ([atlas.width, atlas.height], settings.max_memory);
    let textures = needed(settings, size, 0, mesh);
    let left = limit.0.checked_sub(textures.0).ok_or_else(|| {
        Error::invalid(format!(
            "setting fit.max_memory is {limit}, but textures of {}×{} texels and the mesh alone need about {textures}: raise it, or \
             lower fit.atlas_size",
            size[0], size[1]
        ))
    })?;
    let pixels: u64 = views.iter().map(|view| view.camera.pixels() as u64).sum();
    let useful = PIXELS_PER_TEXEL * atlas.texels.len() as u64;
    let allowed = (left / bytes_of(settings).1).min(useful);
    let factor = (pixels as f64 / allowed.max(1) as f64).sqrt().ceil().max(1.0) as usize;
    if factor == 1 {
        return Ok(views.to_vec());
    }
    let reduced = |view: &View| {
        (factor..=FARTHEST * factor).find_map(|factor| view.reduced(factor)).ok_or_else(|| {
            let (width, height) = (view.camera.width, view.camera.height);
            let why = if factor > width.min(height) {
                "which leaves nothing of it: raise fit.max_memory or fit.atlas_size".to_owned()
            } else {
                format!(
                    "but no number near {factor} divides both, as a panorama must stay whole: resize the images so that \
                     one does, or raise fit.max_memory or fit.atlas_size"
                )
            };
            Error::file(&view.image, format!("{width}×{height} pixels must be reduced {factor} times, {why}"))
        })
    };
    let mut read: Vec<View> = views.iter().map(reduced).collect::<Result<_>>()?;
    let pixels_of = |read: &[View]| read.iter().map(|view| view.camera.pixels() as u64).sum::<u64>();
    let mut left = allowed.saturating_sub(pixels_of(&read));
    for i in spread(views.len()) {
        // A view may have been reduced before.
        let factor = read[i].reduction / views[i].reduction;
        let Some(finer) = (1..factor).rev().find_map(|factor| views[i].reduced(factor)) else { continue };
        let more = (finer.camera.pixels() - read[i].camera.pixels()) as u64;
        if more <= left {
            left -= more;
            read[i] = finer;
        }
    }
    let why = if allowed < useful { format!("max_memory is {limit}") } else { "the atlas holds no more detail".into() };
    progress.warn(&format!(
        "{}: {} pixels of {}, as {why}",
        resolutions(&read),
        counted(pixels_of(&read)),
        counted(pixels)
    ));
    Ok(read)
}

/// How many views are read at which share of their width and height.
fn resolutions(views: &[View]) -> String {
    let mut of: BTreeMap<usize, usize> = BTreeMap::new();
    views.iter().for_each(|view| *of.entry(view.reduction).or_default() += 1);
    let read = |(reduction, count): (usize, usize)| match reduction {
        1 => format!("{count} whole"),
        _ => format!("{count} at 1/{reduction}"),
    };
    let each: Vec<String> = of.into_iter().map(read).collect();
    format!("of {} views, {} of their width and height are read", views.len(), each.join(", "))
}

/// A number with as many digits as one reads.
fn counted(number: u64) -> String {
    match number {
        0..10_000 => number.to_string(),
        10_000..1_000_000 => format!("{:.0} thousand", number as f64 / 1e3),
        _ => format!("{:.1} million", number as f64 / 1e6),
    }
}

/// All of `0..count` in an order whose first few are spread over the whole: by the fractions of multiples of the golden
/// section.
fn spread(count: usize) -> Vec<usize> {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|a, b| (*a as f64 * GOLDEN).fract().total_cmp(&(*b as f64 * GOLDEN).fract()));
    order
}

#[cfg(test)]
mod tests {
    use glam::{Mat4, Vec3};

    use super::*;
    use crate::camera::{Camera, Projection};
    use crate::capture::tests::Warnings;
    use crate::fit::lit_square::LitSquare;
    use crate::progress::Silent;
    use crate::raster::Rgb;

    /// A texture that differs from texel to texel.
    fn texture() -> Rgb {
        let side = crate::fit::lit_square::SIDE;
        Rgb { width: side, height: side, data: (0..side * side).map(|i| [1.0 + i as f32, 2.0, 3.0]).collect() }
    }

    #[test]
    fn an_atlas_that_nobody_asked_for_holds_what_views_show_as_far_as_memory_does() {
        let square = LitSquare::new();
        let mesh = square.scene.mesh();
        let settings = FitSettings::default();
        let views = |width, height, count: usize| {
            let view = square.views(&texture(), [8, 4]).swap_remove(0);
            vec![View { camera: Camera { width, height, ..view.camera }, ..view }; count]
        };
        let side = |views: &[View], settings| atlas_size(settings, None, views, mesh)[0];
        assert_eq!(side(&[], &settings), 1024);
        assert_eq!(side(&views(1024, 512, 2), &settings), 1024, "a pixel for every texel");
        assert_eq!(side(&views(1024, 512, 3), &settings), 2048);
        assert_eq!(side(&views(8192, 4096, 30), &settings), 2048);
        let little = FitSettings { max_memory: bytesize::ByteSize::mib(600), ..settings.clone() };
        assert_eq!(side(&views(1024, 512, 3), &little), 1024);
        // What is asked for, or given, counts before that.
        let of_given = |settings: &FitSettings| atlas_size(settings, Some([640, 320]), &[], mesh);
        assert_eq!(of_given(&settings), [640, 320]);
        assert_eq!(of_given(&FitSettings { atlas_size: 512, ..settings.clone() }), [512; 2]);
    }

    #[test]
    fn views_are_reduced_to_what_the_atlas_holds_and_are_means() {
        let square = LitSquare::new();
        let place = (square.scene.mesh(), &square.atlas);
        let settings = FitSettings::default();
        // 64 texels: 256 pixels are useful. Five views of 8 × 4 are fewer, five of 32 × 16 are ten times as many: at a
        // quarter of their width they have 160, and one of them may have half.
        let few = square.views(&texture(), [8, 4]);
        let same = affordable(&few, place, &settings, &Silent).unwrap();
        assert!(same.iter().all(|v| v.reduction == 1 && v.camera.width == 8));
        let many = square.views(&texture(), [32, 16]);
        let reduced = affordable(&many, place, &settings, &Silent).unwrap();
        assert_eq!(reduced.iter().map(|v| v.reduction).collect::<Vec<_>>(), [2, 4, 4, 4, 4]);
        assert!(reduced[1..].iter().all(|v| (v.camera.width, v.camera.height) == (8, 4)));
        let image = reduced[1].load_image(&Silent).unwrap();
        let whole = many[1].load_image(&Silent).unwrap();
        let mean: f32 = (0..16).map(|i| whole.at(16 + i % 4, 8 + i / 4)[0]).sum::<f32>() / 16.0;
        assert!(mean > 0.0 && (image.at(4, 2)[0] - mean).abs() < 1e-5 * mean, "{:?} for {mean}", image.at(4, 2));
        // Pixels look where the pixels did that they were made of.
        let direction = reduced[1].camera.direction(4.5, 2.5);
        assert!((direction - many[1].camera.direction(18.0, 10.0)).length() < 1e-6);
    }

    #[test]
    fn panoramas_that_few_numbers_divide_use_what_there_is_as_well() {
        let square = LitSquare::new();
        let place = (square.scene.mesh(), &square.atlas);
        let view = square.views(&texture(), [8, 4]).swap_remove(0);
        // 64 texels: 256 pixels are useful.
        let read = |count: usize, [width, height]: [usize; 2]| {
            let views = vec![View { camera: Camera { width, height, ..view.camera }, ..view.clone() }; count];
            let warnings = Warnings::default();
            let read = affordable(&views, place, &FitSettings::default(), &warnings).unwrap();
            let pixels: usize = read.iter().map(|view| view.camera.pixels()).sum();
            assert!(pixels <= 256, "{pixels}");
            (pixels, warnings.all().concat())
        };
        // Reduced 5 times and more, so 8 times: 20 views have 160 pixels. One more at 1/4 has 24 more.
        let (pixels, said) = read(20, [32, 16]);
        assert_eq!(pixels, 256, "{said}");
        assert!(said.contains("of 20 views, 4 at 1/4, 16 at 1/8 of their width and height are read"), "{said}");
        // 20 times and more: up to 31, no number divides 128 rows.
        let (pixels, said) = read(3, [256, 128]);
        assert_eq!(pixels, 192, "{said}");
        // Rows of a large prime number are refused.
        let odd = View { camera: Camera { width: 2 * 1021, height: 1021, ..view.camera }, ..view.clone() };
        let error = affordable(&[odd], place, &FitSettings::default(), &Silent).unwrap_err().to_string();
        assert!(error.contains("resize"), "{error}");
        // Nor is anything left of photos that are narrower than the reduction.
        let projection = Projection::Pinhole { fx: 1.0, fy: 1.0, cx: 1.0, cy: 1.0 };
        let narrow = View { camera: Camera { width: 2, height: 1 << 20, projection, ..view.camera }, ..view.clone() };
        let error = affordable(&[narrow], place, &FitSettings::default(), &Silent).unwrap_err().to_string();
        assert!(error.contains("leaves nothing"), "{error}");
    }

    #[test]
    fn memory_is_kept_to_or_refused() {
        let square = LitSquare::new();
        let place = (square.scene.mesh(), &square.atlas);
        let views = square.views(&texture(), [8, 4]);
        let at = |max_memory| FitSettings { max_memory, ..FitSettings::default() };
        let all = needed(&at(ByteSize(0)), [square.atlas.width, square.atlas.height], 160, square.scene.mesh());
        assert!(affordable(&views, place, &at(all), &Silent).unwrap().iter().all(|v| v.reduction == 1));
        let most = affordable(&views, place, &at(ByteSize(all.0 - 1)), &Silent).unwrap();
        assert_eq!(most.iter().map(|v| v.reduction).collect::<Vec<_>>(), [1, 1, 1, 2, 1]);
        let half = needed(&at(ByteSize(0)), [square.atlas.width, square.atlas.height], 88, square.scene.mesh());
        let some = affordable(&views, place, &at(half), &Silent).unwrap();
        assert_eq!(some.iter().map(|v| v.reduction).collect::<Vec<_>>(), [1, 2, 1, 2, 2]);
        let none = affordable(&views, place, &at(ByteSize(1000)), &Silent).unwrap_err().to_string();
        assert!(none.contains("max_memory") && none.contains("atlas_size"), "{none}");
    }

    #[test]
    fn what_is_read_is_told_in_digits_that_say_something() {
        let square = LitSquare::new();
        let warnings = Warnings::default();
        let views = square.views(&texture(), [32, 16]);
        affordable(&views, (square.scene.mesh(), &square.atlas), &FitSettings::default(), &warnings).unwrap();
        let said = warnings.all();
        assert!(said.len() == 1 && said[0].contains("256 pixels of 2560, as the atlas"), "{said:?}");
        assert_eq!(
            [9999, 10_400, 999_000, 1_260_000].map(counted),
            ["9999", "10 thousand", "999 thousand", "1.3 million"]
        );
    }

    #[test]
    fn the_estimate_is_above_what_was_measured_but_not_far() {
        // docs/performance.md, "Memory of a fit": atlas, pixels, triangles, vertices, MiB at most.
        for (side, pixels, triangles, vertices, measured) in
            [(2048, 24 * 512 * 256, 132_210, 82_171, 1857), (1024, 12 * 256 * 128, 54_484, 35_941, 434)]
        {
            let (triangles, positions) = (vec![[0; 3]; triangles], vec![Vec3::ZERO; vertices]);
            let mesh = Mesh { triangles, positions, ..Mesh::default() };
            let needed = needed(&FitSettings::default(), [side, side], pixels, &mesh);
            let share = needed.0 as f64 / f64::from(measured << 20);
            assert!((1.0..1.1).contains(&share), "{needed}, {share} of what was measured");
        }
    }

    #[test]
    fn panoramas_stay_whole_and_photos_lose_a_rim() {
        let camera = |projection| Camera { projection, width: 10, height: 5, world_from_camera: Mat4::IDENTITY };
        assert_eq!(camera(Projection::Equirectangular).reduced(2), None);
        assert_eq!(camera(Projection::Equirectangular).reduced(5).unwrap().width, 2);
        let photo = camera(Projection::Pinhole { fx: 8.0, fy: 8.0, cx: 5.0, cy: 2.5 });
        let reduced = photo.reduced(2).unwrap();
        assert_eq!((reduced.width, reduced.height), (5, 2));
        assert!((reduced.direction(1.0, 1.0) - photo.direction(2.0, 2.0)).length() < 1e-6);
    }
}
