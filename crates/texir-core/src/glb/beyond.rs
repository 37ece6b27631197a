//! What images hold beyond the charts: engines make mips of them, and these would darken towards an empty atlas.

use crate::raster::Raster;
use crate::texture::Pyramid;

/// Push–pull fill: a texel that is not `known` takes the value of the finest mip texel over it that holds anything
/// known, a mip texel being the unweighted mean of those of its four children that do. Black where nothing is.
pub(super) fn filled<const N: usize>(map: &Raster<[f32; N]>, known: &[bool]) -> Raster<[f32; N]> {
    let levels = Pyramid::new(map.width, map.height, known).levels;
    let mut values: Vec<Option<[f32; N]>> =
        map.data.iter().zip(known).map(|(value, known)| known.then_some(*value)).collect();
    // Every texel of a level but the finest, with its children on the one before.
    let families = || {
        levels.windows(2).flat_map(|pair| {
            let [fine, coarse] = [pair[0], pair[1]];
            let texels = 0..coarse.width * coarse.height;
            texels.map(move |k| (coarse.offset + k, Pyramid::children(&fine, k % coarse.width, k / coarse.width)))
        })
    };
    for (_, children) in families() {
        values.push(mean(children.iter().flatten().filter_map(|child| values[*child])));
    }
    for (parent, children) in families().rev() {
        for child in children.into_iter().flatten() {
            values[child] = values[child].or(values[parent]);
        }
    }
    let data = values[..map.data.len()].iter().map(|value| value.unwrap_or([0.0; N])).collect();
    Raster { data, ..*map }
}

fn mean<const N: usize>(values: impl Iterator<Item = [f32; N]>) -> Option<[f32; N]> {
    let (sum, count) =
        values.fold(([0.0; N], 0.0), |(sum, count), value| (std::array::from_fn(|c| sum[c] + value[c]), count + 1.0));
    (count > 0.0).then(|| sum.map(|sum| sum / count))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mips_are_those_of_what_is_known() {
        // A chart of 3 × 2 texels of an atlas of 6 × 5, and one of a single texel.
        let (width, height) = (6, 5);
        let value = |k: usize| match (k % width, k / width) {
            (0..3, 1..3) => Some([0.2 + 0.1 * (k % width) as f32, 0.8]),
            (5, 4) => Some([0.9, 0.1]),
            _ => None,
        };
        let known: Vec<bool> = (0..width * height).map(|k| value(k).is_some()).collect();
        let data = (0..width * height).map(|k| value(k).unwrap_or_default()).collect();
        let map = filled(&Raster::new(width, height, data).unwrap(), &known);
        for k in 0..width * height {
            if let Some(value) = value(k) {
                assert_eq!(map.data[k], value);
            }
        }
        let near = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).abs() < 1e-6 && (a[1] - b[1]).abs() < 1e-6;
        // Beside a texel; in its square of four; in that of sixteen, by means of both rows of the chart.
        assert!(near(map.data[0], [0.25, 0.8]) && near(map.data[3], [0.4, 0.8]), "{:?} {:?}", map.data[0], map.data[3]);
        assert!(near(map.data[3 * width], [0.25, 0.8]) && near(map.data[4], map.data[5]));
        assert!(near(map.data[4 * width + 4], [0.9, 0.1]));
        // The second mip's first texel: of its sixteen, six are the chart's, of three of its four.
        let texel = |x: usize, y: usize| map.data[y * width + x][0];
        let quarter =
            |x: usize, y: usize| (texel(x, y) + texel(x + 1, y) + texel(x, y + 1) + texel(x + 1, y + 1)) / 4.0;
        let quarters = [quarter(0, 0), quarter(2, 0), quarter(0, 2), quarter(2, 2)];
        assert!(
            quarters.iter().zip([0.25, 0.4, 0.25, 0.4]).all(|(found, mean)| (found - mean).abs() < 1e-6),
            "{quarters:?}"
        );
        // Every texel of the first mip that holds some of a chart is the mean of that.
        for corner in (0..height).step_by(2).flat_map(|y| (0..width).step_by(2).map(move |x| [x, y])) {
            let cells = [[0, 0], [1, 0], [0, 1], [1, 1]].map(|[dx, dy]| [corner[0] + dx, corner[1] + dy]);
            let inside: Vec<usize> =
                cells.iter().filter(|[x, y]| *x < width && *y < height).map(|[x, y]| y * width + x).collect();
            let all = mean(inside.iter().map(|k| map.data[*k])).unwrap();
            if let Some(charts) = mean(inside.iter().filter_map(|k| value(*k))) {
                assert!(near(all, charts), "{all:?} {charts:?}");
            }
        }
        // Nothing is known.
        assert!(filled(&map, &vec![false; width * height]).data.iter().all(|v| *v == [0.0; 2]));
    }
}
