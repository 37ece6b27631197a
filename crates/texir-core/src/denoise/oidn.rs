//! Denoising by Intel's Open Image Denoise (2.x): a network that was trained on path-traced pictures, and sees a map as
//! one.

use bytemuck::{cast_slice, cast_slice_mut};
use oidn::{Device, RayTracing};

use crate::error::{Error, Result};
use crate::raster::{Raster, Rgb};

/// A map of linear RGB from 0 on without most of its noise; `normals`, unit vectors of a map of the same size, show the
/// network where surfaces bend. Both are best continued beyond the charts. Errors when the library finds no device that
/// it can run on, or no memory.
pub fn denoise(map: &Rgb, normals: &Rgb) -> Result<Rgb> {
    let [width, height] = map.size();
    if normals.size() != [width, height] {
        return Err(Error::invalid(format!("a map of {width} × {height} texels, and normals of {:?}", normals.size())));
    }
    let mut clean = Raster::filled(width, height, [0.0f32; 3]);
    filter(map, normals, cast_slice_mut(&mut clean.data))
        .map_err(|e| Error::device(format!("Open Image Denoise: {}; `--no-denoise` does without it", e.message())))?;
    Ok(clean)
}

fn filter(map: &Rgb, normals: &Rgb, clean: &mut [f32]) -> Result<(), oidn::Error> {
    let device = Device::new()?;
    let mut filter = RayTracing::try_new(&device)?;
    // Normals are heard only beside an albedo: irradiance is what a white surface would send.
    let white = vec![1.0; clean.len()];
    filter.hdr(true).clean_aux(true).image_dimensions(map.width, map.height);
    filter.albedo_normal_buffer(device.create_buffer(&white)?, device.create_buffer(cast_slice(&normals.data))?)?;
    filter.filter(cast_slice(&map.data), clean)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::hash2;

    #[test]
    fn noise_goes_and_light_stays() {
        const SIDE: usize = 64;
        let noisy = |i: usize| 1.0 + 0.5 * (hash2(3, i as u32) as f32 / u32::MAX as f32 - 0.5);
        let map = Rgb { width: SIDE, height: SIDE, data: (0..SIDE * SIDE).map(|i| [noisy(i); 3]).collect() };
        let normals = Raster::filled(SIDE, SIDE, [0.0, 0.0, 1.0]);
        let spread = |map: &Rgb| {
            let mean = map.data.iter().map(|v| v[0]).sum::<f32>() / map.data.len() as f32;
            let square = map.data.iter().map(|v| (v[0] - mean).powi(2)).sum::<f32>() / map.data.len() as f32;
            (mean, square.sqrt())
        };
        let (before, after) = (spread(&map), spread(&denoise(&map, &normals).unwrap()));
        assert!(before.1 > 0.1 && after.1 < before.1 / 5.0, "{before:?} {after:?}");
        assert!((after.0 / before.0 - 1.0).abs() < 0.02, "{before:?} {after:?}");
        assert!(denoise(&map, &Raster::filled(SIDE, 1, [0.0; 3])).is_err());
    }
}
