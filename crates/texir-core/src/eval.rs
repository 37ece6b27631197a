//! The evaluation protocol (method section 6): how far recovered materials and re-rendered views are from the truth.
//!
//! Images and albedo are compared after [`metrics::encode`], roughness as it is; the mask leaves light sources out.
//! Radiance is encoded as it is, unless that would be white or black for the most part (a capture in nits). PSNR comes
//! from the mean MSE over views; SSIM is the mean over views of the full image with masked-out pixels set to 0 on both
//! sides. Images are box-filtered over the pixel; true albedo and roughness are those at its centre, as renderers write
//! them, and so are the recovered ones that they are compared with. Where the capture has true textures, they go
//! through the same lookup, light and renderer.

use serde::{Deserialize, Serialize};

use crate::capture::{Capture, Split, Truth, View};
use crate::error::{Error, Result};
use crate::image_io::{read_gray, read_rgb};
use crate::metrics::{self, Pixel, encode, psnr};
use crate::progress::{Progress, Task};
use crate::radiance_scale::scale;
use crate::raster::{Gray, Mask, Raster, Rgb};
use crate::render::{GBuffer, Mipmapped, Renderer, Textures};

/// MSE below which PSNR stops growing (120 dB): below what `f32` images resolve, and finite in JSON.
const MSE_FLOOR: f64 = 1e-12;

/// Figures of one comparison, over one view or over a split.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Peak signal-to-noise ratio, dB; from `mse`.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
    /// Mean squared error over the masked pixels; over views, the mean of theirs.
    pub mse: f64,
}

impl Score {
    fn new(mse: f64, ssim: f64) -> Self {
        Self { psnr: psnr(mse.max(MSE_FLOOR)), ssim, mse }
    }

    /// The figure of a split from those of its views.
    fn over_views(scores: impl IntoIterator<Item = Score>) -> Option<Self> {
        let scores: Vec<Score> = scores.into_iter().collect();
        let mean = |f: fn(&Score) -> f64| scores.iter().map(f).sum::<f64>() / scores.len() as f64;
        (!scores.is_empty()).then(|| Self::new(mean(|s| s.mse), mean(|s| s.ssim)))
    }
}

/// Albedo is known up to a scale: compared after one least-squares scale per image, and after a single one for all
/// views, which shows what the former hides, inconsistency between views.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AlbedoScore {
    /// One scale per image, encoded values: the protocol's figure.
    pub per_image: Score,
    /// One scale for all views, encoded values.
    pub global: Score,
    /// One scale per image, linear values.
    pub per_image_linear: Score,
    /// One scale for all views, linear values.
    pub global_linear: Score,
}

impl AlbedoScore {
    fn over_views(scores: &[AlbedoScore]) -> Option<Self> {
        let over = |f: fn(&AlbedoScore) -> Score| Score::over_views(scores.iter().map(f));
        Some(Self {
            per_image: over(|s| s.per_image)?,
            global: over(|s| s.global)?,
            per_image_linear: over(|s| s.per_image_linear)?,
            global_linear: over(|s| s.global_linear)?,
        })
    }
}

/// Figures of one view, or of a split.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// Against the true albedo, where the capture has it.
    pub albedo: Option<AlbedoScore>,
    /// Against the true perceptual roughness, where the capture has it.
    pub roughness: Option<Score>,
    /// Rendered view against the captured image: re-rendering of a training view, or a novel view.
    pub image: Option<Score>,
}

impl Scores {
    fn over_views(views: &[Scores]) -> Self {
        let albedo: Vec<AlbedoScore> = views.iter().filter_map(|v| v.albedo).collect();
        Self {
            albedo: AlbedoScore::over_views(&albedo),
            roughness: Score::over_views(views.iter().filter_map(|v| v.roughness)),
            image: Score::over_views(views.iter().filter_map(|v| v.image)),
        }
    }
}

/// Figures of a set of textures over a capture.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// Training views: the rows of albedo, roughness and re-rendering.
    pub train: Scores,
    /// Held-out views.
    pub novel: Scores,
    /// The single scale of albedo over all views.
    pub global_albedo_scale: Option<f64>,
}

/// Figures of one view.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewScores {
    /// The view's name.
    pub name: String,
    /// Its split.
    pub split: Split,
    /// The result.
    pub result: Scores,
    /// True materials under the same light, where the capture has them.
    pub true_materials: Option<Scores>,
}

/// What `metrics.json` holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// Rays per pixel.
    pub samples: u32,
    /// The result.
    pub result: Table,
    /// True materials under the same light, where the capture has them: what the protocol can reach.
    pub true_materials: Option<Table>,
    /// View by view.
    pub views: Vec<ViewScores>,
}

/// One evaluated view, handed to whoever wants to show it.
#[derive(Debug)]
pub struct Evaluated<'a> {
    /// The view.
    pub view: &'a View,
    /// The captured image, linear radiance; where that is far from 1 (a mean below 0.01 or above 16), brought there.
    pub image: &'a Rgb,
    /// The view rendered from the result, likewise.
    pub rendered: &'a Rgb,
    /// What the view shows of the result's textures.
    pub surfaces: &'a GBuffer,
    /// True linear albedo.
    pub albedo: Option<&'a Rgb>,
    /// True perceptual roughness.
    pub roughness: Option<&'a Gray>,
    /// Least-squares scale from the result's albedo to the true one, in this view.
    pub albedo_scale: Option<f64>,
    /// The pixels that count.
    pub mask: &'a Mask,
    /// The result's figures.
    pub scores: Scores,
}

/// Errors where a view is too small to be compared: to be asked before any work that an evaluation ends.
pub fn check_sizes(capture: &Capture) -> Result<()> {
    let small = |view: &&View| view.camera.width.min(view.camera.height) < metrics::WINDOW;
    let count = capture.views.iter().filter(small).count();
    let Some(View { name, camera, .. }) = capture.views.iter().find(small) else { return Ok(()) };
    Err(Error::file(
        capture.root.join("transforms.json"),
        format!(
            "w, h: {count} of {} views are too small to be evaluated, the first is {name:?} with {}×{} pixels; expected at least \
             {WINDOW}×{WINDOW}, the window of SSIM: take larger images, or fit without an evaluation (--no-eval)",
            capture.views.len(),
            camera.width,
            camera.height,
            WINDOW = metrics::WINDOW
        ),
    ))
}

/// Evaluates `textures` on every view of `capture`, and its true textures where it has them. `show` sees each view
/// once.
pub fn evaluate(
    renderer: &mut Renderer<'_>,
    capture: &Capture,
    textures: &Textures,
    progress: &dyn Progress,
    show: &mut dyn FnMut(&Evaluated<'_>),
) -> Result<Evaluation> {
    check_sizes(capture)?;
    let true_textures = |truth: &Truth| -> Result<Textures> {
        let (albedo, roughness) = (read_rgb(&truth.albedo)?, read_gray(&truth.roughness)?);
        Ok(Textures { albedo, roughness, metallic: None, ..textures.clone() })
    };
    // Textures of one atlas, looked up by the coordinates of another, would be no true materials.
    let difference = capture.truth.as_ref().and_then(|_| renderer.mesh().atlas_difference(&capture.mesh));
    if let Some(difference) = &difference {
        progress.warn(&format!(
            "the capture's true textures are left out: they belong to {}, and the mesh that is evaluated has another atlas: {difference}",
            capture.mesh_path.display()
        ));
    }
    let truth = capture.truth.as_ref().filter(|_| difference.is_none()).map(true_textures).transpose()?;
    let rays: u64 = capture.views.iter().map(|v| renderer.rays(&v.camera)).sum();
    let task = Task::start(progress, "evaluating", rays, "rays");
    let factor = shown_in(renderer.radiance_scale());
    let mut result = Subject::new(renderer, capture, textures, progress)?;
    let mut true_materials =
        truth.as_ref().map(|truth| Subject::new(renderer, capture, truth, progress)).transpose()?;
    for view in &capture.views {
        let observed = Observed::load(view, factor, progress)?;
        let mut rendered = match &mut true_materials {
            Some(true_materials) => {
                let each = [&result.textures, &true_materials.textures];
                let [rendered, mut best] = renderer.render_each(&view.camera, each, progress)?;
                scale(&mut best, factor);
                true_materials.evaluate(renderer, view, &observed, best)?;
                rendered
            }
            None => renderer.render(&view.camera, &result.textures, progress)?,
        };
        scale(&mut rendered, factor);
        let shown = result.evaluate(renderer, view, &observed, rendered)?;
        show(&Evaluated {
            view,
            image: &observed.image,
            rendered: &shown.rendered,
            surfaces: &shown.surfaces,
            albedo: observed.albedo.as_ref(),
            roughness: observed.roughness.as_ref(),
            albedo_scale: shown.albedo_scale,
            mask: &shown.mask,
            scores: result.views.last().copied().unwrap_or_default(),
        });
    }
    drop(task);
    Ok(Evaluation {
        samples: renderer.rays_per_pixel(),
        result: result.table(capture),
        true_materials: true_materials.as_ref().map(|c| c.table(capture)),
        views: capture
            .views
            .iter()
            .enumerate()
            .map(|(i, view)| ViewScores {
                name: view.name.clone(),
                split: view.split,
                result: result.views[i],
                true_materials: true_materials.as_ref().map(|c| c.views[i]),
            })
            .collect(),
    })
}

/// What radiance is multiplied with before it is encoded for display, where `factor` would bring it to about 1: 1,
/// unless most of an image would be white, or black.
fn shown_in(factor: f32) -> f32 {
    if (0.5..=16.0).contains(&factor) { 1.0 } else { factor }
}

/// What the capture says about a view.
struct Observed {
    image: Rgb,
    albedo: Option<Rgb>,
    roughness: Option<Gray>,
    mask: Option<Mask>,
}

impl Observed {
    /// With the image times `factor`.
    fn load(view: &View, factor: f32, progress: &dyn Progress) -> Result<Self> {
        let mut image = view.load_image(progress)?;
        scale(&mut image, factor);
        Ok(Self { image, albedo: view.load_albedo()?, roughness: view.load_roughness()?, mask: view.load_mask()? })
    }
}

/// Textures under evaluation, and their figures so far, in the order of the views.
struct Subject<'a> {
    textures: Mipmapped<'a>,
    global_scale: Option<f64>,
    views: Vec<Scores>,
}

impl<'a> Subject<'a> {
    /// Finds the global albedo scale: a pass over all views without shading.
    fn new(
        renderer: &mut Renderer<'_>,
        capture: &Capture,
        textures: &'a Textures,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let textures = renderer.mipmapped(textures)?;
        let mut sums = AlbedoSums::default();
        for view in &capture.views {
            progress.check()?;
            if let Some(truth) = view.load_albedo()? {
                let surfaces = renderer.surfaces(&view.camera, &textures)?;
                let mask = view.load_mask()?.unwrap_or_else(|| surfaces.reflective());
                sums.add(AlbedoSums::of(&surfaces.albedo, &truth, &mask));
            }
        }
        Ok(Self { textures, global_scale: sums.scale(), views: Vec::with_capacity(capture.views.len()) })
    }

    /// Keeps a rendered view's figures.
    fn evaluate(
        &mut self,
        renderer: &mut Renderer<'_>,
        view: &View,
        observed: &Observed,
        rendered: Rgb,
    ) -> Result<SubjectView> {
        let surfaces = renderer.surfaces(&view.camera, &self.textures)?;
        let mask = observed.mask.clone().unwrap_or_else(|| surfaces.reflective());
        let albedo_scale =
            observed.albedo.as_ref().and_then(|truth| AlbedoSums::of(&surfaces.albedo, truth, &mask).scale());
        let albedo = match (&observed.albedo, albedo_scale) {
            (Some(truth), Some(scale)) => self.albedo(&surfaces.albedo, truth, scale, &mask)?,
            _ => None,
        };
        let roughness = match &observed.roughness {
            Some(truth) => compare(&surfaces.roughness, truth, &mask)?,
            None => None,
        };
        let known = mask.and(&observed.image.finite())?;
        let image = compare(&encoded(&rendered), &encoded(&observed.image), &known)?;
        self.views.push(Scores { albedo, roughness, image });
        Ok(SubjectView { rendered, surfaces, mask, albedo_scale })
    }

    fn albedo(&self, albedo: &Rgb, truth: &Rgb, own_scale: f64, mask: &Mask) -> Result<Option<AlbedoScore>> {
        let own = scaled(albedo, own_scale);
        let common = scaled(albedo, self.global_scale.unwrap_or(own_scale));
        let (Some(per_image), Some(global), Some(per_image_linear), Some(global_linear)) = (
            compare(&encoded(&own), &encoded(truth), mask)?,
            compare(&encoded(&common), &encoded(truth), mask)?,
            compare(&own, truth, mask)?,
            compare(&common, truth, mask)?,
        ) else {
            return Ok(None);
        };
        Ok(Some(AlbedoScore { per_image, global, per_image_linear, global_linear }))
    }

    fn table(&self, capture: &Capture) -> Table {
        let split = |split: Split| {
            let of: Vec<Scores> =
                capture.views.iter().zip(&self.views).filter(|(v, _)| v.split == split).map(|(_, s)| *s).collect();
            Scores::over_views(&of)
        };
        Table { train: split(Split::Train), novel: split(Split::Novel), global_albedo_scale: self.global_scale }
    }
}

/// A view as a subject shows it.
struct SubjectView {
    rendered: Rgb,
    surfaces: GBuffer,
    mask: Mask,
    albedo_scale: Option<f64>,
}

/// Sums of the least-squares scale s = Σ a·t / Σ a·a from albedo a to truth t.
#[derive(Clone, Copy, Debug, Default)]
struct AlbedoSums {
    cross: f64,
    square: f64,
}

impl AlbedoSums {
    fn of(albedo: &Rgb, truth: &Rgb, mask: &Mask) -> Self {
        let mut sums = Self::default();
        for ((a, t), _) in albedo.data.iter().zip(&truth.data).zip(&mask.data).filter(|(_, used)| **used) {
            for (a, t) in a.iter().zip(t) {
                sums.cross += f64::from(*a) * f64::from(*t);
                sums.square += f64::from(*a).powi(2);
            }
        }
        sums
    }

    fn add(&mut self, other: Self) {
        self.cross += other.cross;
        self.square += other.square;
    }

    /// The scale; `None` for a black albedo or without pixels.
    fn scale(self) -> Option<f64> {
        (self.square > 0.0).then(|| self.cross / self.square)
    }
}

/// `None` where the mask is empty.
fn compare<P: Pixel>(image: &Raster<P>, truth: &Raster<P>, mask: &Mask) -> Result<Option<Score>> {
    let Some(mse) = metrics::mse(image, truth, mask)? else { return Ok(None) };
    let ssim = metrics::ssim(&metrics::blank(image, mask)?, &metrics::blank(truth, mask)?)?;
    Ok(Some(Score::new(mse, ssim)))
}

fn encoded(image: &Rgb) -> Rgb {
    image.map(|p| p.map(encode))
}

fn scaled(image: &Rgb, scale: f64) -> Rgb {
    image.map(|p| p.map(|c| (f64::from(c) * scale) as f32))
}

#[cfg(test)]
mod tests;
