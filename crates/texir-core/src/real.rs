//! The scalar of the CPU twins: `f32` to run, `f64` as the oracle, [`Dual`] to differentiate.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// A real number type that the CPU twins are generic over.
pub trait Real:
    Copy
    + std::fmt::Debug
    + PartialOrd
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + 'static
{
    /// A constant.
    fn of(value: f64) -> Self;
    /// The value without its derivative.
    fn value(self) -> f64;
    /// Square root.
    fn sqrt(self) -> Self;
    /// 2^self.
    fn exp2(self) -> Self;
    /// ln(1 + self).
    fn ln_1p(self) -> Self;
    /// Sine.
    fn sin(self) -> Self;
    /// Cosine.
    fn cos(self) -> Self;
    /// Inverse cosine.
    fn acos(self) -> Self;
    /// Angle of the point (x, self).
    fn atan2(self, x: Self) -> Self;

    /// The larger; the derivative is that of the larger.
    fn max(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
    /// The smaller; the derivative is that of the smaller.
    fn min(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    /// Absolute value.
    fn abs(self) -> Self {
        if self < Self::of(0.0) { -self } else { self }
    }
}

macro_rules! impl_real {
    ($t:ty) => {
        impl Real for $t {
            fn of(value: f64) -> Self {
                value as $t
            }
            fn value(self) -> f64 {
                f64::from(self)
            }
            fn sqrt(self) -> Self {
                <$t>::sqrt(self)
            }
            fn exp2(self) -> Self {
                <$t>::exp2(self)
            }
            fn ln_1p(self) -> Self {
                <$t>::ln_1p(self)
            }
            fn sin(self) -> Self {
                <$t>::sin(self)
            }
            fn cos(self) -> Self {
                <$t>::cos(self)
            }
            fn acos(self) -> Self {
                <$t>::acos(self)
            }
            fn atan2(self, x: Self) -> Self {
                <$t>::atan2(self, x)
            }
        }
    };
}
impl_real!(f32);
impl_real!(f64);

/// A number with its derivative in one variable: forward-mode differentiation for the gradient tests.
#[derive(Clone, Copy, Debug)]
pub struct Dual {
    /// Value.
    pub re: f64,
    /// Derivative.
    pub du: f64,
}

impl Dual {
    /// The variable itself: derivative 1.
    pub fn variable(re: f64) -> Self {
        Self { re, du: 1.0 }
    }
    fn chain(self, re: f64, slope: f64) -> Self {
        Self { re, du: self.du * slope }
    }
}

impl PartialEq for Dual {
    fn eq(&self, other: &Self) -> bool {
        self.re == other.re
    }
}
impl PartialOrd for Dual {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        self.re.partial_cmp(&other.re)
    }
}
impl Add for Dual {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self { re: self.re + o.re, du: self.du + o.du }
    }
}
impl Sub for Dual {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        Self { re: self.re - o.re, du: self.du - o.du }
    }
}
impl Mul for Dual {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Self { re: self.re * o.re, du: self.du * o.re + self.re * o.du }
    }
}
impl Div for Dual {
    type Output = Self;
    fn div(self, o: Self) -> Self {
        Self { re: self.re / o.re, du: (self.du - self.re / o.re * o.du) / o.re }
    }
}
impl Neg for Dual {
    type Output = Self;
    fn neg(self) -> Self {
        Self { re: -self.re, du: -self.du }
    }
}
impl Real for Dual {
    fn of(value: f64) -> Self {
        Self { re: value, du: 0.0 }
    }
    fn value(self) -> f64 {
        self.re
    }
    fn sqrt(self) -> Self {
        let root = self.re.sqrt();
        self.chain(root, 0.5 / root)
    }
    fn exp2(self) -> Self {
        let value = self.re.exp2();
        self.chain(value, value * std::f64::consts::LN_2)
    }
    fn ln_1p(self) -> Self {
        self.chain(self.re.ln_1p(), 1.0 / (1.0 + self.re))
    }
    fn sin(self) -> Self {
        self.chain(self.re.sin(), self.re.cos())
    }
    fn cos(self) -> Self {
        self.chain(self.re.cos(), -self.re.sin())
    }
    fn acos(self) -> Self {
        self.chain(self.re.acos(), -1.0 / (1.0 - self.re * self.re).sqrt())
    }
    fn atan2(self, x: Self) -> Self {
        let square = self.re * self.re + x.re * x.re;
        Self { re: self.re.atan2(x.re), du: (self.du * x.re - self.re * x.du) / square }
    }
}

/// A vector of three [`Real`]s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct V3<R>(pub [R; 3]);

impl<R: Real> V3<R> {
    /// From `f32` components.
    pub fn of(v: [f32; 3]) -> Self {
        Self(v.map(|c| R::of(f64::from(c))))
    }
    /// The zero vector.
    pub fn zero() -> Self {
        Self([R::of(0.0); 3])
    }
    /// Inner product.
    pub fn dot(self, o: Self) -> R {
        self.0[0] * o.0[0] + self.0[1] * o.0[1] + self.0[2] * o.0[2]
    }
    /// Vector product.
    pub fn cross(self, o: Self) -> Self {
        let ([a, b, c], [x, y, z]) = (self.0, o.0);
        Self([b * z - c * y, c * x - a * z, a * y - b * x])
    }
    /// To `f32` components.
    pub fn to_f32(self) -> [f32; 3] {
        self.0.map(|c| c.value() as f32)
    }
    /// Unit vector.
    pub fn normalize(self) -> Self {
        self * (R::of(1.0) / self.dot(self).sqrt())
    }
    /// Component-wise product.
    pub fn hadamard(self, o: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] * o.0[i]))
    }
    /// Applies `f` to every component.
    pub fn map<S>(self, f: impl FnMut(R) -> S) -> V3<S> {
        V3(self.0.map(f))
    }
}
impl<R: Real> Add for V3<R> {
    type Output = Self;
    fn add(self, o: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + o.0[i]))
    }
}
impl<R: Real> Sub for V3<R> {
    type Output = Self;
    fn sub(self, o: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] - o.0[i]))
    }
}
impl<R: Real> Mul<R> for V3<R> {
    type Output = Self;
    fn mul(self, s: R) -> Self {
        Self(self.0.map(|c| c * s))
    }
}
