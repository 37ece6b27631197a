//! Light that does not arrive where it is looked for: at the fronts of faces, which are what a lightmap holds.

use std::f32::consts::PI;

use super::solve::{DARK, finder, reflected};
use super::{Model, Surfaces};
use crate::backend::{Backend, Gather, Gathered};
use crate::bake::{BakedTexels, Texels};
use crate::error::{Result, listed};
use crate::progress::{Progress, Task};
use crate::raster::luminance;
use crate::surface::SurfacePoint;

/// Texels that are looked at per primitive, and of all primitives together.
const PER_PRIMITIVE: usize = 64;
const OF_ALL: usize = 1 << 16;
/// How they are looked at from behind.
const GATHER: Gather = Gather::new(16, 16, 1);
/// A back is lit above this share of the scene's mean irradiance.
const LIT: f32 = 0.1;
/// Behind a face is inside of something where this share of the rays meets backs: nobody looks from there.
const INSIDE: f32 = 0.25;
/// A primitive is told of when this share of it is lit from behind alone.
const SHARE: f32 = 0.1;

/// Warnings: that the `solution` is black; double-sided primitives that are dark in front and lit from behind, where
/// nothing is baked; emissive double-sided ones whose back, which does not emit, receives light.
///
/// Replaces the backend's TBL and environment.
pub fn unlit(
    backend: &mut dyn Backend,
    model: &Model,
    texels: &Texels<'_>,
    surfaces: &Surfaces,
    solution: &BakedTexels,
    progress: &dyn Progress,
) -> Result<Vec<String>> {
    let mean = solution.mean(texels)? as f32;
    if mean == 0.0 {
        return Ok(vec![
            "no light arrives at any surface, and the map is black: only the front of a face is lit, from where its corners run \
             counter-clockwise; turn faces that are seen from behind around, and check where the lights are"
                .to_owned(),
        ]);
    }
    let (points, mut parts) = suspects(model, texels, surfaces, solution, DARK * mean)?;
    if points.is_empty() {
        return Ok(Vec::new());
    }
    let mesh = backend.scene().mesh();
    let behind: Vec<SurfacePoint> = points.iter().map(|suspect| suspect.point.behind(mesh)).collect();
    let light = light_at(backend, texels, surfaces, solution, &behind, progress)?;
    for (suspect, _) in points.iter().zip(light).filter(|(_, light)| *light >= LIT * mean) {
        let Looked { lit, shining, .. } = &mut parts[suspect.part];
        *(if suspect.shines { shining } else { lit }) += 1;
    }
    Ok(parts_lit_from_behind(model, &parts))
}

/// A point that is looked at from behind.
struct Suspect {
    /// The index of its primitive.
    part: usize,
    point: SurfacePoint,
    /// Whether it shines; if not, its front is dark.
    shines: bool,
}

/// What was looked at of a primitive.
#[derive(Clone, Copy, Default)]
struct Looked {
    texels: usize,
    /// Those that are dark in front, and lit behind.
    lit: usize,
    /// Those that shine, and are lit behind.
    shining: usize,
}

/// Texels of double-sided primitives, some of each, that shine or have less irradiance than `dark`, with the index of
/// their primitive; and how many of each were looked at.
fn suspects(
    model: &Model,
    texels: &Texels<'_>,
    surfaces: &Surfaces,
    solution: &BakedTexels,
    dark: f32,
) -> Result<(Vec<Suspect>, Vec<Looked>)> {
    let double: Vec<bool> =
        model.parts.iter().map(|part| model.is_double_sided(part) && !part.is_transparent()).collect();
    let (mut points, mut looked) = (Vec::new(), vec![Looked::default(); double.len()]);
    if !double.contains(&true) {
        return Ok((points, looked));
    }
    let each = (OF_ALL / double.iter().filter(|double| **double).count().max(1)).clamp(1, PER_PRIMITIVE);
    let firsts: Vec<usize> = model.first_triangles().collect();
    let part_of = |point: &SurfacePoint| firsts.partition_point(|first| *first <= point.triangle as usize) - 1;
    let mut counts = vec![0; double.len()];
    solution.each(texels, |point, _, _| counts[part_of(point)] += 1)?;
    // Odd, so that it does not go down one column of a chart.
    let stride = |count: usize| (count / each).max(1) | 1;
    let mut passed = vec![0; double.len()];
    solution.each(texels, |point, irradiance, seen| {
        let part = part_of(point);
        let chosen = double[part] && usize::is_multiple_of(passed[part], stride(counts[part]));
        passed[part] += 1;
        looked[part].texels += usize::from(chosen);
        // More than the noise of an image.
        let shines = PI * luminance(&surfaces.emission.data[point.index as usize]) > dark;
        if chosen && (shines || seen && luminance(&irradiance) < dark) {
            points.push(Suspect { part, point: *point, shines });
        }
    })?;
    Ok((points, looked))
}

/// The luminance of irradiance at points from surfaces and lamps, 0 inside objects. What is beyond the scene has no
/// say: it is below every floor as well.
fn light_at(
    backend: &mut dyn Backend,
    texels: &Texels<'_>,
    surfaces: &Surfaces,
    solution: &BakedTexels,
    points: &[SurfacePoint],
    progress: &dyn Progress,
) -> Result<Vec<f32>> {
    let mut sent = reflected(&surfaces.albedo, |rows| solution.filled_rows(texels, solution, rows))?;
    sent.data.iter_mut().zip(&surfaces.emission.data).for_each(|(sent, own)| (0..3).for_each(|c| sent[c] += own[c]));
    backend.set_environment(None)?;
    let lights = finder(backend, texels, &sent)?.one_sided();
    backend.set_tbl(&sent, &lights)?;
    let per_point = u64::from(GATHER.cosine + GATHER.light) + surfaces.lights.len() as u64;
    let task = Task::start(progress, "backs of double-sided surfaces", points.len() as u64 * per_point, "rays");
    let gathered = backend.irradiance(points, GATHER, progress)?;
    let direct = match &surfaces.lights[..] {
        [] => vec![[0.0; 3]; points.len()],
        lights => backend.punctual(points, lights, progress)?,
    };
    drop(task);
    let all = |(gathered, direct): (&Gathered, &[f32; 3])| {
        if gathered.back_faces < INSIDE { luminance(&gathered.irradiance) + luminance(direct) } else { 0.0 }
    };
    Ok(gathered.iter().zip(&direct).map(all).collect())
}

/// What to tell the user of primitives after they were looked at.
fn parts_lit_from_behind(model: &Model, parts: &[Looked]) -> Vec<String> {
    let names = |count: fn(&Looked) -> usize| -> Vec<String> {
        let told = |looked: &Looked| count(looked) > 0 && count(looked) as f32 >= SHARE * looked.texels as f32;
        let of = model.parts.iter().zip(parts).filter(|(_, looked)| told(looked));
        of.map(|(part, _)| format!("\"{}\"", part.name)).collect()
    };
    let sentence = |names: Vec<String>, what: &str| {
        (!names.is_empty()).then(|| format!("double-sided surfaces ({}) {what}: {}", names.len(), listed(&names)))
    };
    let dark = sentence(
        names(|looked| looked.lit),
        "are lit from behind, where only the light of their fronts is baked, so that they are black; turn their faces around",
    );
    let shining = sentence(
        names(|looked| looked.shining),
        "shine from their fronts alone, from where their corners run counter-clockwise, and have lit surfaces behind them; where these \
         miss the light, turn their faces around or give them a second sheet",
    );
    dark.into_iter().chain(shining).collect()
}
