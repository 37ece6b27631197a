//! `texir render`: views of a fit's result from other cameras.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;
use texir_core::capture::{View, load_cameras};
use texir_core::image_io::{encode_srgb, write_png_rgb, write_rgb};
use texir_core::outputs::{FitOutput, SCENE};
use texir_core::progress::Task;
use texir_core::render::Renderer;
use texir_core::scene::Scene;

use super::eval;
use crate::args::rays;
use crate::checks::check_folder;
use crate::device;
use crate::failure::Failure;
use crate::session::Session;

/// Previews are no brighter or darker than by this many stops.
const MOST_STOPS: f32 = 60.0;

/// Arguments of `texir render`.
#[derive(Debug, Args)]
pub struct Render {
    /// Output folder of `texir fit`
    #[arg(value_name = "FIT")]
    out: PathBuf,
    /// Cameras, equirectangular or pinhole, as nerfstudio's transforms.json; its images need not exist
    #[arg(long, value_name = "FILE")]
    cameras: PathBuf,
    /// Folder for one EXR (linear radiance) and one PNG (sRGB preview) per camera
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Rays per pixel for highlights; raised to 96 if lower
    #[arg(long, default_value_t = eval::RAYS, value_name = "N", value_parser = rays())]
    spp: u32,
    /// Brightness of the previews, in stops
    #[arg(long, default_value_t = 0.0, value_name = "EV", value_parser = stops, allow_negative_numbers = true)]
    exposure: f32,
}

/// Brightness in stops, as far as it leaves numbers of radiance.
fn stops(text: &str) -> Result<f32, String> {
    let stops = text.parse().ok().filter(|stops: &f32| stops.abs() <= MOST_STOPS);
    stops.ok_or_else(|| format!("expected stops, a number of -{MOST_STOPS} to {MOST_STOPS}"))
}

/// One rendered view, as `--json` prints it.
#[derive(Serialize)]
struct Rendered {
    name: String,
    exr: PathBuf,
    png: PathBuf,
}

impl Render {
    /// Renders every camera.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        let views = load_cameras(&self.cameras)?;
        let images = views.iter().flat_map(View::files).map(|(_, path)| path.to_owned());
        check_folder(&self.output, &images.chain([self.cameras.clone(), self.out.join(SCENE)]).collect::<Vec<_>>())?;
        let output = FitOutput::load(&self.out, session.console)?;
        let mut backend = device::open(Scene::new(output.mesh)?, session)?;
        let radiance = &output.tbl.radiance;
        let mut renderer = Renderer::new(backend.as_mut(), radiance, self.spp, session.config.fit.seed)?;
        eval::warn_of_rays(&renderer, self.spp, session);
        let textures = renderer.mipmapped(&output.textures)?;
        let gain = self.exposure.exp2();
        let mut written = Vec::with_capacity(views.len());
        let task =
            Task::start(session.console, "rendering", views.iter().map(|v| renderer.rays(&v.camera)).sum(), "rays");
        for view in &views {
            let radiance = renderer.render(&view.camera, &textures, session.console)?;
            let file = |extension: &str| self.output.join(format!("{}.{extension}", view.name));
            let (exr, png) = (file("exr"), file("png"));
            write_rgb(&exr, &radiance)?;
            write_png_rgb(&png, &encode_srgb(&radiance.map(|p| p.map(|c| c * gain))))?;
            written.push(Rendered { name: view.name.clone(), exr, png });
        }
        drop(task);
        session.print(&written, || format!("{} views in {}", written.len(), self.output.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exposure_is_a_number_of_stops() {
        assert_eq!([stops("-1.5"), stops("0"), stops("60")], [Ok(-1.5), Ok(0.0), Ok(60.0)]);
        for wrong in ["nan", "inf", "-inf", "61", "", "a"] {
            assert!(stops(wrong).is_err(), "{wrong}");
        }
    }
}
