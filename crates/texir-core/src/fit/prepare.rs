//! What a fit starts from: the light of the scene, scaled to about 1, and the views.

use std::path::Path;

use super::memory;
use super::settings::{FitSettings, Mode};
use crate::atlas::{Atlas, crowded};
use crate::backend::Backend;
use crate::capture::survey::Survey;
use crate::capture::{Tbl, View};
use crate::error::Result;
use crate::progress::Progress;
use crate::radiance_scale::{radiance_scale, scale, scale_views};
use crate::raster::times;
use crate::tbl::{self, TblOptions};

/// What a fit sets out with.
pub(super) struct Prepared {
    pub tbl: Tbl,
    pub atlas: Atlas,
    /// The training views.
    pub training: Vec<View>,
    /// The training views as the fit of materials reads them: reduced where need be.
    pub views: Vec<View>,
    /// What all of its light was multiplied with: see [`radiance_scale`].
    pub scale: f32,
}

/// The atlas, the light and the views of a fit, scaled to about 1: the light is the texture that the capture brings, if
/// it has the size that is asked for, else that of its training views.
pub(super) fn prepare(
    backend: &mut dyn Backend,
    (given, mut training): (Option<&Path>, Vec<View>),
    settings: &FitSettings,
    progress: &dyn Progress,
) -> Result<Prepared> {
    let given = given.map(|path| Tbl::read(path, progress)).transpose()?;
    let size_given = given.as_ref().map(|tbl| tbl.radiance.size());
    let size = memory::atlas_size(settings, size_given, &training, backend.scene().mesh());
    if let Some(tbl) = given.as_ref().filter(|tbl| tbl.radiance.size() != size) {
        progress.warn(&format!(
            "the HDR texture has {} texels, and fit.atlas_size asks for {}: it is ignored, and a new one is built from the views",
            times(tbl.radiance.size()),
            times(size)
        ));
    }
    let given = given.filter(|tbl| tbl.radiance.size() == size);
    let is_given = given.is_some();
    let atlas = Atlas::new(backend, size)?;
    crowded(backend, size)?.iter().for_each(|what| progress.warn(what));
    // Before the first long step: what does not fit in memory is refused.
    let mut views = memory::affordable(&training, (backend.scene().mesh(), &atlas), settings, progress)?;
    let survey = Survey::new(backend, &training, progress)?;
    survey.warnings().iter().for_each(|what| progress.warn(what));
    let factor = radiance_scale(survey.radiance());
    scale_views(training.iter_mut().chain(&mut views), factor);
    let mut tbl = match given {
        Some(mut tbl) => {
            scale(&mut tbl.radiance, factor);
            tbl
        }
        None => tbl::build_in(backend, &atlas, &training, &TblOptions::default(), progress)?,
    };
    if is_given && settings.mode == Mode::Full && settings.full.resolve_sources {
        tbl = tbl::resolve_sources(backend, &atlas, &tbl, &training, progress)?;
    }
    Ok(Prepared { tbl, atlas, training, views, scale: factor })
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use bytesize::ByteSize;

    use super::*;
    use crate::fit::lit_square::{LitSquare, SIDE};
    use crate::raster::Rgb;

    /// Takes down what is begun.
    #[derive(Default)]
    struct Begun(Mutex<Vec<String>>);

    impl Progress for Begun {
        fn start(&self, task: &str, _: u64, _: &str) {
            self.0.lock().unwrap().push(task.to_owned());
        }
        fn advance(&self, _: u64) {}
        fn finish(&self) {}
        fn warn(&self, _: &str) {}
        fn cancelled(&self) -> bool {
            false
        }
    }

    #[test]
    fn too_little_memory_is_refused_before_anything_is_begun() {
        let square = LitSquare::new();
        let views = square.views(&Rgb::filled(SIDE, SIDE, [1.0; 3]), [16, 8]);
        let begun = |max_memory| {
            let settings = FitSettings { atlas_size: SIDE, max_memory, ..FitSettings::default() };
            let progress = Begun::default();
            let lit = prepare(&mut square.backend(), (None, views.clone()), &settings, &progress);
            (lit.map(|lit| lit.views.len()).map_err(|e| e.to_string()), progress.0.into_inner().unwrap())
        };
        let (refused, tasks) = begun(ByteSize(1));
        assert!(refused.unwrap_err().contains("max_memory is 1 B") && tasks.is_empty(), "{tasks:?}");
        // Negative control.
        let (lit, tasks) = begun(ByteSize::gib(1));
        assert!(lit == Ok(5) && tasks.contains(&"texture-based lighting".to_owned()), "{tasks:?}");
    }
}
