//! `texir hdr`: one linear image from bracketed exposures.

use std::path::PathBuf;
use std::str::FromStr;

use clap::Args;
use serde::Serialize;
use texir_core::hdr::{self, Frame, Merged, ResponseChoice};
use texir_core::image_io::{TransferCurve, write_rgb};

use crate::checks::{check_exr, check_outputs};
use crate::failure::Failure;
use crate::session::Session;

/// Arguments of `texir hdr`.
#[derive(Debug, Args)]
pub struct Hdr {
    /// The exposures of one view, JPEG, PNG or TIFF of 8 or 16 bits, from one tripod position; the order does not
    /// matter
    #[arg(required = true, num_args = 2..)]
    shots: Vec<PathBuf>,
    /// The linear image, OpenEXR
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Camera response: estimate (from the shots), srgb, linear or gamma=2.2
    #[arg(long, value_name = "CURVE", value_parser = response, default_value = "estimate")]
    response: ResponseChoice,
    /// Exposure times in the order of the shots, such as 1/1000,1/60,1/4: instead of EXIF, at one aperture and ISO
    #[arg(long, value_name = "SECONDS", value_delimiter = ',')]
    times: Vec<Seconds>,
}

/// An exposure time, `1/60` or `0.5`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Seconds(f64);

impl FromStr for Seconds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| text.trim().parse::<f64>().ok();
        let seconds = match text.split_once('/') {
            Some((above, below)) => number(above).zip(number(below)).map(|(above, below)| above / below),
            None => number(text),
        };
        let seconds = seconds.filter(|s| *s > 0.0 && s.is_finite());
        seconds.map(Self).ok_or_else(|| "expected seconds, such as 1/60 or 0.5".to_owned())
    }
}

fn response(text: &str) -> Result<ResponseChoice, String> {
    if text == "estimate" {
        return Ok(ResponseChoice::Estimate);
    }
    let curve = text.parse::<TransferCurve>().map(ResponseChoice::Known);
    curve.map_err(|_| "expected estimate, srgb, linear or gamma=NUMBER".to_owned())
}

/// What `--json` prints.
#[derive(Serialize)]
struct Summary {
    output: PathBuf,
    width: usize,
    height: usize,
    /// Relative exposure of every shot: seconds · ISO / (100 · f-number²).
    exposures: Vec<f64>,
    clipped_pixels: usize,
    ghost_pixels: usize,
}

impl Hdr {
    /// Merges and writes.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        check_exr(&self.output)?;
        check_outputs(&[&self.output], &self.shots)?;
        let shots = self.shots()?;
        let Merged { radiance, clipped, ghosts } = hdr::merge(&shots, self.response, session.console)?;
        // Shots of a scene in which everything moved are shots of other exposures than was said.
        if 2 * ghosts > radiance.data.len() {
            let share = 100.0 * ghosts as f64 / radiance.data.len().max(1) as f64;
            return Err(Failure::new(format!(
                "{share:.0} % of the pixels differ between the shots by more than their exposures explain"
            ))
            .help("check --times against the order of the shots, --response against how they are encoded, and that all show the same"));
        }
        write_rgb(&self.output, &radiance)?;
        let summary = Summary {
            output: self.output.clone(),
            width: radiance.width,
            height: radiance.height,
            exposures: shots.iter().map(|shot| shot.exposure).collect(),
            clipped_pixels: clipped,
            ghost_pixels: ghosts,
        };
        session.print(&summary, || {
            let share = |pixels: usize| 100.0 * pixels as f64 / radiance.data.len().max(1) as f64;
            let (least, most) = shots.iter().fold((f64::INFINITY, 0.0_f64), |(least, most), shot| {
                (least.min(shot.exposure), most.max(shot.exposure))
            });
            format!(
                "{}: {} shots over {:.1} stops; {:.2} % of the pixels are clipped in all of them, {:.2} % show something \
                 that moved",
                summary.output.display(),
                shots.len(),
                (most / least).log2(),
                share(clipped),
                share(ghosts)
            )
        })
    }

    fn shots(&self) -> Result<Vec<Frame>, Failure> {
        let (shots, times) = (self.shots.len(), self.times.len());
        if times > 0 && times != shots {
            return Err(Failure::new(format!("--times has {times} values for {shots} shots")));
        }
        let exposure = |(i, path): (usize, &PathBuf)| {
            let exposure = match self.times.get(i) {
                Some(Seconds(time)) => *time,
                None => hdr::read_exposure(path)?,
            };
            Ok(Frame { path: path.clone(), exposure })
        };
        self.shots.iter().enumerate().map(exposure).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_fractions_or_numbers() {
        assert_eq!("1/8".parse(), Ok(Seconds(0.125)));
        assert_eq!("0.5".parse(), Ok(Seconds(0.5)));
        for wrong in ["", "1/0", "-1", "1/x", "0", "nan"] {
            assert!(wrong.parse::<Seconds>().is_err(), "{wrong}");
        }
        assert_eq!(response("gamma=2.2"), Ok(ResponseChoice::Known(TransferCurve::Gamma(2.2))));
        assert!(response("gamma=0").is_err() && response("film").is_err());
    }
}
