//! Items in groups, and sums over them in an order that does not depend on threads.

use rayon::prelude::*;

use crate::fit::index::NONE;

/// Items in groups: texels in segments, say.
#[derive(Clone, Copy)]
pub struct Partition<'a> {
    /// The group of every item, from 0; [`NONE`] for those of none.
    pub of: &'a [u32],
    /// How many groups there are.
    pub count: usize,
}

/// Items that are added up one after another: few enough for all threads, many beside the groups.
const BLOCK: usize = 1 << 18;

impl Partition<'_> {
    /// Σ `of` over the items of each group. In double precision: a sum of millions of items in single precision stops
    /// where one is less than its last digit.
    pub fn sums<const N: usize>(self, of: impl Fn(usize) -> Option<[f64; N]> + Sync) -> Vec<[f64; N]> {
        let add = |sum: &mut [f64; N], terms: [f64; N]| sum.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        let of_block = |(block, members): (usize, &[u32])| {
            let mut sums = vec![[0.0; N]; self.count];
            for (i, group) in (block * BLOCK..).zip(members).filter(|(_, group)| **group != NONE) {
                of(i).into_iter().for_each(|terms| add(&mut sums[*group as usize], terms));
            }
            sums
        };
        let mut sums = vec![[0.0; N]; self.count];
        // As many at a time as there are threads: groups may be many.
        let together = rayon::current_num_threads().max(1);
        for (k, members) in self.of.chunks(together * BLOCK).enumerate() {
            let numbered = members.par_chunks(BLOCK).enumerate().map(|(i, members)| (k * together + i, members));
            let blocks: Vec<_> = numbered.map(of_block).collect();
            blocks.into_iter().for_each(|block| sums.iter_mut().zip(block).for_each(|(sum, terms)| add(sum, terms)));
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_those_of_the_items_of_each_group() {
        let items = 2 * BLOCK + 5;
        let group: Vec<u32> = (0..items).map(|i| [0, 2, NONE][i % 3]).collect();
        let sums = Partition { of: &group, count: 3 }.sums(|i| (i >= 3).then_some([1.0, i as f64]));
        let of = |rest: usize| (3..items).filter(move |i| i % 3 == rest);
        let expected = |rest: usize| [of(rest).count() as f64, of(rest).sum::<usize>() as f64];
        assert_eq!(sums, [expected(0), [0.0; 2], expected(1)]);
    }
}
