//! The light that arrives at every texel, with all its bounces.
//!
//! Direct irradiance is sampled at every texel from emitters and from the cosine lobe, joined by multiple importance
//! sampling (balance heuristic, Veach and Guibas 1995). Indirect irradiance is gathered at half the atlas' resolution:
//! each texel traces its rays once and remembers which texels they met; the bounces are then iterated over these links
//! until they converge, as in radiosity. A ray that meets a glossy surface also follows one sample of its specular
//! lobe, so light that reaches a diffuse surface by way of one mirror-like reflection is included: of emitters as of
//! surfaces. Chains of two or more specular reflections between diffuse ones are not.

use glam::Vec3;
use rayon::prelude::*;

use super::atlas::{TexelPoint, dilate, texel_points};
use super::options::RenderOptions;
use super::random::{Sample, stream};
use super::trace::{Vertex, World, around, bilinear, lobe, sample_lobe};
use crate::error::Result;
use crate::progress::{Progress, Task};
use crate::raster::{Raster, Rgb, mean_pixel};
use crate::ray_origin::offset_origin;

/// Texels of the atlas per texel of the indirect solution, along one axis.
const SHRINK: usize = 2;
/// Bounces stop when the mean irradiance changes by less than this share.
const TOLERANCE: f64 = 1e-5;
/// Bounces stop here even so.
const MAX_BOUNCES: usize = 64;
/// Passes of the 3×3 filter over direct light: a standard deviation of one texel, so that shadows stay sharp.
const DIRECT_SMOOTHING: usize = 2;
/// Passes of the 3×3 filter over the indirect solution, which varies slowly: a standard deviation of 1.4 of its texels.
const INDIRECT_SMOOTHING: usize = 4;
/// Texels between two looks at progress and cancellation.
const CHUNK: usize = 16_384;

/// No texel.
const NONE: u32 = u32::MAX;

/// One gather ray: the texel that it met, and the one that the reflection there met.
#[derive(Clone, Copy)]
struct Link {
    near: u32,
    far: u32,
    /// Of `far`: specular weight f_s·n·l / pdf.
    weight: f32,
}

/// What a texel's gather rays met.
struct GatherRays {
    links: Vec<Link>,
    /// π / number of rays: those that met nothing, or a back, bring no light.
    scale: f32,
    /// Emitted light that arrives by way of one specular reflection: its irradiance.
    reflected_emission: Vec3,
}

/// Full irradiance E (π not divided out) per texel of the atlas; texels covered by other surfaces hold what is beside
/// them.
pub(super) fn solve(world: &World, options: &RenderOptions, progress: &dyn Progress) -> Result<Rgb> {
    let flat = world.flat;
    let side = flat.albedo.width;
    let coarse_side = side / SHRINK;
    let fine = texel_points(&flat.charts, &flat.places, side, 1);
    let coarse = texel_points(&flat.charts, &flat.places, side, SHRINK);

    let task = Task::start(progress, "demo: direct light", fine.len() as u64, "texels");
    let direct = for_texels(&fine, progress, |texel| direct(world, options, texel))?;
    drop(task);
    let direct = smoothed(side, &fine, direct, DIRECT_SMOOTHING);

    let task = Task::start(progress, "demo: indirect light", coarse.len() as u64, "texels");
    let gathered = for_texels(&coarse, progress, |texel| gather(world, options, texel))?;
    let direct_coarse = halved(&direct);
    let albedo = halved(&flat.albedo);
    let mut indirect: Vec<Option<Vec3>> = gathered.iter().map(|g| g.as_ref().map(|g| g.reflected_emission)).collect();
    for _ in 0..MAX_BOUNCES {
        progress.check()?;
        let mut radiosity = Raster::filled(coarse_side, coarse_side, None);
        for (texel, indirect) in coarse.iter().zip(&indirect) {
            let i = texel.texel;
            let total = Vec3::from(direct_coarse.data[i]) + indirect.unwrap_or(Vec3::ZERO);
            radiosity.data[i] = Some((total * Vec3::from(albedo.data[i]) / std::f32::consts::PI).to_array());
        }
        // A hit on a chart's very edge may round into the gutter.
        dilate(&mut radiosity, 1);
        let radiosity: Vec<Vec3> = radiosity.data.iter().map(|v| v.map_or(Vec3::ZERO, Vec3::from)).collect();
        let next: Vec<Option<Vec3>> = gathered.par_iter().map(|g| g.as_ref().map(|g| bounce(g, &radiosity))).collect();
        let (change, sum) = indirect.iter().zip(&next).fold((0.0, 0.0), |(change, sum), (old, new)| {
            let [old, new] = [old, new].map(|v| f64::from(v.unwrap_or(Vec3::ZERO).element_sum()));
            (change + (new - old).abs(), sum + new)
        });
        indirect = next;
        if change <= TOLERANCE * sum {
            break;
        }
    }
    drop(task);
    let indirect = smoothed(coarse_side, &coarse, indirect, INDIRECT_SMOOTHING);

    let mut total = direct;
    total.data.par_iter_mut().enumerate().for_each(|(i, value)| {
        let uv = glam::Vec2::new((i % side) as f32 + 0.5, (i / side) as f32 + 0.5) / side as f32;
        *value = (Vec3::from(*value) + bilinear(&indirect, uv)).to_array();
    });
    Ok(total)
}

/// Applies `f` to every texel, with progress.
fn for_texels<R: Send>(
    texels: &[TexelPoint],
    progress: &dyn Progress,
    f: impl Fn(&TexelPoint) -> Option<R> + Sync,
) -> Result<Vec<Option<R>>> {
    let mut all = Vec::with_capacity(texels.len());
    for chunk in texels.chunks(CHUNK) {
        progress.check()?;
        all.par_extend(chunk.par_iter().map(&f));
        progress.advance(chunk.len() as u64);
    }
    Ok(all)
}

/// Direct irradiance; `None` where another surface covers the texel (most rays meet backs) or the chart has a hole.
fn direct(world: &World, options: &RenderOptions, texel: &TexelPoint) -> Option<Vec3> {
    let point = texel.point?;
    let room = world.flat.charts[texel.chart].look.room;
    let position = offset_origin(point.position, point.normal);
    let choice = world.emitters.choice(position, point.normal, room);
    let (lights, cosines) = (options.light_samples, (options.light_samples / 4).max(4));
    let joint = |p_light: f32, cosine: f32| lights as f32 * p_light + cosines as f32 * cosine / std::f32::consts::PI;
    let (mut sum, mut backs) = (Vec3::ZERO, 0);
    let seed = stream(options.seed, 1, texel.texel);
    for i in 0..cosines {
        let [u, v] = Sample::new(seed, i as u32).pair();
        let cosine = (1.0 - u).sqrt();
        match world.closest(position, around(point.normal, cosine, v)) {
            Some(hit) if !hit.front => backs += 1,
            Some(hit) => sum += world.emission(&hit) * cosine / joint(world.light_pdf(&hit, &choice), cosine),
            None => {}
        }
    }
    if 2 * backs > cosines {
        return None;
    }
    let seed = stream(options.seed, 2, texel.texel);
    for i in 0..lights {
        let mut sample = Sample::new(seed, i as u32);
        if let Some((direction, radiance, p_light)) = world.light(position, point.normal, &choice, &mut sample) {
            let cosine = point.normal.dot(direction);
            sum += radiance * cosine / joint(p_light, cosine);
        }
    }
    Some(sum)
}

/// Traces the gather rays of a texel.
fn gather(world: &World, options: &RenderOptions, texel: &TexelPoint) -> Option<GatherRays> {
    let point = texel.point?;
    let position = offset_origin(point.position, point.normal);
    let seed = stream(options.seed, 3, texel.texel);
    let count = options.gather_rays;
    let mut links = Vec::with_capacity(count);
    let (mut reflected, mut backs) = (Vec3::ZERO, 0);
    for i in 0..count {
        let mut sample = Sample::new(seed, i as u32);
        let [u, v] = sample.pair();
        let direction = around(point.normal, (1.0 - u).sqrt(), v);
        let Some(hit) = world.closest(position, direction) else { continue };
        if !hit.front {
            backs += 1;
            continue;
        }
        let mut link = Link { near: coarse_texel(world, &hit), far: NONE, weight: 0.0 };
        if options.specular_bounces > 0 {
            reflected += reflect(world, &hit, -direction, &mut link, &mut sample);
        }
        links.push(link);
    }
    let scale = std::f32::consts::PI / count as f32;
    (2 * backs <= count).then_some(GatherRays { links, scale, reflected_emission: reflected * scale })
}

/// Follows the specular lobe at a gather ray's hit: sets the link's far end, returns the emitted light seen in it.
fn reflect(world: &World, hit: &Vertex, view: Vec3, link: &mut Link, sample: &mut Sample) -> Vec3 {
    let (choice, roughness) = (world.choice(hit), world.roughness(hit.uv));
    let mut emitted = Vec3::ZERO;
    if let Some((direction, radiance, p_light)) = world.light(hit.position, hit.normal, &choice, sample) {
        let (value, p_lobe) = lobe(hit.normal, view, direction, roughness);
        emitted += radiance * value / (p_light + p_lobe);
    }
    if let Some(drawn) = sample_lobe(hit.normal, view, roughness, sample.pair())
        && let Some(far) = world.closest(hit.position, drawn.direction)
        && far.front
    {
        let share = drawn.pdf / (drawn.pdf + world.light_pdf(&far, &choice));
        emitted += world.emission(&far) * drawn.weight * share;
        (link.far, link.weight) = (coarse_texel(world, &far), drawn.weight);
    }
    emitted
}

/// Indirect irradiance of a texel from the radiosity (outgoing diffuse radiance) of all texels.
fn bounce(gathered: &GatherRays, radiosity: &[Vec3]) -> Vec3 {
    let mut sum = Vec3::ZERO;
    for link in &gathered.links {
        sum += radiosity[link.near as usize];
        if link.far != NONE {
            sum += radiosity[link.far as usize] * link.weight;
        }
    }
    sum * gathered.scale + gathered.reflected_emission
}

fn coarse_texel(world: &World, hit: &Vertex) -> u32 {
    let side = world.flat.albedo.width / SHRINK;
    let texel = |x: f32| ((x * side as f32) as usize).min(side - 1);
    (texel(hit.uv.y) * side + texel(hit.uv.x)) as u32
}

/// The values in the atlas after `passes` of a 3×3 binomial filter within the known texels, continued beyond them.
fn smoothed(side: usize, texels: &[TexelPoint], values: Vec<Option<Vec3>>, passes: usize) -> Rgb {
    let mut map = Raster::filled(side, side, None);
    texels.iter().zip(values).for_each(|(texel, value)| map.data[texel.texel] = value);
    for _ in 0..passes {
        let data = (0..side * side).into_par_iter().map(|i| blurred(&map, i)).collect();
        map = Raster { width: side, height: side, data };
    }
    let mut map = map.map(|value| value.map(|v| v.to_array()));
    dilate(&mut map, super::atlas::GUTTER);
    map.map(|value| value.unwrap_or([0.0; 3]))
}

/// The binomially weighted mean of the known texels around texel `i`; `None` if that is not known itself.
fn blurred(map: &Raster<Option<Vec3>>, i: usize) -> Option<Vec3> {
    map.data[i]?;
    let (x, y) = (i % map.width, i / map.width);
    let (mut sum, mut weights) = (Vec3::ZERO, 0.0);
    for ny in y.saturating_sub(1)..(y + 2).min(map.height) {
        for nx in x.saturating_sub(1)..(x + 2).min(map.width) {
            if let Some(value) = map.at(nx, ny) {
                let weight = [2.0, 1.0][nx.abs_diff(x)] * [2.0, 1.0][ny.abs_diff(y)];
                sum += value * weight;
                weights += weight;
            }
        }
    }
    Some(sum / weights)
}

/// Means of squares of [`SHRINK`] × [`SHRINK`] texels.
fn halved(map: &Rgb) -> Rgb {
    map.clone().reduced(SHRINK, mean_pixel)
}
