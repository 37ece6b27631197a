//! Checks of what passes are given. Every backend makes them, so that misuse is the same error with each.

use std::ops::Range;

use super::{Gather, GroupTarget, Groups, MAX_SAMPLES, Material, Sampling, Sequences, ShadePoint, Shaded};
use crate::error::{Error, Result};
use crate::lights::{Cut, Lights};
use crate::punctual::PunctualLight;
use crate::raster::Rgb;
use crate::scene::Scene;
use crate::specular_table::{STRATA, TableSampling};
use crate::surface::SurfacePoint;
use crate::texture::{Footprints, Pyramid, SparseRows};

/// That a slice has as many items as expected.
fn sized(what: &str, found: usize, expected: usize) -> Result<()> {
    if found == expected {
        return Ok(());
    }
    Err(Error::invalid(format!("{what}: {found} values where {expected} are expected")))
}

fn drawn(samples: u32) -> Result<()> {
    match samples {
        0 => Err(Error::invalid("the number of samples is 0: at least one is needed")),
        1..=MAX_SAMPLES => Ok(()),
        _ => Err(Error::invalid(format!("{samples} samples are asked for at a point; expected at most {MAX_SAMPLES}"))),
    }
}

/// That all vectors of a point are numbers: no ray of others meets anything.
fn finite<const FIELDS: usize>(what: &str, i: usize, fields: [(&str, [f32; 3]); FIELDS]) -> Result<()> {
    match fields.into_iter().find(|(_, vector)| !vector.iter().all(|v| v.is_finite())) {
        Some((field, vector)) => {
            Err(Error::invalid(format!("the {field} of {what} {i} is {vector:?}; expected finite numbers")))
        }
        None => Ok(()),
    }
}

/// That rays can leave from points.
pub fn points(points: &[SurfacePoint]) -> Result<()> {
    let check = |(i, p): (usize, &SurfacePoint)| finite("point", i, [("position", p.position), ("normal", p.normal)]);
    points.iter().enumerate().try_for_each(check)
}

/// That rays can leave from points to shade.
fn shade_points(what: &str, points: &[ShadePoint]) -> Result<()> {
    points
        .iter()
        .enumerate()
        .try_for_each(|(i, p)| finite(what, i, [("position", p.position), ("normal", p.normal), ("view", p.view)]))
}

/// That the texture-based lighting has texels and possible radiance, and that its lights are those of the scene.
pub fn tbl(scene: &Scene, radiance: &Rgb, lights: &Lights) -> Result<()> {
    if radiance.data.is_empty() {
        return Err(Error::invalid("the texture-based lighting has no texels: expected at least 1×1"));
    }
    radiance.check_radiance("the texture-based lighting")?;
    let triangles = scene.mesh().triangles.len();
    if lights.cuts.len() != triangles {
        return Err(Error::invalid(format!(
            "the lights are those of another mesh: {} triangles, the backend's has {triangles}",
            lights.cuts.len()
        )));
    }
    if !lights.is_consistent() {
        return Err(Error::invalid(
            "the lights' parts, clusters, tables and grid do not fit each other; expected those that Lights makes",
        ));
    }
    let is_solid = scene.is_solid();
    match lights.cuts.iter().zip(&is_solid).position(|(cut, solid)| *cut != Cut::NONE && !solid) {
        Some(triangle) => Err(Error::invalid(format!(
            "triangle {triangle} is among the lights, but transparent, so that no ray meets it; expected lights of opaque triangles",
        ))),
        None => Ok(()),
    }
}

/// That rows are those of an image or an atlas of so many.
pub fn rows(rows: &Range<usize>, height: usize) -> Result<()> {
    if rows.start <= rows.end && rows.end <= height {
        return Ok(());
    }
    Err(Error::invalid(format!("rows {rows:?} are asked for; expected rows of the {height} that there are")))
}

/// That irradiance is gathered by some cosine samples ([`super::Gathered::back_faces`] is their share), and not by too
/// many of a kind; that rays can leave from points; and that texels which share a sequence have a part of it each.
pub fn irradiance(points: &[SurfacePoint], gather: Gather) -> Result<()> {
    self::points(points)?;
    if let Sequences::Shared { width, part, parts } = gather.sequences
        && (width == 0 || part >= parts)
    {
        return Err(Error::invalid(format!(
            "part {part} of {parts} of the sequences of a map {width} texels wide; expected a part below their number, and a \
             width of at least 1"
        )));
    }
    drawn(gather.cosine)?;
    drawn(gather.light.max(1))
}

/// That the tables' rays can leave from their points, and directions be drawn: not too many of a kind.
pub fn specular_tables(pixels: &[[ShadePoint; STRATA]], sampling: TableSampling) -> Result<()> {
    shade_points("stratum", pixels.as_flattened())?;
    [sampling.lobe, sampling.cosine, sampling.light].into_iter().try_for_each(|samples| drawn(samples.max(1)))
}

/// That rays can leave from points, and that lights are possible ones.
pub fn punctual(points: &[SurfacePoint], lights: &[PunctualLight]) -> Result<()> {
    self::points(points)?;
    self::punctual_lights(lights)
}

/// That lights are possible ones.
pub fn punctual_lights(lights: &[PunctualLight]) -> Result<()> {
    let possible = |(i, light): (usize, &PunctualLight)| {
        light.check().map_err(|what| Error::invalid(format!("light {i}: {what}")))
    };
    lights.iter().enumerate().try_for_each(possible)
}

/// That rays can leave from points, and that each has a material; none is a perfect mirror, of which no density can be
/// sampled.
pub fn shade(points: &[ShadePoint], materials: &[Material], sampling: Sampling) -> Result<()> {
    sized("materials to shade", materials.len(), points.len())?;
    shade_points("point", points)?;
    if let Some(material) = materials.iter().find(|material| !(material.roughness > 0.0 && material.roughness <= 1.0)) {
        return Err(Error::invalid(format!(
            "roughness {} of a material to shade; expected one in (0, 1]",
            material.roughness
        )));
    }
    drawn(sampling.samples)
}

/// That every point has a material, what shading left of it, and a cotangent.
pub fn shade_vjp(
    points: &[ShadePoint],
    materials: &[Material],
    shaded: &[Shaded],
    d_radiance: &[[f32; 3]],
) -> Result<()> {
    sized("materials of shade_vjp", materials.len(), points.len())?;
    sized("shaded pixels of shade_vjp", shaded.len(), points.len())?;
    sized("cotangents of shade_vjp", d_radiance.len(), points.len())
}

/// That every pixel has a target.
pub fn radiance_loss(rendered: &[[f32; 3]], target: &[[f32; 3]]) -> Result<()> {
    sized("target of radiance_loss", target.len(), rendered.len())
}

/// That groups are consistent and refer to pixels that exist.
pub fn group_loss(values: &[f32], channels: usize, groups: &Groups, target: GroupTarget) -> Result<()> {
    if let GroupTarget::Quantile(q) = target
        && !(0.0..=1.0).contains(&q)
    {
        return Err(Error::invalid(format!("quantile {q} of a group; expected a share between 0 and 1")));
    }
    let pixels = values.len() / channels.max(1);
    sized("offsets of groups", groups.offsets.len(), groups.references.len() + 1)?;
    let ascending =
        groups.offsets.is_sorted() && groups.offsets.last().is_some_and(|&n| n as usize == groups.members.len());
    let counts = groups.offsets.windows(2).map(|w| w[1].saturating_sub(w[0]));
    if !ascending || counts.zip(&groups.references).any(|(count, &references)| references > count) {
        return Err(Error::invalid("groups: offsets must ascend to the number of members, references must be members"));
    }
    match groups.members.iter().find(|&&m| m as usize >= pixels) {
        Some(member) => {
            Err(Error::invalid(format!("groups: pixel {member} of a group, but there are {pixels} pixels")))
        }
        None => Ok(()),
    }
}

/// That the texture has the size of the pyramid's finest level, and that footprints lie in the pyramid.
pub fn lookup(pyramid: &Pyramid, texture: &[f32], channels: usize, footprints: &SparseRows) -> Result<()> {
    counted(channels)?;
    sized("texture of lookup", texture.len(), texels(pyramid) * channels)?;
    lists(footprints)?;
    within(pyramid, footprints.taps.iter().map(|tap| tap.texel))
}

/// That every footprint has a cotangent, and that footprints lie in the pyramid.
pub fn lookup_vjp(pyramid: &Pyramid, d_values: &[f32], channels: usize, footprints: &Footprints) -> Result<()> {
    counted(channels)?;
    sized("cotangents of lookup_vjp", d_values.len(), footprints.len() * channels)?;
    sized("columns of footprints", footprints.columns.len(), footprints.touched.len())?;
    lists(&footprints.columns)?;
    if footprints.columns.taps.iter().any(|tap| tap.texel as usize >= footprints.len()) {
        return Err(Error::invalid(format!("footprints: a column has a row that is not one of {}", footprints.len())));
    }
    if !footprints.touched.is_sorted_by(|a, b| a < b) {
        return Err(Error::invalid("footprints: the texels that are touched must ascend, each once"));
    }
    within(pyramid, footprints.touched.iter().copied())
}

fn counted(channels: usize) -> Result<()> {
    if channels > 0 { Ok(()) } else { Err(Error::invalid("a texture of 0 channels; expected at least one")) }
}

/// That offsets ascend to the number of taps.
fn lists(rows: &SparseRows) -> Result<()> {
    if rows.offsets.is_sorted() && rows.offsets.last().is_some_and(|&n| n as usize == rows.taps.len()) {
        return Ok(());
    }
    Err(Error::invalid("footprints: offsets must ascend to the number of taps"))
}

/// Texels of the finest level.
fn texels(pyramid: &Pyramid) -> usize {
    pyramid.levels.first().map_or(0, |level| level.width * level.height)
}

fn within(pyramid: &Pyramid, touched: impl Iterator<Item = u32>) -> Result<()> {
    match touched.max().filter(|last| *last as usize >= pyramid.len()) {
        Some(last) => Err(Error::invalid(format!(
            "footprints: texel {last} of a pyramid of {} texels; expected footprints of this atlas",
            pyramid.len()
        ))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_those_that_there_are() {
        for wrong in [0..5, Range { start: 3, end: 2 }] {
            assert!(rows(&wrong, 4).is_err_and(|e| e.to_string().contains("the 4 that there are")), "{wrong:?}");
        }
        assert!(rows(&(0..4), 4).is_ok() && rows(&(4..4), 4).is_ok());
    }

    #[test]
    fn texels_that_share_a_sequence_have_a_part_of_it_each() {
        let shared = |width, part, parts| {
            irradiance(&[], Gather { sequences: Sequences::Shared { width, part, parts }, ..Gather::new(1, 0, 0) })
        };
        for [width, part, parts] in [[8, 0, 0], [8, 2, 2], [0, 0, 1]] {
            assert!(
                shared(width, part, parts).is_err_and(|e| e.to_string().contains("part")),
                "{width} {part} {parts}"
            );
        }
        assert!(shared(8, 1, 2).is_ok());
    }

    #[test]
    fn what_is_no_number_is_named_with_its_place() {
        let sound = SurfacePoint { position: [1.0; 3], triangle: 0, normal: [0.0, 0.0, 1.0], index: 0 };
        let nowhere = SurfacePoint { position: [0.0, f32::NAN, 0.0], ..sound };
        let faceless = SurfacePoint { normal: [f32::INFINITY, 0.0, 0.0], ..sound };
        let named = |result: Result<()>, what: &str| {
            let error = result.unwrap_err().to_string();
            assert!(error.contains(what) && error.contains("expected finite numbers"), "{error}");
        };
        named(irradiance(&[sound, nowhere], Gather::new(1, 0, 0)), "the position of point 1 is [0.0, NaN, 0.0]");
        named(punctual(&[faceless], &[]), "the normal of point 0 is [inf, 0.0, 0.0]");
        let pixel = ShadePoint { view: [f32::NAN; 3], ..ShadePoint::default() };
        let (material, sampling) = (Material::dielectric([0.5; 3], 0.5), Sampling { samples: 1, seed: 0 });
        named(shade(&[pixel], &[material], sampling), "the view of point 0 is [NaN, NaN, NaN]");
        let mut strata = [ShadePoint::default(); STRATA];
        strata[STRATA - 1] = pixel;
        let sampling = TableSampling::of_rays(64, crate::brdf::Masking::Smith, 0);
        named(specular_tables(&[[ShadePoint::default(); STRATA], strata], sampling), "the view of stratum 7 is [NaN");
        assert!(points(&[sound]).is_ok());
    }

    #[test]
    fn what_is_shaded_is_no_perfect_mirror() {
        let point = ShadePoint::default();
        let shaded = |r: f32| shade(&[point], &[Material::dielectric([0.5; 3], r)], Sampling { samples: 1, seed: 0 });
        for r in [0.0, -0.1, 1.1, f32::NAN] {
            assert!(shaded(r).is_err_and(|e| e.to_string().contains("expected one in (0, 1]")), "{r}");
        }
        assert!(shaded(1e-3).is_ok() && shaded(1.0).is_ok());
    }
}
