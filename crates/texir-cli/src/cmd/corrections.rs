//! What is corrected in the views of a capture before they are used.

use clap::Args;
use texir_core::capture::{Capture, Corrections, Split, View};
use texir_core::progress::Progress;
use texir_core::scene::Scene;
use texir_core::tbl::{blur, exposure, pose};

use crate::device;
use crate::failure::Failure;
use crate::session::Session;

/// Corrections of the training views.
#[derive(Debug, Args)]
pub struct CorrectionArgs {
    /// First correct the poses of training views that are misaligned with the other views
    #[arg(long)]
    refine_poses: bool,
    /// First match the training views' exposure and white balance, if they differ by 1 % or more
    #[arg(long)]
    solve_exposure: bool,
    /// First sharpen the training images by the blur measured on surfaces seen from near and far
    #[arg(long)]
    sharpen: bool,
}

impl CorrectionArgs {
    /// Corrects the views, exposure first: poses are found by comparing radiance, and blur by comparing what is in
    /// place. An HDR texture of the capture is dropped where views change, because it was made of them as they were.
    /// Returns what was corrected; `None` when nothing is asked for.
    pub fn apply(&self, capture: &mut Capture, session: &Session<'_>) -> Result<Option<Corrections>, Failure> {
        if !self.solve_exposure && !self.refine_poses && !self.sharpen {
            return Ok(None);
        }
        let mut backend = device::open(Scene::new(capture.mesh.clone())?, session)?;
        let mut training: Vec<&mut View> = capture.views.iter_mut().filter(|v| v.split == Split::Train).collect();
        let views = |training: &[&mut View]| -> Vec<View> { training.iter().map(|v| (**v).clone()).collect() };
        if self.solve_exposure {
            let scales = exposure::solve(backend.as_mut(), &views(&training), session.console)?;
            let differ = exposure::difference(scales.iter().map(|scale| scale.map(f32::ln)));
            let how = format!("exposures differ by {:.1} %, root mean square", 100.0 * differ.exp_m1());
            if differ < exposure::MIN_DIFFERENCE {
                session
                    .console
                    .note(&format!("{how}: within what reflections alone cause, so the views stay as they are"));
            } else {
                session.console.note(&how);
                for (view, scale) in training.iter_mut().zip(scales) {
                    view.scale = scale;
                    let [r, g, b] = scale;
                    session.console.note(&format!("{:>24}  radiance × {r:.3} {g:.3} {b:.3}", view.name));
                }
            }
        }
        let mut moved = 0;
        if self.refine_poses {
            let poses = pose::refine(backend.as_mut(), &views(&training), session.console)?;
            for (view, pose) in training.iter_mut().zip(poses) {
                if view.camera.world_from_camera == pose {
                    continue;
                }
                moved += 1;
                let (_, turn, shift) = (view.camera.world_from_camera.inverse() * pose).to_scale_rotation_translation();
                let degrees = 2.0 * turn.w.abs().min(1.0).acos().to_degrees();
                let millimetres = 1e3 * shift.length();
                session.console.note(&format!("{:>24}  moved by {millimetres:.1} mm, {degrees:.2}°", view.name));
                view.camera.world_from_camera = pose;
            }
            let stay = training.len() - moved;
            if stay > 0 {
                let all = training.len();
                session.console.note(&format!("{stay} of {all} views show no measurable error and stay in place"));
            }
        }
        if self.sharpen {
            let measured = blur::measure(backend.as_mut(), &views(&training), session.console)?;
            let blur = self.blur(measured, session);
            training.iter_mut().for_each(|view| view.blur = blur);
        }
        let is_changed = moved > 0 || training.iter().any(|view| view.scale != [1.0; 3] || view.blur > 0.0);
        if let Some(texture) = capture.tbl.take_if(|_| is_changed) {
            session.console.warn(&format!(
                "{}: not used, as it shows the views before they were corrected; a new HDR texture is built from them",
                texture.display()
            ));
        }
        Ok(Some(Corrections::of(capture)))
    }

    /// How much of the blur that was measured is undone, square pixels.
    fn blur(&self, measured: Option<f32>, session: &Session<'_>) -> f32 {
        let Some(measured) = measured else {
            session
                .console
                .warn("--sharpen: too few textured surfaces are seen from both near and far to measure blur; the views stay as they are");
            return 0.0;
        };
        let width = format!("blur variance of {measured:.2} square pixels beyond a pixel's own");
        if measured < blur::SHARP {
            session.console.note(&format!("{width}: the images are sharp, and stay as they are"));
            return 0.0;
        }
        session.console.note(&format!("{width}, which is undone"));
        if measured > blur::WIDEST {
            session.console.warn(&format!("{width} is more than can be undone: reduce the images by averaging"));
        }
        measured.min(blur::WIDEST)
    }
}
