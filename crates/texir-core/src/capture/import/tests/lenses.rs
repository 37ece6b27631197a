//! Undistorted photos against the scene that they show.

use super::*;
use crate::capture::lens::Undistortion;
use crate::image_io::{encode_srgb, write_gray, write_png_gray, write_png_rgb};
use crate::raster::Gray;

const PHOTO: (usize, usize) = (160, 120);

/// Something smooth to look at, by direction in OpenCV's camera axes, scaled to z = 1.
fn scene(x: f64, y: f64) -> [f32; 3] {
    [(2.0 + (3.0 * x).sin() * (2.0 * y).cos()) as f32, (1.0 + 0.3 * x + 0.2 * y) as f32, (4.0 + x * y) as f32]
}

/// The pinhole coordinates that a lens maps to (u, v), by Newton's method with numerical derivatives.
fn undistort(lens: &Distortion, u: f64, v: f64) -> (f64, f64) {
    let (mut x, mut y) = (u, v);
    for _ in 0..50 {
        let (fu, fv) = lens.distort(x, y);
        let h = 1e-6;
        let ((au, av), (bu, bv)) = (lens.distort(x + h, y), lens.distort(x, y + h));
        let [a, b, c, d] = [(au - fu) / h, (bu - fu) / h, (av - fv) / h, (bv - fv) / h];
        let determinant = a * d - b * c;
        let (ru, rv) = (u - fu, v - fv);
        x += (d * ru - b * rv) / determinant;
        y += (a * rv - c * ru) / determinant;
    }
    (x, y)
}

fn lenses() -> Vec<Distortion> {
    vec![
        Distortion::radial([-0.28, 0.07, 0.0, 0.0], [0.0; 3], [0.0; 2]).unwrap(),
        Distortion::radial([0.12, -0.03, 0.01, -0.002], [0.0; 3], [0.002, -0.003]).unwrap(),
        Distortion::radial([0.2, 0.05, 0.0, 0.0], [0.35, 0.06, 0.001], [-0.001, 0.002]).unwrap(),
        Distortion::Fisheye { k: [0.03, -0.01, 0.002, -0.0005] },
    ]
}

fn camera() -> Camera {
    let (width, height) = PHOTO;
    let projection = Projection::Pinhole { fx: 96.0, fy: 92.0, cx: 83.0, cy: 57.5 };
    Camera { projection, width, height, world_from_camera: glam::Mat4::IDENTITY }
}

fn photo(lens: &Distortion) -> Rgb {
    let (width, height) = PHOTO;
    let pixel = |i: usize| {
        let (u, v) = (((i % width) as f64 + 0.5 - 83.0) / 96.0, ((i / width) as f64 + 0.5 - 57.5) / 92.0);
        let (x, y) = undistort(lens, u, v);
        scene(x, y)
    };
    Rgb::new(width, height, (0..width * height).map(pixel).collect()).unwrap()
}

#[test]
fn an_undistorted_photo_shows_what_a_pinhole_sees() {
    for lens in lenses() {
        let undistortion = Undistortion::new(&camera(), lens).unwrap();
        let (found, pinhole) = (undistortion.smooth(&photo(&lens)), undistortion.pinhole);
        let kept = pinhole.pixels() as f64 / (PHOTO.0 * PHOTO.1) as f64;
        assert!(kept > 0.6, "{lens:?} leaves {pinhole:?}");
        let mut largest = 0.0_f32;
        for (i, found) in found.data.iter().enumerate() {
            let (column, row) = ((i % pinhole.width) as f32 + 0.5, (i / pinhole.width) as f32 + 0.5);
            let d = pinhole.direction(column, row);
            let expected = scene(f64::from(-d.x / d.z), f64::from(d.y / d.z));
            for c in 0..3 {
                largest = largest.max((found[c] / expected[c] - 1.0).abs());
            }
        }
        assert!(largest < 5e-3, "{lens:?}: off by {largest}");
        // The control: the photo itself does not show that.
        let (x, y) = lens.distort(0.7, 0.4);
        assert!((x - 0.7).hypot(y - 0.4) > 0.01, "{lens:?} does nothing");
    }
}

#[test]
fn no_pixel_of_a_pinhole_lies_outside_of_its_photo() {
    for lens in lenses() {
        let undistortion = Undistortion::new(&camera(), lens).unwrap();
        // Beyond the rim lies 0; one row more would show it.
        let (width, height) = PHOTO;
        let inner = Rgb::filled(width, height, [1.0; 3]);
        assert!(undistortion.nearest(&inner).data.iter().all(|p| *p == [1.0; 3]));
        let Camera { width: w, height: h, .. } = undistortion.pinhole;
        for (column, row) in [(0, 0), (w - 1, 0), (0, h - 1), (w - 1, h - 1), (w / 2, 0), (0, h / 2)] {
            let d = undistortion.pinhole.direction(column as f32 + 0.5, row as f32 + 0.5);
            let (x, y) = lens.distort(f64::from(-d.x / d.z), f64::from(d.y / d.z));
            let (px, py) = (96.0 * x + 83.0, 92.0 * y + 57.5);
            assert!(px >= 0.0 && px <= width as f64 && py >= 0.0 && py <= height as f64, "{lens:?}: ({px}, {py})");
        }
    }
}

#[test]
fn a_lens_that_folds_back_is_cut_where_it_does_and_a_hopeless_one_is_refused() {
    // r(1 − 2r²) turns at r = 0.41, well within the photo.
    let folding = Distortion::radial([-2.0, 0.0, 0.0, 0.0], [0.0; 3], [0.0; 2]).unwrap();
    let pinhole = Undistortion::new(&camera(), folding).unwrap().pinhole;
    let d = pinhole.direction(0.0, 0.0);
    assert!((d.x / d.z).hypot(d.y / d.z) < 0.41, "{pinhole:?}");
    let inside_out = Distortion::radial([f64::MAX, -f64::MAX, 0.0, 0.0], [f64::MAX, 0.0, 0.0], [0.0; 2]).unwrap();
    assert!(Undistortion::new(&camera(), inside_out).is_none_or(|u| u.pinhole.pixels() <= 16 * PHOTO.0 * PHOTO.1));
    let beside = Projection::Pinhole { fx: 96.0, fy: 92.0, cx: -300.0, cy: 57.5 };
    assert!(Undistortion::new(&Camera { projection: beside, ..camera() }, lenses()[0]).is_none());
}

/// Writes `transforms.json` for the one view of a folder, taken through the first of the lenses or through none, with
/// ground truth in these files, and a mesh.
fn write_capture(root: &Path, lens: bool, [albedo, roughness]: [&str; 2]) {
    let view = View {
        albedo: Some(root.join(albedo)),
        roughness: Some(root.join(roughness)),
        ..View::new("v".to_owned(), camera(), Split::Train, root.join("v.exr"))
    };
    let path = root.join("transforms.json");
    crate::capture::nerfstudio::write_transforms(&path, &[view]).unwrap();
    let mut document: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
    if lens {
        document["camera_model"] = "OPENCV".into();
        (document["k1"], document["k2"]) = ((-0.28).into(), 0.07.into());
    }
    std::fs::write(path, document.to_string()).unwrap();
    write_mesh(&root.join("mesh.obj"), Vec3::Z, 1.0);
}

#[test]
fn ground_truth_goes_through_the_lens_however_it_is_stored() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let photo = photo(&lenses()[0]);
    write_rgb(root.join("v.exr"), &photo).unwrap();
    let (albedo, roughness) = (photo.map(|p| p.map(|v| v / 6.0)), photo.map(|p| p[2] / 6.0));
    write_rgb(root.join("albedo.exr"), &albedo).unwrap();
    write_gray(root.join("roughness.exr"), &roughness).unwrap();
    write_png_rgb(root.join("albedo.png"), &encode_srgb(&albedo)).unwrap();
    write_png_gray(root.join("roughness.png"), &roughness).unwrap();
    for (lens, files) in [
        (true, ["albedo.exr", "roughness.exr"]),
        (true, ["albedo.png", "roughness.png"]),
        (false, ["albedo.exr", "roughness.exr"]),
        (false, ["albedo.png", "roughness.png"]),
    ] {
        write_capture(root, lens, files);
        let read = read(root, &ImportOptions::default(), &Silent).unwrap();
        let out = tempfile::tempdir().unwrap();
        write(&read, out.path(), &ImportOptions::default(), &Silent).unwrap();
        let capture = crate::capture::load(out.path(), &Default::default(), &Silent).unwrap();
        let view = &capture.views[0];
        // Whatever the pixel shows, they show it too.
        let image = view.load_image(&Silent).unwrap();
        let (albedo, roughness) = (view.load_albedo().unwrap().unwrap(), view.load_roughness().unwrap().unwrap());
        assert_eq!((albedo.size(), roughness.size()), (image.size(), image.size()), "{files:?}");
        for (i, pixel) in image.data.iter().enumerate() {
            let off = (0..3).map(|c| (albedo.data[i][c] - pixel[c] / 6.0).abs()).fold(0.0, f32::max);
            assert!(off < 0.01, "{files:?}, lens {lens}: pixel {i} is {:?}", albedo.data[i]);
            let off = (roughness.data[i] - pixel[2] / 6.0).abs();
            assert!(off < 0.01, "{files:?}, lens {lens}: pixel {i} is {}", roughness.data[i]);
        }
    }
}

#[test]
fn ground_truth_of_another_size_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let (width, height) = PHOTO;
    write_rgb(root.join("v.exr"), &photo(&lenses()[0])).unwrap();
    write_rgb(root.join("albedo.exr"), &Rgb::filled(width, height, [0.5; 3])).unwrap();
    write_gray(root.join("roughness.exr"), &Gray::filled(width, height, 0.5)).unwrap();
    let half = Rgb::filled(width / 2, height / 2, [0.5; 3]);
    write_rgb(root.join("half.exr"), &half).unwrap();
    write_png_rgb(root.join("half.png"), &encode_srgb(&half)).unwrap();
    for (lens, files) in [
        (true, ["half.exr", "roughness.exr"]),
        (true, ["albedo.exr", "half.exr"]),
        (true, ["albedo.exr", "half.png"]),
        (false, ["half.exr", "roughness.exr"]),
        (false, ["half.png", "roughness.exr"]),
    ] {
        write_capture(root, lens, files);
        let read = read(root, &ImportOptions::default(), &Silent).unwrap();
        let out = tempfile::tempdir().unwrap();
        let refused = write(&read, out.path(), &ImportOptions::default(), &Silent).unwrap_err().to_string();
        assert_says(&refused, &["half.", "ground truth", "80×60", "expected 160×120", "resize it"]);
    }
}

#[test]
fn importing_a_distorted_capture_leaves_pinholes_that_load() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let view = View::new("v".to_owned(), camera(), Split::Train, root.join("v.exr"));
    let fisheye = [0.03, -0.01, 0.002, -0.0005];
    // instant-ngp names no model.
    for (model, k, lens) in
        [("OPENCV", [-0.28, 0.07, 0.0, 0.0], 0), ("OPENCV_FISHEYE", fisheye, 3), ("is_fisheye", fisheye, 3)]
    {
        crate::capture::nerfstudio::write_transforms(root.join("transforms.json"), std::slice::from_ref(&view))
            .unwrap();
        let text = std::fs::read_to_string(root.join("transforms.json")).unwrap();
        let mut document: serde_json::Value = serde_json::from_str(&text).unwrap();
        match model {
            "is_fisheye" => (document["is_fisheye"], document["camera_model"]) = (true.into(), Default::default()),
            _ => document["camera_model"] = model.into(),
        }
        for (name, k) in ["k1", "k2", "k3", "k4"].into_iter().zip(k) {
            document[name] = k.into();
        }
        std::fs::write(root.join("transforms.json"), document.to_string()).unwrap();
        write_rgb(root.join("v.exr"), &photo(&lenses()[lens])).unwrap();
        write_mesh(&root.join("mesh.obj"), Vec3::Z, 1.0);
        assert!(!is_capture(root).unwrap());
        let refused = crate::capture::load(root, &Default::default(), &Silent).unwrap_err().to_string();
        assert_says(&refused, &["transforms.json", "texir import"]);
        let read = read(root, &ImportOptions::default(), &Silent).unwrap();
        let out = tempfile::tempdir().unwrap();
        assert_eq!(write(&read, out.path(), &ImportOptions::default(), &Silent).unwrap().undistorted, 1);
        let capture = crate::capture::load(out.path(), &Default::default(), &Silent).unwrap();
        let (found, camera) = (capture.views[0].load_image(&Silent).unwrap(), capture.views[0].camera);
        let d = camera.direction(10.5, 20.5);
        let expected = scene(f64::from(-d.x / d.z), f64::from(d.y / d.z));
        for (found, expected) in found.at(10, 20).iter().zip(expected) {
            assert!((found / expected - 1.0).abs() < 5e-3, "{model}: {found} is not {expected}");
        }
    }
}
