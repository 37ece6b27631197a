//! Points on the mesh: what a ray met, and what shading needs to know there.

use std::ops::{Add, Mul};

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};

use crate::mesh::Mesh;
use crate::ray_origin::offset_origin;

/// Where a ray meets the mesh. Point = (1−u−v)·a + u·b + v·c of the triangle's corners.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Hit {
    /// Index into [`Mesh::triangles`], [`Hit::NONE`] for a miss.
    pub triangle: u32,
    /// Barycentric coordinate of the second corner.
    pub u: f32,
    /// Barycentric coordinate of the third corner.
    pub v: f32,
    /// Distance along the ray, metres.
    pub t: f32,
}

impl Hit {
    /// `triangle` of a miss.
    pub const NONE: u32 = u32::MAX;
    /// A miss.
    pub const MISS: Hit = Hit { triangle: Self::NONE, u: 0.0, v: 0.0, t: 0.0 };

    /// Whether something was hit.
    pub fn is_hit(&self) -> bool {
        self.triangle != Self::NONE
    }

    /// Whether it is on the front of the surface, the side of its texels, seen from a direction towards the eye.
    pub(crate) fn is_front(&self, mesh: &Mesh, towards: Vec3) -> bool {
        let (face, _) = self.front(mesh);
        face.dot(towards) > 0.0
    }

    /// The unit normals of the front: of the face, on the side of the shading normal, and for shading.
    fn front(&self, mesh: &Mesh) -> (Vec3, Vec3) {
        let face = mesh.face_normal(self.triangle);
        let normal = self.interpolate(mesh.corner_normals(self.triangle)).normalize_or(face);
        (if face.dot(normal) < 0.0 { -face } else { face }, normal)
    }

    /// Atlas coordinates of the hit.
    pub fn uv(&self, mesh: &Mesh) -> Vec2 {
        self.interpolate(mesh.corner_uvs(self.triangle))
    }

    /// What lies at the hit between values at the corners of its triangle.
    pub(crate) fn interpolate<V: Add<Output = V> + Mul<f32, Output = V>>(&self, [a, b, c]: [V; 3]) -> V {
        a * (1.0 - self.u - self.v) + b * self.u + c * self.v
    }
}

/// Where a texel of an atlas lies on the mesh: see [`Hit`] for the point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TexelHit<R = f32> {
    /// Index into [`Mesh::triangles`].
    pub triangle: u32,
    /// Barycentric coordinate of the second corner.
    pub u: R,
    /// Barycentric coordinate of the third corner.
    pub v: R,
    /// Whether the texel's centre is inside the triangle, which otherwise only touches the texel.
    pub inside: bool,
}

impl TexelHit {
    /// The same point as that of a ray, without a distance.
    pub fn hit(&self) -> Hit {
        Hit { triangle: self.triangle, u: self.u, v: self.v, t: 0.0 }
    }
}

/// A surface point from which rays leave.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct SurfacePoint {
    /// Ray origin: the world position, moved off the surface along the geometric normal by [`offset_origin`].
    pub position: [f32; 3],
    /// The triangle it lies on.
    pub triangle: u32,
    /// Unit shading normal.
    pub normal: [f32; 3],
    /// Index of the point: the texel's in its atlas. It chooses the point's samples, so that a subset draws the same.
    pub index: u32,
}

impl SurfacePoint {
    /// The point of a hit. With `towards` (a unit direction), both normals are flipped to its side, so that a surface
    /// seen from behind is shaded on the side that is seen. Its index is 0.
    pub fn new(mesh: &Mesh, hit: &Hit, towards: Option<Vec3>) -> Self {
        let (mut face, mut normal) = hit.front(mesh);
        if towards.is_some_and(|d| face.dot(d) < 0.0) {
            face = -face;
            normal = -normal;
        }
        let position = offset_origin(hit.interpolate(mesh.corners(hit.triangle)), face);
        Self { position: position.to_array(), triangle: hit.triangle, normal: normal.to_array(), index: 0 }
    }
}

/// Which of the six axis directions a normal is nearest to: +x, −x, +y, −y, +z, −z; of several, the last, as in the
/// shaders' light tables.
pub(crate) fn facing(normal: Vec3) -> usize {
    let [x, y, z] = normal.abs().to_array();
    let axis = if x > y && x > z { 0 } else { 1 + usize::from(z >= y) };
    2 * axis + usize::from(normal[axis] < 0.0)
}
