//! Every weight and switch of the fit by name, as one TOML file.

use bytesize::ByteSize;
use serde::{Deserialize, Serialize};

mod checks;
mod full;
mod paper;

use self::checks::positive;
pub use self::full::{
    AcceptanceSettings, AlbedoSettings, DiffuseChoice, FinishSettings, FullSettings, JointSettings, MetallicSettings,
    PaletteSettings, RoughnessSettings, SimilaritySettings, Straight,
};
pub use self::paper::{
    OptimiserSettings, PaperSettings, ParameterSettings, StageOneSettings, StageThreeSettings, StageTwoSettings,
};
use crate::atlas::MAX_SIDE;
use crate::backend::MAX_SAMPLES;
use crate::error::{Error, Result};

/// Rays per texel at the least: two halves, whose difference tells the noise, of two kinds.
const LEAST_RAYS: u32 = 4;

/// How materials are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// The paper's three stages of gradient descent.
    Paper,
    /// Robust least squares and a scan over roughness, on light samples drawn beforehand.
    #[default]
    Full,
}

/// Settings of the fit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FitSettings {
    /// Seed of every random choice.
    pub seed: u32,
    /// How materials are found.
    pub mode: Mode,
    /// Side of the square atlas that is fitted, texels; 0 takes the HDR texture's size, or without one what suits the
    /// views ([`crate::fit::memory::atlas_size`]).
    pub atlas_size: usize,
    /// Rays per texel of the irradiance bake, half of them to the light sources; 0 lets them follow the texels' area,
    /// see [`FitSettings::irradiance_rays`].
    pub irradiance_samples: u32,
    /// What the fit may have in memory, such as "2 GiB": views are read at a lower resolution to keep to it.
    pub max_memory: ByteSize,
    /// A texel is a light source where its radiance exceeds both ratio · E/π (what an albedo of this value would
    /// reflect) and ratio times its room's mean radiance.
    pub emitter_ratio: f32,
    /// Paper mode.
    pub paper: PaperSettings,
    /// Full mode.
    pub full: FullSettings,
}

impl Default for FitSettings {
    fn default() -> Self {
        Self {
            seed: 0,
            mode: Mode::default(),
            atlas_size: 0,
            irradiance_samples: 0,
            max_memory: ByteSize::gib(8),
            emitter_ratio: 3.0,
            paper: PaperSettings::default(),
            full: FullSettings::default(),
        }
    }
}

impl FitSettings {
    /// Rays per texel of the irradiance bake, for texels of the given edge in metres. Irradiance varies over surfaces,
    /// not over texels, and the denoiser gathers from those around: 256 rays for texels of about 2.5 cm and more, 128
    /// or 64 for finer ones.
    pub fn irradiance_rays(&self, texel: f32) -> u32 {
        match self.irradiance_samples {
            0 => 256 >> (2.0 * (0.025 / texel).log2()).round().clamp(0.0, 2.0) as u32,
            samples => samples,
        }
    }

    /// How often irradiance is baked: once for each round of full mode, but for the last at a quarter of the texels
    /// ([`thinned`](crate::bake::thinned)).
    pub fn bakes(&self) -> usize {
        if self.mode == Mode::Full { self.full.rounds().len() } else { 1 }
    }

    /// Checks every value; the error names the setting, its value and what is allowed.
    pub fn validate(&self) -> Result<()> {
        let checks = [
            ("atlas_size", self.atlas_size as f32, self.atlas_size <= MAX_SIDE, "at most 16384"),
            (
                "irradiance_samples",
                self.irradiance_samples as f32,
                self.irradiance_samples == 0 || (LEAST_RAYS..=MAX_SAMPLES).contains(&self.irradiance_samples),
                "0, or 4 to 1048576",
            ),
            positive("emitter_ratio", self.emitter_ratio),
        ];
        if self.mode == Mode::Paper && self.full.metallic.enabled {
            return Err(Error::invalid(
                "setting fit.full.metallic.enabled is true, but fit.mode is paper, in which everything is a dielectric; use mode full",
            ));
        }
        match checks.iter().chain(&self.paper.checks()).chain(&self.full.checks()).find(|(_, _, ok, _)| !ok) {
            Some((name, value, _, allowed)) => {
                Err(Error::invalid(format!("setting fit.{name} is {value}; it must be {allowed}")))
            }
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Projection};

    #[test]
    fn diffuse_models_are_chosen_by_name() {
        for choice in [DiffuseChoice::Auto, DiffuseChoice::Lambert, DiffuseChoice::Burley] {
            let name = serde_json::to_string(&choice).unwrap();
            assert_eq!(serde_json::from_str::<DiffuseChoice>(&name).unwrap(), choice);
        }
        let error = serde_json::from_str::<DiffuseChoice>("\"lambrt\"").unwrap_err().to_string();
        for part in ["`lambrt`", "`auto`", "`lambert`", "`burley`"] {
            assert!(error.contains(part), "{part} is not in: {error}");
        }
    }

    #[test]
    fn irradiance_takes_fewer_rays_for_finer_texels() {
        let rays = |irradiance_samples: u32, texel: f32| {
            FitSettings { irradiance_samples, ..FitSettings::default() }.irradiance_rays(texel)
        };
        assert_eq!([0.1, 0.025, 0.018, 0.0125, 0.001].map(|texel| rays(0, texel)), [256, 256, 128, 64, 64]);
        assert_eq!([0.1, 0.001].map(|texel| rays(4, texel)), [4, 4]);
    }

    #[test]
    fn rounds_before_the_last_are_coarse() {
        let bakes = |mode: Mode, alternations: u32| {
            let full = FullSettings { alternations, ..FullSettings::default() };
            FitSettings { mode, full, ..FitSettings::default() }.bakes()
        };
        assert_eq!([0, 1, 2].map(|alternations| bakes(Mode::Full, alternations)), [1, 2, 3]);
        assert_eq!(bakes(Mode::Paper, 1), 1);

        let settings = FullSettings::default();
        let rounds = settings.rounds();
        assert!(rounds.len() == 2 && rounds[1] == settings);
        // By pixels that are 1.4°, 0.7° and 0.35° wide: the last round's rays, 176 per block of 0.7° at least, and the
        // first's, 60 per block of twice that.
        let per_pixel = |projection: Projection, width: usize| {
            let camera = Camera { projection, width, height: width / 2, world_from_camera: glam::Mat4::IDENTITY };
            assert!(rounds[0].squares(&camera).count() <= rounds[1].squares(&camera).count());
            settings.rays(&camera) as f32 / camera.pixels() as f32
        };
        for (width, expected) in [(256, 176.0 + 60.0), (512, 176.0 + 60.0 / 4.0), (1024, 176.0 / 4.0 + 60.0 / 16.0)] {
            let focal = width as f32 / std::f32::consts::TAU;
            let photo = Projection::Pinhole { fx: focal, fy: focal, cx: 0.0, cy: 0.0 };
            assert_eq!(per_pixel(photo, width), expected);
            // Two thirds of a panorama would do to look everywhere; blocks are of whole pixels.
            let share = per_pixel(Projection::Equirectangular, width) / expected;
            assert!((0.63..0.9).contains(&share), "{share} of {width} columns");
        }
    }

    /// The places of all numbers of a table, as paths of keys and indices.
    fn numbers(value: &toml::Value, path: &[String], found: &mut Vec<Vec<String>>) {
        let below = |key: String, value: &toml::Value, found: &mut Vec<_>| {
            numbers(value, &[path, &[key]].concat(), found);
        };
        match value {
            toml::Value::Integer(_) | toml::Value::Float(_) => found.push(path.to_vec()),
            toml::Value::Table(table) => table.iter().for_each(|(key, value)| below(key.clone(), value, found)),
            toml::Value::Array(array) => {
                array.iter().enumerate().for_each(|(i, value)| below(i.to_string(), value, found));
            }
            _ => {}
        }
    }

    fn place<'a>(value: &'a mut toml::Value, path: &[String]) -> &'a mut toml::Value {
        path.iter().fold(value, |value, key| match value {
            toml::Value::Array(array) => &mut array[key.parse::<usize>().unwrap()],
            table => &mut table[key],
        })
    }

    #[test]
    fn every_number_is_checked() {
        let defaults = FitSettings::default();
        defaults.validate().unwrap();
        let table = toml::Value::try_from(&defaults).unwrap();
        let mut paths = Vec::new();
        numbers(&table, &[], &mut paths);
        assert!(paths.len() > 60, "{}", paths.len());
        for path in paths {
            let refused = |with: toml::Value| {
                let mut changed = table.clone();
                *place(&mut changed, &path) = with;
                // Integers that are none, or negative, are refused as they are read.
                FitSettings::deserialize(changed).map_or(true, |settings| settings.validate().is_err())
            };
            for wrong in [f64::NAN, f64::INFINITY, -1.0] {
                assert!(refused(toml::Value::Float(wrong)), "{path:?} = {wrong}");
            }
            // Negative control: what it is.
            assert!(!refused(place(&mut table.clone(), &path).clone()), "{path:?}");
        }
    }
}
