//! Exact Euclidean nearest-cell transform in linear time (Felzenszwalb and Huttenlocher, "Distance Transforms of
//! Sampled Functions", 2012, keeping the arguments of the minima).

use crate::raster::Mask;

/// For every cell, the nearest cell where `sources` holds; `None` everywhere if it holds nowhere.
pub(super) fn nearest(sources: &Mask) -> Option<Vec<u32>> {
    let [w, h] = sources.size();
    sources.data.iter().any(|&s| s).then_some(())?;
    // Per cell, the row of the nearest source in its column.
    let mut row_of = vec![None::<usize>; w * h];
    for x in 0..w {
        let mut last = None;
        for y in 0..h {
            if sources.data[y * w + x] {
                last = Some(y);
            }
            row_of[y * w + x] = last;
        }
        last = None;
        for y in (0..h).rev() {
            if sources.data[y * w + x] {
                last = Some(y);
            }
            let above = row_of[y * w + x];
            row_of[y * w + x] = match (above, last) {
                (Some(a), Some(b)) if b - y < y - a => Some(b),
                (Some(a), _) => Some(a),
                (None, b) => b,
            };
        }
    }
    let mut result = vec![0u32; w * h];
    // Lower envelope of the parabolas (x−i)² + dy(i)²: centres, and from which x on each is the lowest.
    let mut envelope: Vec<(usize, f64)> = Vec::with_capacity(w);
    for y in 0..h {
        let squared = |x: usize| row_of[y * w + x].map(|r| (r as f64 - y as f64).powi(2));
        envelope.clear();
        for x in 0..w {
            let Some(f) = squared(x) else { continue };
            let mut from = f64::NEG_INFINITY;
            while let Some(&(i, start)) = envelope.last() {
                let g = squared(i).unwrap_or(f64::INFINITY);
                let cross = ((f + (x * x) as f64) - (g + (i * i) as f64)) / (2.0 * (x - i) as f64);
                if cross > start {
                    from = cross;
                    break;
                }
                envelope.pop();
            }
            envelope.push((x, from));
        }
        let mut k = 0;
        for x in 0..w {
            while k + 1 < envelope.len() && envelope[k + 1].1 < x as f64 {
                k += 1;
            }
            let column = envelope[k].0;
            result[y * w + x] = (row_of[y * w + column].unwrap_or(y) * w + column) as u32;
        }
    }
    Some(result)
}

/// Distance in cells between the centres of two cells of a plan `width` cells wide.
pub(super) fn between(width: usize, a: usize, b: usize) -> f32 {
    let (dx, dy) = ((a % width) as f32 - (b % width) as f32, (a / width) as f32 - (b / width) as f32);
    dx.hypot(dy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::hash;

    #[test]
    fn agrees_with_brute_force() {
        for seed in 0..20 {
            let (w, h) = (23, 17);
            let data: Vec<bool> = (0..w * h).map(|i| hash(hash(seed) ^ i).is_multiple_of(40)).collect();
            let sources = Mask::new(w as usize, h as usize, data).unwrap();
            let Some(found) = nearest(&sources) else {
                assert!(!sources.data.contains(&true));
                continue;
            };
            for (cell, &n) in found.iter().enumerate() {
                let best = (0..sources.data.len())
                    .filter(|&s| sources.data[s])
                    .map(|s| between(w as usize, cell, s))
                    .fold(f32::INFINITY, f32::min);
                assert!(sources.data[n as usize]);
                assert_eq!(between(w as usize, cell, n as usize), best, "cell {cell}, seed {seed}");
            }
        }
    }

    #[test]
    fn nothing_is_near_in_an_empty_plan() {
        assert_eq!(nearest(&Mask::filled(4, 4, false)), None);
    }
}
