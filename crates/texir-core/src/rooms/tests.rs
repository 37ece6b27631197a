//! Floor plans made of a few quads, with a known answer.

use glam::Quat;

use super::*;
use crate::rng::hash2;

const HEIGHT: f32 = 2.6;
const DOOR_HEAD: f32 = 2.05;

/// A flat under construction.
#[derive(Default)]
struct Flat(Mesh);

impl Flat {
    fn quad(&mut self, corners: [Vec3; 4]) {
        let base = self.0.positions.len() as u32;
        self.0.positions.extend(corners);
        self.0.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    }

    fn slab(&mut self, lo: Vec2, hi: Vec2, z: f32) {
        self.quad([lo, Vec2::new(hi.x, lo.y), hi, Vec2::new(lo.x, hi.y)].map(|p| p.extend(z)));
    }

    /// Floor and ceiling.
    fn storey(mut self, lo: [f32; 2], hi: [f32; 2]) -> Self {
        self.slab(lo.into(), hi.into(), 0.0);
        self.slab(lo.into(), hi.into(), HEIGHT);
        self
    }

    fn wall_between(mut self, a: [f32; 2], b: [f32; 2], z: [f32; 2]) -> Self {
        let (a, b) = (Vec2::from(a), Vec2::from(b));
        self.quad([a.extend(z[0]), b.extend(z[0]), b.extend(z[1]), a.extend(z[1])]);
        self
    }

    fn wall(self, a: [f32; 2], b: [f32; 2]) -> Self {
        self.wall_between(a, b, [0.0, HEIGHT])
    }

    fn lintel(self, a: [f32; 2], b: [f32; 2]) -> Self {
        self.wall_between(a, b, [DOOR_HEAD, HEIGHT])
    }

    /// Four walls.
    fn walls(self, lo: [f32; 2], hi: [f32; 2]) -> Self {
        self.wall(lo, [hi[0], lo[1]]).wall([hi[0], lo[1]], hi).wall(hi, [lo[0], hi[1]]).wall([lo[0], hi[1]], lo)
    }

    /// A piece of furniture.
    fn block(mut self, lo: [f32; 2], hi: [f32; 2], z: [f32; 2]) -> Self {
        self.slab(lo.into(), hi.into(), z[0]);
        self.slab(lo.into(), hi.into(), z[1]);
        self.wall_between(lo, [hi[0], lo[1]], z)
            .wall_between([hi[0], lo[1]], hi, z)
            .wall_between(hi, [lo[0], hi[1]], z)
            .wall_between([lo[0], hi[1]], lo, z)
    }

    fn plan(&self) -> FloorPlan {
        detect(&self.0, &[], &RoomOptions::default()).unwrap()
    }

    fn count(&self) -> usize {
        self.plan().count()
    }
}

/// An 8 m × 4 m storey whose dividing wall at x = 4.5 leaves an opening centred in y.
fn divided(opening: f32) -> Flat {
    let (lo, hi) = (2.0 - opening / 2.0, 2.0 + opening / 2.0);
    Flat::default()
        .storey([0.0, 0.0], [8.0, 4.0])
        .walls([0.0, 0.0], [8.0, 4.0])
        .wall([4.5, 0.0], [4.5, lo])
        .wall([4.5, hi], [4.5, 4.0])
}

fn at(x: f32, y: f32) -> Vec3 {
    Vec3::new(x, y, 1.5)
}

#[test]
fn a_doorway_separates_two_rooms_and_is_their_border() {
    for lintel in [false, true] {
        let mut flat = divided(0.9);
        if lintel {
            flat = flat.lintel([4.5, 1.55], [4.5, 2.45]);
        }
        let plan = flat.plan();
        assert_eq!(plan.count(), 2, "lintel: {lintel}");
        // Ids go by size: the left room is the larger one.
        for (x, room) in [(0.2, 1), (4.3, 1), (4.35, 1), (4.65, 2), (4.8, 2), (7.8, 2)] {
            assert_eq!(plan.room_at(at(x, 2.0)), room, "x = {x}, lintel: {lintel}");
        }
    }
}

#[test]
fn the_two_sides_of_a_wall_belong_to_two_rooms() {
    let plan = divided(0.9).plan();
    let wall = at(4.5, 0.5);
    assert_eq!((plan.room_of(wall, -Vec3::X), plan.room_of(wall, Vec3::X)), (1, 2));
}

#[test]
fn a_wide_opening_does_not_separate() {
    assert_eq!(divided(3.0).count(), 1);
    // Nor does it under a beam.
    assert_eq!(divided(3.0).lintel([4.5, 0.5], [4.5, 3.5]).count(), 1);
    // Negative control: the same storey with the opening closed.
    assert_eq!(divided(0.0).count(), 2);
}

#[test]
fn the_widest_door_is_a_setting() {
    let flat = divided(1.5);
    assert_eq!(flat.count(), 2);
    let narrow = RoomOptions { door_width: 1.2, ..RoomOptions::default() };
    assert_eq!(detect(&flat.0, &[], &narrow).unwrap().count(), 1);
}

#[test]
fn furniture_and_lamps_do_not_split_a_room() {
    let mut flat = Flat::default().storey([0.0, 0.0], [6.0, 4.0]).walls([0.0, 0.0], [6.0, 4.0]);
    assert_eq!(flat.count(), 1);
    // A shelf that leaves a gap as wide as a door, a table, a lamp on its cord in the middle, and a pillar.
    flat = flat
        .block([2.5, 0.0], [2.9, 3.1], [0.0, 2.0])
        .block([4.0, 1.0], [5.5, 2.0], [0.7, 0.75])
        .block([3.9, 2.0], [4.1, 2.2], [1.9, HEIGHT])
        .block([1.2, 2.0], [1.5, 2.3], [0.0, HEIGHT]);
    assert_eq!(flat.count(), 1);
    // Negative control: the same shelf up to the ceiling is a wall.
    assert_eq!(flat.block([2.5, 0.0], [2.9, 3.1], [0.0, HEIGHT]).count(), 2);
}

#[test]
fn an_l_shaped_room_and_a_corridor_around_a_corner_are_one_each() {
    for width in [1.1, 2.5] {
        let flat = Flat::default()
            .storey([0.0, 0.0], [6.0, width])
            .storey([0.0, width], [width, 5.0])
            .wall([0.0, 0.0], [6.0, 0.0])
            .wall([6.0, 0.0], [6.0, width])
            .wall([6.0, width], [width, width])
            .wall([width, width], [width, 5.0])
            .wall([width, 5.0], [0.0, 5.0])
            .wall([0.0, 5.0], [0.0, 0.0]);
        assert_eq!(flat.count(), 1, "{width} m wide");
    }
}

#[test]
fn a_low_ceiling_has_walls_as_well() {
    // Two rooms of 2.2 m behind a hall of 2.6 m: their walls end under their own ceiling.
    let mut flat =
        Flat::default().storey([0.0, 0.0], [4.0, 6.0]).wall([0.0, 0.0], [0.0, 6.0]).wall([4.0, 0.0], [4.0, 6.0]);
    flat = flat.wall([0.0, 0.0], [4.0, 0.0]).wall([0.0, 6.0], [4.0, 6.0]);
    flat.slab(Vec2::new(4.0, 0.0), Vec2::new(7.0, 6.0), 0.0);
    flat.slab(Vec2::new(4.0, 0.0), Vec2::new(7.0, 6.0), 2.2);
    let low = [0.0, 2.2];
    flat = flat.wall_between([4.0, 0.0], [7.0, 0.0], low).wall_between([7.0, 0.0], [7.0, 6.0], low);
    flat = flat.wall_between([4.0, 6.0], [7.0, 6.0], low);
    assert_eq!(flat.count(), 2);
    assert_eq!(flat.wall_between([4.0, 3.0], [7.0, 3.0], low).count(), 3);
}

#[test]
fn turning_the_world_changes_nothing() {
    let flat = divided(0.9);
    let expected = flat.plan();
    // Y up, as in glTF, and a yaw that puts the walls astride the cells.
    let y_up = Quat::from_rotation_x(-std::f32::consts::FRAC_PI_2);
    for (rotation, up) in [(y_up, [0.0, 1.0, 0.0]), (Quat::from_rotation_z(0.4), [0.0, 0.0, 1.0])] {
        let mut mesh = flat.0.clone();
        mesh.positions.iter_mut().for_each(|p| *p = rotation * *p);
        let plan = detect(&mesh, &[], &RoomOptions { up, ..RoomOptions::default() }).unwrap();
        assert_eq!(plan.count(), 2);
        for p in [at(0.5, 0.5), at(4.2, 3.5), at(4.8, 0.5), at(7.5, 3.5)] {
            assert_eq!(plan.room_at(rotation * p), expected.room_at(p), "{p} with {up:?} up");
        }
    }
}

#[test]
fn a_frayed_scan_with_holes_gives_the_same_rooms() {
    // The flat in triangles of about 6 cm, displaced by up to 1 cm, every twentieth of them missing, with a hole of
    // 30 cm in the dividing wall, and none of the floor around the camera.
    let coarse = divided(0.9).lintel([4.5, 1.55], [4.5, 2.45]).0;
    let mut mesh = Mesh::default();
    let mut piece = 0;
    for t in 0..coarse.triangles.len() as u32 {
        let [a, b, c] = coarse.corners(t);
        let n = ((b - a).length().max((c - a).length()) / 0.06).ceil() as u32;
        let point = |i: u32, j: u32| {
            let p = a + (b - a) * (i as f32 / n as f32) + (c - a) * (j as f32 / n as f32);
            let key = p.to_array().map(|v| (v * 1e4).round() as i32 as u32);
            let noise = |axis: u32| hash2(hash2(key[0], key[1]), hash2(key[2], axis)) as f32 / u32::MAX as f32 - 0.5;
            p + Vec3::new(noise(0), noise(1), noise(2)) * 0.02
        };
        let mut add = |corners: [Vec3; 3]| {
            let centre = (corners[0] + corners[1] + corners[2]) / 3.0;
            let in_wall_hole = (centre - Vec3::new(4.5, 0.8, 1.4)).abs().max_element() < 0.15;
            let under_camera = centre.z < 0.1 && centre.distance(Vec3::new(2.0, 2.0, 0.0)) < 0.4;
            piece += 1;
            let missing = hash2(t, piece).is_multiple_of(20);
            if !(in_wall_hole || under_camera || missing) {
                let base = mesh.positions.len() as u32;
                mesh.positions.extend(corners);
                mesh.triangles.push([base, base + 1, base + 2]);
            }
        };
        for i in 0..n {
            for j in 0..n - i {
                add([point(i, j), point(i + 1, j), point(i, j + 1)]);
                if j + 1 < n - i {
                    add([point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)]);
                }
            }
        }
    }
    let plan = detect(&mesh, &[at(2.0, 2.0)], &RoomOptions::default()).unwrap();
    assert_eq!(plan.count(), 2);
    assert_eq!((plan.room_at(at(2.0, 2.0)), plan.room_at(at(6.0, 1.0))), (1, 2));
}

#[test]
fn given_ids_answer_like_detected_ones() {
    let rooms = Labels::new(4, 1, vec![7, 0, 0, 9]).unwrap();
    let walls = Mask::filled(4, 1, false);
    let plan = FloorPlan::new(rooms, walls.clone(), Vec2::new(10.0, 0.0), 1.0, Vec3::Z).unwrap();
    let rooms: Vec<u16> = [9.0, 10.5, 11.5, 12.5, 13.5, 20.0].map(|x| plan.room_at(at(x, 0.5))).into();
    assert_eq!(rooms, [7, 7, 7, 9, 9, 9]);
    let empty = FloorPlan::new(Labels::filled(4, 1, 0), walls, Vec2::ZERO, 1.0, Vec3::Z);
    assert!(empty.is_err_and(|e| e.to_string().contains("no room")));
}

#[test]
fn unusable_input_is_an_error() {
    let no_rooms = Flat::default().wall([0.0, 0.0], [3.0, 0.0]);
    let fails = |mesh: &Mesh, options: RoomOptions, says: &str| {
        let error = detect(mesh, &[], &options).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    };
    fails(&no_rooms.0, RoomOptions::default(), "no room was found");
    fails(&Mesh::default(), RoomOptions::default(), "no triangle");
    fails(&divided(0.9).0, RoomOptions { cell: 0.0, ..RoomOptions::default() }, "rooms.cell is 0");
    fails(&divided(0.9).0, RoomOptions { cell: 1e-5, ..RoomOptions::default() }, "too many cells");
    fails(&divided(0.9).0, RoomOptions { up: [0.0; 3], ..RoomOptions::default() }, "rooms.up");
    let mut broken = divided(0.9).0;
    broken.positions[0] = Vec3::NAN;
    assert_eq!(detect(&broken, &[Vec3::NAN], &RoomOptions::default()).unwrap().count(), 2);
}

#[test]
fn the_picture_shows_rooms_walls_and_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rooms.png");
    let plan = divided(0.9).plan();
    plan.write_png(&path, &[at(1.0, 0.5)]).unwrap();
    let picture = image::open(&path).unwrap().to_rgb8();
    let scale = picture.width() as f32 / plan.rooms.width as f32 / plan.cell;
    let pixel = |x: f32, y: f32| {
        let p = (Vec2::new(x, y) - plan.origin) * scale;
        picture.get_pixel(p.x as u32, picture.height() - 1 - p.y as u32).0
    };
    assert_eq!(pixel(3.0, 0.5), pixel(0.3, 3.7), "one colour per room");
    assert_ne!(pixel(3.0, 0.5), pixel(7.5, 3.7), "two rooms, two colours");
    assert_eq!(pixel(4.5, 0.5), pixel(4.5, 3.7), "walls alike");
    assert_ne!(pixel(4.5, 0.5), pixel(3.0, 0.5), "a wall is no room");
    assert_eq!(pixel(1.0, 0.5), [214, 40, 40], "the camera");
    assert!(plan.write_png(folder.path(), &[]).is_err(), "a folder is no file");
}
