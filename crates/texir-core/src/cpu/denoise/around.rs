//! The two passes of the denoiser that look far: cell by cell, what is around a cell laid out once for all its points,
//! and several of it taken at once.

use glam::Vec3A;
use pulp::{Arch, NullaryFnOnce};
use rayon::prelude::*;

use super::PIECE;
use crate::cpu::lanes::{LANES, Lanes};
use crate::denoise::{Noisy, RADIUS};
use crate::error::Result;
use crate::neighbours::{Entry, FAR, MAX_PLANE_DISTANCE, MIN_NORMAL_COSINE, Neighbours};
use crate::progress::Progress;
use crate::real::Real;

/// A per-point result from sums over the points within [`RADIUS`], of which it reads `FEATURES` numbers each. Its
/// methods at a point must be inlined, to be compiled for the instructions that [`each`] dispatches to.
pub trait Pass<R: Real, const FEATURES: usize>: Sync {
    /// What is known of a point and summed over those around it.
    type Sums;
    /// What is found.
    type Found: Copy + Send + Sync;
    /// The features of point `j`.
    fn features(&self, j: usize) -> [R; FEATURES];
    /// Nothing summed yet at point `i`.
    fn start(&self, i: usize) -> Self::Sums;
    /// Adds several points: their offsets in shares of the radius, 1 less the square of these (how near they are; 0 for
    /// those that have no say), and their features.
    fn add(sums: &mut Self::Sums, at: [Lanes<R>; 3], kernel: Lanes<R>, features: &[Lanes<R>; FEATURES]);
    /// What is found at point `i`.
    fn found(&self, i: usize, sums: Self::Sums) -> Self::Found;
}

/// Points that a thread takes one after another, at least: those of many cells.
const CELLS: usize = 1024;

/// What a pass finds at every one of what is `noisy`, apart from its halves. Errors when `progress` says to stop.
pub fn each<R: Real, const FEATURES: usize, P: Pass<R, FEATURES>>(
    pass: &P,
    neighbours: &Neighbours<FAR>,
    Noisy { points, apart, texel, .. }: Noisy<'_>,
    progress: &dyn Progress,
) -> Result<Vec<P::Found>> {
    let radius = RADIUS * texel;
    let widest = Arch::new();
    let at_point = |around: &mut Around<R, FEATURES>, own: &Entry| {
        if around.cell != Some(own.cell) {
            let near = neighbours.around(own.cell).filter(near(neighbours.cell(own.cell), radius));
            around.lay_out(own.cell, near, |entry| {
                let i = entry.index as usize;
                (points[i].index as usize % LANES, apart[i], pass.features(i))
            });
        }
        widest.dispatch(AtPoint { pass, own, is_apart: apart[own.index as usize], around, radius })
    };
    // In the order of the cells, so that most points find theirs laid out.
    let mut by_entry: Vec<P::Found> = Vec::with_capacity(points.len());
    for entries in neighbours.entries.chunks(PIECE) {
        progress.check()?;
        by_entry.par_extend(entries.par_iter().with_min_len(CELLS).map_init(Around::new, at_point));
    }
    Ok(neighbours.by_point(&by_entry))
}

/// Whether a point may be within `radius` metres of one of a cell's `own`: it is of the box around them.
fn near(own: &[Entry], radius: f32) -> impl Fn(&&Entry) -> bool {
    let places = own.iter().map(|entry| Vec3A::from(entry.position));
    let low = places.clone().fold(Vec3A::MAX, Vec3A::min);
    let high = places.fold(Vec3A::MIN, Vec3A::max);
    move |entry| {
        let place = Vec3A::from(entry.position);
        place.distance_squared(place.clamp(low, high)) <= radius * radius
    }
}

/// What is around a cell, in whole lanes, and how it lies to one of the cell's points. A point's lane is its own, and
/// those of a lane are in the order of the columns, so that sums come out alike whatever else is around. Where lanes
/// have no more points, normals are 0, and none lies near.
struct Around<R, const FEATURES: usize> {
    /// Which cell.
    cell: Option<u32>,
    position: [Vec<f32>; 3],
    normal: [Vec<f32>; 3],
    apart: Vec<f32>,
    features: Vec<[Lanes<R>; FEATURES]>,
    /// Offsets from a point in shares of the radius.
    at: [Vec<R>; 3],
    /// The kernel: 1 less the squared length of the offset, or 0.
    kernel: Vec<R>,
}

impl<R: Real, const FEATURES: usize> Around<R, FEATURES> {
    fn new() -> Self {
        Self {
            cell: None,
            position: Default::default(),
            normal: Default::default(),
            apart: Vec::new(),
            features: Vec::new(),
            at: [Vec::new(), Vec::new(), Vec::new()],
            kernel: Vec::new(),
        }
    }

    /// Lays out what is around a cell: `features_of` gives the lane of a point, whether it is apart, and its features.
    fn lay_out<'a>(
        &mut self,
        cell: u32,
        entries: impl Iterator<Item = &'a Entry>,
        features_of: impl Fn(&Entry) -> (usize, bool, [R; FEATURES]),
    ) {
        self.cell = Some(cell);
        let Self { position, normal, apart, features, at, kernel, .. } = self;
        position.iter_mut().chain(normal.iter_mut()).for_each(Vec::clear);
        apart.clear();
        features.clear();
        let mut rows = [0; LANES];
        for entry in entries {
            let (lane, is_apart, values) = features_of(entry);
            let row = rows[lane];
            rows[lane] += 1;
            if row == features.len() {
                features.push([Lanes::splat(R::of(0.0)); FEATURES]);
                let whole = LANES * features.len();
                position.iter_mut().chain(normal.iter_mut()).for_each(|list| list.resize(whole, 0.0));
                apart.resize(whole, 0.0);
            }
            let place = LANES * row + lane;
            position.iter_mut().zip(entry.position).for_each(|(list, value)| list[place] = value);
            normal.iter_mut().zip(entry.normal).for_each(|(list, value)| list[place] = value);
            apart[place] = f32::from(u8::from(is_apart));
            features[row].iter_mut().zip(values).for_each(|(lanes, value)| lanes.0[lane] = value);
        }
        at.iter_mut().for_each(|list| list.resize(apart.len(), R::of(0.0)));
        kernel.resize(apart.len(), R::of(0.0));
    }

    /// How all lie to one point: a loop over plain lists, which compiles to the widest instructions.
    #[inline(always)]
    fn seen_from(&mut self, own: &Entry, is_apart: bool, radius: f32) {
        let whole = self.kernel.len();
        let [x, y, z] = [&self.position[0][..whole], &self.position[1][..whole], &self.position[2][..whole]];
        let [nx, ny, nz] = [&self.normal[0][..whole], &self.normal[1][..whole], &self.normal[2][..whole]];
        let apart = &self.apart[..whole];
        let [at_x, at_y, at_z] = &mut self.at;
        let (at_x, at_y, at_z) = (&mut at_x[..whole], &mut at_y[..whole], &mut at_z[..whole]);
        let kernel = &mut self.kernel[..whole];
        let ([px, py, pz], [ox, oy, oz]) = (own.position, own.normal);
        let (is_apart, none, one) = (f32::from(u8::from(is_apart)), R::of(0.0), R::of(1.0));
        let scale = one / R::of(f64::from(radius));
        for k in 0..whole {
            let (dx, dy, dz) = (x[k] - px, y[k] - py, z[k] - pz);
            let square = dx * dx + dy * dy + dz * dz;
            let beside = dx * ox + dy * oy + dz * oz;
            let facing = nx[k] * ox + ny[k] * oy + nz[k] * oz;
            let real = |v: f32| R::of(f64::from(v)) * scale;
            let (ax, ay, az) = (real(dx), real(dy), real(dz));
            let weight = one - (ax * ax + ay * ay + az * az);
            let has_a_say = (square < radius * radius)
                & (beside.abs() < MAX_PLANE_DISTANCE * radius)
                & (facing > MIN_NORMAL_COSINE)
                & (apart[k] == is_apart)
                & (weight > none);
            // What is far away must not overflow in a product with no weight.
            let of = |v: R| if has_a_say { v } else { none };
            (at_x[k], at_y[k], at_z[k], kernel[k]) = (of(ax), of(ay), of(az), of(weight));
        }
    }
}

/// A pass at a point.
struct AtPoint<'a, R, const FEATURES: usize, P> {
    pass: &'a P,
    own: &'a Entry,
    is_apart: bool,
    around: &'a mut Around<R, FEATURES>,
    radius: f32,
}

impl<R: Real, const FEATURES: usize, P: Pass<R, FEATURES>> NullaryFnOnce for AtPoint<'_, R, FEATURES, P> {
    type Output = P::Found;

    #[inline(always)]
    fn call(self) -> P::Found {
        let Self { pass, own, is_apart, around, radius } = self;
        around.seen_from(own, is_apart, radius);
        let mut sums = pass.start(own.index as usize);
        for (k, features) in around.features.iter().enumerate() {
            let kernel = Lanes::of(&around.kernel, k);
            if !kernel.is_none() {
                let at = [Lanes::of(&around.at[0], k), Lanes::of(&around.at[1], k), Lanes::of(&around.at[2], k)];
                P::add(&mut sums, at, kernel, features);
            }
        }
        pass.found(own.index as usize, sums)
    }
}
