//! What of a view a model is shown at a time: pinholes are shown whole, panoramas as six overlapping squares.

use std::f32::consts::FRAC_PI_2;

use glam::{Mat4, Vec2, Vec3, Vec4};

use crate::camera::{Camera, Projection};
use crate::image_io::encode_srgb;
use crate::raster::{Raster, Rgb, luminance};
use crate::stats::median;

/// Half the angle that a crop of a panorama takes in. The faces of a cube would do with 45°; what is beyond that
/// overlaps.
const HALF_ANGLE_DEGREES: f32 = 52.0;
/// The shorter edge of a crop when the model leaves it open: that of the benchmark on ADE20K, pixels.
const SHORTER_EDGE: usize = 512;
/// Edges that a model leaves open are multiples of this: networks halve their input five times.
const EDGE_STEP: usize = 32;
/// A crop's longer edge is at most this many times the shorter one.
const LONGEST: usize = 4;
/// At most this many samples along the edge of a crop's pixel.
const MOST_SAMPLES: f32 = 32.0;
/// Exposure: what the median luminance becomes, the grey of a photographer's card.
const MIDDLE_GREY: f32 = 0.18;

/// What a model takes, pixels; an edge that it leaves open is `None`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct InputSize {
    pub(super) width: Option<usize>,
    pub(super) height: Option<usize>,
}

impl InputSize {
    /// The model's own edges, else those of an image that is `width` × `height`, scaled to what models are used to.
    pub(super) fn of_image(self, width: usize, height: usize) -> [usize; 2] {
        let shorter = width.min(height);
        let edge = |edge: usize| {
            let scaled = (edge * SHORTER_EDGE).div_ceil(shorter).min(LONGEST * SHORTER_EDGE);
            scaled.next_multiple_of(EDGE_STEP)
        };
        [self.width.unwrap_or_else(|| edge(width)), self.height.unwrap_or_else(|| edge(height))]
    }
}

/// `view` turned as it is, at the origin: directions are all that crops share with it.
pub(super) fn at_origin(view: &Camera) -> Camera {
    let mut camera = *view;
    camera.world_from_camera.w_axis = Vec4::W;
    camera
}

/// The crops of a view at the origin. Those of panoramas stand upright, however the panorama was held: models know
/// photos that do.
pub(super) fn crops(view: &Camera, input: InputSize) -> Vec<Camera> {
    if let Projection::Pinhole { fx, fy, cx, cy } = view.projection {
        let [width, height] = input.of_image(view.width, view.height);
        let (sx, sy) = (width as f32 / view.width as f32, height as f32 / view.height as f32);
        let projection = Projection::Pinhole { fx: fx * sx, fy: fy * sy, cx: cx * sx, cy: cy * sy };
        return vec![Camera { projection, width, height, ..*view }];
    }
    let [width, height] = input.of_image(1, 1);
    let focal = width.min(height) as f32 / (2.0 * HALF_ANGLE_DEGREES.to_radians().tan());
    let projection = Projection::Pinhole { fx: focal, fy: focal, cx: width as f32 / 2.0, cy: height as f32 / 2.0 };
    let around = (0..4).map(|i| (Mat4::from_rotation_z(i as f32 * FRAC_PI_2).x_axis.truncate(), Vec3::Z));
    let faces = around.chain([(Vec3::Z, Vec3::X), (Vec3::NEG_Z, Vec3::X)]);
    let camera = |(forward, up): (Vec3, Vec3)| {
        let axes = [forward.cross(up), up, -forward].map(|axis| axis.extend(0.0));
        let world_from_camera = Mat4::from_cols(axes[0], axes[1], axes[2], Vec4::W);
        Camera { projection, width, height, world_from_camera }
    };
    faces.map(camera).collect()
}

/// The weight of what a crop tells about a place in it, both coordinates in [0, 1]: falls to nothing at its border,
/// where another one takes over.
pub(super) fn weight(at: Vec2) -> f32 {
    (Vec2::ONE - (2.0 * at - Vec2::ONE).abs()).max(Vec2::ZERO).element_product()
}

/// The radiance that `crop` sees in the image of `view`: means over its pixels.
pub(super) fn cut(image: &Rgb, view: &Camera, crop: &Camera) -> Rgb {
    let edges = |camera: &Camera| match camera.projection {
        Projection::Equirectangular => [camera.pixel_angle(); 2],
        Projection::Pinhole { fx, fy, .. } => [1.0 / fx, 1.0 / fy],
    };
    let coarser = edges(crop)[0].max(edges(crop)[1]) / edges(view)[0].min(edges(view)[1]);
    let samples = coarser.ceil().clamp(1.0, MOST_SAMPLES) as usize;
    let share = 1.0 / samples as f32;
    let pixel = |i: usize| {
        let (x, y) = ((i % crop.width) as f32, (i / crop.width) as f32);
        let (mut sum, mut seen) = (Vec3::ZERO, 0.0_f32);
        for sample in 0..samples * samples {
            let (dx, dy) = ((sample % samples) as f32 + 0.5, (sample / samples) as f32 + 0.5);
            // Rounding may put what is at a border outside.
            if let Some(place) = view.project(crop.direction(x + dx * share, y + dy * share)) {
                let around = image.around(place.as_dvec2(), view.wraps());
                sum += around.iter().map(|&(at, weight)| weight * Vec3::from(image.data[at])).sum::<Vec3>();
                seen += 1.0;
            }
        }
        (sum / seen.max(1.0)).to_array()
    };
    Raster { width: crop.width, height: crop.height, data: (0..crop.pixels()).map(pixel).collect() }
}

/// Crops of one view as a photo of it would show them: exposed alike, so that its median luminance is a middle grey.
pub(super) fn expose(crops: &[Rgb]) -> Vec<Raster<[u8; 3]>> {
    let lit = |pixel: &[f32; 3]| Some(luminance(pixel)).filter(|l| *l > 0.0);
    let mut luminances: Vec<f32> = crops.iter().flat_map(|crop| crop.data.iter().filter_map(lit)).collect();
    let exposure = median(&mut luminances).map_or(1.0, |median| MIDDLE_GREY / median);
    crops.iter().map(|crop| encode_srgb(&crop.map(|pixel| pixel.map(|v| v * exposure)))).collect()
}
