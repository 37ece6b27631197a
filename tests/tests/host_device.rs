//! Devices that a host program made for itself.
#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::sync::Arc;
use std::time::Duration;

use texir_core::backend::{Backend, Gather, ShadePoint};
use texir_core::brdf::Masking;
use texir_core::environment::Environment;
use texir_core::error::Error;
use texir_core::lights::Lights;
use texir_core::progress::Silent;
use texir_core::raster::Rgb;
use texir_core::scene::Scene;
use texir_core::specular_table::{STRATA, TableSampling};
use texir_core::surface::{Hit, SurfacePoint};
use texir_gpu::{BvhStorage, Gpu, GpuBackend, wgpu};
use texir_tests::scenes;

/// A device with these limits, of the adapter that the other tests run on.
fn host(limits: wgpu::Limits) -> (wgpu::Device, wgpu::Queue) {
    let name = texir_tests::gpu().info().name.clone();
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    let adapter = adapters.into_iter().find(|adapter| adapter.get_info().name == name).unwrap();
    let descriptor = wgpu::DeviceDescriptor { required_limits: limits, ..Default::default() };
    pollster::block_on(adapter.request_device(&descriptor)).unwrap()
}

#[test]
fn wgpu_s_default_limits_are_enough_for_a_small_scene_and_no_less() {
    let short = wgpu::Limits { max_storage_buffers_per_shader_stage: 7, ..wgpu::Limits::default() };
    let (device, queue) = host(short);
    let refused = Gpu::from_device(device, queue).err().unwrap().to_string();
    assert!(refused.contains("max_storage_buffers_per_shader_stage is 7; expected 8"), "{refused}");
    let (device, queue) = host(wgpu::Limits::default());
    let own = Gpu::from_device(device, queue).unwrap();
    let mut mesh = scenes::furnished_room();
    mesh.flat_normals();
    let scene = Arc::new(Scene::new(mesh).unwrap());
    let radiance = scenes::smooth_light(192);
    let camera = scenes::cameras()[0];
    let mut sky = Rgb::filled(16, 8, [1.0; 3]);
    sky.data[40] = [200.0; 3];
    let sky = Environment::new(sky).unwrap();
    // What binds most: gathers that sample the lights and the sky, and light samples, of a hierarchy in buffers.
    let found = [own, texir_tests::gpu()].map(|gpu| {
        let mut backend = GpuBackend::with_bvh_storage(&gpu, scene.clone(), BvhStorage::Buffers).unwrap();
        let lights = scenes::lights(&mut backend, &radiance);
        assert!(!lights.is_empty());
        backend.set_tbl(&radiance, &lights).unwrap();
        backend.set_environment(Some(&sky)).unwrap();
        let hits = backend.primary(&camera, camera.rows()).unwrap();
        let met: Vec<&Hit> = hits.iter().filter(|hit| hit.is_hit()).step_by(5).collect();
        let points: Vec<SurfacePoint> = met.iter().map(|hit| SurfacePoint::new(scene.mesh(), hit, None)).collect();
        let seen = |(pixel, hit): (u32, &&Hit)| [ShadePoint::new(scene.mesh(), &camera, pixel, hit, [0.0; 3]); STRATA];
        let pixels: Vec<_> = (0..).zip(&met).map(seen).collect();
        let sampling = TableSampling { lobe: 1, cosine: 1, light: 4, masking: Masking::Smith, seed: 3 };
        let tables = backend.specular_tables(&pixels, 0.04, sampling, &Silent).unwrap();
        (backend.irradiance(&points, Gather::new(16, 16, 1), &Silent).unwrap(), tables)
    });
    assert!(found[0].0.len() > 50, "{} points", found[0].0.len());
    assert!(found[0].0 == found[1].0 && found[0].1 == found[1].1, "other limits, other results");
}

/// A point of the furnished room.
fn point(scene: &Scene) -> SurfacePoint {
    SurfacePoint::new(scene.mesh(), &Hit { triangle: 0, u: 0.3, v: 0.3, t: 0.0 }, None)
}

#[test]
fn a_lost_device_is_an_error_and_no_panic() {
    let scene = Arc::new(Scene::new(scenes::furnished_room()).unwrap());
    let (camera, point) = (scenes::cameras()[0], point(&scene));
    let name = texir_tests::gpu().info().name.clone();
    let (device, queue) = host(wgpu::Limits::default());
    let devices = [Gpu::headless(Some(&name)).unwrap(), Gpu::from_device(device, queue).unwrap()];
    for (gpu, why) in devices.into_iter().zip([Some("Destroyed"), None]) {
        let mut backend = GpuBackend::new(&gpu, scene.clone()).unwrap();
        let radiance = scenes::smooth_light(32);
        backend.set_tbl(&radiance, &Lights::none(scene.mesh())).unwrap();
        backend.primary(&camera, camera.rows()).unwrap();
        gpu.device().destroy();
        let errors = [
            backend.primary(&camera, camera.rows()).map(drop),
            backend.irradiance(&[point], Gather::new(16, 0, 1), &Silent).map(drop),
            backend.radiance_loss(&[[1.0; 3]; 100], &[[2.0; 3]; 100]).map(drop),
        ];
        for (pass, error) in errors.into_iter().enumerate() {
            let error = error.err().unwrap_or_else(|| panic!("pass {pass} of a device that is gone"));
            let told = error.to_string();
            assert!(matches!(error, Error::Device(_)) && why.is_none_or(|why| told.contains(why)), "{pass}: {told}");
        }
    }
}

#[test]
fn the_time_of_a_dispatch_changes_no_result() {
    let scene = Arc::new(Scene::new(scenes::furnished_room()).unwrap());
    let mut backend = GpuBackend::new(&texir_tests::gpu(), scene.clone()).unwrap();
    backend.set_tbl(&scenes::smooth_light(32), &Lights::none(scene.mesh())).unwrap();
    let points = vec![point(&scene); 2000];
    let gather = |backend: &mut GpuBackend| backend.irradiance(&points, Gather::new(16, 0, 1), &Silent).unwrap();
    let usual = gather(&mut backend);
    for wrong in [Duration::ZERO, Duration::from_secs(5)] {
        assert!(backend.set_dispatch_time(wrong).unwrap_err().to_string().contains("at most 1s"));
    }
    backend.set_dispatch_time(Duration::from_micros(500)).unwrap();
    assert!(gather(&mut backend) == usual);
}
