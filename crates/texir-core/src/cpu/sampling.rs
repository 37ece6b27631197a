//! Directions from numbers in [0, 1)², and the frame that they are drawn in; twin of `shared/sampling.wgsl`.

use crate::real::{Real, V3};

/// Tangent and bitangent of a unit normal (Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 2017).
#[derive(Clone, Copy, Debug)]
pub struct Frame<R> {
    /// Unit, perpendicular to the normal.
    pub tangent: V3<R>,
    /// Unit, perpendicular to both.
    pub bitangent: V3<R>,
    /// As given.
    pub normal: V3<R>,
}

impl<R: Real> Frame<R> {
    /// Around a unit normal.
    pub fn of(normal: V3<R>) -> Self {
        let [x, y, z] = normal.0;
        let one = R::of(1.0);
        let sign = if z < R::of(0.0) { -one } else { one };
        let a = -one / (sign + z);
        let b = x * y * a;
        Self {
            tangent: V3([one + sign * x * x * a, sign * b, -sign * x]),
            bitangent: V3([b, sign + y * y * a, -y]),
            normal,
        }
    }

    /// What has these coordinates along tangent, bitangent and normal, in the world.
    pub fn to_world(&self, V3([x, y, z]): V3<R>) -> V3<R> {
        self.tangent * x + self.bitangent * y + self.normal * z
    }
}

/// A cosine-distributed unit direction around +Z; density cosθ/π per solid angle.
pub fn cosine_direction<R: Real>([u, v]: [f32; 2]) -> V3<R> {
    let (u, phi) = (R::of(f64::from(u)), R::of(std::f64::consts::TAU * f64::from(v)));
    let radius = u.sqrt();
    V3([radius * phi.cos(), radius * phi.sin(), (R::of(1.0) - u).sqrt()])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_orthonormal_and_right_handed() {
        let diagonal = |z: f64| V3([0.6, -0.3, z]).normalize();
        for normal in [V3([0.0, 0.0, 1.0]), V3([0.0, 0.0, -1.0]), diagonal(0.2), diagonal(-0.2), V3([1.0, 0.0, 0.0])] {
            let Frame { tangent, bitangent, .. } = Frame::of(normal);
            let products = [(tangent, tangent), (bitangent, bitangent), (tangent, bitangent), (tangent, normal)];
            for ((a, b), expected) in products.into_iter().zip([1.0, 1.0, 0.0, 0.0]) {
                assert!((a.dot(b) - expected).abs() < 1e-12, "{normal:?}");
            }
            assert!((tangent.cross(bitangent).dot(normal) - 1.0).abs() < 1e-12, "{normal:?}");
        }
    }
}
