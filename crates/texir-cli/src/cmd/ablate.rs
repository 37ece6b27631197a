//! `texir ablate`: what each part of the method is worth on a capture (paper, Table 3).

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use texir_core::atomic_file::write_atomic;
use texir_core::capture::Capture;
use texir_core::eval::Evaluation;
use texir_core::fit::{FitSettings, Mode};
use texir_core::outputs::{METRICS, SETTINGS, Staging};

use super::{CaptureArgs, Session, eval, fit, report};
use crate::failure::Failure;
use crate::figures::{self, FIGURES};

/// The table, in the folder of the variants.
const TABLE: &str = "ablation.json";

/// A way to fit.
struct Variant {
    /// Its folder.
    name: &'static str,
    /// What it leaves out.
    set: fn(&mut FitSettings),
}

/// From the least to the most.
const VARIANTS: [Variant; 6] = [
    Variant {
        name: "joint",
        set: |s| {
            s.mode = Mode::Paper;
            s.stage_one.enabled = false;
            s.stage_two.enabled = false;
        },
    },
    Variant { name: "without-stage-1", set: |s| (s.mode, s.stage_one.enabled) = (Mode::Paper, false) },
    Variant { name: "without-stage-2", set: |s| (s.mode, s.stage_two.enabled) = (Mode::Paper, false) },
    Variant { name: "without-stage-3", set: |s| (s.mode, s.stage_three.enabled) = (Mode::Paper, false) },
    Variant { name: "paper", set: |s| s.mode = Mode::Paper },
    Variant { name: "full", set: |s| s.mode = Mode::Full },
];

/// Arguments of `texir ablate`.
#[derive(Debug, Args)]
pub struct Ablate {
    #[command(flatten)]
    capture: CaptureArgs,
    /// Folder for one fit with its report per variant, and ablation.json
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Rays per pixel of the evaluations, for highlights; at least 96
    #[arg(long, default_value_t = eval::RAYS, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    spp: u32,
}

/// A variant's figures.
#[derive(Serialize)]
struct Outcome {
    name: &'static str,
    evaluation: Evaluation,
}

impl Ablate {
    /// Fits and evaluates every variant; those that an earlier run finished with the same capture
    /// and settings are kept.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        let capture = self.capture.load(session)?;
        let outcomes: Vec<Outcome> =
            VARIANTS.iter().map(|variant| self.one(variant, &capture, session)).collect::<Result<_, _>>()?;
        write_atomic(self.output.join(TABLE), |sink| serde_json::to_writer_pretty(sink, &outcomes))?;
        session.print(&outcomes, || table(&outcomes))
    }

    fn one(&self, variant: &Variant, capture: &Capture, session: &Session<'_>) -> Result<Outcome, Failure> {
        let out = self.output.join(variant.name);
        let mut config = session.config.clone();
        (variant.set)(&mut config.fit);
        let session = &Session { config: &config, ..*session };
        let settings = std::fs::read_to_string(out.join(SETTINGS)).ok();
        let same = settings == fit::settings(&config).ok() && self.is_of_this_capture(&out, capture);
        let earlier = std::fs::read_to_string(out.join(METRICS)).ok();
        let evaluation = match earlier.filter(|_| same) {
            Some(metrics) => serde_json::from_str(&metrics).map_err(|e| {
                let path = out.join(METRICS);
                Failure::new(format!("{}: {e}", path.display())).help("remove it to fit this variant again")
            })?,
            None => {
                session.console.note(&format!("{:>24}  {}", "variant", variant.name));
                let output = fit::write(Staging::new(&out)?, capture, session)?;
                report::publish(&out, &output, capture, self.spp, session)?
            }
        };
        Ok(Outcome { name: variant.name, evaluation })
    }

    /// Whether this version made what is in `out` from this capture as it lies in its folder.
    fn is_of_this_capture(&self, out: &Path, capture: &Capture) -> bool {
        eval::read_run(out).is_ok_and(|run| {
            run.version == env!("CARGO_PKG_VERSION")
                && run.capture == fit::absolute(&capture.root)
                && !self.capture.is_overridden()
        })
    }
}

/// A line per variant: PSNR and SSIM of the protocol's rows, and last what true materials reach.
fn table(outcomes: &[Outcome]) -> String {
    let shown = || FIGURES.iter().filter(|figure| !figure.minor);
    let head: String = shown().map(|figure| format!("{:>30}", figure.name)).collect();
    let mut lines = vec![format!("{:<18}{head}", "")];
    let ceiling = outcomes.iter().find_map(|o| o.evaluation.ceiling.map(|c| ("true materials", c)));
    for (name, table) in outcomes.iter().map(|o| (o.name, o.evaluation.result)).chain(ceiling) {
        let score = |figure: &figures::Figure| match (figure.of)(&table) {
            Some(score) => format!("{:>21.2} / {:.4}", score.psnr, score.ssim),
            None => format!("{:>30}", "-"),
        };
        lines.push(format!("{name:<18}{}", shown().map(score).collect::<String>()));
    }
    lines.join("\n")
}
