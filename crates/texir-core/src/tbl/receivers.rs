//! How strongly the barely seen sides of a light source emit, inferred from the surfaces around it.
//!
//! Such a side may emit (the back of a lampshade) or not (its mount). On a surface of one albedo, ln L − ln E is
//! constant; of all fractions of the side's emission in E, the right one makes texels that the side would light match
//! those of the same surface that it would not.

use std::collections::{BTreeMap, BTreeSet};
use std::f32::consts::PI;

use glam::Vec3;
use rayon::prelude::*;

use super::Fusion;
use super::connectivity::Connectivity;
use crate::backend::{Backend, Gather};
use crate::error::Result;
use crate::lights::Lights;
use crate::progress::Silent;
use crate::raster::{luminance, mean_of_channels};
use crate::real::V3;
use crate::scene::trace::Trace;
use crate::stats::median;
use crate::surface::SurfacePoint;

/// How far from a side its light is looked for, metres.
const REACH: f32 = 2.5;
/// Texels that are asked, of all sides together.
const ASKED: usize = 50_000;
/// Rays of each, half of them to the light sources.
const RAYS: u32 = 256;
/// Places of a side that send light to each.
const PLACES: usize = 24;
/// A texel is lit by a side where that would be this share of its light at least.
const LIT: f32 = 0.1;
/// A texel shows its surface without the side's light where that would be less than this share.
const UNLIT: f32 = 0.03;
/// What arrives at a texel from elsewhere is no less than this share of what a side would send to it.
const LEAST: f32 = 0.01;
/// Texels of a surface, of either kind, that count.
const FEW: usize = 12;
/// Shares of its light that a side may have.
const SHARES: usize = 20;
/// Sides of one lamp light the same; how often each is asked for, the others being known.
const ROUNDS: usize = 2;
/// No texel is more wrong than by this, in ln albedo: some are painted otherwise.
const MOST: f32 = 1.0;
/// A side shines like the rest of its source, or it does not: more than half of that light is taken for all of it, and
/// less must leave so much of the error at most, as irradiance is uncertain near lamps.
const CONVINCING: f32 = 0.7;
/// Pixels' worth of a side that views must show for it to be known by itself.
const SHOWN: f32 = 50.0;

/// A smooth part of a light source of which views show nothing, or hardly anything.
struct Side {
    /// Those that shine.
    texels: Vec<usize>,
    centre: Vec3,
    /// Of the sphere around it, metres.
    radius: f32,
    /// How much of its light it sends.
    share: f32,
}

/// What is known of light sources.
pub(super) struct Known<'a> {
    /// Mean over the channels above which a texel shines.
    pub limit: f32,
    /// Pixels' worth that views show of each texel around sources.
    pub shown: &'a [f32],
    /// Which texels views see.
    pub seen: &'a [bool],
    /// What each texel sends where it does not shine.
    pub dark: &'a [[f32; 3]],
}

/// Dims the sides of light sources that views hardly show as far as the surfaces around them tell. Replaces the
/// backend's TBL.
pub(super) fn dim(
    fusion: &Fusion<'_>,
    backend: &mut dyn Backend,
    connectivity: &Connectivity,
    known: &Known<'_>,
    radiance: &mut [[f32; 3]],
) -> Result<()> {
    let atlas = fusion.atlas;
    let shines = |t: usize| mean_of_channels(radiance[t]) > known.limit;
    let mut sides = sides(fusion, connectivity, known.shown, |t| if shines(t) { luminance(&radiance[t]) } else { 0.0 });
    if sides.is_empty() {
        return Ok(());
    }
    let asked = asked(fusion, &sides, |t| known.seen[t] && !shines(t));
    let points: Vec<SurfacePoint> = asked.iter().map(|&t| atlas.points[t]).collect();
    let map = atlas.padded(radiance, fusion.options.gutter)?;
    backend.set_tbl(&map, &Lights::find(fusion.scene, atlas, &map)?)?;
    let gathered = backend.irradiance(&points, Gather::new(RAYS / 2, RAYS / 2, 0), &Silent)?;
    let mut receivers: Vec<Receiver> = gathered
        .iter()
        .zip(&asked)
        .map(|(gathered, &t)| Receiver {
            irradiance: luminance(&gathered.irradiance),
            radiance: luminance(&radiance[t]),
            surface: connectivity.part(atlas.points[t].triangle),
        })
        .collect();
    let lights = sides.iter().map(|side| fusion.progress.check().map(|()| light_of(fusion, side, radiance, &points)));
    let lights = lights.collect::<Result<Vec<_>>>()?;
    for _ in 0..ROUNDS {
        for (side, light) in sides.iter_mut().zip(&lights) {
            let of_others = receivers.iter_mut().zip(light);
            of_others.for_each(|(receiver, light)| receiver.irradiance -= side.share * light);
            side.share = share(&receivers, light);
            let of_all = receivers.iter_mut().zip(light);
            of_all.for_each(|(receiver, light)| receiver.irradiance += side.share * light);
        }
    }
    for side in sides.iter().filter(|side| side.share < 1.0) {
        for &t in &side.texels {
            radiance[t] = Vec3::from(known.dark[t]).lerp(radiance[t].into(), side.share).to_array();
        }
    }
    Ok(())
}

/// A texel that is asked.
struct Receiver {
    /// Luminance of what arrives at it.
    irradiance: f32,
    /// Luminance of what it sends.
    radiance: f32,
    /// The smooth part of the mesh that it is on.
    surface: u32,
}

/// The sides, those with the most power first; of every source, what sends most is none. `shining` is the luminance of
/// texels that shine, and 0 of others.
fn sides(fusion: &Fusion<'_>, connectivity: &Connectivity, shown: &[f32], shining: impl Fn(usize) -> f32) -> Vec<Side> {
    #[derive(Default)]
    struct Part {
        shining: Vec<usize>,
        power: f32,
        shown: f32,
        triangles: BTreeSet<u32>,
    }
    let (mesh, points) = (fusion.scene.mesh(), &fusion.atlas.points);
    let mut parts: BTreeMap<u32, Part> = BTreeMap::new();
    for (t, point) in points.iter().enumerate().filter(|(t, _)| shining(*t) > 0.0) {
        let part = parts.entry(connectivity.part(point.triangle)).or_default();
        part.shining.push(t);
        part.power += shining(t) * fusion.atlas.texel_area(mesh, point.triangle);
        part.triangles.insert(point.triangle);
    }
    for (point, shown) in points.iter().zip(shown) {
        if let Some(part) = parts.get_mut(&connectivity.part(point.triangle)) {
            part.shown += shown;
        }
    }
    let beside = |part: &Part| {
        let beside = part.triangles.iter().flat_map(|t| connectivity.of(*t));
        beside.filter_map(|t| parts.get(&connectivity.part(t))).map(|other| other.power).fold(0.0, f32::max)
    };
    let side = |part: &Part| {
        let position = |t: &usize| Vec3::from(points[*t].position);
        let centre = part.shining.iter().map(position).sum::<Vec3>() / part.shining.len() as f32;
        let radius = part.shining.iter().map(|t| position(t).distance(centre)).fold(0.0, f32::max);
        Side { texels: part.shining.clone(), centre, radius, share: 1.0 }
    };
    let mut hardly_shown: Vec<&Part> =
        parts.values().filter(|part| part.shown < SHOWN && part.power < beside(part)).collect();
    hardly_shown.sort_by(|a, b| b.power.total_cmp(&a.power));
    hardly_shown.into_iter().map(side).collect()
}

/// Texels around the sides, every so many of those that `may` be asked.
fn asked(fusion: &Fusion<'_>, sides: &[Side], may: impl Fn(usize) -> bool + Sync) -> Vec<usize> {
    let points = &fusion.atlas.points;
    let near = |t: &usize| {
        let position = Vec3::from(points[*t].position);
        may(*t) && sides.iter().any(|side| position.distance(side.centre) < side.radius + REACH)
    };
    let all: Vec<usize> = (0..points.len()).into_par_iter().filter(near).collect();
    let every = all.len().div_ceil(ASKED).max(1);
    all.into_iter().step_by(every).collect()
}

/// A place that light is sent from.
struct Place {
    position: Vec3,
    /// Unit normal.
    facing: Vec3,
    /// Luminance × area, m².
    sent: f32,
    area: f32,
}

/// Luminance of the irradiance that arrives at each point from a side directly. Texels count in full, though at the
/// borders of charts not all of them is on the mesh: a rim of a texel's width is taken to send more than it does, so
/// that it must be the darker to be told from one that shines.
fn light_of(fusion: &Fusion<'_>, side: &Side, radiance: &[[f32; 3]], points: &[SurfacePoint]) -> Vec<f32> {
    let mesh = fusion.scene.mesh();
    let every = side.texels.len().div_ceil(PLACES).max(1);
    let places: Vec<Place> = side
        .texels
        .chunks(every)
        .map(|texels| {
            let middle = fusion.atlas.points[texels[texels.len() / 2]];
            let area = |t: &usize| fusion.atlas.texel_area(mesh, fusion.atlas.points[*t].triangle);
            let sent: f32 = texels.iter().map(|t| luminance(&radiance[*t]) * area(t)).sum();
            let area: f32 = texels.iter().map(area).sum();
            Place { position: middle.position.into(), facing: mesh.face_normal(middle.triangle), sent, area }
        })
        .collect();
    let from = |point: &SurfacePoint, place: &Place| {
        let way = place.position - Vec3::from(point.position);
        let length = way.length();
        let direction = way / length;
        let cosines = Vec3::from(point.normal).dot(direction).max(0.0) * (-place.facing.dot(direction)).max(0.0);
        let is_free = || {
            let origin = V3(point.position);
            !fusion.scene.is_blocked(origin, V3(direction.to_array()), length * (1.0 - 1e-3))
        };
        // As of a disc: near it, light does not grow without end.
        let light = place.sent * cosines / (length * length + place.area / PI);
        if light > 0.0 && is_free() { light } else { 0.0 }
    };
    let reach = side.radius + REACH;
    let at = |point: &SurfacePoint| match Vec3::from(point.position).distance(side.centre) < reach {
        true => places.iter().map(|place| from(point, place)).sum(),
        false => 0.0,
    };
    points.par_iter().map(at).collect()
}

/// The share of a side's `light`, beside what arrives from elsewhere, by which the surfaces that it would light look
/// most like themselves elsewhere.
fn share(receivers: &[Receiver], light: &[f32]) -> f32 {
    // What a gather finds may be less than what the side alone would send: it is one of few rays.
    let elsewhere_at = |receiver: &Receiver, light: f32| receiver.irradiance.max(LEAST * light);
    let ln_albedo = |receiver: &Receiver, light: f32, share: f32| {
        (receiver.radiance / (elsewhere_at(receiver, light) + share * light)).ln()
    };
    let mut surfaces: BTreeMap<u32, (Vec<f32>, Vec<usize>)> = BTreeMap::new();
    for (i, (receiver, &light)) in receivers.iter().zip(light).enumerate() {
        if !(receiver.radiance > 0.0 && elsewhere_at(receiver, light) > 0.0) {
            continue;
        }
        let (elsewhere, lit) = surfaces.entry(receiver.surface).or_default();
        if light > LIT * (elsewhere_at(receiver, light) + light) {
            lit.push(i);
        } else if light < UNLIT * receiver.irradiance {
            elsewhere.push(ln_albedo(receiver, light, 0.0));
        }
    }
    let mut said: Vec<(usize, f32)> = Vec::new();
    for (mut elsewhere, lit) in surfaces.into_values().filter(|(elsewhere, lit)| elsewhere.len().min(lit.len()) >= FEW)
    {
        let albedo = median(&mut elsewhere).unwrap_or_default();
        said.extend(lit.into_iter().map(|i| (i, albedo)));
    }
    let error = |k: usize| -> f32 {
        let share = k as f32 / SHARES as f32;
        said.iter().map(|&(i, albedo)| (ln_albedo(&receivers[i], light[i], share) - albedo).abs().min(MOST)).sum()
    };
    let best = (0..=SHARES).min_by(|a, b| error(*a).total_cmp(&error(*b))).unwrap_or(SHARES);
    let is_dark = 2 * best <= SHARES && error(best) < CONVINCING * error(SHARES);
    if is_dark { best as f32 / SHARES as f32 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use glam::Vec2;

    use super::*;
    use crate::atlas::Atlas;
    use crate::cpu::CpuBackend;
    use crate::mesh::Mesh;
    use crate::raster::Rgb;
    use crate::scene::Scene;
    use crate::tbl::TblOptions;

    const SIDE: usize = 256;
    const CELLS: usize = 4;
    const LAMP: f32 = 20.0;
    const ALBEDO: f32 = 0.6;

    /// A quad from `corner` along two edges, seen from the side of a × b, in a cell of the atlas.
    fn quad(mesh: &mut Mesh, corner: Vec3, a: Vec3, b: Vec3) {
        let (cell, base) = (mesh.triangles.len() / 2, mesh.positions.len() as u32);
        let origin = Vec2::new((cell % CELLS) as f32, (cell / CELLS) as f32) + 2.0 * CELLS as f32 / SIDE as f32;
        let extent = 1.0 - 4.0 * CELLS as f32 / SIDE as f32;
        for (u, v) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
            mesh.positions.push(corner + a * u + b * v);
            mesh.normals.push(a.cross(b).normalize());
            mesh.uvs.push((origin + extent * Vec2::new(u, v)) / CELLS as f32);
        }
        mesh.triangles.extend([[base, base + 1, base + 2], [base, base + 2, base + 3]]);
    }

    /// The faces of a box, of which the third looks down: seen from outside or, `inwards`, from inside.
    fn faces(mesh: &mut Mesh, low: Vec3, high: Vec3, inwards: bool) {
        let size = high - low;
        let (x, y, z) = (Vec3::X * size.x, Vec3::Y * size.y, Vec3::Z * size.z);
        for (corner, a, b) in [(low, z, y), (low, x, z), (low, y, x), (low + x, y, z), (low + y, z, x), (low + z, x, y)]
        {
            if inwards { quad(mesh, corner, b, a) } else { quad(mesh, corner, a, b) }
        }
    }

    /// A room, whose ceiling is its sixth face, with a box of a lamp below it, whose top is its last.
    fn room() -> Mesh {
        let mut mesh = Mesh::default();
        faces(&mut mesh, Vec3::ZERO, Vec3::new(3.0, 3.0, 2.5), true);
        faces(&mut mesh, Vec3::new(1.35, 1.4, 2.15), Vec3::new(1.65, 1.6, 2.4), false);
        mesh
    }

    const TOP: usize = 11;

    /// What texels send where those of some faces shine, all bounces.
    fn sent(backend: &mut CpuBackend, atlas: &Atlas, shines: impl Fn(usize) -> bool) -> Vec<[f32; 3]> {
        let emitted = |point: &SurfacePoint| if shines(point.triangle as usize / 2) { LAMP } else { 0.0 };
        let mut sent: Vec<[f32; 3]> = atlas.points.iter().map(|point| [emitted(point); 3]).collect();
        for _ in 0..6 {
            let map = map(atlas, &sent);
            backend.set_tbl(&map, &Lights::find(&backend.scene().clone(), atlas, &map).unwrap()).unwrap();
            let gathered = backend.irradiance(&atlas.points, Gather::new(64, 64, 1), &Silent).unwrap();
            let of_texel = |(point, gathered): (&SurfacePoint, &crate::backend::Gathered)| {
                [if emitted(point) > 0.0 { LAMP } else { ALBEDO / PI * gathered.irradiance[0] }; 3]
            };
            sent = atlas.points.iter().zip(&gathered).map(of_texel).collect();
        }
        sent
    }

    fn map(atlas: &Atlas, sent: &[[f32; 3]]) -> Rgb {
        atlas.padded(sent, 2).unwrap()
    }

    /// Mean radiance of the lamp's top where all of the lamp is taken to shine in a room that is lit by what truly
    /// does, and views show so many pixels of each of its texels.
    fn top(shines: impl Fn(usize) -> bool, shown: f32) -> f32 {
        let scene = std::sync::Arc::new(Scene::new(room()).unwrap());
        let mut backend = CpuBackend::new(scene.clone());
        let atlas = Atlas::new(&mut backend, [SIDE, SIDE]).unwrap();
        let face = |t: usize| atlas.points[t].triangle as usize / 2;
        let truth = sent(&mut backend, &atlas, shines);
        let mut radiance = truth.clone();
        (0..radiance.len()).filter(|t| face(*t) >= 6).for_each(|t| radiance[t] = [LAMP; 3]);
        let options = TblOptions::default();
        let fusion = Fusion { scene: &scene, atlas: &atlas, cameras: &[], options: &options, progress: &Silent };
        let shown: Vec<f32> = (0..radiance.len()).map(|t| if face(t) == TOP { shown } else { 10.0 }).collect();
        let seen: Vec<bool> = (0..radiance.len()).map(|t| face(t) != TOP).collect();
        let known = Known { limit: 5.0, shown: &shown, seen: &seen, dark: &vec![[0.2; 3]; radiance.len()] };
        dim(&fusion, &mut backend, &Connectivity::new(scene.mesh()), &known, &mut radiance).unwrap();
        let of_top: Vec<f32> = (0..radiance.len()).filter(|t| face(*t) == TOP).map(|t| radiance[t][0]).collect();
        let others = (6..TOP).all(|other| (0..radiance.len()).all(|t| face(t) != other || radiance[t] == [LAMP; 3]));
        assert!(others, "what views show of the lamp was dimmed");
        of_top.iter().sum::<f32>() / of_top.len() as f32
    }

    #[test]
    fn the_top_of_a_lamp_that_no_view_shows_shines_as_far_as_the_ceiling_is_lit_by_it() {
        let dark = top(|face| (6..TOP).contains(&face), 0.0);
        assert!(dark < 0.15 * LAMP, "{dark}");
        // Negative controls: it does light the ceiling; and views do show it.
        assert_eq!(top(|face| face >= 6, 0.0), LAMP);
        assert_eq!(top(|face| (6..TOP).contains(&face), 10.0), LAMP);
    }

    #[test]
    fn a_side_is_dark_where_surfaces_look_like_themselves_without_its_light() {
        // A ceiling of 400 texels, on some of which a side would send light, and what arrives besides.
        let light: Vec<f32> = (0..400).map(|i| 10.0 / (1.0 + i as f32).powf(1.5)).collect();
        let found = |truly: f32, painted: &dyn Fn(usize) -> f32| {
            let receiver = |(i, light): (usize, &f32)| Receiver {
                irradiance: 1.0,
                radiance: painted(i) * (1.0 + truly * light),
                surface: 7,
            };
            let receivers: Vec<Receiver> = light.iter().enumerate().map(receiver).collect();
            share(&receivers, &light)
        };
        let white = |_: usize| 0.8;
        assert_eq!([0.0, 0.2, 1.0].map(|truly| found(truly, &white)), [0.0, 0.2, 1.0]);
        // More than half of it is all of it.
        assert_eq!(found(0.7, &white), 1.0);
        // A pattern does not matter, as long as it is the same everywhere.
        let pattern = |i: usize| if i.is_multiple_of(3) { 0.3 } else { 0.8 };
        assert_eq!(found(0.0, &pattern), 0.0);
        // Negative control: nothing is known of surfaces that are lit everywhere.
        assert_eq!(share(&[Receiver { irradiance: 1.0, radiance: 0.8, surface: 7 }], &[10.0]), 1.0);
    }
}
