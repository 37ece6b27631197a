//! `texir report`: one HTML page about a fit.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::Args;
use texir_core::capture::{Capture, Split};
use texir_core::eval::Evaluation;
use texir_core::outputs::{FitOutput, LOG, REPORT, ROOMS, SETTINGS};

use super::eval;
use crate::args::rays;
use crate::console::seconds;
use crate::failure::Failure;
use crate::figures;
use crate::report::{self, Picture, ViewPanel};
use crate::session::Session;

/// Arguments of `texir report`.
#[derive(Debug, Args)]
pub struct Report {
    /// Output folder of `texir fit`
    #[arg(value_name = "FIT")]
    out: PathBuf,
    /// Capture with the images and the truth [default: the one that was fitted]
    #[arg(long, value_name = "DIR")]
    capture: Option<PathBuf>,
    /// Rays per pixel for highlights; raised to 96 if lower
    #[arg(long, default_value_t = eval::RAYS, value_name = "N", value_parser = rays())]
    spp: u32,
}

impl Report {
    /// Evaluates, writes `metrics.json` and the page.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        let output = FitOutput::load(&self.out, session.console)?;
        let capture = eval::load_capture(&self.out, self.capture.as_deref(), session)?;
        let evaluation = publish(&self.out, &output, &capture, self.spp, session)?;
        session.print(&evaluation, || format!("{}\n\n{}", figures::text(&evaluation), self.out.join(REPORT).display()))
    }
}

/// Evaluates the fit in `out` and writes `metrics.json` and `report.html` there.
pub fn publish(
    out: &Path,
    output: &FitOutput,
    capture: &Capture,
    samples: u32,
    session: &Session<'_>,
) -> Result<Evaluation, Failure> {
    let mut panels: Vec<Result<ViewPanel, Failure>> = Vec::with_capacity(capture.views.len());
    let evaluation = eval::of_output(output, capture, samples, session, &mut |view| panels.push(ViewPanel::new(view)))?;
    let page = report::Report {
        title: name(&capture.root),
        summary: format!(
            "{}, a {} × {} atlas.",
            describe(capture),
            output.textures.albedo.width,
            output.textures.albedo.height
        ),
        textures: report::texture_figures(&output.textures, output.confidence.as_ref())?,
        rooms: read(&out.join(ROOMS))?.map(|bytes| Picture::from_png(&bytes)).transpose()?,
        curves: report::draw_curves(&report::parse_log(&read_text(&out.join(LOG))?)?)?,
        views: panels.into_iter().collect::<Result<_, _>>()?,
        facts: facts(out)?,
        settings: read_text(&out.join(SETTINGS))?,
        evaluation,
    };
    eval::write_metrics(out, &page.evaluation)?;
    report::write(&page, &out.join(REPORT))?;
    Ok(page.evaluation)
}

/// How the fit came about, in names and values.
fn facts(out: &Path) -> Result<Vec<(String, String)>, Failure> {
    let run = eval::read_run(out)?;
    let mut facts = vec![
        ("texir".to_owned(), run.version),
        ("capture".to_owned(), run.capture.display().to_string()),
        ("ran on".to_owned(), run.backend),
    ];
    facts.extend(run.timings.into_iter().map(|(phase, s)| (phase, seconds(Duration::from_secs_f64(s.max(0.0))))));
    Ok(facts)
}

/// The last part of the capture's path, as a title.
pub fn name(root: &Path) -> String {
    let absolute = root.canonicalize().unwrap_or_else(|_| root.to_owned());
    absolute.file_name().unwrap_or(absolute.as_os_str()).to_string_lossy().into_owned()
}

/// A file's bytes; `None` where there is no such file.
fn read(path: &Path) -> Result<Option<Vec<u8>>, Failure> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(Failure::new(format!("{}: {e}", path.display()))),
    }
}

/// A file's text; empty where there is no such file.
fn read_text(path: &Path) -> Result<String, Failure> {
    Ok(read(path)?.map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).unwrap_or_default())
}

/// A capture in a line.
pub fn describe(capture: &Capture) -> String {
    let of = |split| capture.views(split).count();
    let sizes: Vec<(usize, usize)> = capture.views.iter().map(|v| (v.camera.width, v.camera.height)).collect();
    let size = match sizes.first() {
        Some(first) if sizes.iter().all(|s| s == first) => format!("{} × {}", first.0, first.1),
        _ => "mixed sizes".to_owned(),
    };
    format!(
        "{} training and {} novel views of {size}, {} triangles",
        of(Split::Train),
        of(Split::Novel),
        capture.mesh.triangles.len()
    )
}
