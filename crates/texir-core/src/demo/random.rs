//! Streams of random numbers over [`crate::rng`]: independent ones to lay out the flat, stratified ones to trace it.

use crate::rng::{hash2, sobol2, to_unit};

/// Independent numbers of a seed, for laying out and painting.
#[derive(Clone, Debug)]
pub(super) struct Random {
    seed: u32,
    drawn: u32,
}

impl Random {
    /// The stream of `seed` with the given purpose.
    pub fn new(seed: u64, purpose: u32) -> Self {
        Self { seed: hash2(fold(seed), purpose), drawn: 0 }
    }

    /// A seed for something that hashes by itself.
    pub fn seed(&mut self) -> u32 {
        self.drawn += 1;
        hash2(self.drawn, self.seed)
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f32 {
        to_unit(self.seed())
    }

    /// Uniform in [`lo`, `hi`).
    pub fn range(&mut self, lo: f32, hi: f32) -> f32 {
        lo + (hi - lo) * self.unit()
    }

    /// Uniform in 0..`n`; 0 for `n` = 0.
    pub fn index(&mut self, n: usize) -> usize {
        ((self.unit() * n as f32) as usize).min(n.saturating_sub(1))
    }

    /// Shuffles in place (Fisher–Yates).
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.index(i + 1));
        }
    }
}

/// One sample of a pixel or texel: a fresh pair of dimensions at every call, each pair stratified over the samples.
pub(super) struct Sample {
    seed: u32,
    index: u32,
    pair: u32,
}

impl Sample {
    /// Sample `index` of the stream `seed`, see [`stream`].
    pub fn new(seed: u32, index: u32) -> Self {
        Self { seed, index, pair: 0 }
    }

    /// The next two dimensions, in [0, 1)².
    pub fn pair(&mut self) -> [f32; 2] {
        self.pair += 1;
        sobol2(self.index, hash2(self.seed, self.pair))
    }
}

/// The stream of one pixel or texel: `seed` of the run, what it is for, and its index.
pub(super) fn stream(seed: u64, purpose: u32, index: usize) -> u32 {
    hash2(hash2(fold(seed), purpose), index as u32)
}

/// A uniform number in [0, 1) for a lattice point, the same on every call.
pub(super) fn lattice(x: i32, y: i32, seed: u32) -> f32 {
    to_unit(hash2(hash2(x as u32, seed), y as u32))
}

fn fold(seed: u64) -> u32 {
    hash2(seed as u32, (seed >> 32) as u32)
}
