//! The paper's three stages (method section 3). Each is the same loop, one view per step: look the parameters up,
//! render, compare, and carry the gradient back to the texels, where Adam updates them.

use std::borrow::Cow;

use super::views::FitView;
use crate::backend::{Backend, Gather, GroupTarget, Groups, Loss, Material, MaterialGrad, Sampling, ShadePoint};
use crate::checkpoint::{Array, Checkpoints, Step};
use crate::error::{Error, Result};
use crate::fit::adam::Adam;
use crate::fit::settings::{OptimiserSettings, PaperSettings};
use crate::progress::{Progress, Task, Uncounted};
use crate::rng::hash2;
use crate::surface::SurfacePoint;
use crate::texture::Pyramid;

/// The parameters: textures in the atlas.
#[derive(Clone, Debug, PartialEq)]
pub struct Textures {
    /// Linear RGB per texel, interleaved.
    pub albedo: Vec<f32>,
    /// Perceptual roughness per texel.
    pub roughness: Vec<f32>,
}

/// Which stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub enum Stage {
    /// Albedo under diffuse lighting.
    I,
    /// Roughness at virtual highlights, propagated.
    II,
    /// Both.
    III,
}

/// Mean losses of one epoch.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct EpochLog {
    /// The stage.
    pub stage: Stage,
    /// Epoch within the stage, from 0.
    pub epoch: u32,
    /// Step size.
    pub learning_rate: f32,
    /// Sum of the two terms.
    pub loss: f32,
    /// Image term.
    pub image: f32,
    /// Smoothness or propagation term, weighted.
    pub smooth: f32,
    /// Seconds since the stages began, in the run that came to it.
    pub seconds: f64,
}

/// What one step found: its losses and the gradients with respect to the texels it moves.
#[derive(Default)]
struct Found {
    image: f32,
    smooth: f32,
    d_albedo: Option<Vec<f32>>,
    d_roughness: Option<Vec<f32>>,
}

/// The loop around the stages.
pub struct Optimisation<'a> {
    /// Runs the passes; holds the full TBL.
    pub backend: &'a mut dyn Backend,
    /// Mips of the atlas.
    pub pyramid: &'a Pyramid,
    /// The training views.
    pub views: &'a [FitView],
    /// Weights and schedule.
    pub settings: &'a PaperSettings,
    /// Seed of the run.
    pub seed: u32,
    /// Progress and cancellation.
    pub progress: &'a dyn Progress,
    /// Receives one entry per epoch.
    pub log: &'a mut dyn FnMut(&EpochLog),
    /// When the stages began.
    pub started: std::time::Instant,
    /// Epochs that were done before.
    pub checkpoints: &'a Checkpoints,
}

impl<'a> Optimisation<'a> {
    /// Runs the enabled stages in order.
    pub fn run(&mut self, textures: &mut Textures) -> Result<()> {
        if self.settings.stage_one.enabled {
            self.epochs(Stage::I, textures, Self::stage_one)?;
        }
        if self.settings.stage_two.enabled {
            let albedo = self.albedo_at_highlights(textures)?;
            self.epochs(Stage::II, textures, |this, view, textures, seed| {
                this.stage_two(view, &albedo[view], textures, seed)
            })?;
        }
        if self.settings.stage_three.enabled {
            self.epochs(Stage::III, textures, Self::stage_three)?;
        }
        Ok(())
    }

    /// Stage I, albedo: mean|T(aE/π) − T(I)| + β_ssa mean|a − mean_class(a)|.
    fn stage_one(&mut self, view: usize, textures: &Textures, seed: u32) -> Result<Found> {
        let view = self.view(view);
        let points = self.lit(&view.points, seed)?;
        let albedo = self.lookup(&textures.albedo, 3, view)?;
        let diffuse = |p: &ShadePoint| p.irradiance.map(|e| e * std::f32::consts::FRAC_1_PI);
        let rendered: Vec<[f32; 3]> =
            points.iter().zip(albedo.as_chunks::<3>().0).map(|(p, a)| product(diffuse(p), *a)).collect();
        let image = self.backend.radiance_loss(&rendered, &view.target)?;
        let mut d_albedo: Vec<f32> =
            points.iter().zip(&image.gradient).flat_map(|(p, d)| product(diffuse(p), *d)).collect();
        let smooth = self.smoothness(
            &albedo,
            (&view.by_class, GroupTarget::Mean),
            self.settings.stage_one.semantic_weight,
            &mut d_albedo,
        )?;
        let d_albedo = Some(self.lookup_vjp(&d_albedo, 3, view)?);
        Ok(Found { image: image.value, smooth, d_albedo, d_roughness: None })
    }

    /// Stage II, roughness with the albedo frozen: mean over highlight pixels of |T(L_o) − T(I)|
    /// + β_sp mean|r − Q_q(r at highlights of the class)| over the rest.
    fn stage_two(&mut self, view: usize, albedo: &[[f32; 3]], textures: &Textures, seed: u32) -> Result<Found> {
        let view = self.view(view);
        let roughness = self.lookup(&textures.roughness, 1, view)?;
        let mut d_roughness = vec![0.0; roughness.len()];
        let mut image = 0.0;
        if !view.highlights.is_empty() {
            let at = |h: &u32| *h as usize;
            let points: Vec<ShadePoint> = view.highlights.iter().map(|h| view.points[at(h)]).collect();
            let target: Vec<[f32; 3]> = view.highlights.iter().map(|h| view.target[at(h)]).collect();
            let materials: Vec<Material> =
                view.highlights.iter().zip(albedo).map(|(h, a)| Material::dielectric(*a, roughness[at(h)])).collect();
            let loss = self.shaded_loss(&points, &materials, &target, seed)?;
            image = loss.value;
            for (h, d) in view.highlights.iter().zip(loss.gradient) {
                d_roughness[at(h)] = d.roughness;
            }
        }
        let smooth = self.smoothness(
            &roughness,
            (&view.by_class_highlights, GroupTarget::Quantile(self.settings.stage_two.quantile)),
            self.settings.stage_two.propagation_weight,
            &mut d_roughness,
        )?;
        let d_roughness = Some(self.lookup_vjp(&d_roughness, 1, view)?);
        Ok(Found { image, smooth, d_albedo: None, d_roughness })
    }

    /// Stage III, albedo and roughness: mean|T(L_o) − T(I)| + β_ssr mean|r − mean_(class ∧ room)(r)|.
    fn stage_three(&mut self, view: usize, textures: &Textures, seed: u32) -> Result<Found> {
        let view = self.view(view);
        let albedo = self.lookup(&textures.albedo, 3, view)?;
        let roughness = self.lookup(&textures.roughness, 1, view)?;
        let materials: Vec<Material> =
            albedo.as_chunks::<3>().0.iter().zip(&roughness).map(|(a, r)| Material::dielectric(*a, *r)).collect();
        let loss = self.shaded_loss(&view.points, &materials, &view.target, seed)?;
        let d_albedo: Vec<f32> = loss.gradient.iter().flat_map(|d| d.albedo).collect();
        let mut d_roughness: Vec<f32> = loss.gradient.iter().map(|d| d.roughness).collect();
        let smooth = self.smoothness(
            &roughness,
            (&view.by_class_and_room, GroupTarget::Mean),
            self.settings.stage_three.smoothness_weight,
            &mut d_roughness,
        )?;
        Ok(Found {
            image: loss.value,
            smooth,
            d_albedo: Some(self.lookup_vjp(&d_albedo, 3, view)?),
            d_roughness: Some(self.lookup_vjp(&d_roughness, 1, view)?),
        })
    }

    /// The image loss of shaded pixels and its gradient with respect to their albedo and roughness.
    fn shaded_loss(
        &mut self,
        points: &[ShadePoint],
        materials: &[Material],
        target: &[[f32; 3]],
        seed: u32,
    ) -> Result<Loss<MaterialGrad>> {
        let sampling = Sampling { samples: self.settings.specular_samples, seed };
        let points = &*self.lit(points, seed)?;
        let shaded =
            self.backend.shade(points, materials, sampling, self.settings.gradient, &Uncounted(self.progress))?;
        let radiance: Vec<[f32; 3]> = shaded.iter().map(|s| s.radiance).collect();
        let loss = self.backend.radiance_loss(&radiance, target)?;
        let gradient = self.backend.shade_vjp(points, materials, &shaded, &loss.gradient)?;
        Ok(Loss { value: loss.value, gradient })
    }

    /// The points with the irradiance that a step sees: the precomputed one, or one gathered now.
    fn lit<'p>(&mut self, points: &'p [ShadePoint], seed: u32) -> Result<Cow<'p, [ShadePoint]>> {
        if self.settings.precomputed_irradiance {
            return Ok(points.into());
        }
        let gather = Gather::new(self.settings.specular_samples, 0, seed);
        let origins: Vec<SurfacePoint> = points.iter().map(ShadePoint::origin).collect();
        let gathered = self.backend.irradiance(&origins, gather, &Uncounted(self.progress))?;
        Ok(points.iter().zip(gathered).map(|(p, g)| ShadePoint { irradiance: g.irradiance, ..*p }).collect())
    }

    /// `weight` times a group loss; its gradient is added to `d_values`.
    fn smoothness(
        &mut self,
        values: &[f32],
        (groups, target): (&Groups, GroupTarget),
        weight: f32,
        d_values: &mut [f32],
    ) -> Result<f32> {
        let channels = values.len() / groups.members.len().max(1);
        let Loss { value, gradient } = self.backend.group_loss(values, channels, groups, target)?;
        d_values.iter_mut().zip(gradient).for_each(|(d, g)| *d += weight * g);
        Ok(weight * value)
    }

    /// Looks the frozen albedo up where stage II shades.
    fn albedo_at_highlights(&mut self, textures: &Textures) -> Result<Vec<Vec<[f32; 3]>>> {
        (0..self.views.len())
            .map(|i| {
                let view = self.view(i);
                let albedo = self.lookup(&textures.albedo, 3, view)?;
                Ok(view.highlights.iter().map(|&h| albedo.as_chunks::<3>().0[h as usize]).collect())
            })
            .collect()
    }

    /// Epochs over the views in a new order each, one Adam step per view; the optimiser starts afresh, or where an
    /// earlier run was stopped.
    fn epochs(
        &mut self,
        stage: Stage,
        textures: &mut Textures,
        mut step: impl FnMut(&mut Self, usize, &Textures, u32) -> Result<Found>,
    ) -> Result<()> {
        let optimiser = &self.settings.optimiser;
        let ranges = &self.settings.parameters;
        let name = format!("stage-{stage:?}");
        let Epochs { mut albedo, mut roughness, mut done } =
            self.checkpoints.find(&name).and_then(|kept| Epochs::resume(&kept, textures, optimiser)).unwrap_or_else(
                || {
                    let [albedo, roughness] =
                        [&textures.albedo, &textures.roughness].map(|t| Adam::new(optimiser, t.len()));
                    Epochs { albedo, roughness, done: Vec::new() }
                },
            );
        let views = self.views.len() as u32;
        let _task = Task::start(
            self.progress,
            &format!("stage {stage:?}"),
            u64::from(optimiser.epochs) * u64::from(views),
            "steps",
        );
        self.progress.advance(done.len() as u64 * u64::from(views));
        done.iter().for_each(|epoch| (self.log)(epoch));
        for epoch in done.len() as u32..optimiser.epochs {
            let learning_rate = optimiser.learning_rate * optimiser.decay.powi((epoch / optimiser.decay_epochs) as i32);
            let epoch_seed = hash2(hash2(self.seed, stage as u32), epoch);
            let mut order: Vec<u32> = (0..views).collect();
            order.sort_by_key(|&v| hash2(epoch_seed, v));
            let (mut image, mut smooth) = (0.0, 0.0);
            for view in order {
                self.progress.check()?;
                let found = step(self, view as usize, textures, hash2(epoch_seed, !view))?;
                if let Some(d) = &found.d_albedo {
                    albedo.step(&mut textures.albedo, d, learning_rate, ranges.albedo_range);
                }
                if let Some(d) = &found.d_roughness {
                    roughness.step(&mut textures.roughness, d, learning_rate, ranges.roughness_range);
                }
                image += found.image / views as f32;
                smooth += found.smooth / views as f32;
                self.progress.advance(1);
            }
            let seconds = self.started.elapsed().as_secs_f64();
            let log = EpochLog { stage, epoch, learning_rate, loss: image + smooth, image, smooth, seconds };
            (self.log)(&log);
            done.push(log);
            let state = Epochs { albedo, roughness, done };
            state.keep(self.checkpoints, &name, textures)?;
            Epochs { albedo, roughness, done } = state;
        }
        Ok(())
    }

    fn view(&self, index: usize) -> &'a FitView {
        &self.views[index]
    }

    fn lookup(&mut self, texture: &[f32], channels: usize, view: &FitView) -> Result<Vec<f32>> {
        self.backend.lookup(self.pyramid, texture, channels, &view.footprints.rows)
    }

    fn lookup_vjp(&mut self, d_values: &[f32], channels: usize, view: &FitView) -> Result<Vec<f32>> {
        self.backend.lookup_vjp(self.pyramid, d_values, channels, &view.footprints)
    }
}

/// How far a stage has come, apart from the textures.
struct Epochs {
    albedo: Adam,
    roughness: Adam,
    done: Vec<EpochLog>,
}

impl Epochs {
    fn keep(&self, checkpoints: &Checkpoints, step: &str, textures: &Textures) -> Result<()> {
        let (albedo_moments, albedo_steps) = self.albedo.state();
        let (roughness_moments, roughness_steps) = self.roughness.state();
        let log =
            serde_json::to_vec(&self.done).map_err(|e| Error::invalid(format!("the log has no JSON form: {e}")))?;
        let steps = [albedo_steps, roughness_steps];
        let arrays = [
            ("albedo", Array::from(&textures.albedo[..])),
            ("albedo_moments", albedo_moments.into()),
            ("roughness", Array::from(&textures.roughness[..])),
            ("roughness_moments", roughness_moments.into()),
            ("steps", Array::from(&steps[..])),
            ("log", Array::from(&log[..])),
        ];
        checkpoints.keep(step, &arrays)
    }

    /// What was kept; the textures become what they were. `None` if it does not fit them.
    fn resume(kept: &Step, textures: &mut Textures, optimiser: &OptimiserSettings) -> Option<Self> {
        let done: Vec<EpochLog> = serde_json::from_slice(&kept.array::<u8>("log")?).ok()?;
        let &[albedo_steps, roughness_steps] = &kept.array::<u32>("steps")?[..] else { return None };
        let (albedo, roughness) = (kept.array::<f32>("albedo")?, kept.array::<f32>("roughness")?);
        let (albedo_moments, roughness_moments) = (kept.array("albedo_moments")?, kept.array("roughness_moments")?);
        let fits = [albedo.len(), albedo_moments.len()] == [textures.albedo.len(); 2]
            && [roughness.len(), roughness_moments.len()] == [textures.roughness.len(); 2];
        if !fits {
            return None;
        }
        *textures = Textures { albedo, roughness };
        Some(Self {
            albedo: Adam::resume(optimiser, albedo_moments, albedo_steps),
            roughness: Adam::resume(optimiser, roughness_moments, roughness_steps),
            done,
        })
    }
}

fn product(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|c| a[c] * b[c])
}
