//! `texir ablate`: what each part of the method is worth on a capture (paper, Table 3).

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use texir_core::atomic_file::write_atomic;
use texir_core::capture::{Capture, Split};
use texir_core::eval::{Evaluation, Table, check_sizes};
use texir_core::fit::{FitSettings, Mode};
use texir_core::outputs::{FitOutput, METRICS, RUN, SETTINGS, Staging};
use texir_core::raster::Gray;
use texir_core::render::{self, Renderer};
use texir_core::scene::Scene;

use super::report::{name, publish};
use super::{eval, fit};
use crate::args::{CaptureArgs, rays};
use crate::checks::check_folder;
use crate::device;
use crate::failure::Failure;
use crate::figures::{self, FIGURES};
use crate::report::ablation::{self, Ablation, Pictures};
use crate::report::{self, Picture};
use crate::session::Session;

/// The table, in the folder of the variants.
const TABLE: &str = "ablation.json";
/// The page, beside it.
const PAGE: &str = "ablation.html";

/// A way to fit.
struct Variant {
    /// Its folder.
    name: &'static str,
    /// What it leaves out, in words.
    note: &'static str,
    /// What it leaves out, in settings.
    set: fn(&mut FitSettings),
}

/// From the least to the most; all but the last in paper mode.
const VARIANTS: [Variant; 7] = [
    Variant {
        name: "joint",
        note: "albedo and roughness together from the start: no stage I, no stage II",
        set: |s| (s.paper.stage_one.enabled, s.paper.stage_two.enabled) = (false, false),
    },
    Variant {
        name: "without-stage-1",
        note: "no albedo of its own before roughness",
        set: |s| s.paper.stage_one.enabled = false,
    },
    Variant {
        name: "without-stage-2",
        note: "no roughness from virtual highlights",
        set: |s| s.paper.stage_two.enabled = false,
    },
    Variant { name: "without-stage-3", note: "no refinement of both", set: |s| s.paper.stage_three.enabled = false },
    Variant {
        name: "source-tbl",
        note: "irradiance gathered anew at every step instead of precomputed",
        set: |s| s.paper.precomputed_irradiance = false,
    },
    Variant { name: "paper", note: "the paper's three stages", set: |_| () },
    Variant { name: "full", note: "the program's own way", set: |s| s.mode = Mode::Full },
];

/// Arguments of `texir ablate`.
#[derive(Debug, Args)]
pub struct Ablate {
    #[command(flatten)]
    capture: CaptureArgs,
    /// Folder for one fit with its report per variant, ablation.html and ablation.json
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Rays per pixel of the evaluations, for highlights; at least 96
    #[arg(long, default_value_t = eval::RAYS, value_name = "N", value_parser = rays())]
    spp: u32,
}

/// A variant's figures.
#[derive(Serialize)]
struct Outcome {
    name: &'static str,
    evaluation: Evaluation,
}

impl Ablate {
    /// Fits and evaluates every variant; what an earlier run finished with the same capture, settings and rays is kept.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        session.config.check_set_of_all_modes()?;
        let capture = self.capture.load(session)?;
        check_folder(&self.output, &capture.files())?;
        check_sizes(&capture)?;
        let outcomes: Vec<Outcome> =
            VARIANTS.iter().map(|variant| self.one(variant, &capture, session)).collect::<Result<_, _>>()?;
        write_atomic(self.output.join(TABLE), |sink| serde_json::to_writer_pretty(sink, &outcomes))?;
        let page = self.output.join(PAGE);
        report::write_ablation(&self.page(&outcomes, &capture, session)?, &page)?;
        session.print(&outcomes, || format!("{}\n\n{}", table(&outcomes), page.display()))
    }

    /// The page, with the first training view's pictures.
    fn page(&self, outcomes: &[Outcome], capture: &Capture, session: &Session<'_>) -> Result<Ablation, Failure> {
        let Some(view) = capture.views(Split::Train).next() else {
            return Err(Failure::new(format!("{} has no training view", capture.root.display())));
        };
        let (albedo, roughness) = (view.load_albedo()?, view.load_roughness()?);
        let mut backend = device::open(Scene::new(capture.mesh.clone())?, session)?;
        let mut variants = Vec::new();
        for (variant, outcome) in VARIANTS.iter().zip(outcomes) {
            let output = FitOutput::load(&self.output.join(variant.name), session.console)?;
            let (radiance, seed) = (&output.tbl.radiance, session.config.fit.seed);
            let mut renderer = Renderer::new(backend.as_mut(), radiance, self.spp, seed)?;
            let textures = renderer.mipmapped(&output.textures)?;
            let surfaces = renderer.surfaces(&view.camera, &textures)?;
            let mask = surfaces.reflective();
            let error = |truth: &Gray| Picture::value_error(&surfaces.roughness, truth, &mask);
            variants.push(ablation::Variant {
                name: variant.name,
                note: variant.note,
                table: outcome.evaluation.result,
                pictures: Pictures {
                    albedo: Picture::linear(&surfaces.albedo)?,
                    roughness: Picture::values(&surfaces.roughness)?,
                    error: roughness.as_ref().map(error).transpose()?,
                },
            });
        }
        let truth = match (true_materials(outcomes), &albedo, &roughness) {
            (Some(table), Some(albedo), Some(roughness)) => {
                let (albedo, roughness) = (Picture::linear(albedo)?, Picture::values(roughness)?);
                Some((table, Pictures { albedo, roughness, error: None }))
            }
            _ => None,
        };
        Ok(Ablation { title: name(&capture.root), view: view.name.clone(), variants, truth })
    }

    fn one(&self, variant: &Variant, capture: &Capture, session: &Session<'_>) -> Result<Outcome, Failure> {
        let out = self.output.join(variant.name);
        let mut config = session.config.clone();
        config.fit.mode = Mode::Paper;
        (variant.set)(&mut config.fit);
        let session = &Session { config: &config, ..*session };
        let settings = std::fs::read_to_string(out.join(SETTINGS)).ok();
        let is_fitted = settings == fit::settings(&config).ok() && self.is_of_this_capture(&out, capture);
        let evaluation = match self.earlier(&out, capture).filter(|_| is_fitted) {
            Some(evaluation) => evaluation,
            None => {
                session.console.note(&format!("{:>24}  {}", "variant", variant.name));
                let output = match is_fitted {
                    true => FitOutput::load(&out, session.console)?,
                    false => fit::write(Staging::new(&out)?, capture, session)?,
                };
                publish(&out, &output, capture, self.spp, session)?
            }
        };
        Ok(Outcome { name: variant.name, evaluation })
    }

    /// The evaluation that is in `out`, if it is of these views and took the rays that this one would: `texir eval` and
    /// `texir report` may have written another there.
    fn earlier(&self, out: &Path, capture: &Capture) -> Option<Evaluation> {
        let metrics = std::fs::read_to_string(out.join(METRICS)).ok()?;
        let evaluation: Evaluation = serde_json::from_str(&metrics).ok()?;
        let same_views = evaluation.views.iter().map(|scores| &scores.name).eq(capture.views.iter().map(|v| &v.name));
        (same_views && evaluation.samples == render::rays_per_pixel(self.spp)).then_some(evaluation)
    }

    /// Whether this version made what is in `out` from this capture as it lies in its folder, and no file of that was
    /// written since.
    fn is_of_this_capture(&self, out: &Path, capture: &Capture) -> bool {
        let written = |path: &Path| path.metadata().and_then(|known| known.modified()).ok();
        let Some(made) = written(&out.join(RUN)) else { return false };
        eval::read_run(out).is_ok_and(|run| {
            run.version == env!("CARGO_PKG_VERSION")
                && run.capture == fit::absolute(&capture.root)
                && !self.capture.is_overridden()
                && capture.files().iter().all(|file| written(file).is_some_and(|time| time <= made))
        })
    }
}

/// What true materials reach, under the light of any variant that tells.
fn true_materials(outcomes: &[Outcome]) -> Option<Table> {
    outcomes.iter().find_map(|outcome| outcome.evaluation.true_materials)
}

/// A line per variant: PSNR and SSIM of the protocol's rows, and last what true materials reach.
fn table(outcomes: &[Outcome]) -> String {
    let shown = || FIGURES.iter().filter(|figure| !figure.minor);
    let head: String = shown().map(|figure| format!("{:>30}", figure.name)).collect();
    let mut lines = vec![format!("{:<18}{head}", "")];
    let true_materials = true_materials(outcomes).map(|table| ("true materials", table));
    for (name, table) in outcomes.iter().map(|o| (o.name, o.evaluation.result)).chain(true_materials) {
        let score = |figure: &figures::Figure| match (figure.of)(&table) {
            Some(score) => format!("{:>21.2} / {:.4}", score.psnr, score.ssim),
            None => format!("{:>30}", "-"),
        };
        lines.push(format!("{name:<18}{}", shown().map(score).collect::<String>()));
    }
    lines.join("\n")
}
