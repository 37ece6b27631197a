//! Faces of any number of corners, cut into triangles that are wound as they are.

mod ears;

use glam::{DVec2, DVec3, Vec3};

use super::RawMesh;

impl RawMesh {
    /// Adds a planar polygon, concave or not: as a fan about its first corner where that covers it, as it does all that
    /// are convex, and by its ears otherwise.
    pub(super) fn push_polygon(&mut self, corners: &[u32]) {
        if corners.len() < 4 {
            // Points and lines are no surface.
            self.triangles.extend(corners.first_chunk::<3>());
            return;
        }
        // An index out of range becomes an error once the triangle is there that has it.
        let position = |i: &u32| self.positions.get(*i as usize).copied().unwrap_or(Vec3::NAN);
        let outline = Outline::from_front(corners.iter().map(position));
        let fan = (2..corners.len()).map(|i| [0, i - 1, i]);
        let with_corners = |triangle: [usize; 3]| triangle.map(|i| corners[i]);
        match outline {
            Some(outline) if !outline.covers(fan.clone()) => {
                let triangles = ears::clip(&outline);
                self.crossing_polygons += usize::from(!outline.covers(triangles.iter().copied()));
                self.triangles.extend(triangles.into_iter().map(with_corners));
            }
            _ => self.triangles.extend(fan.map(with_corners)),
        }
    }
}

/// A polygon as seen from its front: counter-clockwise.
struct Outline {
    points: Vec<DVec2>,
    /// How far off its line a corner may be: coordinates, its own and those of the line's ends, are single precision.
    rounding: f64,
}

impl Outline {
    /// Leaves out the axis that is closest to the polygon's normal (Newell's), which keeps straight what is straight
    /// and rounds nothing. `None` where there is no normal, or a corner has no place.
    fn from_front(corners: impl Iterator<Item = Vec3> + Clone) -> Option<Self> {
        let first = corners.clone().next()?.as_dvec3();
        let edges = corners.clone().zip(corners.clone().cycle().skip(1));
        let normal: DVec3 = edges.map(|(a, b)| (a.as_dvec3() - first).cross(b.as_dvec3() - first)).sum();
        let axis = normal.abs().max_position();
        if !(normal.is_finite() && normal[axis] != 0.0) {
            return None;
        }
        let (x, y) = ((axis + 1) % 3, (axis + 2) % 3);
        let (x, y) = if normal[axis] > 0.0 { (x, y) } else { (y, x) };
        let largest = corners.clone().map(|p| p.abs().max_element()).fold(0.0, f32::max);
        let points = corners.map(|p| DVec2::new(p[x].into(), p[y].into())).collect();
        Some(Self { points, rounding: 2.0 * f64::from(f32::EPSILON) * f64::from(largest) })
    }

    /// Twice the area of a triangle; negative where it is turned over.
    fn turn(&self, [a, b, c]: [usize; 3]) -> f64 {
        let [a, b, c] = [a, b, c].map(|i| self.points[i]);
        (b - a).perp_dot(c - a)
    }

    /// [`Self::turn`], or 0 where the triangle is no higher than rounding makes it.
    fn certain_turn(&self, triangle: [usize; 3]) -> f64 {
        let [a, b, c] = triangle.map(|i| self.points[i]);
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let turn = self.turn(triangle);
        if turn.abs() > self.rounding * longest { turn } else { 0.0 }
    }

    /// Whether the triangles of a cut cover what the polygon encloses once, and nothing else. Over every place their
    /// windings add up to the polygon's, 1 inside and 0 outside: none may be turned over.
    fn covers(&self, mut triangles: impl Iterator<Item = [usize; 3]>) -> bool {
        triangles.all(|triangle| self.certain_turn(triangle) >= 0.0)
    }
}
