//! Colours of other primaries, as ACES has them, to those of Rec. 709, in which texir calculates.

use exr::meta::attribute::Chromaticities;
use exr::prelude::Vec2;
use glam::{DMat3, DVec3};

/// ITU-R BT.709, white D65: what an OpenEXR without chromaticities has.
const REC_709: Chromaticities =
    Chromaticities { red: Vec2(0.64, 0.33), green: Vec2(0.3, 0.6), blue: Vec2(0.15, 0.06), white: Vec2(0.3127, 0.329) };

/// Coordinates that differ by no more are the same: headers round them.
const SAME: f32 = 1e-3;

/// A determinant below this is that of primaries on a line, which span no colours.
const SINGULAR: f64 = 1e-6;

/// XYZ to the responses of cones that the Bradford adaptation scales (Lam 1985).
const BRADFORD: DMat3 = DMat3::from_cols(
    DVec3::new(0.8951, -0.7502, 0.0389),
    DVec3::new(0.2664, 1.7135, -0.0685),
    DVec3::new(-0.1614, 0.0367, 1.0296),
);

/// What takes linear RGB of these primaries to linear Rec. 709, the one white to the other; `None` where they are Rec.
/// 709's own, and an error where they span no colours.
pub(super) fn to_rec_709(from: &Chromaticities) -> Result<Option<DMat3>, String> {
    if distance(from, &REC_709) <= SAME {
        return Ok(None);
    }
    let wrong = || {
        let [red, green, blue, white] = points(from).map(|Vec2(x, y)| format!("({x}, {y})"));
        format!(
            "has chromaticities red {red}, green {green}, blue {blue}, white {white}, which span no colours; expected the x and y \
             of the primaries: correct the attribute, or remove it where the image is Rec. 709"
        )
    };
    let (source, target) = (xyz_from_rgb(from).ok_or_else(wrong)?, xyz_from_rgb(&REC_709).ok_or_else(wrong)?);
    let adapted = adaptation(xyz(from.white), xyz(REC_709.white)).ok_or_else(wrong)?;
    Ok(Some(target.inverse() * adapted * source))
}

fn points(of: &Chromaticities) -> [Vec2<f32>; 4] {
    [of.red, of.green, of.blue, of.white]
}

/// The largest difference of a coordinate; infinite where one is no number.
fn distance(a: &Chromaticities, b: &Chromaticities) -> f32 {
    let differences = points(a).into_iter().zip(points(b)).flat_map(|(a, b)| [(a.0 - b.0).abs(), (a.1 - b.1).abs()]);
    differences.fold(0.0, |most, d| if d <= most { most } else { d })
}

/// The colour of a chromaticity, with x + y + z = 1.
fn xyz(Vec2(x, y): Vec2<f32>) -> DVec3 {
    let (x, y) = (f64::from(x), f64::from(y));
    DVec3::new(x, y, 1.0 - x - y)
}

/// The normalised primary matrix (SMPTE RP 177-1993): white is (1, 1, 1) in RGB and has the luminance 1.
fn xyz_from_rgb(of: &Chromaticities) -> Option<DMat3> {
    let primaries = DMat3::from_cols(xyz(of.red), xyz(of.green), xyz(of.blue));
    let white = xyz(of.white) / xyz(of.white).y;
    let scale = invertible(primaries)?.inverse() * white;
    invertible(primaries * DMat3::from_diagonal(scale))
}

/// Bradford's chromatic adaptation, XYZ to XYZ: what looks white under one white looks white under the other.
fn adaptation(from: DVec3, to: DVec3) -> Option<DMat3> {
    let cones = |white: DVec3| BRADFORD * (white / white.y);
    invertible(BRADFORD.inverse() * DMat3::from_diagonal(cones(to) / cones(from)) * BRADFORD)
}

fn invertible(matrix: DMat3) -> Option<DMat3> {
    (matrix.is_finite() && matrix.determinant().abs() > SINGULAR).then_some(matrix)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// SMPTE ST 2065-1.
    const ACES_AP0: Chromaticities = Chromaticities {
        red: Vec2(0.7347, 0.2653),
        green: Vec2(0.0, 1.0),
        blue: Vec2(0.0001, -0.077),
        white: Vec2(0.32168, 0.33767),
    };

    /// ACEScg (S-2014-004).
    const ACES_AP1: Chromaticities =
        Chromaticities { red: Vec2(0.713, 0.293), green: Vec2(0.165, 0.83), blue: Vec2(0.128, 0.044), ..ACES_AP0 };

    /// Rows as published by the Academy's OpenColorIO configurations.
    #[test]
    fn matrices_are_the_published_ones() {
        let ap0 = [
            [2.521_686, -1.134_131, -0.387_555],
            [-0.276_480, 1.372_719, -0.096_239],
            [-0.015_378, -0.152_975, 1.168_353],
        ];
        let ap1 = [
            [1.705_051, -0.621_792, -0.083_259],
            [-0.130_256, 1.140_805, -0.010_548],
            [-0.024_003, -0.128_969, 1.152_972],
        ];
        for (of, rows) in [(ACES_AP0, ap0), (ACES_AP1, ap1)] {
            let published = DMat3::from_cols_array_2d(&rows).transpose();
            let found = to_rec_709(&of).unwrap().unwrap();
            assert!(found.abs_diff_eq(published, 2e-5), "{found}");
            assert!((found * DVec3::ONE).abs_diff_eq(DVec3::ONE, 1e-9), "white stays white");
        }
    }

    #[test]
    fn what_is_rec_709_but_for_rounding_is_left_alone() {
        assert_eq!(to_rec_709(&REC_709), Ok(None));
        assert_eq!(to_rec_709(&Chromaticities { white: Vec2(0.3127, 0.3299), ..REC_709 }), Ok(None));
        assert_ne!(to_rec_709(&Chromaticities { white: Vec2(0.3127, 0.3311), ..REC_709 }), Ok(None));
    }

    #[test]
    fn primaries_that_span_nothing_are_refused() {
        let flat = Chromaticities { green: REC_709.red, ..REC_709 };
        let dark = Chromaticities { white: Vec2(0.3, 0.0), ..REC_709 };
        let nothing = Chromaticities { white: Vec2(f32::NAN, 0.3), ..REC_709 };
        for wrong in [flat, dark, nothing] {
            let what = to_rec_709(&wrong).unwrap_err();
            assert!(what.contains("chromaticities red (0.64, 0.33)") && what.contains("expected"), "{what}");
        }
    }
}
