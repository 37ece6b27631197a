//! `texir inspect`: a dry run. What was found in a capture and what is assumed of it, whether its cameras and its atlas
//! make sense, and what a fit will cost.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use clap::Args;
use glam::{Mat4, Vec3};
use serde::Serialize;
use texir_core::atlas;
use texir_core::backend::Backend;
use texir_core::camera::{Camera, Projection};
use texir_core::capture::import::{self, Import};
use texir_core::capture::survey::Survey;
use texir_core::capture::{Capture, Split, Tbl, View};
use texir_core::cpu::CpuBackend;
use texir_core::error::Error;
use texir_core::fit::{FitSettings, Mode, memory};
use texir_core::image_io::is_encoded;
use texir_core::mesh::Mesh;
use texir_core::mesh_io::atlas_report;
use texir_core::progress::Progress;
use texir_core::rooms::{self, RoomOptions};
use texir_core::scene::Scene;
use texir_core::tbl::blur;

use super::import::SourceArgs;
use super::overlay;
use crate::args::CaptureArgs;
use crate::checks::check_folder;
use crate::console::count;
use crate::failure::Failure;
use crate::session::Session;

/// Columns of the coarse panorama that is traced from every camera.
const PROBE: usize = 64;

/// A camera from which more than this share of directions leaves the mesh is taken to be outside.
const OUTSIDE: f64 = 0.3;

/// A camera that sees more back faces than this is taken to be inside a solid, or the mesh to be turned inside out.
const INSIDE_OUT: f64 = 0.3;

/// Cameras that people carry or put on tripods are so high above the floor, metres.
const HEIGHTS: RangeInclusive<f32> = 0.3..=3.5;

/// Rows of the table of cameras, unless all are asked for.
const ROWS: usize = 30;

/// Masks that leave out more than this share of all pixels are taken to be inverted.
const MASKED: f64 = 0.9;

/// Arguments of `texir inspect`.
#[derive(Debug, Args)]
pub struct Inspect {
    #[command(flatten)]
    capture: CaptureArgs,
    #[command(flatten)]
    source: SourceArgs,
    /// Write every view with the mesh's edges drawn over it: where they lie beside the photo's, something is wrong
    #[arg(long, value_name = "FOLDER")]
    overlay: Option<PathBuf>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Findings {
    capture: String,
    origin: Origin,
    mesh: MeshFindings,
    atlas: AtlasFindings,
    views: Vec<ViewFindings>,
    known: Known,
    /// Variance of the images' point spread beyond that of a pixel, square pixels; absent where no surface is seen from
    /// near and from far, and of what is no capture yet.
    blur: Option<f32>,
    /// The most frequent first.
    classes: Vec<ClassFindings>,
    estimate: Estimate,
    warnings: Vec<String>,
}

/// Which program the files come from, and what that was taken to mean.
#[derive(Serialize)]
struct Origin {
    format: String,
    /// The folder is a capture; otherwise `texir import` makes one of it.
    capture: bool,
    assumed: Vec<String>,
    /// What an import will ask for or do, in sentences.
    #[serde(skip)]
    warnings: Vec<String>,
}

#[derive(Serialize)]
struct MeshFindings {
    file: String,
    triangles: usize,
    vertices: usize,
    /// Metres.
    size: [f32; 3],
    /// Square metres.
    area: f64,
}

#[derive(Serialize)]
struct AtlasFindings {
    /// Side, texels.
    size: usize,
    covered: f64,
    overlapping: f64,
    outside_triangles: usize,
    texels_per_metre: f64,
}

#[derive(Serialize)]
struct ViewFindings {
    name: String,
    split: Split,
    projection: &'static str,
    width: usize,
    height: usize,
    /// Share of directions that meet no surface.
    open: f64,
    /// Share of the surfaces that are seen from behind.
    back_faces: f64,
    /// Distance to the surface below, metres.
    height_above_floor: Option<f32>,
    /// Distance to the nearest surface, metres.
    nearest: Option<f32>,
}

/// What the capture brings along, in numbers of views where it is per view.
#[derive(Serialize)]
struct Known {
    train: usize,
    novel: usize,
    semantic: usize,
    mask: usize,
    room: usize,
    albedo: usize,
    roughness: usize,
    hdr_texture: bool,
    true_textures: bool,
}

/// A semantic class in the views.
#[derive(Serialize)]
struct ClassFindings {
    id: u16,
    /// Where the capture names a list of classes.
    name: Option<String>,
    /// Share of the pixels of all semantic images.
    share: f64,
}

/// What a fit with the current settings takes.
#[derive(Serialize)]
struct Estimate {
    bake_rays: u64,
    fit_rays: u64,
    /// Bytes of host memory.
    memory: u64,
}

impl Inspect {
    /// Looks, and says what was seen.
    pub fn run(&self, session: &Session<'_>) -> Result<(), Failure> {
        let (capture, origin) = self.open(session)?;
        if let Some(folder) = &self.overlay {
            if !origin.capture {
                return Err(Failure::new(
                    "--overlay needs a capture: lenses and 8-bit images have to be converted first",
                )
                .help("make one with `texir import`"));
            }
            check_folder(folder, &capture.files())?;
            let mut backend = CpuBackend::new(Scene::new(capture.mesh.clone())?);
            overlay::write(&mut backend, &capture.views, folder, session.console)?;
        }
        let findings = inspect(&capture, origin, session)?;
        let rows = if session.console.is_verbose() { usize::MAX } else { ROWS };
        session.print(&findings, || text(&findings, rows))
    }

    /// A capture as every command loads it; other programs' files as they would be after an import.
    fn open(&self, session: &Session<'_>) -> Result<(Capture, Origin), Failure> {
        let CaptureArgs { capture: folder, mesh, .. } = &self.capture;
        if !self.source.are_given() && import::is_capture(folder)? {
            return Ok((self.capture.load(session)?, Origin::of_capture()));
        }
        let source = import::read(folder, &self.source.options(mesh.clone()), session.console)?;
        Ok((source.preview(), Origin::of_import(&source)))
    }
}

impl Origin {
    fn of_capture() -> Self {
        Self {
            format: "texir (nerfstudio's transforms.json without distortion)".to_owned(),
            capture: true,
            assumed: vec![
                "poses are camera-to-world with OpenGL axes (−Z forward, +Y up)".to_owned(),
                "units are metres, +Z is up".to_owned(),
            ],
            warnings: Vec::new(),
        }
    }

    fn of_import(source: &Import) -> Self {
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
        Self { format: source.format.to_owned(), capture: false, assumed, warnings }
    }
}

fn inspect(capture: &Capture, origin: Origin, session: &Session<'_>) -> Result<Findings, Failure> {
    let settings = &session.config.fit;
    let mesh = &capture.mesh;
    let tbl = capture.tbl.as_ref().map(|path| Tbl::read(path, session.console)).transpose()?;
    let training: Vec<View> = capture.views(Split::Train).cloned().collect();
    let size = match (settings.atlas_size, tbl) {
        (0, Some(tbl)) => tbl.radiance.width,
        (0, None) => memory::default_side(&training, mesh, settings),
        (size, _) => size,
    };
    let area = area(mesh);
    let report = atlas_report(mesh, size);
    let covered_texels = report.covered_fraction * (size * size) as f64;
    let atlas = AtlasFindings {
        size,
        covered: report.covered_fraction,
        overlapping: report.overlapping_fraction,
        outside_triangles: report.outside_unit_square_triangles,
        texels_per_metre: (covered_texels / area).sqrt(),
    };
    let mut backend = CpuBackend::new(Scene::new(mesh.clone())?);
    let views = capture.views.iter().map(|view| probe(&mut backend, view)).collect::<Result<Vec<_>, _>>()?;
    let (low, high) = mesh.bounds();
    let mut unreadable = Vec::new();
    let blur = match origin.capture {
        true => or_told(blur::measure(&mut backend, &training, session.console), &mut unreadable)?.flatten(),
        false => None,
    };
    let classes = classes(&capture.views, &mut unreadable);
    let mut findings = Findings {
        capture: capture.root.display().to_string(),
        mesh: MeshFindings {
            file: capture.mesh_path.display().to_string(),
            triangles: mesh.triangles.len(),
            vertices: mesh.positions.len(),
            size: (high - low).to_array(),
            area,
        },
        known: known(capture),
        blur,
        classes,
        estimate: estimate(capture, settings, &atlas),
        atlas,
        views,
        warnings: origin.warnings.clone(),
        origin,
    };
    findings.warnings.extend(unreadable);
    if findings.origin.capture {
        findings.warnings.extend(masked(&training, session)?);
        let survey = Survey::new(&mut backend, &training, session.console);
        let survey = or_told(survey, &mut findings.warnings)?;
        findings.warnings.extend(survey.iter().flat_map(Survey::warnings));
        findings.warnings.extend(atlas::crowded(&mut backend, [size; 2])?);
    }
    let cameras: Vec<Vec3> = capture.views.iter().map(|view| view.camera.position()).collect();
    findings.warnings.extend(rooms::detect(mesh, &cameras, &RoomOptions::default()).err().map(|e| e.to_string()));
    findings.warnings.extend(warnings(&findings));
    Ok(findings)
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

/// What is wrong with the masks of the training views, if they leave hardly anything.
fn masked(views: &[View], session: &Session<'_>) -> Result<Option<String>, Failure> {
    let (mut excluded, mut all) = (0, 0);
    for view in views {
        session.console.check()?;
        all += view.camera.pixels();
        excluded += view.load_mask()?.map_or(0, |mask| mask.data.iter().filter(|used| !**used).count());
    }
    let share = excluded as f64 / all.max(1) as f64;
    Ok((share > MASKED).then(|| {
        format!(
            "mask_path: masks leave out {:.0} % of the training views' pixels: white is used and black is not; are they inverted?",
            100.0 * share
        )
    }))
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
        open: open / all,
        back_faces: if seen > 0.0 { behind / seen } else { 0.0 },
        height_above_floor: floor,
        nearest: nearest.is_finite().then_some(nearest),
    })
}

fn known(capture: &Capture) -> Known {
    let with = |has: fn(&View) -> bool| capture.views.iter().filter(|v| has(v)).count();
    Known {
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
    let texels = (atlas.size * atlas.size) as u64;
    let training = || capture.views(Split::Train).map(|v| &v.camera);
    let pixels: u64 = training().map(|c| c.pixels() as u64).sum();
    let fit_rays = match settings.mode {
        // Stage I traces nothing, stage II only the few pixels that could show a highlight.
        Mode::Paper => {
            let epochs = u64::from(settings.stage_three.enabled) * u64::from(settings.optimiser.epochs);
            pixels * u64::from(settings.specular_samples) * epochs
        }
        Mode::Full => training().map(|camera| settings.full.rays(camera)).sum(),
    };
    let needed = memory::needed(settings, (atlas.size, atlas.size), pixels, &capture.mesh);
    // All bakes but the last have a quarter of the points.
    let bakes = 1.0 + 0.25 * (settings.bakes() - 1) as f64;
    let rays = f64::from(settings.irradiance_rays(1.0 / atlas.texels_per_metre as f32));
    Estimate {
        bake_rays: (texels as f64 * atlas.covered * rays * bakes) as u64,
        fit_rays,
        memory: needed.min(settings.max_memory).0,
    }
}

fn warnings(findings: &Findings) -> Vec<String> {
    let mut warnings = Vec::new();
    for view in &findings.views {
        if view.open > OUTSIDE {
            warnings.push(format!(
                "camera {} sees no surface in {:.0} % of all directions: it is outside of the mesh, or the mesh is open",
                view.name,
                100.0 * view.open
            ));
        }
        if view.back_faces > INSIDE_OUT {
            warnings.push(format!(
                "camera {} sees {:.0} % of its surroundings from behind: it is inside a solid, or faces point the wrong way",
                view.name,
                100.0 * view.back_faces
            ));
        }
    }
    let mut heights: Vec<f32> = findings.views.iter().filter_map(|view| view.height_above_floor).collect();
    heights.sort_by(f32::total_cmp);
    if let Some(height) = heights.get(heights.len() / 2).filter(|height| !HEIGHTS.contains(*height)) {
        warnings.push(format!(
            "cameras are {height:.2} m above what is below them, in the median; expected {} to {}: are the units metres, and is +Z up? \
             `texir import` takes --metres-per-unit and --up",
            HEIGHTS.start(),
            HEIGHTS.end()
        ));
    }
    if findings.atlas.overlapping > 0.01 {
        warnings.push(format!(
            "{:.1} % of the covered texels belong to more than one surface: `texir import --unwrap` makes a new atlas",
            100.0 * findings.atlas.overlapping
        ));
    }
    if let Some(blur) = findings.blur.filter(|blur| *blur >= blur::SHARP) {
        warnings.push(format!(
            "the images are softer than their pixels, by a point spread of {blur:.2} square pixels: a fit is better with --sharpen"
        ));
    }
    if findings.known.semantic == 0 {
        warnings.push("no view has semantic classes: a fit makes segments from geometry and colour alone".to_owned());
    }
    warnings
}

/// The findings in words, with a row each for as many cameras.
fn text(findings: &Findings, rows: usize) -> String {
    let Findings { origin, mesh, atlas, known, estimate, .. } = findings;
    let mut out = String::new();
    let mut line = |name: &str, value: String| out.push_str(&format!("{name:>16}  {value}\n"));
    line("capture", findings.capture.clone());
    let next = if origin.capture { "" } else { "; `texir import` makes a capture of it" };
    line("format", format!("{}{next}", origin.format));
    origin.assumed.iter().for_each(|assumed| line("assumed", assumed.clone()));
    line("mesh", format!("{}, {} triangles, {} vertices", mesh.file, mesh.triangles, mesh.vertices));
    let [x, y, z] = mesh.size;
    line("extent", format!("{x:.2} × {y:.2} × {z:.2} m (z is up), {:.1} m² of surface", mesh.area));
    line(
        "atlas",
        format!(
            "{0} × {0}, {1:.1} % covered, {2:.2} % of that overlapping, {3} triangles outside, {4:.0} texels per metre",
            atlas.size,
            100.0 * atlas.covered,
            100.0 * atlas.overlapping,
            atlas.outside_triangles,
            atlas.texels_per_metre
        ),
    );
    line("views", format!("{} training, {} novel", known.train, known.novel));
    if let Some(blur) = findings.blur.filter(|blur| *blur < blur::SHARP) {
        line("images", format!("as sharp as their pixels (point spread of {blur:.2} square pixels beyond)"));
    }
    line(
        "annotated",
        format!(
            "semantic {}, mask {}, room {} of {} views",
            known.semantic,
            known.mask,
            known.room,
            findings.views.len()
        ),
    );
    let class = |class: &ClassFindings| {
        let name = class.name.clone().unwrap_or_else(|| format!("class {}", class.id));
        format!("{name} {:.1} %", 100.0 * class.share)
    };
    if !findings.classes.is_empty() {
        line("classes", findings.classes.iter().map(class).collect::<Vec<_>>().join(", "));
    }
    let yes = |known| if known { "given" } else { "to be built" };
    line("HDR texture", yes(known.hdr_texture).to_owned());
    line(
        "truth",
        format!(
            "albedo of {} views, roughness of {} views, {}",
            known.albedo,
            known.roughness,
            if known.true_textures { "textures" } else { "no textures" }
        ),
    );
    line(
        "cost of a fit",
        format!(
            "{} rays to bake, {} to fit, about {:.1} GB of memory",
            count(estimate.bake_rays),
            count(estimate.fit_rays),
            estimate.memory as f64 / 1e9
        ),
    );
    out.push_str(&cameras(&findings.views, rows));
    if let Some(left @ 1..) = findings.views.len().checked_sub(rows) {
        out.push_str(&format!("… {left} more, with -v; {}\n", summary(findings)));
    }
    for warning in &findings.warnings {
        out.push_str(&format!("warning: {warning}\n"));
    }
    out.trim_end().to_owned()
}

/// All cameras in a line.
fn summary(findings: &Findings) -> String {
    let Known { train, novel, semantic, mask, .. } = findings.known;
    let mut sizes: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    findings.views.iter().for_each(|view| *sizes.entry((view.width, view.height)).or_default() += 1);
    let sizes: Vec<String> = sizes.iter().map(|((w, h), count)| format!("{count} of {w} × {h}")).collect();
    format!(
        "in all {train} train and {novel} novel, {}; {semantic} with semantics, {mask} with masks",
        sizes.join(", ")
    )
}

/// A table of as many cameras as there are to be `rows`.
fn cameras(views: &[ViewFindings], rows: usize) -> String {
    let views = &views[..rows.min(views.len())];
    let width = views.iter().map(|v| v.name.chars().count()).max().unwrap_or(0).max(6);
    let mut out =
        format!("\n{:<width$}  split  projection       size         open  behind  above floor  nearest\n", "camera");
    let metres = |value: Option<f32>| value.map_or("-".to_owned(), |v| format!("{v:.2} m"));
    for view in views {
        let split = match view.split {
            Split::Train => "train",
            Split::Novel => "novel",
        };
        let size = format!("{} × {}", view.width, view.height);
        out += &format!(
            "{:<width$}  {split}  {:<15}  {size:<11}  {:>3.0} %  {:>4.0} %  {:>11}  {:>7}\n",
            view.name,
            view.projection,
            100.0 * view.open,
            100.0 * view.back_faces,
            metres(view.height_above_floor),
            metres(view.nearest)
        );
    }
    out
}
