//! Round trips of what is written, foreign files made byte by byte, and every kind of bad file.

use ::exr::meta::attribute::Chromaticities;
use ::exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, ImageAttributes, IntegerBounds, Layer, LayerAttributes,
    Vec2, WritableImage, f16,
};
use tempfile::TempDir;

use super::*;

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn gradient(width: usize, height: usize) -> Rgb {
    let value = |i: usize| [i as f32 * 0.37, 1e5 / (1.0 + i as f32), 1e-6 * i as f32];
    Raster::new(width, height, (0..width * height).map(value).collect()).unwrap()
}

/// An EXR of arbitrary half-float channels, as other programs write them: channel `(name, v)` holds v + pixel index.
fn write_exr(path: &Path, size: [usize; 2], attributes: LayerAttributes, window: IntegerBounds, of: &[(&str, f32)]) {
    let samples = |v: f32| FlatSamples::F16((0..size[0] * size[1]).map(|i| f16::from_f32(v + i as f32)).collect());
    let list = of.iter().map(|(name, v)| AnyChannel::new(*name, samples(*v))).collect();
    let layer = Layer::new((size[0], size[1]), attributes, Encoding::FAST_LOSSLESS, AnyChannels::sort(list));
    Image::new(ImageAttributes::new(window), layer).write().to_file(path).unwrap();
}

fn whole(width: usize, height: usize) -> IntegerBounds {
    IntegerBounds::from_dimensions((width, height))
}

fn message<T: std::fmt::Debug>(result: Result<T>) -> String {
    result.unwrap_err().to_string()
}

#[test]
fn rgb_and_gray_survive_a_round_trip_exactly() {
    let folder = folder();
    let path = folder.path().join("image.exr");
    let rgb = gradient(7, 5);
    write_rgb(&path, &rgb).unwrap();
    assert_eq!(read_rgb(&path).unwrap(), rgb);
    assert_eq!(read_size(&path).unwrap(), [7, 5]);
    let gray = rgb.map(|p| p[1]);
    write_gray(&path, &gray).unwrap();
    assert_eq!(read_gray(&path).unwrap(), gray);
    assert_eq!(read_rgb(&path).unwrap(), gray.map(|v| [*v; 3]), "Y as grey");
}

#[test]
fn half_floats_alpha_and_named_layers_are_read() {
    let folder = folder();
    let path = folder.path().join("image.exr");
    for prefix in ["", "View.Combined."] {
        let names = ["R", "G", "B", "A"].map(|c| format!("{prefix}{c}"));
        let channels = [0, 1, 2, 3].map(|i| (names[i].as_str(), 10.0 * i as f32));
        write_exr(&path, [2, 1], LayerAttributes::default(), whole(2, 1), &channels);
        assert_eq!(read_rgb(&path).unwrap().data, [[0.0, 10.0, 20.0], [1.0, 11.0, 21.0]], "prefix {prefix:?}");
    }
    write_exr(&path, [2, 1], LayerAttributes::default(), whole(2, 1), &[("normal.X", 0.0), ("normal.Y", 0.0)]);
    let error = message(read_rgb(&path));
    assert!(
        error.contains("image.exr") && error.contains("normal.X, normal.Y") && error.contains("R, G and B"),
        "{error}"
    );
}

/// Two pixels, of which the second is white, as OpenEXR with these chromaticities.
fn write_with_primaries(path: &Path, pixels: [[f32; 3]; 2], chromaticities: Option<Chromaticities>) {
    let channel = |c: usize, name| AnyChannel::new(name, FlatSamples::F32(pixels.iter().map(|p| p[c]).collect()));
    let list = [channel(0, "R"), channel(1, "G"), channel(2, "B")].into_iter().collect();
    let layer = Layer::new((2, 1), LayerAttributes::default(), Encoding::UNCOMPRESSED, AnyChannels::sort(list));
    let attributes = ImageAttributes { chromaticities, ..ImageAttributes::new(whole(2, 1)) };
    Image::new(attributes, layer).write().to_file(path).unwrap();
}

#[test]
fn colours_of_other_primaries_become_those_of_rec_709() {
    let folder = folder();
    let path = folder.path().join("view.exr");
    let rec_709 = Chromaticities {
        red: Vec2(0.64, 0.33),
        green: Vec2(0.3, 0.6),
        blue: Vec2(0.15, 0.06),
        white: Vec2(0.3127, 0.329),
    };
    let aces = Chromaticities {
        red: Vec2(0.7347, 0.2653),
        green: Vec2(0.0, 1.0),
        blue: Vec2(0.0001, -0.077),
        white: Vec2(0.32168, 0.33767),
    };
    let pixels = [[0.3, 0.1, 7.7e-3], [2.0; 3]];
    write_with_primaries(&path, pixels, Some(aces));
    let read = read_rgb(&path).unwrap().data;
    // 0.3 of the first column, 0.1 of the second and 0.0077 of the third of the published matrix.
    let expected = [[0.640_109, 0.053_587, -0.010_915], [2.0; 3]];
    for (read, expected) in read.iter().flatten().zip(expected.iter().flatten()) {
        assert!((read - expected).abs() < 2e-5, "{read} {expected}");
    }
    write_with_primaries(&path, [[0.3; 3], [2.0; 3]], Some(aces));
    assert_eq!(read_gray(&path).unwrap().data, [0.3, 2.0], "a channel on its own is data, no colour");
    for same in [None, Some(rec_709)] {
        write_with_primaries(&path, pixels, same);
        assert_eq!(read_rgb(&path).unwrap().data, pixels);
    }
    write_with_primaries(&path, pixels, Some(Chromaticities { green: Vec2(0.64, 0.33), ..rec_709 }));
    let error = message(read_rgb(&path));
    assert!(error.contains("view.exr") && error.contains("green (0.64, 0.33)"), "{error}");
}

#[test]
fn a_cropped_exr_is_placed_in_its_display_window() {
    let folder = folder();
    let path = folder.path().join("crop.exr");
    let attributes = LayerAttributes { layer_position: Vec2(1, -1), ..LayerAttributes::default() };
    write_exr(&path, [2, 2], attributes, whole(4, 2), &[("Y", 5.0)]);
    assert_eq!(read_size(&path).unwrap(), [4, 2]);
    // Row 0 shows the data window's second row; its first lies above the display.
    assert_eq!(read_gray(&path).unwrap().data, [0.0, 7.0, 8.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
}

#[test]
fn what_an_exr_does_not_show_is_unknown_in_a_photo_and_black_in_a_texture() {
    let folder = folder();
    let path = folder.path().join("photo.exr");
    let colours = [("R", 1.0), ("G", 1.0), ("B", 1.0)];
    // The third column lies outside of the data window; alpha is 0, 1.
    write_exr(&path, [2, 1], LayerAttributes::default(), whole(3, 1), &[&colours[..], &[("A", 0.0)]].concat());
    assert_eq!(read_rgb(&path).unwrap().data, [[1.0; 3], [2.0; 3], [0.0; 3]]);
    let photo = read_photo(&path).unwrap().data;
    assert!(photo[0].iter().chain(&photo[2]).all(|v| v.is_nan()) && photo[1] == [2.0; 3], "{photo:?}");
    // An alpha channel that is 0 everywhere says nothing.
    write_exr(&path, [1, 1], LayerAttributes::default(), whole(1, 1), &[&colours[..], &[("A", 0.0)]].concat());
    assert_eq!(read_photo(&path).unwrap().data, [[1.0; 3]]);
}

#[test]
fn of_many_layers_the_combined_one_is_read() {
    let folder = folder();
    let path = folder.path().join("layers.exr");
    let layers = [("View.AO.", 50.0), ("View.Combined.", 1.0), ("View.Env.", 90.0)];
    let names = layers.map(|(layer, value)| ["B", "G", "R"].map(|c| (format!("{layer}{c}"), value)));
    let channels: Vec<(&str, f32)> = names.iter().flatten().map(|(name, value)| (name.as_str(), *value)).collect();
    write_exr(&path, [1, 1], LayerAttributes::default(), whole(1, 1), &channels);
    assert_eq!(read_rgb(&path).unwrap().data, [[1.0; 3]]);
}

#[test]
fn radiance_hdr_is_divided_by_its_exposure() {
    let folder = folder();
    let path = folder.path().join("image.hdr");
    let texel = [128, 64, 32, 129 + 3];
    for (header, factor) in [("", 1.0), ("EXPOSURE=4\n", 0.25)] {
        let mut bytes = format!("#?RADIANCE\n{header}FORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n").into_bytes();
        bytes.extend(texel);
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(read_rgb(&path).unwrap().data, [[8.0 * factor, 4.0 * factor, 2.0 * factor]]);
        assert_eq!(read_size(&path).unwrap(), [1, 1]);
    }
}

#[test]
fn float_tiff_is_read_and_integer_tiff_refused() {
    let folder = folder();
    let path = folder.path().join("image.tiff");
    let values = vec![0.5, 20.0, 1e-3, 1.0, 2.0, 3.0];
    image::Rgb32FImage::from_raw(2, 1, values).unwrap().save(&path).unwrap();
    assert_eq!(read_rgb(&path).unwrap().data, [[0.5, 20.0, 1e-3], [1.0, 2.0, 3.0]]);
    image::RgbImage::new(2, 1).save(&path).unwrap();
    let error = message(read_rgb(&path));
    assert!(error.contains("image.tiff") && error.contains("Rgb8") && error.contains("float"), "{error}");
}

#[test]
fn eight_bit_images_are_no_radiance() {
    let folder = folder();
    for name in ["image.png", "image.jpg"] {
        let path = folder.path().join(name);
        image::RgbImage::new(2, 2).save(&path).unwrap();
        let error = message(read_rgb(&path));
        assert!(error.contains(name) && error.contains("linear"), "{error}");
    }
}

#[test]
fn labels_survive_a_round_trip_in_eight_and_sixteen_bits() {
    let folder = folder();
    for ids in [vec![0, 3, 255, 7, 8, 9], vec![0, 256, 65535, 7, 8, 9]] {
        let labels = Labels::new(3, 2, ids).unwrap();
        let path = folder.path().join("ids.png");
        write_png_labels(&path, &labels).unwrap();
        assert_eq!(read_labels(&path).unwrap(), labels);
        let path = folder.path().join("ids.exr");
        write_gray(&path, &labels.map(|id| f32::from(*id))).unwrap();
        assert_eq!(read_labels(&path).unwrap(), labels);
    }
}

#[test]
fn a_palette_gives_its_indices_at_every_bit_depth() {
    let folder = folder();
    let path = folder.path().join("palette.png");
    let (width, height) = (5, 2);
    for (depth, bits) in [(::png::BitDepth::Two, 2), (::png::BitDepth::Four, 4), (::png::BitDepth::Eight, 8)] {
        let ids: Vec<u16> = (0..width * height).map(|i| (i * 3 % 4) as u16).collect();
        let mut rows = Vec::new();
        for row in ids.chunks(width) {
            let mut packed = vec![0_u8; (width * bits).div_ceil(8)];
            for (x, id) in row.iter().enumerate() {
                packed[x * bits / 8] |= (*id as u8) << (8 - bits - x * bits % 8);
            }
            rows.extend(packed);
        }
        let mut encoder = ::png::Encoder::new(File::create(&path).unwrap(), width as u32, height as u32);
        encoder.set_color(::png::ColorType::Indexed);
        encoder.set_depth(depth);
        encoder.set_palette(vec![200_u8; 12]);
        encoder.write_header().unwrap().write_image_data(&rows).unwrap();
        assert_eq!(read_labels(&path).unwrap().data, ids, "{bits} bits");
    }
}

#[test]
fn labels_that_are_no_ids_are_refused() {
    let folder = folder();
    let path = folder.path().join("ids.png");
    image::RgbImage::new(2, 2).save(&path).unwrap();
    let error = message(read_labels(&path));
    assert!(error.contains("ids.png") && error.contains("Rgb") && error.contains("palette"), "{error}");
    let path = folder.path().join("ids.exr");
    for bad in [0.5, -1.0, 65536.0, f32::NAN] {
        write_gray(&path, &Gray::new(2, 1, vec![1.0, bad]).unwrap()).unwrap();
        let error = message(read_labels(&path));
        assert!(error.contains("ids.exr") && error.contains("pixel (1, 0)"), "{error}");
    }
}

#[test]
fn masks_and_gray_previews_survive_a_round_trip() {
    let folder = folder();
    let path = folder.path().join("mask.png");
    let mask = Mask::new(3, 1, vec![true, false, true]).unwrap();
    write_png_mask(&path, &mask).unwrap();
    assert_eq!(read_mask(&path).unwrap(), mask);
    write_png_gray(&path, &Gray::new(3, 1, vec![-1.0, 0.5, 2.0]).unwrap()).unwrap();
    assert_eq!(read_labels(&path).unwrap().data, [0, 128, 255]);
    write_png_rgb(&path, &Raster::new(3, 1, vec![[0, 0, 0], [0, 0, 1], [9, 0, 0]]).unwrap()).unwrap();
    assert_eq!(read_mask(&path).unwrap().data, [false, true, true]);
}

#[test]
fn missing_truncated_and_foreign_files_are_errors_that_name_the_file() {
    let folder = folder();
    let path = folder.path().join("view.exr");
    let error = message(read_rgb(&path));
    assert!(error.contains("view.exr") && error.contains("cannot be read"), "{error}");

    write_rgb(&path, &gradient(64, 64)).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    for kept in [0, 3, 20, 100, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..kept]).unwrap();
        let error = message(read_rgb(&path));
        assert!(error.contains("view.exr"), "{kept} bytes: {error}");
    }

    std::fs::write(&path, b"a letter to the editor").unwrap();
    let error = message(read_rgb(&path));
    assert!(error.contains("view.exr") && error.contains("expected OpenEXR"), "{error}");
}

#[test]
fn a_jpeg_that_ends_early_is_refused() {
    let folder = folder();
    let path = folder.path().join("photo.jpg");
    let picture = image::RgbImage::from_fn(64, 48, |x, y| image::Rgb([(x * y) as u8, (x * 4) as u8, (y * 5) as u8]));
    picture.save(&path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    // A preview of its own in front, and what phones append: neither is the image's end.
    let preview = [&[0xff, 0xe1, 0x00, 0x06, 0xff, 0xd8, 0xff, 0xd9][..], &bytes[2..]].concat();
    let appended = [&bytes[..], b"more \xff\xda of it"].concat();
    for whole in [&bytes, &[&bytes[..2], &preview[..]].concat(), &appended] {
        std::fs::write(&path, whole).unwrap();
        assert_eq!(read_encoded(&path).unwrap().values.size(), [64, 48]);
        check_whole(&path).unwrap();
    }
    for cut in [bytes.len() - 2, bytes.len() * 6 / 10, bytes.len() / 2] {
        std::fs::write(&path, [&bytes[..2], &preview[..cut]].concat()).unwrap();
        assert!(message(read_encoded(&path)).contains("it ends before its image does"), "{cut} bytes");
        assert!(message(check_whole(&path)).contains("it ends before its image does"), "{cut} bytes");
    }
}

#[test]
fn three_channels_are_one_where_they_are_the_same() {
    let folder = folder();
    let path = folder.path().join("roughness.exr");
    let mut image = Rgb::filled(3, 2, [0.25; 3]);
    write_rgb(&path, &image).unwrap();
    assert_eq!(read_gray(&path).unwrap(), Gray::filled(3, 2, 0.25));
    image.data[4] = [0.25, 0.5, 0.25];
    write_rgb(&path, &image).unwrap();
    let error = message(read_gray(&path));
    assert!(error.contains("roughness.exr: pixel (1, 1) is [0.25, 0.5, 0.25]; expected one channel"), "{error}");
}

#[test]
fn sanitising_replaces_and_counts_what_no_radiance_can_be() {
    let mut image =
        Rgb::new(5, 1, vec![[1.0, f32::NAN, 2.0], [f32::INFINITY, -1.0, 3.0], [-0.5, -0.5, 1.0], [4.0; 3], [3e38; 3]])
            .unwrap();
    let found = sanitise_radiance(&mut image, 7.0);
    assert_eq!(found, Sanitised { non_finite: 3, negative: 1 });
    assert_eq!(image.data, [[7.0; 3], [7.0; 3], [0.0, 0.0, 1.0], [4.0; 3], [7.0; 3]]);
    assert!(sanitise_radiance(&mut image, 7.0).is_clean());
}

#[test]
fn srgb_encoding_meets_its_published_points() {
    for (linear, encoded) in [(0.0, 0.0), (0.003_130_8, 0.040_45), (0.214_041_14, 0.5), (1.0, 1.0), (7.0, 1.0)] {
        assert!((srgb_from_linear(linear) - encoded).abs() < 1e-5, "{linear}");
    }
    assert_eq!(encode_srgb(&Rgb::filled(1, 1, [f32::NAN, -1.0, 1.0])).data, [[0, 0, 255]]);
}

/// 3 million pixels in one row are no more than a file may have for its size, but compressed in blocks of 16 rows.
#[test]
fn blocks_that_are_larger_than_the_image_are_refused() {
    let folder = folder();
    let path = folder.path().join("wide.exr");
    write_rgb(&path, &gradient(4, 1)).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    let attribute = b"dataWindow\0box2i\0\x10\0\0\0";
    let start = bytes.windows(attribute.len()).position(|w| w == attribute).unwrap() + attribute.len();
    bytes[start + 8..start + 12].copy_from_slice(&2_999_999_i32.to_le_bytes());
    std::fs::write(&path, bytes).unwrap();
    let message = message(read_rgb(&path));
    assert!(message.contains("wide.exr") && message.contains("blocks of 3000000×16 pixels"), "{message}");
}
