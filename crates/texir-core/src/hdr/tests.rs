//! Synthetic brackets with the noise of a sensor, against the truth; EXIF; bad series.

use exif::experimental::Writer;
use exif::{Field, In, Rational, SRational, Tag, Value};
use image::{ExtendedColorType, ImageEncoder};
use tempfile::TempDir;

use super::*;
use crate::progress::Silent;
use crate::raster::Raster;

const WIDTH: usize = 96;
const HEIGHT: usize = 64;
/// Pixels along a side of a patch of one radiance.
const PATCH: usize = 8;
/// Electrons at full scale.
const FULL_WELL: f64 = 30_000.0;
/// Electrons of read noise.
const READ_NOISE: f64 = 6.0;
/// The paper's seven brackets: 1/25000 s to 1/8 s.
const TIMES: [(u32, u32); 7] = [(1, 25_000), (1, 6_400), (1, 1_600), (1, 400), (1, 100), (1, 30), (1, 8)];
const APERTURE: f64 = 8.0;
const ISO: u32 = 200;

fn exposure(time: (u32, u32)) -> f64 {
    f64::from(time.0) / f64::from(time.1) * f64::from(ISO) / (100.0 * APERTURE * APERTURE)
}

/// Numbers in [0, 1) from a counter (SplitMix64).
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Box and Muller.
    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// Patches whose radiance spans what the brackets can see, in every mixture of colours.
fn scene() -> Rgb {
    let (least, most) = (0.02 / exposure(TIMES[6]), 0.85 / exposure(TIMES[0]));
    let patch = |i: usize| {
        let (x, y) = (i % WIDTH / PATCH, i / WIDTH / PATCH);
        let patches = (WIDTH / PATCH) * (HEIGHT / PATCH);
        let t = (y * (WIDTH / PATCH) + x) as f64 / (patches - 1) as f64;
        let radiance = least * (most / least).powf(t);
        [1.0, 0.6 + 0.4 * (x as f64).sin().abs(), 0.5 + 0.5 * (y as f64).cos().abs()].map(|c| (radiance * c) as f32)
    };
    Raster::new(WIDTH, HEIGHT, (0..WIDTH * HEIGHT).map(patch).collect()).unwrap()
}

/// Light to encoded value.
type Curve = fn(f64) -> f64;

fn srgb(v: f64) -> f64 {
    f64::from(crate::image_io::srgb_from_linear(v as f32))
}

/// A steeper toe and a shoulder, as picture styles have them.
fn film(v: f64) -> f64 {
    let shoulder = v * 1.3 / (0.3 + v);
    shoulder.powf(1.0 / 1.8)
}

/// A 12-bit photo in a 16-bit PNG, with shot and read noise, and the fields of its EXIF.
fn photo(scene: &Rgb, time: (u32, u32), curve: Curve, random: &mut Random) -> Vec<u8> {
    let exposure = exposure(time);
    let value = |radiance: &f32| {
        let electrons = f64::from(*radiance) * exposure * FULL_WELL;
        let noisy = electrons + electrons.sqrt() * random.normal() + READ_NOISE * random.normal();
        let encoded = curve((noisy / FULL_WELL).clamp(0.0, 1.0));
        let twelve_bits = (encoded * 4095.0).round();
        (twelve_bits / 4095.0 * 65535.0).round() as u16
    };
    let values: Vec<u16> = scene.data.iter().flatten().map(value).collect();
    png(&values, &exif(time))
}

/// What an exposure is read from.
pub(crate) fn exif(time: (u32, u32)) -> Vec<u8> {
    exif_of(&[
        (Tag::ExposureTime, Value::Rational(vec![Rational { num: time.0, denom: time.1 }])),
        (Tag::FNumber, Value::Rational(vec![Rational { num: 8, denom: 1 }])),
        (Tag::PhotographicSensitivity, Value::Short(vec![ISO as u16])),
    ])
}

fn exif_of(fields: &[(Tag, Value)]) -> Vec<u8> {
    let fields: Vec<Field> =
        fields.iter().map(|(tag, value)| Field { tag: *tag, ifd_num: In::PRIMARY, value: value.clone() }).collect();
    let mut writer = Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    let mut bytes = std::io::Cursor::new(Vec::new());
    writer.write(&mut bytes, false).unwrap();
    bytes.into_inner()
}

fn png(values: &[u16], exif: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    encoder.set_exif_metadata(exif.to_vec()).unwrap();
    let raw: &[u8] = bytemuck::cast_slice(values);
    encoder.write_image(raw, WIDTH as u32, HEIGHT as u32, ExtendedColorType::Rgb16).unwrap();
    bytes
}

/// The series in a folder, exposures from its EXIF.
fn series(scene_of: impl Fn(usize) -> Rgb, curve: Curve) -> (TempDir, Vec<Frame>) {
    let folder = tempfile::tempdir().unwrap();
    let mut random = Random(7);
    let shots = TIMES.iter().enumerate().map(|(i, time)| {
        let path = folder.path().join(format!("shot_{i}.png"));
        std::fs::write(&path, photo(&scene_of(i), *time, curve, &mut random)).unwrap();
        Frame { exposure: read_exposure(&path).unwrap(), path }
    });
    let shots = shots.collect();
    (folder, shots)
}

/// Ratio of found to true radiance: the mean of every patch, and all pixels. The unit of an estimated response is
/// arbitrary: the median patch has the ratio 1.
fn ratios(found: &Rgb, truth: &Rgb) -> (Vec<f64>, Vec<f64>) {
    let mut patches = Vec::new();
    for (py, px) in (0..HEIGHT / PATCH).flat_map(|y| (0..WIDTH / PATCH).map(move |x| (y, x))) {
        for c in 0..3 {
            let of = |image: &Rgb| -> f64 {
                let inside = (0..PATCH * PATCH).map(|i| image.at(px * PATCH + i % PATCH, py * PATCH + i / PATCH)[c]);
                inside.map(f64::from).sum()
            };
            patches.push(of(found) / of(truth));
        }
    }
    let mut sorted = patches.clone();
    sorted.sort_by(f64::total_cmp);
    let scale = sorted[sorted.len() / 2];
    let pixels = found.data.iter().flatten().zip(truth.data.iter().flatten());
    let pixels = pixels.map(|(found, truth)| f64::from(found / truth) / scale).collect();
    (patches.into_iter().map(|r| r / scale).collect(), pixels)
}

fn largest_error(ratios: &[f64]) -> f64 {
    ratios.iter().map(|r| (r - 1.0).abs()).fold(0.0, f64::max)
}

#[test]
fn seven_noisy_brackets_merge_to_within_two_per_cent() {
    let truth = scene();
    for (curve, choice) in [
        (srgb as Curve, ResponseChoice::Known(TransferCurve::Srgb)),
        (srgb, ResponseChoice::Estimate),
        (film, ResponseChoice::Estimate),
        (|v| v.powf(1.0 / 2.4), ResponseChoice::Estimate),
        (|v| v, ResponseChoice::Known(TransferCurve::Linear)),
    ] {
        let (_folder, shots) = series(|_| scene(), curve);
        let merged = merge(&shots, choice, &Silent).unwrap();
        let (patches, pixels) = ratios(&merged.radiance, &truth);
        let error = largest_error(&patches);
        let rms = (pixels.iter().map(|r| (r - 1.0).powi(2)).sum::<f64>() / pixels.len() as f64).sqrt();
        assert!(error < 0.02, "{choice:?}: the worst patch is off by {error:.4}");
        assert!(rms < 0.02, "{choice:?}: pixels are off by {rms:.4} rms");
        assert_eq!(merged.clipped, 0);
        assert!(merged.ghosts < WIDTH * HEIGHT / 200, "{choice:?}: {} ghosts where nothing moved", merged.ghosts);
    }
}

#[test]
fn a_wrong_response_shows() {
    let (_folder, shots) = series(|_| scene(), film);
    let merged = merge(&shots, ResponseChoice::Known(TransferCurve::Srgb), &Silent).unwrap();
    assert!(largest_error(&ratios(&merged.radiance, &scene()).0) > 0.1);
}

#[test]
fn merging_is_less_noisy_than_its_best_shot() {
    let (_folder, shots) = series(|_| scene(), srgb);
    let choice = ResponseChoice::Known(TransferCurve::Srgb);
    let rms = |shots: &[Frame]| {
        let merged = merge(shots, choice, &Silent).unwrap();
        let (_, pixels) = ratios(&merged.radiance, &scene());
        // Patches in the middle of the range: neither of the two shots clips them.
        let middle = &pixels[pixels.len() / 3..pixels.len() / 2];
        (middle.iter().map(|r| (r - 1.0).powi(2)).sum::<f64>() / middle.len() as f64).sqrt()
    };
    assert!(rms(&shots) < 0.9 * rms(&shots[..3]), "{} {}", rms(&shots), rms(&shots[..3]));
}

#[test]
fn what_moved_is_shown_once() {
    // Someone in white stands in the left third of two shots.
    let visitor = 0.5 / exposure(TIMES[3]);
    let scene_of = |shot: usize| {
        let mut scene = scene();
        if shot == 2 || shot == 4 {
            for (i, pixel) in scene.data.iter_mut().enumerate() {
                if i % WIDTH < WIDTH / 3 {
                    *pixel = [visitor as f32; 3];
                }
            }
        }
        scene
    };
    let (_folder, shots) = series(scene_of, srgb);
    let merged = merge(&shots, ResponseChoice::Estimate, &Silent).unwrap();
    assert!(merged.ghosts > WIDTH * HEIGHT / 5, "{} ghosts", merged.ghosts);
    let truth = scene();
    let patches = ratios(&merged.radiance, &truth).0;
    let columns = WIDTH / PATCH;
    let still: Vec<f64> = (0..patches.len()).filter(|i| i / 3 % columns >= columns / 3).map(|i| patches[i]).collect();
    assert!(largest_error(&still) < 0.02, "what did not move is off by {}", largest_error(&still));
    let (mut visited, mut mixed) = (0, 0);
    for (i, (found, truth)) in merged.radiance.data.iter().zip(&truth.data).enumerate() {
        if i % WIDTH < WIDTH / 3 {
            let near = |a: f32, b: f32| (a / b - 1.0).abs() < 0.15;
            // Either the wall or the visitor, not a mixture of both.
            let whole = near(found[0], truth[0]) || near(found[0], visitor as f32);
            mixed += usize::from(!whole);
            visited += 1;
        }
    }
    assert!(mixed < visited / 20, "{mixed} of {visited} pixels are mixtures");
}

#[test]
fn what_every_shot_clips_is_counted_and_at_least_as_bright_as_the_shortest_says() {
    let lamp = |_| {
        let mut scene = scene();
        for pixel in &mut scene.data[..PATCH] {
            *pixel = [(50.0 / exposure(TIMES[0])) as f32; 3];
        }
        scene
    };
    let (_folder, shots) = series(lamp, srgb);
    let merged = merge(&shots, ResponseChoice::Known(TransferCurve::Srgb), &Silent).unwrap();
    assert_eq!(merged.clipped, PATCH);
    let shown = f64::from(merged.radiance.data[0][0]) * exposure(TIMES[0]);
    assert!((0.9..1.1).contains(&shown), "{shown}");
}

#[test]
fn a_missing_or_useless_exif_field_is_an_error_that_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shot.png");
    let values = vec![0_u16; 3 * WIDTH * HEIGHT];
    let rational = |num, denom| Value::Rational(vec![Rational { num, denom }]);
    let all = [
        (Tag::ExposureTime, rational(1, 60)),
        (Tag::FNumber, rational(28, 10)),
        (Tag::PhotographicSensitivity, Value::Short(vec![100])),
    ];
    std::fs::write(&path, png(&values, &exif_of(&all))).unwrap();
    assert!((read_exposure(&path).unwrap() - 1.0 / 60.0 / 2.8 / 2.8).abs() < 1e-9);
    for (missing, name) in ["ExposureTime", "FNumber", "PhotographicSensitivity"].into_iter().enumerate() {
        let mut fields = all.to_vec();
        fields.remove(missing);
        std::fs::write(&path, png(&values, &exif_of(&fields))).unwrap();
        let message = read_exposure(&path).unwrap_err().to_string();
        assert!(message.contains("shot.png") && message.contains(name) && message.contains("--times"), "{message}");
    }
    for useless in [rational(0, 0), Value::Double(vec![f64::NAN]), Value::Float(vec![-1.0]), Value::Double(vec![])] {
        let mut fields = all.to_vec();
        fields[0].1 = useless;
        std::fs::write(&path, png(&values, &exif_of(&fields))).unwrap();
        assert!(read_exposure(&path).unwrap_err().to_string().contains("ExposureTime is"));
    }
    // Not every program keeps the types of the standard.
    let signed = Value::SRational(vec![SRational { num: 1, denom: 200 }]);
    for time in [rational(1, 200), signed, Value::Float(vec![0.005]), Value::Double(vec![0.005])] {
        let mut fields = all.to_vec();
        fields[0].1 = time;
        std::fs::write(&path, png(&values, &exif_of(&fields))).unwrap();
        assert!((read_exposure(&path).unwrap() - 0.005 / 2.8 / 2.8).abs() < 1e-9);
    }
    crate::image_io::write_png_gray(&path, &Raster::filled(2, 2, 0.5)).unwrap();
    assert!(read_exposure(&path).unwrap_err().to_string().contains("no readable EXIF"));
}

#[test]
fn series_that_cannot_be_merged_are_errors() {
    let (folder, shots) = series(|_| scene(), srgb);
    let message = |shots: &[Frame], choice| merge(shots, choice, &Silent).unwrap_err().to_string();
    let known = ResponseChoice::Known(TransferCurve::Srgb);
    assert!(message(&[], known).contains("no shots"));
    let same: Vec<Frame> = shots.iter().map(|s| Frame { exposure: 1.0, ..s.clone() }).collect();
    assert!(message(&same, known).contains("same exposure"));
    let mut odd = shots.clone();
    odd[1].exposure = f64::NAN;
    assert!(message(&odd, known).contains("shot_1.png"));
    let other = folder.path().join("other.png");
    crate::image_io::write_png_gray(&other, &Raster::filled(2, 2, 0.5)).unwrap();
    odd[1] = Frame { path: other, exposure: 1.0 };
    assert!(message(&odd, known).contains("2×2"));
    // Two shots without a pixel in common.
    let far = [shots[0].clone(), Frame { exposure: 1e9, ..shots[6].clone() }];
    let dark = |_| Rgb::filled(WIDTH, HEIGHT, [1e-4 / exposure(TIMES[6]) as f32; 3]);
    let (_folder, dark) = series(dark, srgb);
    assert!(message(&dark, ResponseChoice::Estimate).contains("--response"));
    assert!(merge(&far, known, &Silent).is_ok());
}
