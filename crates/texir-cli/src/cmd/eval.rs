//! `texir eval`: the figures of a fit, beside those of true materials.

use std::path::{Path, PathBuf};

use clap::Args;
use texir_core::atomic_file::write_atomic;
use texir_core::capture::{self, Capture, Corrections, LoadOptions};
use texir_core::eval::{Evaluated, Evaluation, evaluate};
use texir_core::mesh::Mesh;
use texir_core::mesh_io::read_mesh;
use texir_core::outputs::{CORRECTIONS, FitOutput, MESH, METRICS, REPORT, RUN, Run};
use texir_core::progress::{Progress, Silent};
use texir_core::render::Renderer;
use texir_core::scene::Scene;
use texir_core::text_file::read_text;

use crate::args::rays;
use crate::device;
use crate::failure::{Context, Failure};
use crate::figures;
use crate::session::Session;

/// Rays per pixel of the protocol.
pub const RAYS: u32 = 256;

/// Arguments of `texir eval`.
#[derive(Debug, Args)]
pub struct Eval {
    /// Output folder of `texir fit`
    #[arg(value_name = "FIT")]
    out: PathBuf,
    /// Capture with the truth [default: the one that was fitted]
    #[arg(long, value_name = "DIR")]
    capture: Option<PathBuf>,
    /// Evaluate with this mesh instead of the fit's, such as the true one behind a scan (same triangles and UVs): the
    /// scores then exclude the scan's geometric error; metrics.json is not written
    #[arg(long, value_name = "FILE")]
    mesh: Option<PathBuf>,
    /// Rays per pixel for highlights; raised to 96 if lower
    #[arg(long, default_value_t = RAYS, value_name = "N", value_parser = rays())]
    spp: u32,
}

impl Eval {
    /// Evaluates, prints the table, writes `metrics.json` unless the mesh is another.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        let mut output = FitOutput::load(&self.out, session.console)?;
        if let Some(path) = &self.mesh {
            output.mesh = with_atlas_of(&output.mesh, path)?;
        }
        let capture = load_capture(&self.out, self.capture.as_deref(), session)?;
        let evaluation = of_output(&output, &capture, self.spp, session, &mut |_| ())?;
        // What was waited for is told also where the folder cannot be written to.
        session.print(&evaluation, || figures::text(&evaluation))?;
        if self.mesh.is_none() {
            write_metrics(&self.out, &evaluation)?;
            let report = self.out.join(REPORT);
            if report.is_file() {
                session
                    .console
                    .note(&format!("{}: shows an earlier evaluation; update it with `texir report`", report.display()));
            }
        }
        Ok(())
    }
}

/// The mesh of a file, whose triangles lie in the atlas as those of `fitted` do.
fn with_atlas_of(fitted: &Mesh, path: &Path) -> Result<Mesh, Failure> {
    let mesh = read_mesh(path)?.mesh;
    match mesh.atlas_difference(fitted) {
        None => Ok(mesh),
        Some(difference) => Err(Failure::new(format!(
            "{}: textures of the fit do not belong to this mesh: {difference}; expected the triangles and coordinates of the fit's mesh.obj",
            path.display()
        ))),
    }
}

/// Evaluates a fit's output; `show` sees every view.
pub fn of_output(
    output: &FitOutput,
    capture: &Capture,
    rays: u32,
    session: &Session<'_>,
    show: &mut dyn FnMut(&Evaluated<'_>),
) -> Result<Evaluation, Failure> {
    let mut backend = device::open(Scene::new(output.mesh.clone())?, session)?;
    let radiance = &output.tbl.radiance;
    let mut renderer = Renderer::new(backend.as_mut(), radiance, rays, session.config.fit.seed)?;
    warn_of_rays(&renderer, rays, session);
    Ok(evaluate(&mut renderer, capture, &output.textures, session.console, show)?)
}

/// Says so where a renderer takes more rays than `asked` for.
pub fn warn_of_rays(renderer: &Renderer<'_>, asked: u32, session: &Session<'_>) {
    let taken = renderer.rays_per_pixel();
    if taken > asked {
        session.console.warn(&format!("--spp is {asked}, below the minimum; using {taken} rays per pixel"));
    }
}

/// The given capture, or the one that `out` was fitted to, with its views corrected as the fit corrected them.
pub fn load_capture(out: &Path, given: Option<&Path>, session: &Session<'_>) -> Result<Capture, Failure> {
    let folder = match given {
        Some(folder) => folder.to_owned(),
        None => read_run(out).map_err(|failure| failure.help("name the capture with --capture"))?.capture,
    };
    // The mesh that was fitted: the folder may have another, or none.
    let options = LoadOptions { mesh: Some(out.join(MESH)), ..LoadOptions::default() };
    let mut capture = capture::load(&folder, &options, session.console)
        .context(format!("the capture {} could not be read", folder.display()))?;
    if given.is_some() {
        warn_of_another(&folder, &capture.mesh, session);
    }
    let path = out.join(CORRECTIONS);
    Corrections::read(&path)?
        .apply(&mut capture, session.console)
        .context(format!("{} cannot be applied", path.display()))?;
    Ok(capture)
}

/// Warns where the folder has a mesh of its own that was not fitted: another capture's figures would say nothing.
fn warn_of_another(folder: &Path, fitted: &Mesh, session: &Session<'_>) {
    // One without a mesh is judged by the fit's alone.
    let Ok(own) = capture::load(folder, &LoadOptions::default(), &Silent) else { return };
    if let Some(difference) = own.mesh.atlas_difference(fitted) {
        session.console.warn(&format!(
            "{}: its mesh is not the one that was fitted ({difference}): expected the capture of this fit",
            folder.display()
        ));
    }
}

/// How the fit in `out` came about.
pub fn read_run(out: &Path) -> Result<Run, Failure> {
    let path = out.join(RUN);
    serde_json::from_str(&read_text(&path)?).map_err(|e| Failure::new(format!("{}: {e}", path.display())))
}

/// Writes `metrics.json`.
pub fn write_metrics(out: &Path, evaluation: &Evaluation) -> Result<(), Failure> {
    Ok(write_atomic(out.join(METRICS), |sink| serde_json::to_writer_pretty(sink, evaluation))?)
}
