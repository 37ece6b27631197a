//! Pixels near ones that take no part in the fit.
//!
//! A light source, a mirror that is masked, the sky behind a hole of the mesh: each is left out where it is seen. But
//! meshes, poses and images agree to a centimetre at best, so that the pixel beside it, which should show a window's
//! frame alone, may hold a sliver of the pane that outshines the frame twenty times.

use rayon::prelude::*;

use crate::camera::Camera;

/// Pixels in a margin of `angle` degrees: at least one, unless there is none.
pub fn reach(angle: f32, camera: &Camera) -> usize {
    if angle > 0.0 { (angle.to_radians() / camera.pixel_angle()).round().max(1.0) as usize } else { 0 }
}

/// Which pixels lie within `reach` rows and columns of one that is left out. Where an image ends, nothing is.
pub fn dilate(camera: &Camera, left_out: &[bool], reach: usize) -> Vec<bool> {
    let reach = reach as i64;
    let spread = |from: &[bool], [right, down]: [i64; 2]| -> Vec<bool> {
        let near = |pixel: usize| {
            let (x, y) = ((pixel % camera.width) as i64, (pixel / camera.width) as i64);
            let at = |k: i64| camera.pixel(x + k * right, y + k * down);
            (-reach..=reach).filter_map(at).any(|pixel| from[pixel])
        };
        (0..camera.pixels()).into_par_iter().map(near).collect()
    };
    spread(&spread(left_out, [1, 0]), [0, 1])
}

#[cfg(test)]
mod tests {
    use glam::Mat4;

    use super::*;
    use crate::camera::Projection;

    const WIDTH: usize = 16;
    const HEIGHT: usize = 8;

    fn camera(projection: Projection) -> Camera {
        Camera { projection, width: WIDTH, height: HEIGHT, world_from_camera: Mat4::IDENTITY }
    }

    /// Columns and rows of pixels.
    fn places(of: &[bool]) -> Vec<[usize; 2]> {
        (0..of.len()).filter(|&p| of[p]).map(|p| [p % WIDTH, p / WIDTH]).collect()
    }

    fn square(columns: &[usize], rows: std::ops::Range<usize>) -> Vec<[usize; 2]> {
        rows.flat_map(|y| columns.iter().map(move |&x| [x, y])).collect()
    }

    #[test]
    fn rims_go_round_what_is_left_out_and_over_the_seam_of_a_panorama() {
        let mut left_out = vec![false; WIDTH * HEIGHT];
        left_out[3 * WIDTH] = true;
        let panorama = camera(Projection::Equirectangular);
        let photo = camera(Projection::Pinhole { fx: 8.0, fy: 8.0, cx: 8.0, cy: 4.0 });
        assert_eq!(places(&dilate(&panorama, &left_out, 1)), square(&[0, 1, WIDTH - 1], 2..5));
        assert_eq!(places(&dilate(&panorama, &left_out, 2)), square(&[0, 1, 2, WIDTH - 2, WIDTH - 1], 1..6));
        assert_eq!(places(&dilate(&photo, &left_out, 1)), square(&[0, 1], 2..5));
        // Negative controls: no rim but what is left out, and nothing left out.
        assert_eq!(places(&dilate(&photo, &left_out, 0)), [[0, 3]]);
        assert!(places(&dilate(&photo, &[false; WIDTH * HEIGHT], 3)).is_empty());
    }

    #[test]
    fn rims_are_as_wide_in_images_of_any_size() {
        let panorama = |width: usize| Camera { width, height: width / 2, ..camera(Projection::Equirectangular) };
        assert_eq!([256, 512, 1024, 4096].map(|width| reach(0.7, &panorama(width))), [1, 1, 2, 8]);
        assert_eq!(reach(0.0, &panorama(4096)), 0);
    }
}
