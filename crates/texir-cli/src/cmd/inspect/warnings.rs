//! What a user should look at before a fit.

use std::ops::RangeInclusive;

use texir_core::capture::View;
use texir_core::progress::Progress;
use texir_core::tbl::blur;

use super::findings::Findings;
use crate::failure::Failure;
use crate::session::Session;

/// A camera from which more than this share of directions leaves the mesh is taken to be outside.
const OUTSIDE: f64 = 0.3;

/// A camera that sees more back faces than this is taken to be inside a solid, or the mesh to be turned inside out.
const INSIDE_OUT: f64 = 0.3;

/// Cameras that people carry or put on tripods are so high above the floor, metres.
const HEIGHTS: RangeInclusive<f32> = 0.3..=3.5;

/// Masks that leave out more than this share of all pixels are taken to be inverted.
const MASKED: f64 = 0.9;

/// What is wrong with the masks of the training views, if they leave hardly anything.
pub fn masked(views: &[View], session: &Session<'_>) -> Result<Option<String>, Failure> {
    let (mut excluded, mut all) = (0, 0);
    for view in views {
        session.console.check()?;
        all += view.camera.pixels();
        excluded += view.load_mask()?.map_or(0, |mask| mask.data.iter().filter(|used| !**used).count());
    }
    let share = excluded as f64 / all.max(1) as f64;
    Ok((share > MASKED).then(|| {
        format!(
            "mask_path: masks leave out {:.0} % of the training views' pixels: white is used and black is not; are they inverted?",
            100.0 * share
        )
    }))
}

/// What is wrong with what was found, or may be.
pub fn warnings(findings: &Findings) -> Vec<String> {
    let mut warnings = Vec::new();
    for view in &findings.views {
        if view.no_hit > OUTSIDE {
            warnings.push(format!(
                "camera {} sees no surface in {:.0} % of all directions: it is outside of the mesh, or the mesh is open",
                view.name,
                100.0 * view.no_hit
            ));
        }
        if view.back_faces > INSIDE_OUT {
            warnings.push(format!(
                "camera {} sees {:.0} % of its surroundings from behind: it is inside a solid, or faces point the wrong way",
                view.name,
                100.0 * view.back_faces
            ));
        }
    }
    let mut heights: Vec<f32> = findings.views.iter().filter_map(|view| view.height_above_floor).collect();
    heights.sort_by(f32::total_cmp);
    if let Some(height) = heights.get(heights.len() / 2).filter(|height| !HEIGHTS.contains(*height)) {
        warnings.push(format!(
            "cameras are {height:.2} m above what is below them, in the median; expected {} to {}: are the units metres, and is +Z up? \
             `texir import` takes --metres-per-unit and --up",
            HEIGHTS.start(),
            HEIGHTS.end()
        ));
    }
    if findings.atlas.overlapping_fraction > 0.01 {
        warnings.push(format!(
            "{:.1} % of the covered texels belong to more than one surface: `texir import --unwrap` makes a new atlas",
            100.0 * findings.atlas.overlapping_fraction
        ));
    }
    if let Some(blur) = findings.blur.filter(|blur| *blur >= blur::SHARP) {
        warnings.push(format!(
            "the images are softer than their pixels, by a point spread of {blur:.2} square pixels: a fit is better with --sharpen"
        ));
    }
    if findings.inputs.semantic == 0 {
        warnings.push("no view has semantic classes: a fit makes segments from geometry and colour alone".to_owned());
    }
    warnings
}
