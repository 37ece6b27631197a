//! Several numbers at once, so that a processor can take them in one instruction: arithmetic lane by lane, which
//! compiles to that.
//!
//! Everything is inlined into what is compiled for the widest instructions of a processor ([`pulp::Arch`]); closures
//! might not be.

use std::ops::{Add, Div, Mul, Sub};

use crate::real::Real;

/// How many numbers are taken at once: what fills a register of AVX in single precision.
pub const LANES: usize = 8;

/// One number in each lane.
#[derive(Clone, Copy, Debug)]
pub struct Lanes<R>(pub [R; LANES]);

impl<R: Real> Lanes<R> {
    /// The same number in all lanes.
    #[inline(always)]
    pub fn splat(value: R) -> Self {
        Self([value; LANES])
    }

    /// The `k`th of a list that fills whole lanes.
    #[inline(always)]
    pub fn of(list: &[R], k: usize) -> Self {
        let mut lanes = Self::splat(R::of(0.0));
        lanes.0.copy_from_slice(&list[k * LANES..(k + 1) * LANES]);
        lanes
    }

    /// Whether all are 0.
    #[inline(always)]
    pub fn is_none(self) -> bool {
        let mut any = false;
        for lane in 0..LANES {
            any |= self.0[lane] != R::of(0.0);
        }
        !any
    }

    /// Σ a b.
    #[inline(always)]
    pub fn dot(a: [Self; 3], b: [Self; 3]) -> Self {
        a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    }

    /// All lanes together, in pairs.
    #[inline(always)]
    pub fn sum(self) -> R {
        let [a, b, c, d, e, f, g, h] = self.0;
        ((a + e) + (c + g)) + ((b + f) + (d + h))
    }
}

/// A function of two numbers, lane by lane.
macro_rules! by_lane {
    ($(#[$doc:meta])* $visibility:vis $name:ident, $a:ident, $b:ident => $of:expr) => {
        $(#[$doc])*
        #[inline(always)]
        $visibility fn $name(mut self, other: Self) -> Self {
            for lane in 0..LANES {
                let ($a, $b) = (self.0[lane], other.0[lane]);
                self.0[lane] = $of;
            }
            self
        }
    };
}

impl<R: Real> Lanes<R> {
    by_lane!(
        /// The larger of both.
        pub max, a, b => if a > b { a } else { b }
    );
    by_lane!(
        /// The smaller of both.
        pub min, a, b => if a < b { a } else { b }
    );
}

impl<R: Real> Add for Lanes<R> {
    type Output = Self;
    by_lane!(add, a, b => a + b);
}

impl<R: Real> Sub for Lanes<R> {
    type Output = Self;
    by_lane!(sub, a, b => a - b);
}

impl<R: Real> Mul for Lanes<R> {
    type Output = Self;
    by_lane!(mul, a, b => a * b);
}

impl<R: Real> Div for Lanes<R> {
    type Output = Self;
    by_lane!(div, a, b => a / b);
}
