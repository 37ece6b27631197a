//! The report: one self-contained HTML page that shows how good a fit is, and where it is not.

pub mod ablation;
mod curves;
mod page;
mod picture;

use std::io::Write;
use std::path::Path;

use texir_core::capture::Split;
use texir_core::eval::{Evaluated, Evaluation, Score, Scores};
use texir_core::raster::Gray;
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
    /// Names and values: version, capture, backend, timings.
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
        let Evaluated { view, image, rendered, surfaces, mask, scores, .. } = evaluated;
        let Scores { albedo: albedo_score, roughness: roughness_score, image: image_score } = *scores;
        let scale = evaluated.albedo_scale.unwrap_or(1.0) as f32;
        let albedo = surfaces.albedo.map(|p| p.map(|c| c * scale));
        let roughness = &surfaces.roughness;
        let rows = vec![
            Row {
                label: match view.split {
                    Split::Train => "Re-rendering",
                    Split::Novel => "Novel view",
                },
                score: image_score,
                columns: ["Captured", "Rendered"],
                truth: Some(Picture::linear(image)?),
                result: Picture::linear(rendered)?,
                error: Some(Picture::linear_error(rendered, image, mask)?),
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
pub fn texture_figures(textures: &Textures, confidence: Option<&Gray>) -> Result<Vec<TextureFigure>, Failure> {
    let Textures { albedo, roughness, metallic, irradiance, .. } = textures;
    let diffuse = irradiance.map(|p| p.map(|c| c * std::f32::consts::FRAC_1_PI));
    let figure = |name, [width, height]: [usize; 2], shown: &str, picture| TextureFigure {
        name,
        note: format!("{width} × {height}{shown}"),
        picture,
    };
    let mut figures = vec![
        figure("Albedo", albedo.size(), "", Picture::linear_texture(albedo)?),
        figure("Roughness", roughness.size(), ", black 0, white 1", Picture::value_texture(roughness)?),
        figure("Irradiance", irradiance.size(), ", shown as E/π", Picture::linear_texture(&diffuse)?),
    ];
    if let Some(metallic) = metallic {
        figures.push(figure("Metallic", metallic.size(), ", white metal", Picture::value_texture(metallic)?));
    }
    if let Some(confidence) = confidence {
        let note = ": black where roughness is a guess";
        figures.push(figure("Confidence", confidence.size(), note, Picture::value_texture(confidence)?));
    }
    Ok(figures)
}

/// Writes the page of a fit.
pub fn write(report: &Report, path: &Path) -> Result<(), Failure> {
    publish(&page::html(report), path)
}

/// Writes the page of an ablation.
pub fn write_ablation(ablation: &ablation::Ablation, path: &Path) -> Result<(), Failure> {
    publish(&ablation::html(ablation), path)
}

/// What was there before stays until the new page is whole.
fn publish(html: &str, path: &Path) -> Result<(), Failure> {
    texir_core::atomic_file::write_atomic(path, |file| file.write_all(html.as_bytes())).map_err(Failure::from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use texir_core::brdf::Masking;
    use texir_core::diffuse::DiffuseModel;
    use texir_core::eval::{AlbedoScore, Table, ViewScores};
    use texir_core::fit::{EpochLog, Stage};
    use texir_core::raster::{Mask, Rgb};

    fn score(psnr: f64) -> Score {
        Score { psnr, ssim: 1.0 - 3.0 / psnr, mse: 10f64.powf(-psnr / 10.0) }
    }

    fn scores(psnr: f64) -> Scores {
        let albedo = AlbedoScore {
            per_image: score(psnr),
            global: score(psnr - 0.8),
            per_image_linear: score(psnr + 1.0),
            global_linear: score(psnr),
        };
        Scores { albedo: Some(albedo), roughness: Some(score(psnr - 6.0)), image: Some(score(psnr + 8.0)) }
    }

    fn table(psnr: f64) -> Table {
        Table { train: scores(psnr), novel: scores(psnr - 2.0), global_albedo_scale: Some(1.02) }
    }

    /// A picture that is not flat: shaded bands.
    fn bands(phase: f32) -> Rgb {
        let (width, height) = (256, 128);
        let mut image = Rgb::filled(width, height, [0.0; 3]);
        for (i, pixel) in image.data.iter_mut().enumerate() {
            let (x, y) = ((i % width) as f32 / width as f32, (i / width) as f32 / height as f32);
            let stripe = 0.5 + 0.5 * (24.0 * x + phase).sin();
            *pixel = [0.2 + 0.6 * stripe * y, 0.3 * stripe + 0.2 * y, 0.15 + 0.4 * (1.0 - y)];
        }
        image
    }

    fn panel(name: &str, split: Split) -> ViewPanel {
        let (image, other) = (bands(0.0), bands(0.25));
        let mut mask = Mask::filled(256, 128, true);
        mask.data[..256 * 6].fill(false);
        let row = |label, columns, truth: bool| Row {
            label,
            score: truth.then(|| score(25.0)),
            columns,
            truth: truth.then(|| Picture::linear(&image).unwrap()),
            result: Picture::linear(&other).unwrap(),
            error: truth.then(|| Picture::linear_error(&image, &other, &mask).unwrap()),
        };
        let rows = vec![
            row("Re-rendering", ["Captured", "Rendered"], true),
            row("Albedo", ["True", "Recovered"], true),
            row("Roughness", ["True", "Recovered"], false),
        ];
        ViewPanel { name: name.to_owned(), split, rows }
    }

    fn report() -> Report {
        let textures = Textures {
            albedo: bands(0.0),
            roughness: Gray::filled(256, 128, 0.5),
            metallic: None,
            irradiance: bands(1.0),
            emission: bands(2.0),
            diffuse: DiffuseModel::Lambert,
            masking: Masking::Smith,
        };
        let log: Vec<EpochLog> = [Stage::I, Stage::II, Stage::III]
            .into_iter()
            .flat_map(|stage| {
                (0..41).map(move |epoch| {
                    let image = 0.05 + 0.5 * (-(epoch as f32) / 8.0).exp();
                    let smooth = if stage == Stage::II { 0.0 } else { 0.3 * image };
                    EpochLog { stage, epoch, learning_rate: 0.03, loss: image + smooth, image, smooth, seconds: 0.0 }
                })
            })
            .collect();
        Report {
            title: "flat <one> & \"two\"".into(),
            summary: "12 training and 6 novel panoramas of 256 × 128, 54 k triangles, one 1024 × 1024 atlas.".into(),
            evaluation: Evaluation {
                samples: 256,
                result: table(21.0),
                true_materials: Some(table(24.5)),
                views: vec![ViewScores {
                    name: "pano_000".into(),
                    split: Split::Train,
                    result: scores(21.0),
                    true_materials: None,
                }],
            },
            textures: texture_figures(&textures, Some(&textures.roughness)).unwrap(),
            rooms: Some(Picture::linear(&bands(0.5)).unwrap()),
            curves: draw_curves(&log).unwrap(),
            views: vec![panel("pano_000", Split::Train), panel("pano_012", Split::Novel)],
            facts: vec![("backend".into(), "llvmpipe".into()), ("stage I".into(), "1 min 12 s".into())],
            settings: "seed = 1\nbackend = \"auto\"\n\n[fit]\nspecular_samples = 16".into(),
        }
    }

    #[test]
    fn the_page_is_whole_and_stands_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("report.html");
        write(&report(), &path).unwrap();
        let html = std::fs::read_to_string(&path).unwrap();

        for part in [
            "flat &lt;one&gt; &amp; &quot;two&quot;",
            "21.00",
            "24.50",
            "True materials",
            "Stage III",
            "pano_000",
            "novel view",
            "no ground truth",
            "specular_samples = 16",
            "llvmpipe",
            "id=\"view-1\"",
        ] {
            assert!(html.contains(part), "\"{part}\" is missing");
        }
        for outside in ["http:", "https:", "src=\"/", "url(", "@import", "<script", "<link"] {
            assert!(!html.contains(outside), "\"{outside}\" reaches out of the file");
        }
        assert_eq!(html.matches("<img ").count(), html.matches("src=\"data:image/").count());
    }

    #[test]
    fn a_capture_without_truth_says_so() {
        let mut report = report();
        report.evaluation.true_materials = None;
        report.rooms = None;
        report.curves.clear();
        let html = page::html(&report);
        assert!(html.contains("No ground-truth textures") && !html.contains("true materials"));
        assert!(!html.contains("Floor plan") && !html.contains("Stage I"));
    }
}
