//! Images without the blur that lenses, stitching and resampling gave them.
//!
//! A pixel is taken for the mean of what it covers. Where the images' point spread is wider, the image is sought that
//! blurs into the one at hand: x ← x + (image − blurred x) (Van Cittert 1931), a few times only: what noise there is
//! grows by half where the spread is a sixth of a square pixel, and threefold at the widest. A pixel changes by no more
//! than a factor: beside a lamp nearly all of its light may be the lamp's, and what is left of it without that is
//! chance.

use glam::Vec3A;
use rayon::prelude::*;

use crate::raster::Rgb;

/// Steps: what the blur leaves half of comes back to 94 %.
const STEPS: usize = 3;
/// The most that a channel of a pixel changes, as a factor: as much as at edges of paint.
const CHANGE: f32 = 1.3;
/// The widest point spread, square pixels, that one pass over three pixels makes.
const PASS: f32 = 0.5;

/// Undoes a point spread of this variance beyond that of a pixel, square pixels along each axis. Left and right meet
/// where the image `wraps`. Pixels that are not finite stay as they are, and spread to no other.
pub(super) fn sharpen(image: &mut Rgb, variance: f32, wraps: bool) {
    let [width, height] = image.size();
    let at = |x: usize, y: usize| y * width + x;
    let beside_in_row = |x: usize, y: usize| match wraps {
        true => [at((x + width - 1) % width, y), at((x + 1) % width, y)],
        false => [at(x.saturating_sub(1), y), at((x + 1).min(width - 1), y)],
    };
    let beside_in_column = |x: usize, y: usize| [at(x, y.saturating_sub(1)), at(x, (y + 1).min(height - 1))];
    let passes = (variance / PASS).ceil();
    let share = 0.5 * variance / passes;
    let spread = |values: &[Vec3A], beside: &(dyn Fn(usize, usize) -> [usize; 2] + Sync)| -> Vec<Vec3A> {
        let of_pixel = |i: usize| {
            let towards = |neighbour: usize| match values[neighbour].is_finite() {
                true => share * (values[neighbour] - values[i]),
                false => Vec3A::ZERO,
            };
            values[i] + beside(i % width, i / width).map(towards).into_iter().sum::<Vec3A>()
        };
        (0..values.len()).into_par_iter().map(of_pixel).collect()
    };
    let pass = |values: &[Vec3A]| spread(&spread(values, &beside_in_row), &beside_in_column);
    let blurred = |values: &[Vec3A]| (1..passes as usize).fold(pass(values), |values, _| pass(&values));
    let seen: Vec<Vec3A> = image.data.iter().copied().map(Vec3A::from).collect();
    let mut sharp = seen.clone();
    for _ in 0..STEPS {
        let blurred = blurred(&sharp);
        for ((sharp, seen), blurred) in sharp.iter_mut().zip(&seen).zip(blurred) {
            if seen.is_finite() {
                *sharp = (*sharp + *seen - blurred).clamp(*seen / CHANGE, *seen * CHANGE);
            }
        }
    }
    image.data = sharp.into_iter().map(Into::into).collect();
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A checkerboard of squares of three pixels, painted, with a lamp in the middle.
    fn board(lamp: f32) -> Rgb {
        let value = |i: usize| match (i % 24 / 3 + i / 24 / 3) % 2 {
            _ if i == 24 * 6 + 12 => [lamp; 3],
            0 => [0.8, 0.5, 1.6],
            _ => [0.4, 0.2, 0.8],
        };
        Rgb { width: 24, height: 12, data: (0..24 * 12).map(value).collect() }
    }

    /// The mean of an image and itself, read a pixel to the left and to the right, and then up and down.
    fn blurred(image: &Rgb) -> Rgb {
        let mut out = image.clone();
        for (dx, dy) in [(1, 0), (0, 1)] {
            let before = out.clone();
            let read = |x: i64, y: i64| *before.at(x.rem_euclid(24) as usize, y.clamp(0, 11) as usize);
            for i in 0..24 * 12 {
                let (x, y) = (i as i64 % 24, i as i64 / 24);
                let [a, b, c] = [read(x - dx, y - dy), read(x, y), read(x + dx, y + dy)];
                out.data[i as usize] = std::array::from_fn(|k| (a[k] + 10.0 * b[k] + c[k]) / 12.0);
            }
        }
        out
    }

    fn difference(a: &Rgb, b: &Rgb) -> f32 {
        let pixels = a.data.iter().zip(&b.data).filter(|(a, _)| a[0].is_finite());
        pixels.map(|(a, b)| (0..3).map(|c| (a[c] - b[c]).abs()).sum::<f32>()).sum::<f32>() / a.data.len() as f32
    }

    #[test]
    fn an_image_that_was_blurred_comes_back_and_unknown_pixels_touch_none() {
        let truth = board(1.0);
        let seen = blurred(&truth);
        let mut sharp = seen.clone();
        sharpen(&mut sharp, 1.0 / 6.0, true);
        let (before, after) = (difference(&seen, &truth), difference(&sharp, &truth));
        assert!(after < 0.1 * before, "off by {before}, by {after} after sharpening");
        // Negative control: another blur than it has.
        sharpen(&mut sharp, 1.0 / 6.0, true);
        assert!(difference(&sharp, &truth) > 0.3 * before);
        let mut unknown = seen.clone();
        unknown.data[24 * 5 + 7] = [f32::NAN; 3];
        sharpen(&mut unknown, 1.0 / 6.0, true);
        assert_eq!(unknown.data.iter().filter(|pixel| pixel[0].is_nan()).count(), 1);
        // What is beside it is not taken for what is beside black.
        let mut black = seen.clone();
        black.data[24 * 5 + 7] = [0.0; 3];
        sharpen(&mut black, 1.0 / 6.0, true);
        let beside = |image: &Rgb| image.data[24 * 5 + 8][0];
        let sharp = || {
            let mut sharp = seen.clone();
            sharpen(&mut sharp, 1.0 / 6.0, true);
            sharp
        };
        assert!((beside(&unknown) - beside(&sharp())).abs() < 0.3 * (beside(&black) - beside(&sharp())).abs());
    }

    #[test]
    fn nothing_turns_black_beside_a_lamp() {
        // Blurred by less than is taken for it.
        let mut sharp = blurred(&board(1000.0));
        sharpen(&mut sharp, 1.0 / 4.0, true);
        assert!(sharp.data.iter().flatten().all(|v| *v > 0.15), "{:?}", sharp.data);
    }
}
