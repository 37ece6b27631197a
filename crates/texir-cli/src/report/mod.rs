//! The report: one self-contained HTML page that shows how good a fit is, and where it is not.

mod curves;
mod page;
mod picture;

use std::path::Path;

use texir_core::capture::Split;
use texir_core::eval::{Evaluated, Evaluation, Score, Scores};
use texir_core::render::Textures;

use crate::failure::Failure;
pub use curves::{Curve, draw as draw_curves, parse as parse_log};
pub use picture::Picture;

/// Everything on the page.
#[derive(Clone, Debug)]
pub struct Report {
    /// Name of the capture.
    pub title: String,
    /// A sentence on what was fitted.
    pub summary: String,
    /// The figures.
    pub evaluation: Evaluation,
    /// The recovered textures.
    pub textures: Vec<TextureFigure>,
    /// The floor plan.
    pub rooms: Option<Picture>,
    /// Loss by stage.
    pub curves: Vec<Curve>,
    /// The views.
    pub views: Vec<ViewPanel>,
    /// Names and values: backend, seed, timings.
    pub facts: Vec<(String, String)>,
    /// `settings.toml`.
    pub settings: String,
}

/// A texture on the page.
#[derive(Clone, Debug)]
pub struct TextureFigure {
    /// What it is.
    pub name: &'static str,
    /// Its size, and how it is shown.
    pub note: String,
    /// The texture.
    pub picture: Picture,
}

/// One view: truth, result and difference of image, albedo and roughness.
#[derive(Clone, Debug)]
pub struct ViewPanel {
    /// The view's name.
    pub name: String,
    /// Its split.
    pub split: Split,
    /// What is compared, top to bottom.
    pub rows: Vec<Row>,
}

/// One comparison of a view.
#[derive(Clone, Debug)]
pub struct Row {
    /// What is compared.
    pub label: &'static str,
    /// Its figures, where there is a truth.
    pub score: Option<Score>,
    /// What the truth and the result are called.
    pub columns: [&'static str; 2],
    /// Captured or true.
    pub truth: Option<Picture>,
    /// Rendered or recovered.
    pub result: Picture,
    /// Where they differ.
    pub error: Option<Picture>,
}

impl ViewPanel {
    /// The panel of a view as it is evaluated. Albedo is shown at the scale it is judged at.
    pub fn new(evaluated: &Evaluated<'_>) -> Result<Self, Failure> {
        let Evaluated { view, image, rendered, mask, scores, .. } = evaluated;
        let Scores { albedo: albedo_score, roughness: roughness_score, image: image_score } = *scores;
        let scale = evaluated.albedo_scale.unwrap_or(1.0) as f32;
        let albedo = rendered.surfaces.albedo.map(|p| p.map(|c| c * scale));
        let roughness = &rendered.surfaces.roughness;
        let rows = vec![
            Row {
                label: match view.split {
                    Split::Train => "Re-rendering",
                    Split::Novel => "Novel view",
                },
                score: image_score,
                columns: ["Captured", "Rendered"],
                truth: Some(Picture::linear(image)?),
                result: Picture::linear(&rendered.radiance)?,
                error: Some(Picture::linear_error(&rendered.radiance, image, mask)?),
            },
            Row {
                label: "Albedo",
                score: albedo_score.map(|s| s.per_image),
                columns: ["True", "Recovered"],
                truth: evaluated.albedo.map(Picture::linear).transpose()?,
                result: Picture::linear(&albedo)?,
                error: evaluated.albedo.map(|truth| Picture::linear_error(&albedo, truth, mask)).transpose()?,
            },
            Row {
                label: "Roughness",
                score: roughness_score,
                columns: ["True", "Recovered"],
                truth: evaluated.roughness.map(Picture::values).transpose()?,
                result: Picture::values(roughness)?,
                error: evaluated.roughness.map(|truth| Picture::value_error(roughness, truth, mask)).transpose()?,
            },
        ];
        Ok(Self { name: view.name.clone(), split: view.split, rows })
    }
}

/// The page's pictures of a fit's textures.
pub fn texture_figures(textures: &Textures) -> Result<Vec<TextureFigure>, Failure> {
    let Textures { albedo, roughness, irradiance, .. } = textures;
    let diffuse = irradiance.map(|p| p.map(|c| c * std::f32::consts::FRAC_1_PI));
    let figure = |name, (width, height): (usize, usize), shown: &str, picture| TextureFigure {
        name,
        note: format!("{width} × {height}{shown}"),
        picture,
    };
    Ok(vec![
        figure("Albedo", albedo.size(), "", Picture::linear_texture(albedo)?),
        figure("Roughness", roughness.size(), ", black 0, white 1", Picture::value_texture(roughness)?),
        figure("Irradiance", irradiance.size(), ", shown as E/π", Picture::linear_texture(&diffuse)?),
    ])
}

/// Writes the page; what was there before stays until the new one is whole.
pub fn write(report: &Report, path: &Path) -> Result<(), Failure> {
    let html = page::html(report);
    texir_core::image_io::write_atomic(path, |file| file.write_all(html.as_bytes())).map_err(Failure::from)
}
