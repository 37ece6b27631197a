//! `texir demo`: a synthetic flat, made and path-traced here, then fitted as any capture would be.

use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::RangedU64ValueParser;
use tempfile::TempDir;
use texir_core::capture::{self, LoadOptions};
use texir_core::demo::{self, Flat, FlatOptions, PaintStyle, PanoramaOptions, RenderOptions};
use texir_core::outputs::{REPORT, SCENE, Staging};

use super::fit;
use crate::args::number;
use crate::failure::Failure;
use crate::figures;
use crate::session::Session;

/// Folder of the capture within the demo's.
const CAPTURE: &str = "capture";

/// What the capture was made from; in its folder, beside what [`demo::write`] leaves there.
const RECIPE: &str = "demo.txt";

/// Folder of the fit within the demo's.
const FIT: &str = "fit";

/// Side of the atlas: at the distances of a room, a texel of it is about as large as a pixel of the panoramas.
const ATLAS: usize = 512;

/// Panoramas the fit sees: with these the whole demo takes a few minutes on two cores.
const TRAIN: usize = 9;

/// Panoramas the fit sees, for each that is held out.
const TRAIN_PER_NOVEL: usize = 3;

/// Rays per pixel of the evaluation: half the protocol's, which is enough to look at.
const RAYS: u32 = 128;

/// The most panoramas that a demo may have: more than anyone has taken of a flat.
const MOST_VIEWS: u64 = 1000;

/// Arguments of `texir demo`.
#[derive(Debug, Args)]
pub struct Demo {
    /// Folder for the capture and the fit
    #[arg(short, long, value_name = "DIR", default_value = "texir-demo")]
    output: PathBuf,
    /// Rooms of the flat, 3 to 5
    #[arg(long, value_name = "N", default_value_t = FlatOptions::default().rooms,
        value_parser = RangedU64ValueParser::<usize>::new().range(3..=5))]
    rooms: usize,
    /// Panoramas that the fit sees; a third as many more are held out
    #[arg(long, value_name = "N", default_value_t = TRAIN, value_parser = RangedU64ValueParser::<usize>::new().range(1..=MOST_VIEWS))]
    views: usize,
    /// One colour per surface, no patterns
    #[arg(long)]
    plain: bool,
    /// How much roughness varies within surfaces: 0 not at all, 1 moderately
    #[arg(long, value_name = "AMOUNT", default_value_t = FlatOptions::default().roughness_variation, value_parser = variation)]
    roughness_variation: f32,
}

/// What `--roughness-variation` may be.
fn variation(text: &str) -> Result<f32, String> {
    number(text, |amount| (0.0..=10.0).contains(&amount), "a number from 0 to 10")
}

/// Seed of everything random in the capture. The built-in flats are numbered from 1.
fn seed(session: &Session<'_>) -> u64 {
    u64::from(session.config.fit.seed) + 1
}

/// Errors where something is in the place of the capture that no demo has made: it would be lost.
fn check_replaceable(folder: &Path) -> Result<(), Failure> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(e) => {
            return Err(Failure::new(format!("{}: not a readable folder: {e}", folder.display()))
                .help("give another --output, or move it elsewhere: a folder of that name is made"));
        }
    };
    let names: Vec<_> = entries.flatten().map(|entry| entry.file_name()).collect();
    let other = names.iter().find(|name| *name != RECIPE && !demo::FILES.iter().any(|file| *name == file));
    let missing = demo::FILES.iter().find(|file| !names.iter().any(|name| name == *file));
    let what = match (other, missing) {
        (Some(other), _) => format!("holds {}", other.display()),
        (None, Some(missing)) if !names.is_empty() => format!("holds a capture without {missing}"),
        _ => return Ok(()),
    };
    Err(Failure::new(format!("{}: {what}, which `texir demo` did not write", folder.display()))
        .help("give another --output, or move it elsewhere: the folder would be replaced"))
}

impl Demo {
    /// Makes the capture, fits it, says where to look.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        let (folder, out) = (self.output.join(CAPTURE), self.output.join(FIT));
        session.config.check_set()?;
        if self.views < self.rooms {
            return Err(Failure::new(format!(
                "--views is {}; expected one for each of {} rooms at least",
                self.views, self.rooms
            ))
            .help("give more --views: a fit needs to see every room"));
        }
        check_replaceable(&folder)?;
        let of_flat = self.of_flat(session);
        let flat = Flat::generate(&of_flat)?;
        let staging = Staging::new(&out)?;
        let mut config = session.config.clone();
        if config.fit.atlas_size == 0 {
            config.fit.atlas_size = ATLAS;
        }
        let session = &Session { config: &config, ..*session };
        self.make(&folder, (&of_flat, &flat), staging.partial().is_dir(), session)?;
        let capture = capture::load(&folder, &LoadOptions::default(), session.console)?;
        let output = fit::write(staging, &capture, session)?;
        let evaluation = fit::evaluate(&out, &output, &capture, RAYS, session)?;
        session.print(&evaluation, || {
            let line = |what: &str, path: PathBuf| format!("{what:<12}{}", path.display());
            [
                figures::text(&evaluation),
                String::new(),
                line("report", out.join(REPORT)),
                line("scene", out.join(SCENE)),
                line("textures", out.clone()),
                line("capture", folder.clone()),
            ]
            .join("\n")
        })
    }

    fn of_flat(&self, session: &Session<'_>) -> FlatOptions {
        let Self { rooms, roughness_variation, .. } = *self;
        let paint = if self.plain { PaintStyle::Plain } else { PaintStyle::Patterned };
        FlatOptions { seed: seed(session), rooms, paint, roughness_variation, atlas: ATLAS }
    }

    /// Renders the flat, and puts the capture in place of an earlier one once it is whole; unless a fit `was_stopped`
    /// of just this capture, which goes on then.
    fn make(
        &self,
        folder: &Path,
        (of_flat, flat): (&FlatOptions, &Flat),
        was_stopped: bool,
        session: &Session<'_>,
    ) -> Result<(), Failure> {
        let seed = seed(session);
        let (train, novel) = (self.views, self.views.div_ceil(TRAIN_PER_NOVEL));
        let of_shots = PanoramaOptions { seed, train, novel, ..PanoramaOptions::default() };
        let of_views = RenderOptions { seed, ..RenderOptions::default() };
        let recipe = format!("texir {}\n{of_flat:?}\n{of_shots:?}\n{of_views:?}\n", env!("CARGO_PKG_VERSION"));
        if was_stopped && std::fs::read_to_string(folder.join(RECIPE)).is_ok_and(|made| made == recipe) {
            session.console.note(&format!("{:>24}  {}", "made already", folder.display()));
            return Ok(());
        }
        let shots = demo::panoramas(flat, &of_shots, session.console)?;
        let rendered = demo::render(flat, &shots, &of_views, session.console)?;
        let failed = |e: std::io::Error| Failure::new(format!("{}: cannot be written: {e}", folder.display()));
        let fresh = TempDir::with_prefix_in(".texir-", &self.output).map_err(failed)?;
        let made = fresh.path().join(CAPTURE);
        demo::write(flat, &rendered, &made, session.console)?;
        std::fs::write(made.join(RECIPE), recipe).map_err(failed)?;
        let earlier = fresh.path().join("earlier");
        if folder.exists() {
            std::fs::rename(folder, &earlier).map_err(failed)?;
        }
        std::fs::rename(&made, folder).map_err(|e| {
            // What was there comes back, if it can.
            std::fs::rename(&earlier, folder).ok();
            failed(e)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_of_others_are_not_replaced() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join(CAPTURE);
        assert!(check_replaceable(&folder).is_ok());
        std::fs::write(&folder, "mine").unwrap();
        assert!(check_replaceable(&folder).is_err(), "a file");
        std::fs::remove_file(&folder).unwrap();
        std::fs::create_dir_all(&folder).unwrap();
        assert!(check_replaceable(&folder).is_ok());
        let refused = || check_replaceable(&folder).unwrap_err().to_string();
        for name in demo::FILES {
            std::fs::write(folder.join(name), "").unwrap();
            assert!(demo::FILES.last() == Some(&name) || refused().contains("a capture without"), "{name}");
        }
        std::fs::write(folder.join(RECIPE), "").unwrap();
        assert!(check_replaceable(&folder).is_ok());
        std::fs::write(folder.join("notes.txt"), "mine").unwrap();
        assert!(refused().contains("notes.txt"));
    }
}
