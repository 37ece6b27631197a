//! The rows in which an evaluation is shown, on the terminal and in the report.

use texir_core::eval::{Evaluation, Score, Table};

/// A row of figures.
pub struct Figure {
    /// What is compared.
    pub name: &'static str,
    /// A side note to the protocol's own rows.
    pub minor: bool,
    /// Where it is found.
    pub of: fn(&Table) -> Option<Score>,
}

const fn row(name: &'static str, minor: bool, of: fn(&Table) -> Option<Score>) -> Figure {
    Figure { name, minor, of }
}

/// All rows, top to bottom.
pub const FIGURES: [Figure; 7] = [
    row("Albedo, one scale per image", false, |t| t.train.albedo.map(|a| a.per_image)),
    row("Albedo, one scale for all views", true, |t| t.train.albedo.map(|a| a.global)),
    row("Roughness", false, |t| t.train.roughness),
    row("Re-rendering", false, |t| t.train.image),
    row("Novel views", false, |t| t.novel.image),
    row("Albedo in novel views", true, |t| t.novel.albedo.map(|a| a.per_image)),
    row("Roughness in novel views", true, |t| t.novel.roughness),
];

/// What ground truth the capture lacks, for the user.
pub fn lacks(evaluation: &Evaluation) -> Option<&'static str> {
    let Table { train, novel, .. } = &evaluation.result;
    let is_scored = [train, novel].iter().any(|views| views.albedo.is_some() || views.roughness.is_some());
    match (is_scored, evaluation.true_materials.is_some()) {
        (_, true) => None,
        (true, false) => Some("No ground-truth textures in this capture, so that their own scores are not known."),
        (false, false) => Some("No ground truth in this capture: albedo and roughness are not scored."),
    }
}

/// The table as text: the result, and beside it that of the true materials where they are known.
pub fn text(evaluation: &Evaluation) -> String {
    let true_materials = evaluation.true_materials.as_ref();
    let head = "   PSNR    SSIM     MSE";
    let mut lines = vec![format!("{:<32}{head}{}", "", if true_materials.is_some() { "  |" } else { "" })];
    if true_materials.is_some() {
        lines[0] += &format!("{head}  (true materials, same light)");
    }
    let figures = |s: Score| format!("{:>7.2}{:>8.4}{:>8.4}", s.psnr, s.ssim, s.mse);
    for figure in &FIGURES {
        let Some(score) = (figure.of)(&evaluation.result) else { continue };
        let mut line = format!("{:<32}{}", figure.name, figures(score));
        if let Some(score) = true_materials.and_then(figure.of) {
            line += &format!("  |{}", figures(score));
        }
        lines.push(line);
    }
    lines.extend(lacks(evaluation).map(str::to_owned));
    lines.join("\n")
}
