//! Pixels near ones that take no part in the fit.
//!
//! A light source, a mirror that is masked, the sky behind a hole of the mesh: each is left out where it is seen. But
//! meshes, poses and images agree to a centimetre at best, so that the pixel beside it, which should show a window's
//! frame alone, may hold a sliver of the pane that outshines the frame twenty times.

use rayon::prelude::*;

use crate::camera::Camera;

/// Columns and rows in a margin of `angle` degrees around pixels of a row: at least one, unless there is none; towards
/// the poles of a panorama, where columns are crowded, up to all of them.
fn reach(angle: f32, camera: &Camera, row: usize) -> [i64; 2] {
    if angle <= 0.0 {
        return [0; 2];
    }
    let pixels = angle.to_radians() * camera.pixels_per_radian(row as f32 + 0.5);
    let most = [camera.width, camera.height];
    std::array::from_fn(|axis| (pixels[axis].round().max(1.0) as i64).min(most[axis] as i64))
}

/// Which pixels lie within `angle` degrees, along their row and their column, of one that is left out. Where an image
/// ends, nothing is.
pub fn dilate(camera: &Camera, left_out: &[bool], angle: f32) -> Vec<bool> {
    let spread = |from: &[bool], axis: usize| -> Vec<bool> {
        let near = |pixel: usize| {
            let (x, y) = (pixel % camera.width, pixel / camera.width);
            let reach = reach(angle, camera, y)[axis];
            let [right, down] = [[1, 0], [0, 1]][axis];
            let at = |k: i64| camera.pixel(x as i64 + k * right, y as i64 + k * down);
            (-reach..=reach).filter_map(at).any(|pixel| from[pixel])
        };
        (0..camera.pixels()).into_par_iter().map(near).collect()
    };
    spread(&spread(left_out, 0), 1)
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
        // A pixel of the panorama is 22.5° wide.
        assert_eq!(places(&dilate(&panorama, &left_out, 1.0)), square(&[0, 1, WIDTH - 1], 2..5));
        assert_eq!(places(&dilate(&panorama, &left_out, 45.0)), square(&[0, 1, 2, WIDTH - 2, WIDTH - 1], 1..6));
        assert_eq!(places(&dilate(&photo, &left_out, 1.0)), square(&[0, 1], 2..5));
        // Negative controls: no rim but what is left out, and nothing left out.
        assert_eq!(places(&dilate(&photo, &left_out, 0.0)), [[0, 3]]);
        assert!(places(&dilate(&photo, &[false; WIDTH * HEIGHT], 30.0)).is_empty());
    }

    #[test]
    fn rims_are_as_wide_in_images_of_any_size() {
        let panorama = |width: usize| Camera { width, height: width / 2, ..camera(Projection::Equirectangular) };
        let at_the_horizon = |width: usize| reach(0.7, &panorama(width), width / 4);
        assert_eq!([256, 512, 1024, 4096].map(at_the_horizon), [[1; 2], [1; 2], [2; 2], [8; 2]]);
        assert_eq!(reach(0.0, &panorama(4096), 1024), [0; 2]);
    }

    #[test]
    fn rims_are_as_wide_near_the_poles_of_a_panorama() {
        let camera = Camera { width: 512, height: 256, ..camera(Projection::Equirectangular) };
        // 7° from the zenith.
        let row = 10;
        let mut left_out = vec![false; camera.pixels()];
        left_out[row * camera.width + 100] = true;
        let left_out = dilate(&camera, &left_out, 0.7);
        let place = |pixel: usize| ((pixel % camera.width) as f32 + 0.5, (pixel / camera.width) as f32 + 0.5);
        let (x, y) = place(row * camera.width + 100);
        let degrees = |&pixel: &usize| {
            let (to_x, to_y) = place(pixel);
            camera.direction(x, y).angle_between(camera.direction(to_x, to_y)).to_degrees()
        };
        let widest = (row * camera.width..(row + 1) * camera.width).filter(|&p| left_out[p]).map(|p| degrees(&p));
        let widest = widest.fold(0.0, f32::max);
        assert!((0.5..0.9).contains(&widest), "{widest}");
    }
}
