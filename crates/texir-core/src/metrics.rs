//! Image quality: MSE, PSNR, SSIM.
