//! Parts of images that hold nothing: what was cut out, what a stitcher did not cover.

use crate::raster::Rgb;

/// Pixels of an area at least: single ones are black by chance where there is little light.
const AREA: usize = 16;

/// Makes areas that are exactly black unknown (NaN); counts their pixels.
pub(super) fn blank_black_areas(image: &mut Rgb) -> usize {
    let [width, height] = image.size();
    let mut black: Vec<bool> = image.data.iter().map(|pixel| *pixel == [0.0; 3]).collect();
    let mut blanked = 0;
    let mut area = Vec::new();
    for start in 0..black.len() {
        if !std::mem::take(&mut black[start]) {
            continue;
        }
        area.clear();
        area.push(start);
        let mut next = 0;
        while let Some(&pixel) = area.get(next) {
            next += 1;
            let (x, y) = (pixel % width, pixel / width);
            let beside = [
                (x > 0).then(|| pixel - 1),
                (x + 1 < width).then(|| pixel + 1),
                (y > 0).then(|| pixel - width),
                (y + 1 < height).then(|| pixel + width),
            ];
            area.extend(beside.into_iter().flatten().filter(|&other| std::mem::take(&mut black[other])));
        }
        if area.len() >= AREA {
            area.iter().for_each(|&pixel| image.data[pixel] = [f32::NAN; 3]);
            blanked += area.len();
        }
    }
    blanked
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas_are_blanked_and_single_pixels_are_not() {
        let black = |x: usize, y: usize| {
            // A bent strip of 18 pixels, a corner of 4 × 4, a block of 15 that touches nothing.
            let strip = (y == 2 && (2..12).contains(&x)) || (x == 11 && (2..11).contains(&y));
            strip || (x >= 28 && y >= 12) || ((15..20).contains(&x) && (5..8).contains(&y))
        };
        let (width, height) = (32, 16);
        let pixel = |i: usize| if black(i % width, i / width) { [0.0; 3] } else { [0.0, 0.0, 1e-30] };
        let mut image = Rgb { width, height, data: (0..width * height).map(pixel).collect() };
        let before = image.clone();
        assert_eq!(blank_black_areas(&mut image), 18 + 16);
        for (i, (after, before)) in image.data.iter().zip(&before.data).enumerate() {
            let (x, y) = (i % width, i / width);
            let block = (15..20).contains(&x) && (5..8).contains(&y);
            if black(x, y) && !block {
                assert!(after.iter().all(|v| v.is_nan()), "({x}, {y})");
            } else {
                assert_eq!(after, before, "({x}, {y})");
            }
        }
    }
}
