//! Where the panoramas are taken.

use glam::{Mat3, Mat4, Vec2, Vec3};

use super::random::{Random, Sample};
use super::trace::{World, around};
use super::{Flat, Room};
use crate::camera::{Camera, Projection};
use crate::capture::Split;
use crate::error::{Error, Result};
use crate::progress::{Progress, Task};

/// Height of cameras above the floor, metres.
const HEIGHT: (f32, f32) = (1.2, 1.7);
/// Nothing is nearer to a camera than this, metres.
const CLEARANCE: f32 = 0.5;
/// Largest pitch and roll, degrees.
const TILT: f32 = 2.0;
/// Places tried per camera.
const ATTEMPTS: usize = 40;

/// How many panoramas, and how large.
#[derive(Clone, Copy, Debug)]
pub struct PanoramaOptions {
    /// Places and turns follow from it.
    pub seed: u64,
    /// Panoramas for the fit; at least one a room.
    pub train: usize,
    /// Panoramas held out.
    pub novel: usize,
    /// Rows; columns are twice as many.
    pub height: usize,
}

impl Default for PanoramaOptions {
    fn default() -> Self {
        Self { seed: 1, train: 12, novel: 6, height: 128 }
    }
}

/// A camera to render.
#[derive(Clone, Debug)]
pub struct Panorama {
    /// File stem.
    pub name: String,
    /// Pose and projection.
    pub camera: Camera,
    /// Training or held out.
    pub split: Split,
    /// The room it stands in.
    pub room_id: u16,
}

/// Places panoramas in all rooms, away from surfaces and from each other. Training views come first.
pub fn panoramas(flat: &Flat, options: &PanoramaOptions, progress: &dyn Progress) -> Result<Vec<Panorama>> {
    let (rooms, &PanoramaOptions { train, height, .. }) = (flat.rooms.len(), options);
    if train < rooms {
        return Err(Error::invalid(format!(
            "PanoramaOptions::train is {train}; expected one for each of {rooms} rooms at least"
        )));
    }
    if height == 0 {
        return Err(Error::invalid("PanoramaOptions::height is 0; expected a row at least"));
    }
    let world = World::new(flat)?;
    let mut random = Random::new(options.seed, 3);
    let mut all: Vec<Panorama> = Vec::new();
    let _task = Task::start(progress, "demo: cameras", (options.train + options.novel) as u64, "views");
    for (split, count) in [(Split::Train, options.train), (Split::Novel, options.novel)] {
        for room in share(&flat.rooms, count) {
            progress.check()?;
            let position = place(&world, room, &all, &mut random)?;
            let tilt = || (TILT / 3.0f32.sqrt()).to_radians();
            let (yaw, pitch, roll) = (
                random.range(0.0, std::f32::consts::TAU),
                random.range(-tilt(), tilt()),
                random.range(-tilt(), tilt()),
            );
            // OpenGL camera axes in a world with z up: looking along +y before the yaw.
            let upright = Mat3::from_rotation_x(std::f32::consts::FRAC_PI_2);
            let tilted = Mat3::from_rotation_x(pitch) * Mat3::from_rotation_z(roll);
            let turn = Mat3::from_rotation_z(yaw) * upright * tilted;
            let mut world_from_camera = Mat4::from_mat3(turn);
            world_from_camera.w_axis = position.extend(1.0);
            let camera = Camera {
                projection: Projection::Equirectangular,
                width: 2 * options.height,
                height: options.height,
                world_from_camera,
            };
            let name = format!("pano_{:03}", all.len());
            all.push(Panorama { name, camera, split, room_id: room.id });
            progress.advance(1);
        }
    }
    Ok(all)
}

/// `count` rooms in turn, larger ones more often (D'Hondt's method): each room once before any comes a second time.
fn share(rooms: &[Room], count: usize) -> Vec<&Room> {
    let mut given = vec![0usize; rooms.len()];
    (0..count)
        .filter_map(|_| {
            let claim = |i: usize| {
                let size = rooms[i].hi - rooms[i].lo;
                if given[i] == 0 { f32::INFINITY } else { size.x * size.y / (given[i] + 1) as f32 }
            };
            let next = (0..rooms.len()).max_by(|&a, &b| claim(a).total_cmp(&claim(b)).then(b.cmp(&a)))?;
            given[next] += 1;
            Some(&rooms[next])
        })
        .collect()
}

/// The free place in the room that is farthest from the cameras so far, among a few tried.
fn place(world: &World, room: &Room, others: &[Panorama], random: &mut Random) -> Result<Vec3> {
    let mut best: Option<(f32, Vec3)> = None;
    let mut free = 0;
    for attempt in 0..20 * ATTEMPTS {
        let at = Vec2::new(random.unit(), random.unit());
        let plan = room.lo + CLEARANCE + (room.hi - room.lo - 2.0 * CLEARANCE) * at;
        let candidate = plan.extend(random.range(HEIGHT.0, HEIGHT.1));
        if !is_free(world, candidate) {
            continue;
        }
        free += 1;
        let distance = others.iter().map(|o| o.camera.position().distance(candidate)).fold(f32::INFINITY, f32::min);
        if best.is_none_or(|(most, _)| distance > most) {
            best = Some((distance, candidate));
        }
        if free >= ATTEMPTS || attempt >= 10 * ATTEMPTS {
            break;
        }
    }
    let found = best.map(|(_, position)| position);
    found.ok_or_else(|| Error::invalid(format!("room {} has no place for a camera: use another seed", room.id)))
}

/// Whether all around is free space: fronts of surfaces, none too near.
fn is_free(world: &World, position: Vec3) -> bool {
    const RAYS: u32 = 256;
    (0..RAYS).all(|i| {
        let [u, v] = Sample::new(0, i).pair();
        let hit = world.closest(position, around(Vec3::Z, 1.0 - 2.0 * u, v));
        hit.is_none_or(|hit| hit.front && hit.distance > CLEARANCE)
    })
}
