//! The denoiser in WGSL against its twin in `f64`.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use glam::Vec3;
use texir_core::backend::Backend;
use texir_core::cpu;
use texir_core::denoise::Noisy;
use texir_core::progress::Silent;
use texir_core::rng::hash2;
use texir_core::scene::Scene;
use texir_core::surface::SurfacePoint;
use texir_gpu::GpuBackend;
use texir_tests::compare::{Tolerance, lanes3};
use texir_tests::{gpu, scenes};

const TEXEL: f32 = 0.02;
const SIDE: u32 = 80;
/// Systems of six unknowns, solved in single precision.
const SOLVED: Tolerance = Tolerance { absolute: 1e-5, relative: 1e-4 };

fn unit(i: u32, stream: u32) -> f32 {
    hash2(i, stream) as f32 / u32::MAX as f32
}

/// A floor and a wall that meet at an edge, not along the axes; and a line of texels by themselves.
fn points() -> Vec<SurfacePoint> {
    let [along, across, up] = [Vec3::new(0.8, 0.6, 0.0), Vec3::new(-0.6, 0.8, 0.0), Vec3::Z];
    let point = |position: Vec3, normal: Vec3| SurfacePoint {
        position: position.to_array(),
        triangle: 0,
        normal: normal.to_array(),
        index: 0,
    };
    let place = |i: u32| [(i % SIDE) as f32 * TEXEL, ((i / SIDE) as f32 + 0.5) * TEXEL];
    let floor = (0..SIDE * SIDE).map(|i| point(along * place(i)[0] + across * place(i)[1], up));
    let wall = (0..SIDE * SIDE / 2).map(|i| point(along * place(i)[0] + up * place(i)[1], across));
    let line = (0..30).map(|i| point(Vec3::new(-3.0, 0.0, i as f32 * TEXEL), Vec3::X));
    floor.chain(wall).chain(line).collect()
}

/// Light with a shadow's edge, noise, and a few samples that are rare and bright.
fn halves(count: usize) -> [Vec<[f32; 3]>; 2] {
    [1, 2].map(|half| {
        let value = |i: u32| {
            let truth = if i % SIDE < 30 { 0.4 } else { 1.0 + (i / SIDE) as f32 / 40.0 };
            let noise = 0.2 * (unit(i, half) + unit(i, half + 8) - 1.0);
            let rare = if unit(i, half + 4) < 0.02 { 3.0 } else { 0.0 };
            [1.0, 0.8, 0.1].map(|tint| tint * (truth * (1.0 + noise) + rare))
        };
        (0..count as u32).map(value).collect()
    })
}

fn empty() -> Scene {
    Scene::new(scenes::furnished_room()).unwrap()
}

#[test]
fn denoising() {
    let points = points();
    let (halves, apart) = (halves(points.len()), (0..points.len()).map(|i| i % 80 > 70).collect::<Vec<_>>());
    let noisy = Noisy { points: &points, halves: [&halves[0], &halves[1]], apart: &apart, texel: TEXEL };
    let mut backend = GpuBackend::new(&gpu(), empty()).unwrap();
    let got = backend.denoise(noisy, &Silent).unwrap();
    let twin =
        |noisy| cpu::denoise::denoise::<f64>(noisy, &Silent).unwrap().into_iter().flatten().collect::<Vec<f64>>();
    let expected = twin(noisy);
    SOLVED.check("denoised", &lanes3(&got), &expected);
    // Negative controls: what is left of the noise, and points that are mixed with those apart, are told apart.
    let mean: Vec<[f32; 3]> =
        halves[0].iter().zip(&halves[1]).map(|(a, b)| [0, 1, 2].map(|c| (a[c] + b[c]) / 2.0)).collect();
    assert!(SOLVED.failures(&lanes3(&mean), &expected).len() > 2 * points.len());
    let mixed = twin(Noisy { apart: &vec![false; points.len()], ..noisy });
    assert!(SOLVED.failures(&lanes3(&got), &mixed).len() > points.len() / 10);
    // The same bits however it is cut: the second call has measured the device, and a block sees what is around it.
    assert!(got == backend.denoise(noisy, &Silent).unwrap());
    let part: Vec<usize> = (0..points.len()).filter(|i| *i as u32 % SIDE < 50).collect();
    let pick = |half: &[[f32; 3]]| part.iter().map(|&i| half[i]).collect::<Vec<_>>();
    let block = backend
        .denoise(
            Noisy {
                points: &part.iter().map(|&i| points[i]).collect::<Vec<_>>(),
                halves: [&pick(&halves[0]), &pick(&halves[1])],
                apart: &part.iter().map(|&i| apart[i]).collect::<Vec<_>>(),
                texel: TEXEL,
            },
            &Silent,
        )
        .unwrap();
    let differs = |margin: u32| {
        let own = |i: &usize| *i as u32 % SIDE < 50 - margin;
        part.iter().zip(&block).filter(|(i, clean)| own(i) && **clean != got[**i]).count()
    };
    assert_eq!(differs(21), 0);
    assert!(differs(0) > 0, "a block that does not see what is around it differs at its border");
}

#[test]
fn points_in_any_order_and_by_themselves_pass() {
    let mut backend = GpuBackend::new(&gpu(), empty()).unwrap();
    assert!(
        backend
            .denoise(Noisy { points: &[], halves: [&[], &[]], apart: &[], texel: TEXEL }, &Silent)
            .unwrap()
            .is_empty()
    );
    let lonely = Noisy { points: &points()[..1], halves: [&[[1.0; 3]], &[[3.0; 3]]], apart: &[false], texel: TEXEL };
    assert_eq!(backend.denoise(lonely, &Silent).unwrap(), [[2.0; 3]]);
    let short = Noisy { points: &points()[..2], ..lonely };
    assert!(backend.denoise(short, &Silent).unwrap_err().to_string().contains("2 points to denoise"));
    let dark = Noisy { points: &points()[..500], halves: [&[[0.0; 3]; 500]; 2], apart: &[false; 500], texel: TEXEL };
    assert!(backend.denoise(dark, &Silent).unwrap().iter().all(|e| *e == [0.0; 3]));
}
