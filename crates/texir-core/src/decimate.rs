//! Fewer triangles for scans that are denser than an atlas can follow: edges are collapsed in the order of what that
//! costs, by quadric error metrics (Garland and Heckbert, "Surface Simplification Using Quadric Error Metrics",
//! SIGGRAPH 1997).
//!
//! Written here because what there is in Rust does not serve: meshopt-rs turns triangles over, which rays then see from
//! behind, and baby_shark panics over surfaces with borders (docs/performance.md).

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::{DMat3, DVec3, Vec2, Vec3};

use crate::error::{Error, Result};
use crate::mesh::{Mesh, weld};
use crate::progress::{Progress, Task};

/// How far a vertex may come to lie from the planes of the triangles that it stands for (root mean square), metres:
/// less than a texel of a flat.
pub const FARTHEST: f64 = 0.01;
/// Fewer triangles are no room: a box has as many.
const FEWEST: usize = 12;
/// Cosine of the angle by which a triangle may turn when a corner moves.
const MOST_TURN: f64 = 0.2;
/// Cosine of the angle at which faces still are one smooth surface.
const CREASE: f64 = 0.75;
/// Weight of the squared distance from corners beside that from planes: triangles stay even where a surface is flat.
const EVENNESS: f64 = 1e-4;
/// Weight of borders beside that of faces.
const BORDER: f64 = 10.0;
/// Collapses between two looks at whether to stop.
const PACE: usize = 4096;

/// What is left of a mesh.
#[derive(Debug)]
pub struct Decimated {
    /// Without an atlas: coordinates are (0, 0). Normals are smooth but for creases, and point to where triangles face.
    pub mesh: Mesh,
    /// Largest distance of a vertex from the planes of the triangles that it stands for (root mean square), metres.
    pub moved: f64,
}

/// Reduces a mesh to `target` triangles, or to as many as it has when the next collapse would go further than
/// [`FARTHEST`].
///
/// Vertices at one place are one: seams of normals and texture coordinates are no borders. Closed surfaces stay closed,
/// borders keep their course, and no collapse turns a triangle over. What meets at an edge of three or more triangles
/// stays as it is.
pub fn decimate(mesh: &Mesh, target: usize, progress: &dyn Progress) -> Result<Decimated> {
    let before = mesh.triangles.len();
    if target < FEWEST {
        return Err(Error::invalid(format!(
            "cannot be reduced to {target} triangles; expected {FEWEST} or more: try a tenth of the {before} that it has"
        )));
    }
    let (mut surface, mut queue) = CollapsibleMesh::new(mesh);
    let (mut live, mut moved) = (surface.triangles.len(), 0.0_f64);
    let _task = Task::start(progress, "decimating", live.saturating_sub(target) as u64, "triangles");
    let (mut collapses, mut told) = (0, live);
    while live > target {
        let Some(candidate) = queue.pop() else { break };
        let place = surface.best(candidate.edge);
        if surface.is_stale(&candidate) || place.moved > FARTHEST * FARTHEST {
            continue;
        }
        let Some(kept) = surface.kept(candidate.edge, place.at) else { continue };
        live -= surface.collapse(candidate.edge, place.at, kept);
        moved = moved.max(place.moved);
        let [vertex, _] = candidate.edge;
        queue.extend(surface.ring(vertex).iter().map(|(other, _)| surface.candidate([vertex, *other])));
        collapses += 1;
        if collapses % PACE == 0 {
            progress.check()?;
            progress.advance((told - live) as u64);
            told = live;
        }
    }
    Ok(Decimated { mesh: surface.mesh(), moved: moved.sqrt() })
}

/// Squared distances from weighted planes and points, as functions of the place.
#[derive(Clone, Copy)]
struct Quadric {
    /// Of the planes: x·Sx − 2 x·l + c.
    square: DMat3,
    linear: DVec3,
    constant: f64,
    /// Area of the triangles in the planes, m².
    area: f64,
    /// The sum of the corners, weighted by area, and of their squared lengths.
    corners: DVec3,
    lengths: f64,
}

impl Quadric {
    const NONE: Self =
        Self { square: DMat3::ZERO, linear: DVec3::ZERO, constant: 0.0, area: 0.0, corners: DVec3::ZERO, lengths: 0.0 };

    fn add_plane(&mut self, point: DVec3, normal: DVec3, weight: f64) {
        let distance = normal.dot(point);
        self.square += DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z) * weight;
        self.linear += normal * (distance * weight);
        self.constant += distance * distance * weight;
    }

    fn add_corner(&mut self, corner: DVec3, area: f64) {
        self.area += area;
        self.corners += corner * area;
        self.lengths += corner.length_squared() * area;
    }

    fn plus(&self, other: &Self) -> Self {
        Self {
            square: self.square + other.square,
            linear: self.linear + other.linear,
            constant: self.constant + other.constant,
            area: self.area + other.area,
            corners: self.corners + other.corners,
            lengths: self.lengths + other.lengths,
        }
    }

    fn best(&self) -> Optimum {
        let evenness = EVENNESS * self.area;
        let square = self.square + DMat3::from_diagonal(DVec3::splat(evenness));
        let at = square.inverse() * (self.linear + EVENNESS * self.corners);
        let from_planes = at.dot(self.square * at) - 2.0 * at.dot(self.linear) + self.constant;
        let from_corners = self.area * at.length_squared() - 2.0 * at.dot(self.corners) + self.lengths;
        let mean = |sum: f64| sum.max(0.0) / self.area.max(f64::MIN_POSITIVE);
        let moved = mean(from_planes);
        Optimum { at, moved, cost: moved + EVENNESS * mean(from_corners) }
    }
}

/// Where a vertex lies best.
struct Optimum {
    at: DVec3,
    /// Mean squared distance from the planes, m².
    moved: f64,
    /// The same, and a little for the distance from corners.
    cost: f64,
}

/// An edge that may become one vertex.
struct Candidate {
    cost: f64,
    edge: [u32; 2],
    /// How often the ends had moved when that was found.
    moves: [u32; 2],
}

impl Ord for Candidate {
    /// The cheapest is the greatest.
    fn cmp(&self, other: &Self) -> Ordering {
        other.cost.total_cmp(&self.cost).then(other.edge.cmp(&self.edge))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Candidate {}

/// A mesh whose edges can be collapsed.
struct CollapsibleMesh {
    positions: Vec<DVec3>,
    quadrics: Vec<Quadric>,
    /// How often each vertex has moved.
    moves: Vec<u32>,
    /// The triangles around each vertex.
    fans: Vec<Vec<u32>>,
    /// Those that are gone have one corner three times.
    triangles: Vec<[u32; 3]>,
}

impl CollapsibleMesh {
    /// The mesh with its vertices welded, and all its edges.
    fn new(mesh: &Mesh) -> (Self, BinaryHeap<Candidate>) {
        let (welded, firsts) = weld(mesh.positions.iter().map(|p| bits(*p)));
        let positions: Vec<DVec3> = firsts.iter().map(|&i| mesh.positions[i as usize].as_dvec3()).collect();
        let corners = mesh.triangles.iter().map(|t| t.map(|i| welded[i as usize]));
        let triangles: Vec<_> = corners.filter(|[a, b, c]| a != b && b != c && c != a).collect();

        let mut quadrics = vec![Quadric::NONE; positions.len()];
        let mut fans = vec![Vec::new(); positions.len()];
        let mut edges = Vec::with_capacity(3 * triangles.len());
        for (t, &triangle) in triangles.iter().enumerate() {
            let corners = triangle.map(|v| positions[v as usize]);
            let (normal, twice_area) = cross(corners).normalize_and_length();
            let area = 0.5 * twice_area;
            for (k, v) in triangle.into_iter().enumerate() {
                let quadric: &mut Quadric = &mut quadrics[v as usize];
                quadric.add_plane(corners[0], normal, area);
                quadric.add_corner(corners[k], area);
                fans[v as usize].push(t as u32);
                let w = triangle[(k + 1) % 3];
                edges.push(([v.min(w), v.max(w)], t as u32));
            }
        }
        edges.sort_unstable();
        let edges: Vec<_> = edges.chunk_by(|(one, _), (other, _)| one == other).collect();
        for &([v, w], t) in edges.iter().filter(|at_edge| at_edge.len() == 1).map(|at_edge| &at_edge[0]) {
            let normal = cross(triangles[t as usize].map(|i| positions[i as usize]));
            let along = positions[w as usize] - positions[v as usize];
            let beside = along.cross(normal).normalize_or_zero();
            for end in [v, w] {
                quadrics[end as usize].add_plane(positions[v as usize], beside, BORDER * along.length_squared());
            }
        }
        let moves = vec![0; positions.len()];
        let surface = Self { positions, quadrics, moves, fans, triangles };
        let queue = edges.iter().map(|at_edge| surface.candidate(at_edge[0].0)).collect();
        (surface, queue)
    }

    /// Where the one vertex that an edge becomes lies best.
    fn best(&self, edge: [u32; 2]) -> Optimum {
        let [a, b] = edge.map(|v| &self.quadrics[v as usize]);
        a.plus(b).best()
    }

    fn candidate(&self, edge: [u32; 2]) -> Candidate {
        Candidate { cost: self.best(edge).cost, edge, moves: edge.map(|v| self.moves[v as usize]) }
    }

    fn is_stale(&self, candidate: &Candidate) -> bool {
        candidate.moves != candidate.edge.map(|v| self.moves[v as usize])
    }

    /// The neighbours of a vertex by number, with how many triangles lie at the edge to each.
    fn ring(&self, vertex: u32) -> Vec<(u32, usize)> {
        let corners = self.fans[vertex as usize].iter().flat_map(|&t| self.triangles[t as usize]);
        let mut others: Vec<u32> = corners.filter(|&v| v != vertex).collect();
        others.sort_unstable();
        others.chunk_by(|a, b| a == b).map(|run| (run[0], run.len())).collect()
    }

    /// The triangles around the one vertex that an edge becomes; `None` where the surface would be torn, pinched or
    /// turned over.
    fn kept(&self, [a, b]: [u32; 2], place: DVec3) -> Option<Vec<u32>> {
        let rings = [self.ring(a), self.ring(b)];
        let shared = rings[0].iter().find(|(v, _)| *v == b)?.1;
        let branches = rings.iter().flatten().any(|(_, triangles)| *triangles > 2);
        let joins_borders = shared == 2 && rings.iter().all(|ring| ring.iter().any(|(_, triangles)| *triangles == 1));
        // A neighbour of both ends without a triangle between the three: there is a handle or a hole.
        let common = rings[0].iter().filter(|(v, _)| rings[1].binary_search_by_key(v, |(w, _)| *w).is_ok()).count();
        if branches || joins_borders || common != shared {
            return None;
        }
        let is_end = |v: &u32| *v == a || *v == b;
        let around = [a, b].into_iter().flat_map(|v| &self.fans[v as usize]).copied();
        let kept: Vec<u32> =
            around.filter(|&t| self.triangles[t as usize].iter().filter(|v| is_end(v)).count() == 1).collect();
        let across = |t: &u32| self.triangles[*t as usize].map(|v| if is_end(&v) { u32::MAX } else { v });
        let mut sides: Vec<[u32; 3]> = kept.iter().map(across).collect();
        sides.iter_mut().for_each(|side| side.sort_unstable());
        sides.sort_unstable();
        let folds = sides.windows(2).any(|pair| pair[0] == pair[1]);
        let turns = |t: &u32| {
            let corners = self.triangles[*t as usize];
            let before = cross(corners.map(|v| self.positions[v as usize]));
            let after = cross(corners.map(|v| if is_end(&v) { place } else { self.positions[v as usize] }));
            !(before.dot(after) > MOST_TURN * before.length() * after.length())
        };
        (!folds && !kept.iter().any(turns)).then_some(kept)
    }

    /// Makes an edge's first end its one vertex; returns how many triangles are gone.
    fn collapse(&mut self, edge: [u32; 2], place: DVec3, kept: Vec<u32>) -> usize {
        let [a, b] = edge.map(|v| v as usize);
        let shared = |t: &&u32| self.triangles[**t as usize].contains(&edge[1]);
        let gone: Vec<u32> = self.fans[a].iter().filter(shared).copied().collect();
        for t in &gone {
            let corners = std::mem::replace(&mut self.triangles[*t as usize], [edge[0]; 3]);
            corners.into_iter().for_each(|v| self.fans[v as usize].retain(|other| other != t));
        }
        for t in &kept {
            self.triangles[*t as usize] = self.triangles[*t as usize].map(|v| if v == edge[1] { edge[0] } else { v });
        }
        self.positions[a] = place;
        self.quadrics[a] = self.quadrics[a].plus(&self.quadrics[b]);
        self.fans[a] = kept;
        self.fans[b] = Vec::new();
        self.moves[a] += 1;
        self.moves[b] += 1;
        gone.len()
    }

    /// The triangles that are left. A vertex in a crease is there once per side.
    fn mesh(&self) -> Mesh {
        let face = |t: &[u32; 3]| cross(t.map(|v| self.positions[v as usize]));
        let faces: Vec<DVec3> = self.triangles.iter().map(face).collect();
        let mut mesh = Mesh::default();
        let mut triangles = self.triangles.clone();
        for (v, fan) in self.fans.iter().enumerate() {
            let first = mesh.normals.len();
            for &t in fan {
                let own = faces[t as usize];
                let is_smooth = |face: &DVec3| face.dot(own) > CREASE * face.length() * own.length();
                let around = fan.iter().map(|&other| faces[other as usize]).filter(is_smooth);
                let normal = around.sum::<DVec3>().normalize_or(DVec3::Z).as_vec3();
                let known = mesh.normals[first..].iter().position(|n| *n == normal);
                if known.is_none() {
                    mesh.positions.push(self.positions[v].as_vec3());
                    mesh.normals.push(normal);
                }
                let index = known.map_or(mesh.normals.len() - 1, |i| first + i) as u32;
                let corners = self.triangles[t as usize].iter().zip(&mut triangles[t as usize]);
                corners.filter(|(old, _)| **old as usize == v).for_each(|(_, new)| *new = index);
            }
        }
        mesh.uvs = vec![Vec2::ZERO; mesh.positions.len()];
        let left = self.triangles.iter().zip(triangles).filter(|([a, b, _], _)| a != b);
        mesh.triangles = left.map(|(_, new)| new).collect();
        mesh
    }
}

/// A place, exactly; −0 is 0.
fn bits(place: Vec3) -> [u32; 3] {
    (place + 0.0).to_array().map(f32::to_bits)
}

/// Twice the area of a triangle along its normal.
fn cross([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;
    use crate::progress::{Impatient, Silent};
    use crate::real::V3;
    use crate::rng::hash;
    use crate::scene::Scene;
    use crate::scene::trace::{Trace, TraceHit};

    /// `n` × `n` squares from −1 to 1, bent by `place`; vertices are there once per square.
    fn patch(mesh: &mut Mesh, n: u32, place: impl Fn(f32, f32) -> Vec3) {
        let at = |i: u32| 2.0 * i as f32 / n as f32 - 1.0;
        for (x, y) in (0..n).flat_map(|y| (0..n).map(move |x| (x, y))) {
            let base = mesh.positions.len() as u32;
            for (x, y) in [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)] {
                mesh.positions.push(place(at(x), at(y)));
                mesh.normals.push(Vec3::Z);
                mesh.uvs.push(Vec2::new(at(x), at(y)));
            }
            mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
        }
    }

    /// The faces of a cube around the origin, bent by `place`.
    fn cube(n: u32, place: impl Fn(Vec3) -> Vec3) -> Mesh {
        let mut mesh = Mesh::default();
        for (normal, x) in [(Vec3::X, Vec3::Y), (Vec3::Y, Vec3::Z), (Vec3::Z, Vec3::X)] {
            for side in [1.0, -1.0] {
                patch(&mut mesh, n, |u, v| place(side * normal + u * x + v * side * normal.cross(x)));
            }
        }
        mesh
    }

    /// Four metres of a wall with 3 mm of noise.
    fn noisy_wall() -> Mesh {
        let mut mesh = Mesh::default();
        patch(&mut mesh, 64, |x, y| {
            let noise = hash(x.to_bits() ^ hash(y.to_bits())) as f32 / u32::MAX as f32 - 0.5;
            Vec3::new(2.0 * x, 2.0 * y, 0.006 * noise)
        });
        mesh
    }

    fn sphere() -> Mesh {
        // On a lattice: where faces meet, places are equal to the bit.
        cube(32, |p| (p.normalize() * 65536.0).round() / 65536.0)
    }

    /// Edges that are not in exactly two triangles, one in either direction. Vertices count by place.
    fn open_edges(mesh: &Mesh) -> usize {
        let place = |i: u32| bits(mesh.positions[i as usize]);
        let edges = mesh.triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]);
        let all: Vec<_> = edges.map(|(a, b)| (place(a), place(b))).collect();
        let directed: HashSet<_> = all.iter().copied().collect();
        all.len() - directed.len() + directed.iter().filter(|(a, b)| !directed.contains(&(*b, *a))).count()
    }

    /// How far along a ray the mesh is, which the ray has to meet from the back.
    fn behind(scene: &Scene, origin: Vec3, direction: Vec3) -> f32 {
        let hit: TraceHit<f32> = scene.closest(V3(origin.to_array()), V3(direction.to_array())).expect("a hole");
        assert!(scene.mesh().face_normal(hit.triangle).dot(direction) > 0.0, "turned over at {origin} to {direction}");
        hit.t
    }

    #[test]
    fn a_noisy_wall_keeps_its_place_and_its_border() {
        let wall = noisy_wall();
        let Decimated { mesh, moved } = decimate(&wall, 1000, &Silent).unwrap();
        assert!((999..=1000).contains(&mesh.triangles.len()), "{}", mesh.triangles.len());
        assert!(moved < FARTHEST, "{moved}");
        let area: f32 = (0..mesh.triangles.len() as u32).map(|t| mesh.area(t)).sum();
        assert!((area / 16.0 - 1.0).abs() < 0.01, "{area}");
        let scene = Scene::new(mesh).unwrap();
        for p in &wall.positions {
            let inside = Vec3::new(0.998 * p.x, 0.998 * p.y, -1.0);
            let apart = behind(&scene, inside, Vec3::Z) - 1.0 - p.z;
            assert!(apart.abs() < 0.007, "{p} is {apart} m from the surface");
        }
    }

    #[test]
    fn a_sphere_stays_closed_and_faces_outwards() {
        let sphere = sphere();
        assert_eq!(open_edges(&sphere), 0);
        let Decimated { mesh, moved } = decimate(&sphere, 1200, &Silent).unwrap();
        assert!((1199..=1200).contains(&mesh.triangles.len()), "{}", mesh.triangles.len());
        assert_eq!(open_edges(&mesh), 0);
        assert!(moved < 0.005, "{moved}");
        for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
            assert!(n.dot(p.normalize()) > 0.98 && (n.length() - 1.0).abs() < 1e-5, "{n} at {p}");
        }
        let scene = Scene::new(mesh).unwrap();
        for p in &sphere.positions {
            let apart = behind(&scene, Vec3::ZERO, *p) - 1.0;
            assert!(apart.abs() < 0.01, "{p} is {apart} m from the surface");
        }
    }

    #[test]
    fn a_box_of_many_squares_becomes_a_box_with_sharp_edges() {
        let half = Vec3::new(1.5, 1.0, 0.5);
        let Decimated { mesh, moved } = decimate(&cube(16, |p| half * p), 12, &Silent).unwrap();
        assert_eq!((mesh.triangles.len(), mesh.positions.len(), open_edges(&mesh)), (12, 24, 0));
        assert!(moved < 0.01, "{moved}");
        for (p, n) in mesh.positions.iter().zip(&mesh.normals) {
            assert!((p.abs() - half).length() < 0.005, "{p} is no corner");
            assert!(n.abs().max_element() > 0.999 && (*n * *p).element_sum() > 0.0, "{n} at {p}");
        }
    }

    #[test]
    fn the_shape_is_not_left_for_a_target() {
        let Decimated { mesh, moved } = decimate(&sphere(), 12, &Silent).unwrap();
        assert!((100..600).contains(&mesh.triangles.len()), "{}", mesh.triangles.len());
        assert!((0.8 * FARTHEST..=FARTHEST).contains(&moved), "{moved}");
        assert_eq!(open_edges(&mesh), 0);
    }

    #[test]
    fn walls_at_one_edge_stay_joined() {
        let mut walls = Mesh::default();
        for direction in [Vec3::X, Vec3::Y, Vec3::NEG_X] {
            patch(&mut walls, 16, |x, y| y * Vec3::Z + (x + 1.0) * direction);
        }
        let Decimated { mesh, .. } = decimate(&walls, 100, &Silent).unwrap();
        let at_edge = |mesh: &Mesh| {
            let places = mesh.positions.iter().filter(|p| p.truncate() == Vec2::ZERO).map(|p| p.z.to_bits());
            places.collect::<HashSet<_>>().len()
        };
        assert_eq!((at_edge(&mesh), at_edge(&walls)), (17, 17));
        assert!(mesh.triangles.len() < walls.triangles.len() / 4, "{}", mesh.triangles.len());
    }

    #[test]
    fn what_is_no_surface_is_no_panic() {
        let mut mesh = noisy_wall();
        let (first, last) = (mesh.triangles[0], mesh.triangles[mesh.triangles.len() - 1]);
        mesh.triangles.extend([first, first, [first[0]; 3], [first[0], last[2], last[2]], [last[1], last[0], last[2]]]);
        let line = mesh.positions.len() as u32;
        mesh.positions.extend([1.0, 2.0, 4.0].map(|x| Vec3::splat(x * 1e30)));
        mesh.triangles.push([line, line + 1, line + 2]);
        let left = decimate(&mesh, 500, &Silent).unwrap().mesh;
        assert!(
            left.triangles.len() < 2000 && left.normals.iter().all(|n| n.is_normalized()),
            "{}",
            left.triangles.len()
        );
    }

    #[test]
    fn too_few_are_no_room() {
        for target in [0, 11] {
            let said = decimate(&noisy_wall(), target, &Silent).map(|_| ()).unwrap_err().to_string();
            assert!(said.contains(&format!("to {target} triangles")) && said.contains("12 or more"), "{said}");
        }
    }

    #[test]
    fn decimating_can_be_stopped() {
        let mut wall = Mesh::default();
        patch(&mut wall, 100, |x, y| Vec3::new(x, y, 0.0));
        assert!(matches!(decimate(&wall, 1000, &Impatient::after(0)), Err(Error::Cancelled)));
    }
}
