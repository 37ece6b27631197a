//! Floor plans made of a few quads, with a known answer.

use glam::{Quat, Vec2};

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

/// Floor of the upper storey of [`house`].
const UPSTAIRS: f32 = 2.9;

/// Two storeys of 8 m × 4 m, joined by stairs in a stairwell at x < 1.2, y < 3.2: two rooms below, which a door joins,
/// three above. `slab` is the thickness of what lies between them; without, one sheet is ceiling and floor.
fn house(slab: bool) -> Flat {
    let mut house = divided(0.9);
    house.0.triangles.drain(2..4);
    let holed = |house: &mut Flat, z: f32| {
        house.slab(Vec2::new(1.2, 0.0), Vec2::new(8.0, 4.0), z);
        house.slab(Vec2::new(0.0, 3.2), Vec2::new(1.2, 4.0), z);
    };
    let downwards = |house: &mut Flat, from: usize| house.0.triangles[from..].iter_mut().for_each(|t| t.swap(0, 1));
    let from = house.0.triangles.len();
    if slab {
        holed(&mut house, HEIGHT);
        downwards(&mut house, from);
    }
    let floor = if slab { UPSTAIRS } else { HEIGHT };
    holed(&mut house, floor);
    let from = house.0.triangles.len();
    house.slab(Vec2::ZERO, Vec2::new(8.0, 4.0), floor + HEIGHT);
    downwards(&mut house, from);
    for step in 0..16 {
        let (y, z) = (0.2 * step as f32, floor * step as f32 / 16.0);
        house.slab(Vec2::new(0.0, y), Vec2::new(1.2, y + 0.2), z);
        house = house.wall_between([0.0, y], [1.2, y], [z - floor / 16.0, z]);
    }
    let upper = [floor, floor + HEIGHT];
    // The outer walls go through both storeys; above, walls at x = 3 and x = 6, with a door each.
    for (a, b) in
        [([0.0, 0.0], [8.0, 0.0]), ([8.0, 0.0], [8.0, 4.0]), ([8.0, 4.0], [0.0, 4.0]), ([0.0, 4.0], [0.0, 0.0])]
    {
        house = house.wall_between(a, b, [0.0, floor + HEIGHT]);
    }
    for x in [3.0, 6.0] {
        house = house.wall_between([x, 0.9], [x, 4.0], upper).wall_between(
            [x, 0.0],
            [x, 0.9],
            [floor + DOOR_HEAD, upper[1]],
        );
    }
    house
}

/// Cameras in [`house`]: three below at different heights, one on the stairs, three above.
fn eyes() -> [Vec3; 7] {
    [
        at(2.0, 2.0),
        Vec3::new(3.0, 1.0, 0.9),
        Vec3::new(6.0, 3.0, 1.9),
        Vec3::new(0.6, 1.5, 2.75),
        Vec3::new(2.0, 2.0, UPSTAIRS + 1.4),
        Vec3::new(4.0, 2.0, UPSTAIRS + 1.7),
        Vec3::new(7.0, 2.0, UPSTAIRS + 1.2),
    ]
}

#[test]
fn storeys_have_rooms_of_their_own() {
    let as_built = house(true).0;
    let mut inside_out = as_built.clone();
    inside_out.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    let mut both_sides = as_built.clone();
    both_sides.triangles.extend(&inside_out.triangles);
    for (what, mesh) in [
        ("as built", as_built),
        ("inside out", inside_out),
        ("both sides", both_sides),
        ("one sheet between the storeys", house(false).0),
    ] {
        let plan = detect(&mesh, &eyes(), &RoomOptions::default()).unwrap();
        assert_eq!((plan.storeys.len(), plan.count()), (2, 5), "{what}");
        let room = |x: f32, y: f32, z: f32| plan.room_at(Vec3::new(x, y, z));
        // By size: below, 1 is left of the wall; above, 3 and 4 have 12 m², 5 has 8.
        for z in [0.05, 1.5, 2.5] {
            assert_eq!((room(2.0, 2.0, z), room(6.0, 2.0, z)), (1, 2), "{what}, {z} m up");
        }
        for z in [2.95, 4.4, 5.1] {
            let above = [2.0, 4.5, 7.0].map(|x| room(x, 2.0, z));
            assert!(above == [3, 4, 5] || above == [4, 3, 5], "{what}, {z} m up: {above:?}");
        }
        // The stairwell belongs to the room that it opens to.
        assert_eq!((room(0.6, 0.6, 1.2), room(0.6, 2.9, 4.2)), (1, room(2.0, 2.0, 4.2)), "{what}");
        // Both sides of the slab.
        let ceiling = if what.starts_with("one") { HEIGHT } else { UPSTAIRS };
        assert_eq!(plan.room_of(Vec3::new(6.0, 2.0, ceiling), Vec3::Z), room(6.0, 2.0, 4.0), "{what}");
        assert_eq!(plan.room_of(Vec3::new(6.0, 2.0, HEIGHT), -Vec3::Z), 2, "{what}");
    }
    // Negative control: where no camera stands there is no storey.
    for (eyes, rooms) in [(&eyes()[..3], 2), (&eyes()[4..], 3)] {
        let plan = detect(&house(true).0, eyes, &RoomOptions::default()).unwrap();
        assert_eq!((plan.storeys.len(), plan.count()), (1, rooms));
    }
}

#[test]
fn cameras_high_and_low_in_one_storey_do_not_make_two() {
    // A hall 3.6 m high; a third of its floor is covered by shelves as high as a man, with cameras over them.
    let mut hall = Flat::default();
    hall.slab(Vec2::ZERO, Vec2::new(8.0, 6.0), 0.0);
    hall.slab(Vec2::ZERO, Vec2::new(8.0, 6.0), 3.6);
    for (a, b) in
        [([0.0, 0.0], [8.0, 0.0]), ([8.0, 0.0], [8.0, 6.0]), ([8.0, 6.0], [0.0, 6.0]), ([0.0, 6.0], [0.0, 0.0])]
    {
        hall = hall.wall_between(a, b, [0.0, 3.6]);
    }
    for y in [1.0, 2.7, 4.4] {
        hall = hall.block([1.0, y], [7.0, y + 0.9], [0.0, 2.2]);
    }
    let eyes = [Vec3::new(0.5, 3.0, 1.2), Vec3::new(7.5, 3.0, 1.7), Vec3::new(4.0, 1.5, 2.8)];
    let plan = detect(&hall.0, &eyes, &RoomOptions::default()).unwrap();
    assert_eq!((plan.storeys.len(), plan.count()), (1, 1));
}

#[test]
fn a_sloped_ceiling_has_walls_up_to_it() {
    // An attic: the ceiling rises from 1 m at both eaves to 3.4 m, in large triangles and in small ones; a gable wall
    // divides it, with a door or without.
    for pieces in [1, 40] {
        let attic = |door: bool| {
            let mut attic = Flat::default();
            attic.slab(Vec2::ZERO, Vec2::new(9.0, 6.0), 0.0);
            let ceiling = |y: f32| 1.0 + 2.4 * (1.0 - (y - 3.0).abs() / 3.0);
            for piece in 0..pieces {
                let at = |i: i32| 3.0 * i as f32 / pieces as f32;
                for (y0, y1) in [(at(piece), at(piece + 1)), (6.0 - at(piece), 6.0 - at(piece + 1))] {
                    let corner = |x: f32, y: f32| Vec3::new(x, y, ceiling(y));
                    attic.quad([corner(0.0, y0), corner(9.0, y0), corner(9.0, y1), corner(0.0, y1)]);
                }
            }
            for y in [0.0, 6.0] {
                attic = attic.wall_between([0.0, y], [9.0, y], [0.0, 1.0]);
            }
            for x in [0.0, 5.0, 9.0] {
                let door = door && x == 5.0;
                for (y0, y1) in [(0.0, 2.5), (3.5, 6.0)] {
                    let (y0, y1): (f32, f32) = (y0, y1);
                    attic
                        .quad([[x, y0, 0.0], [x, y1, 0.0], [x, y1, ceiling(y1)], [x, y0, ceiling(y0)]].map(Vec3::from));
                }
                let (from, apex) = (if door { DOOR_HEAD } else { 0.0 }, 3.4);
                attic.quad([[x, 2.5, from], [x, 3.5, from], [x, 3.5, 3.0], [x, 2.5, 3.0]].map(Vec3::from));
                attic.quad([[x, 2.5, 3.0], [x, 3.5, 3.0], [x, 3.0, apex], [x, 3.0, apex]].map(Vec3::from));
            }
            attic.0
        };
        for door in [true, false] {
            let plan = detect(&attic(door), &[], &RoomOptions::default()).unwrap();
            assert_eq!(plan.count(), 2, "{pieces} pieces, door: {door}");
            assert_eq!((plan.room_at(at(2.0, 3.0)), plan.room_at(at(7.0, 3.0))), (1, 2));
        }
    }
}

#[test]
fn given_ids_answer_like_detected_ones() {
    let rooms = Labels::new(4, 1, vec![7, 0, 0, 9]).unwrap();
    let walls = Mask::filled(4, 1, false);
    let grid = Grid { width: 4, height: 1, origin: Vec2::new(10.0, 0.0), cell: 1.0 };
    let storey = StoreyPlan::new(rooms, walls.clone(), f32::NEG_INFINITY).unwrap();
    let plan = FloorPlan::new(grid, vec![storey.clone()], Vec3::Z).unwrap();
    let rooms: Vec<u16> = [9.0, 10.5, 11.5, 12.5, 13.5, 20.0].map(|x| plan.room_at(at(x, 0.5))).into();
    assert_eq!(rooms, [7, 7, 7, 9, 9, 9]);
    let empty = StoreyPlan::new(Labels::filled(4, 1, 0), walls, 0.0);
    assert!(empty.is_err_and(|e| e.to_string().contains("no room")));
    assert!(FloorPlan::new(grid, vec![], Vec3::Z).is_err());
    assert!(FloorPlan::new(Grid { width: 5, ..grid }, vec![storey], Vec3::Z).is_err());
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
    fails(&divided(0.9).0, RoomOptions { cell: 0.0, ..RoomOptions::default() }, "RoomOptions::cell is 0");
    fails(&divided(0.9).0, RoomOptions { cell: 1e-5, ..RoomOptions::default() }, "too many cells");
    fails(&divided(0.9).0, RoomOptions { up: [0.0; 3], ..RoomOptions::default() }, "RoomOptions::up");
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
    let scale = picture.width() as f32 / plan.grid.width as f32 / plan.grid.cell;
    let pixel = |x: f32, y: f32| {
        let p = (Vec2::new(x, y) - plan.grid.origin) * scale;
        picture.get_pixel(p.x as u32, picture.height() - 1 - p.y as u32).0
    };
    assert_eq!(pixel(3.0, 0.5), pixel(0.3, 3.7), "one colour per room");
    assert_ne!(pixel(3.0, 0.5), pixel(7.5, 3.7), "two rooms, two colours");
    assert_eq!(pixel(4.5, 0.5), pixel(4.5, 3.7), "walls alike");
    assert_ne!(pixel(4.5, 0.5), pixel(3.0, 0.5), "a wall is no room");
    assert_eq!(pixel(1.0, 0.5), [214, 40, 40], "the camera");
    assert!(plan.write_png(folder.path(), &[]).is_err(), "a folder is no file");
}
