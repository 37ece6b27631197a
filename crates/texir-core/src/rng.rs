//! Random and low-discrepancy numbers: integer arithmetic only, so that the CPU twin and the WGSL draw the same
//! samples.

/// PCG-style hash of one word (Jarzynski and Olano, "Hash Functions for GPU Rendering", JCGT 2020).
pub fn hash(x: u32) -> u32 {
    let state = x.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
    let word = ((state >> ((state >> 28) + 4)) ^ state).wrapping_mul(277_803_737);
    (word >> 22) ^ word
}

/// Hash of two words.
pub fn hash2(a: u32, b: u32) -> u32 {
    hash(a ^ hash(b).rotate_left(16))
}

/// Hash-based Owen scrambling of a bit-reversed number (Burley, "Practical Hash-based Owen Scrambling", JCGT 2020, with
/// the constants of Vegdahl's improved Laine–Karras permutation).
fn laine_karras(mut x: u32, seed: u32) -> u32 {
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul((seed >> 16) | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x
}

/// Owen scrambling of `x`: a random permutation of every elementary interval.
fn owen(x: u32, seed: u32) -> u32 {
    laine_karras(x.reverse_bits(), seed).reverse_bits()
}

/// The second Sobol dimension of index `i`, as a 32-bit fraction: i times Pascal's triangle modulo 2, which factors
/// into five masked shifts (no loop: loop iterations are scarce on some drivers).
fn sobol_pascal(i: u32) -> u32 {
    let mut x = i.reverse_bits();
    x ^= (x & 0x5555_5555) << 1;
    x ^= (x & 0x3333_3333) << 2;
    x ^= (x & 0x0f0f_0f0f) << 4;
    x ^= (x & 0x00ff_00ff) << 8;
    x ^= (x & 0x0000_ffff) << 16;
    x
}

/// Sample `index` of the two-dimensional Owen-scrambled Sobol sequence of `seed`, as fractions in [0, 1).
///
/// Any aligned run of 2^k samples is a (0, k, 2)-net, so that a prefix of a sequence is already well spread. Values
/// have 24 bits and are therefore the same numbers in `f32` and `f64`.
pub fn sobol2(index: u32, seed: u32) -> [f32; 2] {
    let shuffled = owen(index, seed);
    let x = owen(shuffled.reverse_bits(), hash2(seed, 1));
    let y = owen(sobol_pascal(shuffled), hash2(seed, 2));
    [to_unit(x), to_unit(y)]
}

/// The largest number below 1 with 24 bits.
pub const BELOW_ONE: f32 = 1.0 - 1.0 / 16_777_216.0;

/// The upper 24 bits as a number in [0, 1).
pub(crate) fn to_unit(x: u32) -> f32 {
    (x >> 8) as f32 / 16_777_216.0
}

/// Point `i` of the lattice sequence {(φ(i), frac(g·φ(i)))}, φ the radical inverse in base 2, shifted as a whole by
/// `offset` (32-bit fractions), as numbers in [0, 1) with 24 bits.
///
/// Its first 2^k points, and every aligned run of as many, are a lattice (Hickernell et al., "Extensible Lattice
/// Sequences for Quasi-Monte Carlo Quadrature", SIAM J. Sci. Comput. 22, 2000), so that sampling can go on until the
/// error is small enough. For a random offset every point is uniform, and an estimate unbiased (Cranley and Patterson,
/// SIAM J. Numer. Anal. 13, 1976). Where an integrand jumps, its error is lower than that of a scrambled net of as many
/// points.
pub fn lattice2(i: u32, offset: [u32; 2]) -> [f32; 2] {
    // Of the lattices of 2^4 to 2^17 points with this g, none has a dual vector with a product of components (0
    // counting as 1) below 7 % of the number of points; up to 2^10, none below 14 %. That keeps points apart whatever
    // the stretch between the two dimensions, which in the polar map of a hemisphere changes with the elevation.
    const GENERATOR: u32 = 38_695;
    let x = i.reverse_bits();
    [to_unit(x.wrapping_add(offset[0])), to_unit(x.wrapping_mul(GENERATOR).wrapping_add(offset[1]))]
}

/// Cells along an edge of a square that [`scrambled_morton`] goes through.
pub const MORTON_SIDE: u32 = 32;

/// Index of a cell of a [`MORTON_SIDE`]² square along a Z-order (Morton) curve, Owen-scrambled by `seed`: halves come
/// in a random order at every level, so that no pattern shows. Every aligned square of 2^k cells a side is still one
/// run.
pub fn scrambled_morton(cell: [u32; 2], seed: u32) -> u32 {
    const BITS: u32 = 2 * MORTON_SIDE.ilog2();
    let [x, y] = cell.map(|v| {
        let v = (v | (v << 4)) & 0x0f0f;
        let v = (v | (v << 2)) & 0x3333;
        (v | (v << 1)) & 0x5555
    });
    owen((x | (y << 1)) << (32 - BITS), seed) >> (32 - BITS)
}

/// Indices of [`lattice2`] in the order in which a curve that fills the square (Hilbert 1891) meets their points: rays
/// that are traced after or beside each other then go similar ways, and read the same parts of the scene.
pub fn sort_by_hilbert(mut indices: Vec<u32>) -> Vec<u32> {
    indices.sort_by_cached_key(|&i| hilbert(lattice2(i, [0; 2])));
    indices
}

/// How far along the Hilbert curve of 2^12 × 2^12 cells a point of the unit square lies.
fn hilbert(point: [f32; 2]) -> u32 {
    const BITS: u32 = 12;
    let [mut x, mut y] = point.map(|v| (v * (1 << BITS) as f32) as u32);
    let mut along = 0;
    for bit in (0..BITS).rev() {
        let (right, upper) = ((x >> bit) & 1, (y >> bit) & 1);
        along = (along << 2) | ((3 * right) ^ upper);
        // The curve within a quarter is a turned or mirrored copy of the whole.
        if upper == 0 {
            if right == 1 {
                (x, y) = (!x, !y);
            }
            (x, y) = (y, x);
        }
    }
    along
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hilbert_curve_steps_from_cell_to_cell() {
        const SIDE: u32 = 64;
        let centre = |i: u32| [i % SIDE, i / SIDE].map(|v| (v as f32 + 0.5) / SIDE as f32);
        let mut cells: Vec<u32> = (0..SIDE * SIDE).collect();
        cells.sort_by_key(|&i| hilbert(centre(i)));
        let apart = |a: u32, b: u32| (a % SIDE).abs_diff(b % SIDE) + (a / SIDE).abs_diff(b / SIDE);
        assert!(cells.windows(2).all(|pair| apart(pair[0], pair[1]) == 1));
    }

    #[test]
    fn a_z_curve_passes_every_cell_and_square_after_square() {
        for seed in [0, 5] {
            let mut passed = vec![false; (MORTON_SIDE * MORTON_SIDE) as usize];
            let along = |cell| scrambled_morton(cell, seed);
            for i in 0..MORTON_SIDE * MORTON_SIDE {
                let cell = [i % MORTON_SIDE, i / MORTON_SIDE];
                assert!(!std::mem::replace(&mut passed[along(cell) as usize], true), "{cell:?}");
                for k in 1..5 {
                    let square = cell.map(|v| v >> k << k);
                    assert_eq!(along(cell) >> (2 * k), along(square) >> (2 * k), "{cell:?}");
                }
            }
        }
        // Squares are met in different orders, or a pattern would repeat all over a map.
        let first = |x: u32| scrambled_morton([x, 0], 5) & 3;
        assert!((0..MORTON_SIDE).step_by(2).any(|x| first(x) != first(0)));
    }

    /// Standard deviation, over 400 seeds, of the estimated share of a disc in the unit square.
    fn deviation(n: u32, points: impl Fn(u32, u32) -> [f32; 2]) -> f64 {
        let inside = |[u, v]: [f32; 2]| f64::from(u8::from((u - 0.4).powi(2) + (v - 0.6).powi(2) < 0.09));
        let share = 0.09 * std::f64::consts::PI;
        let error = |s: u32| (0..n).map(|i| inside(points(i, s))).sum::<f64>() / f64::from(n) - share;
        ((0..400).map(|s| error(s).powi(2)).sum::<f64>() / 400.0).sqrt()
    }

    #[test]
    fn every_aligned_run_of_a_shifted_lattice_beats_a_scrambled_net() {
        let offset = |s: u32| [hash(s), hash2(s, 1)];
        for n in [128, 256, 1024] {
            let net = deviation(n, |i, s| sobol2(i, hash(s)));
            for part in [0, 1, 2] {
                let lattice = deviation(n, |i, s| lattice2(part * n + i, offset(s)));
                assert!(lattice < 0.95 * net, "part {part} of {n} points: {lattice} against {net}");
            }
            // Negative control: half as many points, each drawn twice.
            assert!(deviation(n, |i, s| lattice2(i / 2, offset(s))) > net);
        }
        // Two parts that continue each other are better than two that do not know of each other.
        let together = deviation(256, |i, s| lattice2(i, offset(s)));
        let apart = deviation(256, |i, s| lattice2(i % 128, offset(2 * s + i / 128)));
        assert!(together < 0.85 * apart, "{together} against {apart}");
        assert_eq!(lattice2(0, [1 << 31, 1 << 30]), [0.5, 0.25]);
        assert_eq!(lattice2(1, [0, 0])[0], 0.5);
    }

    /// Direction numbers of the second Sobol dimension by their recurrence v_k = v_{k−1} ^ (v_{k−1} >> 1).
    fn sobol_by_recurrence(mut i: u32) -> u32 {
        let (mut v, mut x) = (1u32 << 31, 0);
        while i != 0 {
            if i & 1 != 0 {
                x ^= v;
            }
            v ^= v >> 1;
            i >>= 1;
        }
        x
    }

    #[test]
    fn pascal_factorisation_is_the_sobol_recurrence() {
        for i in (0..4096).chain((0..4096).map(hash)) {
            assert_eq!(sobol_pascal(i), sobol_by_recurrence(i), "index {i}");
        }
    }

    /// A (0, k, 2)-net: each of the 2^k elementary boxes of every shape holds exactly one of 2^k samples.
    fn is_net(points: &[[f32; 2]]) -> bool {
        let k = points.len().trailing_zeros();
        (0..=k).all(|a| {
            let (nx, ny) = (1usize << a, 1usize << (k - a));
            let mut seen = vec![false; points.len()];
            points.iter().all(|p| {
                let cell = (p[1] * ny as f32) as usize * nx + (p[0] * nx as f32) as usize;
                !std::mem::replace(&mut seen[cell], true)
            })
        })
    }

    #[test]
    fn every_aligned_run_is_a_net() {
        for seed in [1, 7, 0xdead_beef] {
            for start in [0u32, 256, 1024] {
                let points: Vec<_> = (start..start + 256).map(|i| sobol2(i, seed)).collect();
                assert!(is_net(&points), "seed {seed}, start {start}");
            }
        }
        // Negative control: independent random points are no net.
        let random: Vec<_> = (0..256).map(|i| [to_unit(hash(2 * i)), to_unit(hash(2 * i + 1))]).collect();
        assert!(!is_net(&random));
    }

    #[test]
    fn seeds_decorrelate() {
        let mean = |f: &dyn Fn(u32) -> f32| (0..4096).map(f).sum::<f32>() / 4096.0;
        let covariance = mean(&|s| (sobol2(3, hash(s))[0] - 0.5) * (sobol2(3, hash(s) ^ 1)[0] - 0.5));
        assert!(covariance.abs() < 0.01, "{covariance}");
    }
}
