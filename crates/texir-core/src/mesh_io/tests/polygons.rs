//! Faces of more than three corners, as files have them and as they may come.

use super::*;

/// A wall with a doorway, as width and height.
const WALL: [(f32, f32); 8] =
    [(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (2.0, 2.0), (2.0, 0.0), (3.0, 0.0), (3.0, 2.5), (0.0, 2.5)];
const WALL_AREA: f32 = 3.0 * 2.5 - 1.0 * 2.0;

/// The wall, turned about the vertical.
fn stand((width, height): (f32, f32), turn: f32) -> Vec3 {
    Vec3::new(width * turn.cos(), width * turn.sin(), height)
}

/// The wall's place in the atlas, v up.
fn place((width, height): (f32, f32)) -> Vec2 {
    Vec2::new(width / 4.0, height / 4.0)
}

/// The wall as one face of an OBJ, of a PLY with coordinates per vertex, and of one with coordinates per corner.
fn files(wall: &[(f32, f32)], turn: f32) -> [(&'static str, String); 3] {
    let each = |line: &dyn Fn((f32, f32)) -> String| wall.iter().map(|at| line(*at)).collect::<String>();
    let position = |at| format!("{} {} {}", stand(at, turn).x, stand(at, turn).y, stand(at, turn).z);
    let uv = |at| format!("{} {}", place(at).x, place(at).y);
    let (count, indices) = (wall.len(), (0..wall.len()).map(|i| format!(" {i}")).collect::<String>());
    // `vt` are in another order than `v`.
    let corners: String = (0..count).map(|i| format!(" {}/{}/1", i + 1, count - i)).collect();
    let reversed: String = wall.iter().rev().map(|at| format!("vt {}\n", uv(*at))).collect();
    let obj = format!("{}{reversed}vn 0 0 1\nf{corners}\n", each(&|at| format!("v {}\n", position(at))));
    let header = |vertex: &str, face: &str| {
        let floats: String = vertex.split(' ').map(|name| format!("property float {name}\n")).collect();
        format!(
            "ply\nformat ascii 1.0\nelement vertex {count}\n{floats}element face 1\n\
             property list uchar int vertex_indices\n{face}end_header\n"
        )
    };
    let vertices = each(&|at| format!("{} {}\n", position(at), uv(at)));
    let per_vertex = format!("{}{vertices}{count}{indices}\n", header("x y z s t", ""));
    let vertices = each(&|at| format!("{}\n", position(at)));
    let uvs = each(&|at| format!(" {}", uv(at)));
    let per_corner = format!(
        "{}{vertices}{count}{indices} {}{uvs}\n",
        header("x y z", "property list uchar float texcoord\n"),
        2 * count
    );
    [("a.obj", obj), ("a.ply", per_vertex), ("b.ply", per_corner)]
}

#[test]
fn a_wall_keeps_its_doorway() {
    for (start, is_reversed, turn) in (0..8).flat_map(|start| [(start, false, 0.0_f32), (start, true, 0.5)]) {
        let mut wall = WALL;
        wall.rotate_left(start);
        if is_reversed {
            wall.reverse();
        }
        let front = Vec3::new(turn.sin(), -turn.cos(), 0.0) * if is_reversed { -1.0 } else { 1.0 };
        for (name, text) in files(&wall, turn) {
            let MeshFile { mesh, warnings } = read_text(name, text).unwrap();
            assert!(warnings.is_empty(), "{name}: {warnings:?}");
            let triangles = 0..mesh.triangles.len() as u32;
            assert_eq!(triangles.len(), 6, "{name} from corner {start}");
            let area: f32 = triangles.clone().map(|t| mesh.area(t)).sum();
            assert!((area - WALL_AREA).abs() < 1e-5, "{name} from corner {start} has {area} m²");
            assert!(triangles.clone().all(|t| mesh.face_normal(t).dot(front) > 0.999), "{name} from corner {start}");
            for t in triangles {
                for (p, uv) in mesh.corners(t).into_iter().zip(mesh.corner_uvs(t)) {
                    let at = place((p.truncate().length(), p.z));
                    assert!(uv.distance(Vec2::new(at.x, 1.0 - at.y)) < 1e-6, "{name}: {p} is at {uv}");
                }
            }
            assert!(name != "a.obj" || mesh.normals.iter().all(|n| *n == Vec3::Z));
        }
    }
}

/// A polygon, and nothing else.
fn polygon(corners: &[Vec3]) -> RawMesh {
    let mut raw = RawMesh { positions: corners.to_vec(), ..RawMesh::default() };
    raw.push_polygon(&(0..corners.len() as u32).collect::<Vec<_>>());
    raw
}

fn flat(corners: &[(f32, f32)]) -> Vec<Vec3> {
    corners.iter().map(|(x, y)| Vec3::new(*x, *y, 0.0)).collect()
}

/// Areas of the triangles; negative where they face −z.
fn areas(raw: &RawMesh) -> Vec<f64> {
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| raw.positions[i as usize].as_dvec3());
        0.5 * (b - a).cross(c - a).z
    };
    raw.triangles.iter().map(area).collect()
}

/// Of a polygon that is counter-clockwise: no triangle is turned over, and together they have its area.
#[track_caller]
fn assert_covers(raw: &RawMesh) {
    let count = raw.positions.len();
    let corners: Vec<_> = raw.positions.iter().map(|p| p.truncate().as_dvec2()).collect();
    let expected: f64 = (0..count).map(|i| 0.5 * corners[i].perp_dot(corners[(i + 1) % count])).sum();
    let areas = areas(raw);
    assert_eq!((areas.len(), raw.crossing_polygons), (count - 2, 0));
    assert!(areas.iter().all(|area| *area >= -1e-9), "{:?}", areas.iter().find(|area| **area < 0.0));
    let area: f64 = areas.iter().sum();
    assert!((area / expected - 1.0).abs() < 1e-6, "{area} m², but it has {expected}");
}

/// So many corners, at a distance from the centre each.
fn round(count: usize, distance: impl Fn(usize) -> f32) -> Vec<Vec3> {
    let corner = |i: usize| {
        let (y, x) = (std::f64::consts::TAU * i as f64 / count as f64).sin_cos();
        Vec3::new(x as f32, y as f32, 0.0) * distance(i)
    };
    (0..count).map(corner).collect()
}

#[test]
fn convex_polygons_are_fans_about_their_first_corners() {
    let fan = |corners: u32| (2..corners).map(|i| [0, i - 1, i]).collect::<Vec<_>>();
    let turned = glam::Quat::from_rotation_x(0.3) * glam::Quat::from_rotation_y(1.1);
    for count in [3, 4, 5, 6, 9, 40] {
        for corners in [round(count, |_| 2.0), round(count, |_| 2.0).into_iter().rev().collect()] {
            assert_eq!(polygon(&corners).triangles, fan(count as u32));
            let oblique: Vec<Vec3> = corners.iter().map(|p| turned * *p + Vec3::new(5.0, -3.0, 1.0)).collect();
            assert_eq!(polygon(&oblique).triangles, fan(count as u32));
        }
    }
    // Corners on its edges, where its neighbours end, are in line but for rounding.
    let sides = [(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0), (0.0, 2.0), (0.0, 1.0)];
    let oblique: Vec<Vec3> = flat(&sides).iter().map(|p| turned * *p + Vec3::new(5.0, -3.0, 1.0)).collect();
    assert_eq!(polygon(&oblique).triangles, fan(8));
    // Negative control: a fan would cover the doorway.
    assert_ne!(polygon(&flat(&WALL)).triangles, fan(8));
}

#[test]
fn concave_polygons_are_covered_once_whatever_corner_comes_first() {
    let arrow = vec![(0.0, 0.0), (2.0, -1.0), (0.0, 3.0), (-2.0, -1.0)];
    let doubled = WALL.into_iter().flat_map(|at| [at, at]).collect();
    // To a window and back, by the same edge.
    let window = vec![
        (0.0, 0.0),
        (4.0, 0.0),
        (4.0, 3.0),
        (0.0, 3.0),
        (0.0, 0.0),
        (1.0, 1.0),
        (1.0, 2.0),
        (3.0, 2.0),
        (3.0, 1.0),
        (1.0, 1.0),
    ];
    // Out of a corner and back, and into the wall and back.
    let mut spiked = WALL.to_vec();
    spiked.splice(6..7, [(3.0, 2.5), (3.5, 3.0), (3.0, 2.5)]);
    spiked.splice(2..3, [(1.0, 2.0), (0.5, 2.25), (1.0, 2.0)]);
    for mut corners in [arrow, WALL.to_vec(), doubled, window, spiked] {
        for _ in 0..corners.len() {
            corners.rotate_left(1);
            assert_covers(&polygon(&flat(&corners)));
        }
    }
}

#[test]
fn polygons_without_area_are_left_out() {
    let vertices = "v 0 0 0\nv 1 1 1\nv 2 2 2\nv 3 3 3\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\n";
    for collapsed in ["1/1 1/2 1/3 1/1 1/2", "1/1 2/2 3/3 4/1", "4/1 1/2 3/3 2/1 1/2", "1/1 2/2 1/1 2/2"] {
        let text = format!("{vertices}f {collapsed}\nf 1/1 2/2 5/3\n");
        let MeshFile { mesh, warnings } = read_text("a.obj", text).unwrap();
        assert_eq!(mesh.triangles.len(), 1, "{collapsed}");
        assert!(warnings.len() == 1 && warnings[0].contains("have no area"), "{warnings:?}");
    }
    let error = message(read_text("a.obj", format!("{vertices}v nan 0 0\nf 1/1 2/2 5/3 6/1\n")));
    assert!(error.contains("a.obj") && error.contains("expected finite coordinates"), "{error}");
    let error = message(read_text("a.obj", format!("{vertices}f 1/1 2/2 5/3\nf\n")));
    assert!(error.contains("line 10: an `f` line has no vertices"), "{error}");
    // Points and lines are no surface.
    let few = format!("{vertices}f 1/1\nf 1/1 2/2\nl 1 2\nf 1/1 2/2 5/3\n");
    assert_eq!(read_text("a.obj", few).unwrap().mesh.triangles.len(), 1);
}

#[test]
fn polygons_that_cross_themselves_are_told() {
    let text = "v 0 0 0\nv 3 0 0\nv 3 3 0\nv 1 -1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n";
    let MeshFile { mesh, warnings } = read_text("a.obj", text).unwrap();
    assert_eq!(mesh.triangles.len(), 2);
    assert!(warnings.len() == 1 && warnings[0].contains("a.obj: the outlines of 1 polygons cross"), "{warnings:?}");
}

/// With quadratic time any of these would take minutes.
#[test]
fn polygons_of_many_corners() {
    let count = 50_000;
    assert_covers(&polygon(&round(count, |i| if i % 2 == 0 { 2.0 } else { 1.0 })));
    assert_covers(&polygon(&round(count, |i| if i == count / 2 { 1.0 } else { 2.0 })));
    let tooth = |i: usize| (1.0 - i as f32 / count as f32, if i.is_multiple_of(2) { 1.0 } else { 0.1 });
    let comb: Vec<_> = [(0.0, 0.0), (1.0, 0.0)].into_iter().chain((0..count - 1).map(tooth)).collect();
    assert_covers(&polygon(&flat(&comb)));

    // All over the place, at few places, in one line, and nowhere.
    let mut state = 1u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32
    };
    let crossing: Vec<_> = (0..count).map(|_| (random(), random())).collect();
    let repeated: Vec<_> = crossing.iter().map(|(x, y)| (x % 10.0, y % 10.0)).collect();
    let collinear: Vec<_> = crossing.iter().map(|(x, _)| (*x, *x)).collect();
    let nowhere: Vec<_> = crossing.iter().map(|(x, _)| (*x, f32::NAN)).collect();
    for (corners, crosses) in [(crossing, true), (repeated, true), (collinear, false), (nowhere, false)] {
        let raw = polygon(&flat(&corners));
        assert_eq!((raw.triangles.len(), raw.crossing_polygons > 0), (count - 2, crosses));
    }
}
