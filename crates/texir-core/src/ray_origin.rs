//! Where rays begin that leave a surface.

use glam::Vec3;

/// Moves a ray origin off its surface by a few units in the last place, so that the ray does not meet the surface that
/// it starts on, at any scene scale (Wächter and Binder, "A Fast and Robust Method for Avoiding Self-Intersection", Ray
/// Tracing Gems, chapter 6).
pub fn offset_origin(p: Vec3, n: Vec3) -> Vec3 {
    const ORIGIN: f32 = 1.0 / 32.0;
    const FLOAT_SCALE: f32 = 1.0 / 65_536.0;
    const INT_SCALE: f32 = 256.0;
    let move_one = |p: f32, n: f32| {
        if p.abs() < ORIGIN {
            p + FLOAT_SCALE * n
        } else {
            let steps = (INT_SCALE * n) as i32;
            f32::from_bits((p.to_bits() as i32).wrapping_add(if p < 0.0 { -steps } else { steps }) as u32)
        }
    };
    Vec3::new(move_one(p.x, n.x), move_one(p.y, n.y), move_one(p.z, n.z))
}
