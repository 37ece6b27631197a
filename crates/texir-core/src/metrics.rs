//! Image quality: MSE, PSNR and SSIM of images in [0, 1], with masks.
//!
//! SSIM is the definition of scikit-image's defaults, on floating-point images: the crates that offer one quantise to 8
//! bits or use another window, and their figures do not compare with published ones.

use rayon::prelude::*;

use crate::error::{Error, Result};
use crate::raster::{Mask, Raster};

/// Side of the SSIM window, pixels: smaller images have no SSIM.
pub const WINDOW: usize = 7;
/// Stabilisers of SSIM, (K·L)² with L = 1 (Wang et al., "Image Quality Assessment", 2004).
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// A pixel of one or more channels.
pub trait Pixel: Copy + Sync {
    /// Number of channels.
    const CHANNELS: usize;
    /// Every channel zero.
    const ZERO: Self;
    /// The channels.
    fn channels(&self) -> &[f32];
}

impl Pixel for f32 {
    const CHANNELS: usize = 1;
    const ZERO: Self = 0.0;
    fn channels(&self) -> &[f32] {
        std::slice::from_ref(self)
    }
}

impl Pixel for [f32; 3] {
    const CHANNELS: usize = 3;
    const ZERO: Self = [0.0; 3];
    fn channels(&self) -> &[f32] {
        self
    }
}

/// Display encoding of the protocol: linear value to clamp(x^(1/2.2), 0, 1). NaN and negative values give 0.
pub fn encode(linear: f32) -> f32 {
    linear.max(0.0).powf(1.0 / 2.2).min(1.0)
}

/// Peak signal-to-noise ratio in dB for a data range of 1; infinite for equal images.
pub fn psnr(mse: f64) -> f64 {
    -10.0 * mse.log10()
}

/// Mean squared error over channels and the pixels of the mask; `None` where the mask is empty.
pub fn mse<P: Pixel>(a: &Raster<P>, b: &Raster<P>, mask: &Mask) -> Result<Option<f64>> {
    same_size(a.size(), b.size())?;
    same_size(a.size(), mask.size())?;
    let (mut sum, mut count) = (0.0, 0_usize);
    for ((p, q), _) in a.data.iter().zip(&b.data).zip(&mask.data).filter(|(_, used)| **used) {
        sum += p.channels().iter().zip(q.channels()).map(|(x, y)| f64::from(x - y).powi(2)).sum::<f64>();
        count += P::CHANNELS;
    }
    Ok((count > 0).then(|| sum / count as f64))
}

/// Structural similarity: 7×7 uniform window, K1 = 0.01, K2 = 0.03, data range 1, sample covariance, the mean over all
/// windows inside the image and over channels.
pub fn ssim<P: Pixel>(a: &Raster<P>, b: &Raster<P>) -> Result<f64> {
    same_size(a.size(), b.size())?;
    let [width, height] = a.size();
    if width < WINDOW || height < WINDOW {
        return Err(Error::invalid(format!(
            "SSIM needs images of at least {WINDOW}×{WINDOW} pixels, not {width}×{height}"
        )));
    }
    let rows = height - WINDOW + 1;
    let sum: f64 = (0..P::CHANNELS * rows)
        .into_par_iter()
        .map(|i| row_of_windows(a, b, i / rows, i % rows))
        .collect::<Vec<f64>>()
        .iter()
        .sum();
    Ok(sum / (P::CHANNELS * rows * (width - WINDOW + 1)) as f64)
}

/// The image with the pixels outside the mask set to 0, as SSIM of a masked image is taken.
pub fn blank<P: Pixel>(image: &Raster<P>, mask: &Mask) -> Result<Raster<P>> {
    same_size(image.size(), mask.size())?;
    let data = image.data.iter().zip(&mask.data).map(|(&p, &used)| if used { p } else { P::ZERO }).collect();
    Raster::new(image.width, image.height, data)
}

/// Sum of SSIM over the windows whose top row is `top`, in one channel.
fn row_of_windows<P: Pixel>(a: &Raster<P>, b: &Raster<P>, channel: usize, top: usize) -> f64 {
    // Moments of one column of the window: sums of x, y, x², y², xy.
    let columns: Vec<[f64; 5]> = (0..a.width)
        .map(|column| {
            (top..top + WINDOW).fold([0.0; 5], |m, row| {
                let x = f64::from(a.at(column, row).channels()[channel]);
                let y = f64::from(b.at(column, row).channels()[channel]);
                [m[0] + x, m[1] + y, m[2] + x * x, m[3] + y * y, m[4] + x * y]
            })
        })
        .collect();
    columns.windows(WINDOW).map(window_ssim).sum()
}

/// SSIM of one window from the moments of its columns.
fn window_ssim(columns: &[[f64; 5]]) -> f64 {
    let n = (WINDOW * WINDOW) as f64;
    let [x, y, xx, yy, xy] =
        columns.iter().fold([0.0; 5], |sum, m| std::array::from_fn(|i| sum[i] + m[i])).map(|sum| sum / n);
    let sample = n / (n - 1.0);
    let (var_x, var_y, covariance) = (sample * (xx - x * x), sample * (yy - y * y), sample * (xy - x * y));
    (2.0 * x * y + C1) * (2.0 * covariance + C2) / ((x * x + y * y + C1) * (var_x + var_y + C2))
}

fn same_size(a: [usize; 2], b: [usize; 2]) -> Result<()> {
    if a == b {
        Ok(())
    } else {
        Err(Error::invalid(format!("images to compare differ in size: {}×{} and {}×{}", a[0], a[1], b[0], b[1])))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::{Gray, Rgb};

    /// A pair of 33×24 images by formula, the second a dimmed and rippled copy of the first.
    fn pair() -> (Rgb, Rgb) {
        let (width, height) = (33, 24);
        let pixel = |i: usize| ((i % width) as f64, (i / width) as f64);
        let first = |i: usize, c: usize| {
            let (x, y) = pixel(i);
            0.5 + 0.5 * (0.37 * x + 0.21 * y * (c + 1) as f64).sin()
        };
        let second = |i: usize, c: usize| {
            let (x, y) = pixel(i);
            (first(i, c) * 0.9 + 0.05 * (1.3 * x - 0.7 * y).cos() + 0.02).clamp(0.0, 1.0)
        };
        let image = |f: &dyn Fn(usize, usize) -> f64| {
            let data = (0..width * height).map(|i| std::array::from_fn(|c| f(i, c) as f32)).collect();
            Raster::new(width, height, data).unwrap()
        };
        (image(&first), image(&second))
    }

    fn all<T>(image: &Raster<T>) -> Mask {
        image.map(|_| true)
    }

    #[test]
    fn ssim_is_scikit_images() {
        // skimage.metrics.structural_similarity(a, b, data_range=1, channel_axis=-1), version 0.26, on the f32 images.
        let (a, b) = pair();
        let value = ssim(&a, &b).unwrap();
        assert!((value - 0.984_117_171_010_537_3).abs() < 1e-9, "{value}");
        let red = |image: &Rgb| image.map(|p| p[0]);
        let value = ssim(&red(&a), &red(&b)).unwrap();
        assert!((value - 0.980_461_986_832_151_6).abs() < 1e-9, "{value}");
        // Negative control: the figure is sensitive to a change of a single pixel.
        let mut c = b.clone();
        c.data[400] = [0.0; 3];
        assert!((ssim(&a, &c).unwrap() - 0.984_117_171_010_537_3).abs() > 1e-4);
    }

    #[test]
    fn mse_is_numpys() {
        let (a, b) = pair();
        let value = mse(&a, &b, &all(&a)).unwrap().unwrap();
        assert!((value - 0.003_356_531_787_290_055).abs() < 1e-10, "{value}");
    }

    #[test]
    fn constant_images_have_the_closed_forms() {
        let a = Gray::filled(16, 12, 0.25);
        let b = Gray::filled(16, 12, 0.75);
        let error = mse(&a, &b, &all(&a)).unwrap().unwrap();
        assert!((psnr(error) - 10.0 * 4f64.log10()).abs() < 1e-9);
        let luminance = (2.0 * 0.25 * 0.75 + C1) / (0.0625 + 0.5625 + C1);
        assert!((ssim(&a, &b).unwrap() - luminance).abs() < 1e-12);
        assert!((ssim(&a, &a).unwrap() - 1.0).abs() < 1e-12);
        assert!(psnr(0.0).is_infinite());
    }

    #[test]
    fn masked_pixels_do_not_count() {
        let (a, mut b) = pair();
        let mut mask = all(&a);
        let clean = mse(&a, &b, &mask).unwrap();
        b.data[100] = [50.0; 3];
        mask.data[100] = false;
        let masked = mse(&a, &b, &mask).unwrap();
        assert!((clean.unwrap() - masked.unwrap()).abs() < 1e-4);
        assert!(mse(&a, &b, &all(&a)).unwrap().unwrap() > 1.0);
        assert_eq!(blank(&b, &mask).unwrap().data[100], [0.0; 3]);
        assert_eq!(mse(&a, &b, &mask.map(|_| false)).unwrap(), None);
    }

    #[test]
    fn encode_covers_the_line() {
        assert_eq!(encode(-1.0), 0.0);
        assert_eq!(encode(f32::NAN), 0.0);
        assert_eq!(encode(7.0), 1.0);
        assert!((encode(0.5) - 0.5f32.powf(1.0 / 2.2)).abs() < 1e-7);
    }

    #[test]
    fn sizes_are_checked() {
        let (a, b) = (Gray::filled(8, 8, 0.0), Gray::filled(8, 9, 0.0));
        assert!(mse(&a, &b, &all(&a)).is_err());
        assert!(ssim(&a, &b).is_err());
        assert!(ssim(&Gray::filled(6, 9, 0.0), &Gray::filled(6, 9, 0.0)).is_err());
    }
}
