//! Light sources: texels that send out more than they can reflect.

use crate::atlas::Atlas;
use crate::backend::Backend;
use crate::capture::View;
use crate::error::Result;
use crate::progress::Progress;
use crate::raster::{Mask, Raster, Rgb};
use crate::surface::SurfacePoint;

/// Finds the texels that send out more than an albedo of `ratio` would reflect of what arrives, L > ratio · E/π, and that
/// stand out from the scene, L > ratio · mean L; in luminance (Rec. 709). Where views see such a texel, the median of what
/// they see must pass as well: in the texture, a lamp bleeds into what is seen beside and behind it.
pub fn find(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    (radiance, irradiance): (&Rgb, &Rgb),
    views: &[View],
    ratio: f32,
    progress: &dyn Progress,
) -> Result<Mask> {
    let texels = || atlas.texels.iter().map(|&t| t as usize);
    let mean = texels().map(|t| luminance(&radiance.data[t])).sum::<f32>() / atlas.texels.len() as f32;
    let least: Raster<f32> = irradiance.map(|e| ratio * (luminance(e) * std::f32::consts::FRAC_1_PI).max(mean));
    let mut mask = Mask::filled(radiance.width, radiance.height, false);
    for t in texels() {
        mask.data[t] = luminance(&radiance.data[t]) > least.data[t];
    }
    let candidates: Vec<usize> = (0..atlas.texels.len()).filter(|&i| mask.data[atlas.texels[i] as usize]).collect();
    for (i, mut seen) in candidates.iter().zip(sightings(backend, atlas, &candidates, views, progress)?) {
        if !seen.is_empty() {
            let middle = seen.len() / 2;
            let median = *seen.select_nth_unstable_by(middle, f32::total_cmp).1;
            let texel = atlas.texels[*i] as usize;
            mask.data[texel] = median > least.data[texel];
        }
    }
    Ok(mask)
}

/// Luminances of the pixels that show each of the given texels.
fn sightings(
    backend: &mut dyn Backend,
    atlas: &Atlas,
    texels: &[usize],
    views: &[View],
    progress: &dyn Progress,
) -> Result<Vec<Vec<f32>>> {
    let points: Vec<SurfacePoint> = texels.iter().map(|&i| atlas.points[i]).collect();
    let mut seen = vec![Vec::new(); texels.len()];
    for view in views {
        progress.check()?;
        let image = view.load_image(progress)?;
        for (seen, at) in seen.iter_mut().zip(backend.project(&points, &view.camera)?) {
            if at.distance > 0.0 {
                let [x, y] = at.pixel.map(|c| c.max(0.0) as usize);
                seen.push(luminance(image.at(x.min(image.width - 1), y.min(image.height - 1))));
            }
        }
    }
    Ok(seen)
}

fn luminance(c: &[f32; 3]) -> f32 {
    0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2]
}
