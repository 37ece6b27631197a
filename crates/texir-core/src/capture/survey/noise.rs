//! How noisy an image is, by itself.

use crate::raster::{Rgb, luminance};
use crate::stats::median;

/// Edge of the blocks that are looked at, pixels.
const BLOCK: usize = 8;
/// Blocks that an image is judged by at least.
const ENOUGH: usize = 50;
/// The share of blocks that are plainer than what an image's noise is read from: noise is everywhere, texture is not.
const PLAINEST: f64 = 0.1;
/// A standard deviation by the median of absolute values, where these are normal.
const OF_NORMAL: f32 = 1.4826;

/// Standard deviation of ln radiance from pixel to pixel. Blocks are convolved with the difference of two Laplacians,
/// which leaves nothing of an even or sloped patch (Immerkær 1996, Fast noise variance estimation, eq. 2), and one of
/// the plainest speaks for the image. Blocks with black in them do not count, nor do those without any noise, which
/// something has cut off or filled in. `None` where too few count.
pub(super) fn noise(image: &Rgb) -> Option<f32> {
    let (columns, rows) = (image.width / BLOCK, image.height / BLOCK);
    let blocks = (0..columns * rows).filter_map(|block| {
        let [x, y] = [block % columns, block / columns].map(|at| at * BLOCK);
        of_block(|dx, dy| luminance(image.at(x + dx, y + dy)).ln())
    });
    let mut blocks: Vec<f32> = blocks.filter(|noise| *noise > 0.0).collect();
    let place = (PLAINEST * blocks.len() as f64) as usize;
    (blocks.len() >= ENOUGH).then(|| *blocks.select_nth_unstable_by(place, f32::total_cmp).1)
}

/// The same of a block of which `at` tells the logarithms; `None` where one of them is not finite.
fn of_block(at: impl Fn(usize, usize) -> f32) -> Option<f32> {
    const KERNEL: [f32; 3] = [1.0, -2.0, 1.0];
    let inner = |x: usize, y: usize| {
        let of_row = |j: usize| (0..3).map(|i| KERNEL[i] * at(x + i, y + j)).sum::<f32>();
        // Of noise of 1, the standard deviation of this is 6: the square root of the sum of the kernel's squares.
        (0..3).map(|j| KERNEL[j] * of_row(j)).sum::<f32>().abs() / 6.0
    };
    let edge = BLOCK - 2;
    let mut differences: Vec<f32> = (0..edge * edge).map(|k| inner(k % edge, k / edge)).collect();
    let known = differences.iter().all(|difference| difference.is_finite());
    known.then(|| median(&mut differences))?.map(|middle| OF_NORMAL * middle)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::hash2;

    /// A picture of a sloped light on boards, the left half of plain paint, with noise of a standard deviation.
    fn picture(noise: f32, width: usize, height: usize) -> Rgb {
        let uniform = |k: u32, of: u32| hash2(k, of) as f32 / u32::MAX as f32 - 0.5;
        let data = (0..width * height).map(|k| {
            let (x, y) = (k % width, k / width);
            let paint = if x < width / 2 { 0.6 } else { 0.3 + 0.2 * uniform((x / 3) as u32, 1) };
            // Twelve uniform numbers less their mean make a normal one.
            let normal: f32 = (0..12).map(|of| uniform(k as u32, 2 + of)).sum();
            [paint * (1.0 + (x + 2 * y) as f32 / 300.0) * (noise * normal).exp(); 3]
        });
        Rgb::new(width, height, data.collect()).unwrap()
    }

    #[test]
    fn the_noise_of_an_image_is_told_from_its_texture() {
        for sigma in [0.02f32, 0.1, 0.3] {
            let found = noise(&picture(sigma, 256, 128)).unwrap();
            // One of the plainest blocks has less than most.
            assert!((0.7 * sigma..1.05 * sigma).contains(&found), "{found} for {sigma}");
        }
        let clean = noise(&picture(0.0, 256, 128)).unwrap();
        assert!(clean < 0.005, "{clean}");
    }

    #[test]
    fn what_is_black_or_cut_off_says_nothing() {
        let mut image = picture(0.1, 256, 128);
        let [black, cut] = [[0.0; 3], [5.0; 3]];
        for y in 0..60 {
            image.data[y * 256..][..128].fill(black);
            image.data[y * 256..][128..256].fill(cut);
        }
        let found = noise(&image).unwrap();
        assert!((0.06..0.105).contains(&found), "{found}");
        // Too little is left of it.
        image.data[60 * 256..120 * 256].fill(cut);
        assert_eq!(noise(&image), None);
        assert_eq!(noise(&picture(0.1, 7, 300)), None);
    }
}
