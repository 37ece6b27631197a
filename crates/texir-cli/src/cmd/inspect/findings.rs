//! What there is to find in a capture.

use std::collections::BTreeMap;

use glam::{Mat4, Vec3};
use serde::Serialize;
use texir_core::atlas;
use texir_core::backend::Backend;
use texir_core::camera::{Camera, Projection};
use texir_core::capture::import::Import;
use texir_core::capture::survey::Survey;
use texir_core::capture::{Capture, Split, Tbl, View};
use texir_core::cpu::CpuBackend;
use texir_core::error::Error;
use texir_core::fit::{FitSettings, Mode, memory};
use texir_core::image_io::is_encoded;
use texir_core::mesh::Mesh;
use texir_core::mesh_io::atlas_report;
use texir_core::rooms::{self, RoomOptions};
use texir_core::scene::Scene;
use texir_core::tbl::blur;

use super::warnings::{masked, warnings};
use crate::failure::Failure;
use crate::session::Session;

/// Columns of the coarse panorama that is traced from every camera.
const PROBE: usize = 64;

/// What `--json` prints.
#[derive(Serialize)]
pub struct Findings {
    pub capture: String,
    pub origin: Origin,
    pub mesh: MeshFindings,
    pub atlas: AtlasFindings,
    pub views: Vec<ViewFindings>,
    pub inputs: Inputs,
    /// Variance of the images' point spread beyond that of a pixel, square pixels; absent where no surface is seen from
    /// near and from far, and of what is no capture yet.
    pub blur: Option<f32>,
    /// The most frequent first.
    pub classes: Vec<ClassFindings>,
    pub estimate: Estimate,
    pub warnings: Vec<String>,
}

/// Which program the files come from, and what that was taken to mean.
#[derive(Serialize)]
pub struct Origin {
    pub format: String,
    /// The folder is a capture; otherwise `texir import` makes one of it.
    pub is_capture: bool,
    pub assumed: Vec<String>,
    /// What an import will ask for or do, in sentences.
    #[serde(skip)]
    pub warnings: Vec<String>,
}

#[derive(Serialize)]
pub struct MeshFindings {
    pub file: String,
    pub triangles: usize,
    pub vertices: usize,
    /// Metres.
    pub extent: [f32; 3],
    /// Square metres.
    pub area: f64,
}

#[derive(Serialize)]
pub struct AtlasFindings {
    /// Columns and rows.
    pub size: [usize; 2],
    pub covered_fraction: f64,
    pub overlapping_fraction: f64,
    pub outside_triangles: usize,
    pub texels_per_metre: f64,
}

#[derive(Serialize)]
pub struct ViewFindings {
    pub name: String,
    pub split: Split,
    pub projection: &'static str,
    pub width: usize,
    pub height: usize,
    /// Share of directions that meet no surface.
    pub no_hit: f64,
    /// Share of the surfaces that are seen from behind.
    pub back_faces: f64,
    /// Distance to the surface below, metres.
    pub height_above_floor: Option<f32>,
    /// Distance to the nearest surface, metres.
    pub nearest: Option<f32>,
}

/// What the capture brings along, in numbers of views where it is per view.
#[derive(Serialize)]
pub struct Inputs {
    pub train: usize,
    pub novel: usize,
    pub semantic: usize,
    pub mask: usize,
    pub room: usize,
    pub albedo: usize,
    pub roughness: usize,
    pub hdr_texture: bool,
    pub true_textures: bool,
}

/// A semantic class in the views.
#[derive(Serialize)]
pub struct ClassFindings {
    pub id: u16,
    /// Where the capture names a list of classes.
    pub name: Option<String>,
    /// Share of the pixels of all semantic images.
    pub share: f64,
}

/// What a fit with the current settings takes.
#[derive(Serialize)]
pub struct Estimate {
    pub bake_rays: u64,
    pub fit_rays: u64,
    /// Bytes of host memory.
    pub memory_bytes: u64,
}

impl Origin {
    pub fn of_capture() -> Self {
        Self {
            format: "texir (nerfstudio's transforms.json without distortion)".to_owned(),
            is_capture: true,
            assumed: vec![
                "poses are camera-to-world with OpenGL axes (−Z forward, +Y up)".to_owned(),
                "units are metres, +Z is up".to_owned(),
            ],
            warnings: Vec::new(),
        }
    }

    pub fn of_import(source: &Import) -> Self {
        let mut warnings = Vec::new();
        let mut about = |what: &str, views: Vec<&View>| {
            if let Some(first) = views.first() {
                let (number, all) = (views.len(), source.shots.len());
                warnings.push(format!("{number} of {all} images {what}; the first is {}", first.image.display()));
            }
        };
        let views = || source.shots.iter().map(|shot| &shot.view);
        about("do not exist", views().filter(|v| !v.image.is_file()).collect());
        about(
            "hold 8 or 16-bit values: merge bracketed exposures with `texir hdr`, or import with --curve as a last resort",
            views().filter(|v| is_encoded(&v.image).unwrap_or(false)).collect(),
        );
        let mut assumed = source.assumed.clone();
        let distorted = source.shots.iter().filter(|shot| shot.distortion.is_some()).count();
        if distorted > 0 {
            assumed.push(format!("{distorted} images are distorted by their lenses; `texir import` undistorts them"));
        }
        Self { format: source.format.to_owned(), is_capture: false, assumed, warnings }
    }
}

impl Findings {
    /// Looks at everything.
    pub fn of(capture: &Capture, origin: Origin, session: &Session<'_>) -> Result<Self, Failure> {
        let settings = &session.config.fit;
        let mesh = &capture.mesh;
        let tbl = capture.tbl.as_ref().map(|path| Tbl::read(path, session.console)).transpose()?;
        let training: Vec<View> = capture.views(Split::Train).cloned().collect();
        let size = memory::atlas_size(settings, tbl.map(|tbl| tbl.radiance.size()), &training, mesh);
        let area = area(mesh);
        let report = atlas_report(mesh, size);
        let covered_texels = report.covered_fraction * (size[0] * size[1]) as f64;
        let atlas = AtlasFindings {
            size,
            covered_fraction: report.covered_fraction,
            overlapping_fraction: report.overlapping_fraction,
            outside_triangles: report.outside_unit_square_triangles,
            texels_per_metre: (covered_texels / area).sqrt(),
        };
        let mut backend = CpuBackend::new(Scene::new(mesh.clone())?);
        let views = capture.views.iter().map(|view| probe(&mut backend, view)).collect::<Result<Vec<_>, _>>()?;
        let (low, high) = mesh.bounds();
        let mut unreadable = Vec::new();
        let blur = match origin.is_capture {
            true => or_told(blur::measure(&mut backend, &training, session.console), &mut unreadable)?.flatten(),
            false => None,
        };
        let classes = classes(&capture.views, &mut unreadable);
        let mut findings = Self {
            capture: capture.root.display().to_string(),
            mesh: MeshFindings {
                file: capture.mesh_path.display().to_string(),
                triangles: mesh.triangles.len(),
                vertices: mesh.positions.len(),
                extent: (high - low).to_array(),
                area,
            },
            inputs: known(capture),
            blur,
            classes,
            estimate: estimate(capture, settings, &atlas),
            atlas,
            views,
            warnings: origin.warnings.clone(),
            origin,
        };
        findings.warnings.extend(unreadable);
        if findings.origin.is_capture {
            findings.warnings.extend(masked(&training, session)?);
            let survey = Survey::new(&mut backend, &training, session.console);
            let survey = or_told(survey, &mut findings.warnings)?;
            findings.warnings.extend(survey.iter().flat_map(Survey::warnings));
            findings.warnings.extend(atlas::crowded(&mut backend, size)?);
        }
        let cameras: Vec<Vec3> = capture.views.iter().map(|view| view.camera.position()).collect();
        findings.warnings.extend(rooms::detect(mesh, &cameras, &RoomOptions::default()).err().map(|e| e.to_string()));
        findings.warnings.extend(warnings(&findings));
        Ok(findings)
    }
}

/// What is found. Errors become warnings, as much else can still be said of a capture; being cancelled stays one.
fn or_told<T>(found: texir_core::error::Result<T>, warnings: &mut Vec<String>) -> Result<Option<T>, Failure> {
    match found {
        Ok(found) => return Ok(Some(found)),
        Err(Error::Cancelled) => return Err(Error::Cancelled.into()),
        Err(e) if warnings.contains(&e.to_string()) => {}
        Err(e) => warnings.push(e.to_string()),
    }
    Ok(None)
}

fn area(mesh: &Mesh) -> f64 {
    (0..mesh.triangles.len() as u32).map(|t| f64::from(mesh.area(t))).sum()
}

/// Looks around from a view's position.
fn probe(backend: &mut CpuBackend, view: &View) -> Result<ViewFindings, Failure> {
    let scene = backend.scene().clone();
    let position = view.camera.position();
    let camera = |projection, width, height| Camera {
        projection,
        width,
        height,
        world_from_camera: Mat4::from_translation(position),
    };
    let around = camera(Projection::Equirectangular, PROBE, PROBE / 2);
    // In a panorama a row's share of the sphere goes with the sine of its polar angle.
    let (mut all, mut open, mut seen, mut behind) = (0.0, 0.0, 0.0, 0.0);
    let mut nearest = f32::INFINITY;
    for (i, hit) in backend.primary(&around, around.rows())?.iter().enumerate() {
        let (x, y) = ((i % PROBE) as f32 + 0.5, (i / PROBE) as f32 + 0.5);
        let weight = (std::f64::consts::TAU * f64::from(y) / PROBE as f64).sin();
        all += weight;
        if !hit.is_hit() {
            open += weight;
            continue;
        }
        seen += weight;
        nearest = nearest.min(hit.t);
        if scene.mesh().face_normal(hit.triangle).dot(around.direction(x, y)) > 0.0 {
            behind += weight;
        }
    }
    // A camera at rest looks along −Z, which is down in the world.
    let down = camera(Projection::Pinhole { fx: 1.0, fy: 1.0, cx: 0.5, cy: 0.5 }, 1, 1);
    let floor = backend.primary(&down, down.rows())?.first().filter(|hit| hit.is_hit()).map(|hit| hit.t);
    Ok(ViewFindings {
        name: view.name.clone(),
        split: view.split,
        projection: match view.camera.projection {
            Projection::Equirectangular => "equirectangular",
            Projection::Pinhole { .. } => "pinhole",
        },
        width: view.camera.width,
        height: view.camera.height,
        no_hit: open / all,
        back_faces: if seen > 0.0 { behind / seen } else { 0.0 },
        height_above_floor: floor,
        nearest: nearest.is_finite().then_some(nearest),
    })
}

fn known(capture: &Capture) -> Inputs {
    let with = |has: fn(&View) -> bool| capture.views.iter().filter(|v| has(v)).count();
    Inputs {
        train: capture.views(Split::Train).count(),
        novel: capture.views(Split::Novel).count(),
        semantic: with(|v| v.semantic.is_some()),
        mask: with(|v| v.mask.is_some()),
        room: with(|v| v.room.is_some() || v.room_id.is_some()),
        albedo: with(|v| v.albedo.is_some()),
        roughness: with(|v| v.roughness.is_some()),
        hdr_texture: capture.tbl.is_some(),
        true_textures: capture.truth.is_some(),
    }
}

/// What the semantic images hold; what is wrong with those that cannot be read goes to `unreadable`.
fn classes(views: &[View], unreadable: &mut Vec<String>) -> Vec<ClassFindings> {
    let mut pixels: BTreeMap<u16, usize> = BTreeMap::new();
    for view in views {
        match view.read_semantic() {
            Ok(labels) => labels.iter().flat_map(|l| &l.data).for_each(|id| *pixels.entry(*id).or_default() += 1),
            Err(e) => unreadable.push(e.to_string()),
        }
    }
    let all = pixels.values().sum::<usize>() as f64;
    let list = views.iter().find_map(|view| view.classes.as_ref());
    let name = |id| match id {
        0 => Some("unknown".to_owned()),
        _ => Some(list?.of_id(id)?.name.clone()),
    };
    let of_id = |(&id, &pixels): (&u16, &usize)| ClassFindings { id, name: name(id), share: pixels as f64 / all };
    let mut found: Vec<ClassFindings> = pixels.iter().map(of_id).collect();
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    found
}

fn estimate(capture: &Capture, settings: &FitSettings, atlas: &AtlasFindings) -> Estimate {
    let texels = (atlas.size[0] * atlas.size[1]) as u64;
    let training = || capture.views(Split::Train).map(|v| &v.camera);
    let pixels: u64 = training().map(|c| c.pixels() as u64).sum();
    let fit_rays = match settings.mode {
        // Stage I traces nothing, stage II only the few pixels that could show a highlight.
        Mode::Paper => {
            let epochs = u64::from(settings.paper.stage_three.enabled) * u64::from(settings.paper.optimiser.epochs);
            pixels * u64::from(settings.paper.specular_samples) * epochs
        }
        Mode::Full => training().map(|camera| settings.full.rays(camera)).sum(),
    };
    let needed = memory::needed(settings, atlas.size, pixels, &capture.mesh);
    // All bakes but the last have a quarter of the points.
    let bakes = 1.0 + 0.25 * (settings.bakes() - 1) as f64;
    let rays = f64::from(settings.irradiance_rays(1.0 / atlas.texels_per_metre as f32));
    Estimate {
        bake_rays: (texels as f64 * atlas.covered_fraction * rays * bakes) as u64,
        fit_rays,
        memory_bytes: needed.min(settings.max_memory).0,
    }
}
