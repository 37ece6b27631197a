//! Lightmaps as engines want them: what a texel holds, and in which file.

use std::path::Path;

use crate::error::{Error, Result};
use crate::image_io::{ImageRows, write_hdr, write_ktx2, write_rgb};
use crate::raster::Rgb;

/// What an engine takes a lightmap's texel for. `docs/baking.md` says what else each one needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Profile {
    /// E = ∫ L cosθ dω in full: texir's own convention.
    #[default]
    Irradiance,
    /// Bevy: E/π; `Lightmap` component, UV_1, `lightmap_exposure` = 1 (nits per unit).
    Bevy,
    /// Godot 4: E/π, before its exposure normalisation; `LightmapGIData`, UV2.
    Godot,
    /// Unity's built-in pipeline: E/π; `Mesh.uv2`.
    Unity,
    /// three.js (r155 and later): E in full; `lightMap`, the second set of coordinates.
    Three,
    /// `MOZ_lightmap` as Hubs reads it: E in full, inside the GLB.
    Moz,
}

impl Profile {
    /// What irradiance is multiplied by.
    pub fn scale(self) -> f32 {
        match self {
            Self::Irradiance | Self::Three | Self::Moz => 1.0,
            Self::Bevy | Self::Godot | Self::Unity => std::f32::consts::FRAC_1_PI,
        }
    }

    /// The lightmap of an irradiance map.
    pub fn lightmap(self, irradiance: &Rgb) -> Rgb {
        irradiance.map(|e| e.map(|v| v * self.scale()))
    }
}

/// Errors on an extension that [`write_lightmap`] does not know, so that a long bake does not end in one.
pub fn check_extension(path: impl AsRef<Path>) -> Result<()> {
    writer(path.as_ref()).map(drop)
}

/// Writes `.exr` (32-bit float), `.hdr` (RGBE) or `.ktx2` (half float), by extension.
pub fn write_lightmap<'a>(path: impl AsRef<Path>, map: impl Into<ImageRows<'a, 3>>) -> Result<()> {
    writer(path.as_ref())?(path.as_ref(), map.into())
}

fn writer(path: &Path) -> Result<fn(&Path, ImageRows<'_, 3>) -> Result<()>> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    Ok(match extension.as_str() {
        "exr" => |path, map| write_rgb(path, map),
        "hdr" => |path, map| write_hdr(path, map),
        "ktx2" => |path, map| write_ktx2(path, map),
        _ => return Err(Error::file(path, "is no lightmap that texir writes; expected .exr, .hdr or .ktx2")),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image_io::read_rgb;

    #[test]
    fn texels_hold_what_the_engine_divides_by() {
        let irradiance = Rgb::filled(1, 1, [std::f32::consts::PI; 3]);
        let (full, over_pi) = (std::f32::consts::PI, 1.0);
        for (profile, texel) in [
            (Profile::Irradiance, full),
            (Profile::Bevy, over_pi),
            (Profile::Godot, over_pi),
            (Profile::Unity, over_pi),
            (Profile::Three, full),
            (Profile::Moz, full),
        ] {
            assert!((profile.lightmap(&irradiance).data[0][0] - texel).abs() < 1e-6, "{profile:?}");
        }
    }

    #[test]
    fn maps_come_back_from_their_files() {
        let map = Rgb::new(2, 1, vec![[0.25, 0.5, 1.0], [1000.0, 500.0, 10.0]]).unwrap();
        let folder = tempfile::tempdir().unwrap();
        // RGBE has eight bits below the largest channel's exponent.
        for (name, tolerance) in [("map.exr", 0.0), ("map.hdr", 1.0 / 128.0)] {
            let path = folder.path().join(name);
            write_lightmap(&path, &map).unwrap();
            for (read, written) in read_rgb(&path).unwrap().data.iter().zip(&map.data) {
                let most = written.iter().copied().fold(0.0, f32::max);
                let off = |c: usize| (read[c] - written[c]).abs();
                assert!((0..3).all(|c| off(c) <= tolerance * most), "{name}: {read:?} {written:?}");
            }
        }
        let error = check_extension("map.png").unwrap_err().to_string();
        assert!(error.contains(".ktx2") && error.contains("map.png"), "{error}");
    }
}
