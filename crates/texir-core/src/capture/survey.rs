//! What the training views show of the mesh, before anything is fitted: light that the mesh has no front for, images
//! that clip, and views that contradict the others. Each of these ruins a result, and none of them stops a fit.

mod noise;

use std::collections::HashMap;

use glam::Vec3;

use super::View;
use crate::backend::Backend;
use crate::error::{Result, listed};
use crate::progress::{Progress, Task};
use crate::raster::{Rgb, luminance, mean_of_channels, mean_pixel};
use crate::stats::median;
use crate::surface::facing;
use crate::tbl::exposure::{self, Sighting};
use crate::tbl::pose;

/// Columns of a view as it is looked at, at most.
const COLUMNS: usize = 256;
/// Edge of the cells of surface in which views are compared, metres.
const CELL: f32 = 0.25;
/// Views of a cell, at least, by which each of them can be judged.
const JUDGES: usize = 3;
/// Cells, at least, that a view is judged in.
const ENOUGH: usize = 30;

/// Shares of the light and of the directions, of all training views, that may meet the backs of faces.
const BEHIND: [f64; 2] = [0.03, 0.05];
/// Shares of the light and of the directions, likewise, that may meet no surface.
const OPEN: [f64; 2] = [0.05, 0.1];
/// An image clips where so many of its pixels share its largest value in two channels.
const CLIPPED: f64 = 1e-3;
/// A view contradicts the others where it is off by this in the median, in ln, and by so many times what views are off
/// in the median.
const OFF: f32 = 0.3;
const TIMES: f32 = 2.5;
/// Images are noisy where their radiance differs by this from pixel to pixel for no reason, in ln.
const NOISY: f32 = 0.04;

/// What a training view shows.
#[derive(Clone, Debug)]
pub struct ViewSurvey {
    /// Name of the view.
    pub name: String,
    /// The part whose rays meet back faces.
    pub behind: LightShare,
    /// The part whose rays miss the mesh.
    pub open: LightShare,
    /// All that it shows.
    pub all: LightShare,
    /// The largest value of its image, and the share of its pixels that have it in two channels at least.
    pub largest: (f32, f64),
    /// Standard deviation of ln radiance from pixel to pixel, of the file's own pixels, where nothing but noise makes
    /// them differ; `None` where the image is too small or black.
    pub noise: Option<f32>,
    /// How it agrees with other views of the same places; `None` where too few show enough of them.
    pub agreement: Option<Agreement>,
    /// By how many of its pixels it should be moved, roughly, to show what the others show; `None` where it is
    /// in place (see [`pose::out_of_place`]).
    pub out_of_place: Option<f32>,
}

/// A part of what a view shows.
#[derive(Clone, Copy, Debug, Default)]
pub struct LightShare {
    /// Solid angle, sr.
    pub directions: f64,
    /// Radiance × solid angle.
    pub light: f64,
    /// Column and row of the image where most of it comes from, with its light there.
    brightest: (f64, [usize; 2]),
}

/// How a view agrees with all views of the same places.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// By how much it is brighter than the middle one of them, in ln, per channel.
    pub exposure: [f32; 3],
    /// Median over cells of surface of |ln radiance − median of all views|, after subtracting `exposure`.
    pub spread: f32,
}

impl Agreement {
    /// By how much the view is brighter, in ln.
    fn brighter(&self) -> f32 {
        mean_of_channels(self.exposure)
    }
}

/// What all training views show.
#[derive(Clone, Debug, Default)]
pub struct Survey(Vec<ViewSurvey>);

impl Survey {
    /// Surveys all `views`, reduced to some 256 columns. Masked pixels count as light, but are not compared.
    pub fn new(backend: &mut dyn Backend, views: &[View], progress: &dyn Progress) -> Result<Self> {
        let task = Task::start(progress, "what views show", views.len() as u64, "views");
        let (mut shown, mut cells) = (Vec::with_capacity(views.len()), Vec::new());
        for (index, view) in views.iter().enumerate() {
            progress.check()?;
            // What ends at a value does so in the file, before anything is made of it.
            let plain = View { scale: [1.0; 3], blur: 0.0, ..view.clone() }.load_image(progress)?;
            let (largest, noise) = (largest(&plain), noise::noise(&plain));
            let reduced = (1..=view.camera.width.div_ceil(COLUMNS)).rev().find_map(|factor| view.reduced(factor));
            let view = reduced.as_ref().unwrap_or(view);
            let reduced = plain.reduced(view.reduction / views[index].reduction, mean_pixel);
            let image = reduced.map(|pixel| std::array::from_fn(|c| pixel[c] * view.scale[c]));
            let mut of_view = ViewSurvey {
                name: view.name.clone(),
                behind: LightShare::default(),
                open: LightShare::default(),
                all: LightShare::default(),
                largest,
                noise,
                agreement: None,
                out_of_place: None,
            };
            let means = of_view.look(backend, view, &image)?;
            cells.extend(means.into_iter().map(|(cell, log)| (cell, Sighting { view: index, log })));
            shown.push(of_view);
            progress.advance(1);
        }
        drop(task);
        agreements(&mut shown, cells);
        for (shown, pixels) in shown.iter_mut().zip(pose::out_of_place(backend, views, progress)?) {
            shown.out_of_place = pixels;
        }
        Ok(Self(shown))
    }

    /// What each view shows.
    pub fn views(&self) -> &[ViewSurvey] {
        &self.0
    }

    /// Mean radiance over all directions of all views.
    pub fn radiance(&self) -> f64 {
        let all = self.sum(|shown| shown.all);
        all.light / all.directions.max(f64::MIN_POSITIVE)
    }

    /// What users are told, in sentences.
    pub fn warnings(&self) -> Vec<String> {
        let mut told = Vec::new();
        if self.0.is_empty() {
            return told;
        }
        let [behind, open, all] =
            [|s: &ViewSurvey| s.behind, |s: &ViewSurvey| s.open, |s: &ViewSurvey| s.all].map(|part| self.sum(part));
        let exceeds = |part: LightShare, [light, directions]: [f64; 2]| {
            part.light > light * all.light || part.directions > directions * all.directions
        };
        let percent = |part: LightShare| {
            let of = |part: f64, all: f64| 100.0 * part / all.max(f64::MIN_POSITIVE);
            format!(
                "{:.0} % of the light and {:.0} % of the directions",
                of(part.light, all.light),
                of(part.directions, all.directions)
            )
        };
        if exceeds(behind, BEHIND) {
            told.push(format!(
                "{} that the training views show come from the backs of faces{}: what faces the wrong way stays dark and is given no \
                 materials that mean anything; turn these faces around",
                percent(behind),
                self.brightest(|s| s.behind)
            ));
        }
        if exceeds(open, OPEN) {
            told.push(format!(
                "{} that the training views show come from where the mesh has no surface{}: what shines through its holes is missing \
                 from the light, and albedo makes up for it; close them, with a plane before a window",
                percent(open),
                self.brightest(|s| s.open)
            ));
        }
        if self.0.len() < JUDGES {
            told.push(format!(
                "{} training views: where one view alone shows a place, its highlights cannot be told from its paint; expected several \
                 views of every room",
                self.0.len()
            ));
        }
        told.extend(self.clipped());
        told.extend(self.noisy());
        // A view that shows something else is moved to nowhere, and the others with it.
        let contradicted = self.contradicted();
        if contradicted.is_none() {
            told.extend(self.exposed_differently());
            told.extend(self.out_of_place());
        }
        told.extend(contradicted);
        told
    }

    fn sum(&self, part: impl Fn(&ViewSurvey) -> LightShare) -> LightShare {
        self.0.iter().fold(LightShare::default(), |sum, shown| {
            let part = part(shown);
            LightShare { directions: sum.directions + part.directions, light: sum.light + part.light, ..sum }
        })
    }

    /// Where most light of a part comes from.
    fn brightest(&self, part: impl Fn(&ViewSurvey) -> LightShare) -> String {
        let most = self.0.iter().max_by(|a, b| part(a).brightest.0.total_cmp(&part(b).brightest.0));
        let place = |shown: &ViewSurvey| {
            let (light, [x, y]) = part(shown).brightest;
            (light > 0.0).then(|| format!(" (most in view {:?} at column {x}, row {y})", shown.name))
        };
        most.and_then(place).unwrap_or_default()
    }

    fn clipped(&self) -> Option<String> {
        let clipped: Vec<&ViewSurvey> = self.0.iter().filter(|shown| shown.largest.1 > CLIPPED).collect();
        let alike = |a: &ViewSurvey| clipped.iter().filter(|b| is_at(b.largest.0, a.largest.0)).count();
        let most = clipped.iter().max_by_key(|shown| alike(shown))?;
        let ((value, share), count) = (most.largest, alike(most));
        // One image alone proves nothing where there are others.
        (count > 1 || self.0.len() == 1).then(|| {
            format!(
                "{count} training images end at {value}, which {:.1} % of the pixels of {:?} have in several channels: are lamps or windows \
                 clipped (or is it an even, white lamp)? What is missing of their light, albedo makes up for; merge shorter exposures into \
                 the images (`texir hdr`)",
                100.0 * share,
                most.name
            )
        })
    }

    fn noisy(&self) -> Option<String> {
        let noise = median(&mut self.0.iter().filter_map(|shown| shown.noise).collect::<Vec<_>>())?;
        (noise > NOISY).then(|| {
            format!(
                "the training images are noisy, by {:.0} % from pixel to pixel: surfaces come out too rough, and uneven; average several \
                 exposures, draw renderings with more samples, or denoise them",
                100.0 * noise
            )
        })
    }

    fn out_of_place(&self) -> Option<String> {
        let off = || self.0.iter().filter_map(|shown| Some((shown, shown.out_of_place?)));
        let (most, pixels) = off().max_by(|a, b| a.1.total_cmp(&b.1))?;
        Some(format!(
            "{} of {} training views are out of place on the mesh, {:?} most, by {pixels:.1} pixels: --refine-poses moves them to where \
             they agree with the others, unless it is the mesh that is off (in another unit or frame than the cameras, say), or \
             something was moved",
            off().count(),
            self.0.len(),
            most.name
        ))
    }

    /// The views of which it is known how they agree with others.
    fn known(&self) -> Vec<(&ViewSurvey, Agreement)> {
        self.0.iter().filter_map(|shown| Some((shown, shown.agreement?))).collect()
    }

    /// Views that show something else than the others.
    fn contradicted(&self) -> Option<String> {
        let known = self.known();
        let mut spreads: Vec<f32> = known.iter().map(|(_, agreement)| agreement.spread).collect();
        let most = median(&mut spreads).map_or(OFF, |typical| OFF.max(TIMES * typical));
        let off = known.iter().filter(|(_, agreement)| agreement.spread > most);
        let off: Vec<String> = off.map(|(shown, _)| format!("{:?}", shown.name)).collect();
        (!off.is_empty()).then(|| {
            format!(
                "views that do not show what the others show of the same places: {}; is it their pose, or their image, or was something moved, \
                 or a lamp switched?",
                listed(&off)
            )
        })
    }

    /// Views that show the same brighter or darker.
    fn exposed_differently(&self) -> Option<String> {
        let known = self.known();
        let differ = exposure::difference(known.iter().map(|(_, agreement)| agreement.exposure));
        let (most, agreement) = known.iter().max_by(|a, b| a.1.brighter().abs().total_cmp(&b.1.brighter().abs()))?;
        (differ > exposure::MIN_DIFFERENCE).then(|| {
            format!(
                "the training views are exposed differently, by {:.1} % (root mean square), {:?} most ({:.3} times as bright as the middle \
                 one): --solve-exposure brings them together, unless the light was changed between them",
                100.0 * differ.exp_m1(),
                most.name,
                agreement.brighter().exp()
            )
        })
    }
}

/// A cell of surface that faces one way.
type Cell = ([i32; 3], u8);

impl ViewSurvey {
    /// Looks at an image; yields the mean ln of radiance per cell that it shows from the front.
    fn look(&mut self, backend: &mut dyn Backend, view: &View, image: &Rgb) -> Result<HashMap<Cell, [f64; 3]>> {
        let camera = &view.camera;
        let (known, usable) = (image.finite(), view.usable(image)?);
        let hits = backend.primary(camera, camera.rows())?;
        let mesh = backend.scene().mesh();
        let mut cells: HashMap<Cell, ([f64; 3], f64)> = HashMap::new();
        // Masks leave out lights, and with them what this is about.
        for (pixel, hit) in hits.iter().enumerate().filter(|(pixel, _)| known.data[*pixel]) {
            let place = [pixel % camera.width, pixel / camera.width];
            let bright = f64::from(luminance(&image.data[pixel]));
            let seen =
                LightShare::of(f64::from(camera.solid_angle(pixel)), bright, place.map(|at| at * view.reduction));
            self.all.add(seen);
            if !hit.is_hit() {
                self.open.add(seen);
                continue;
            }
            let front = mesh.face_normal(hit.triangle);
            let cosine = -front.dot(camera.direction_of(pixel));
            let radiance = image.data[pixel];
            if cosine < 0.0 {
                self.behind.add(seen);
            } else if cosine >= exposure::MIN_COSINE && usable.data[pixel] && radiance.iter().all(|r| *r > 0.0) {
                let at = hit.interpolate(mesh.corners(hit.triangle));
                let (sum, count) = cells.entry(cell(at, front)).or_default();
                (0..3).for_each(|c| sum[c] += f64::from(radiance[c]).ln());
                *count += 1.0;
            }
        }
        Ok(cells.into_iter().map(|(cell, (sum, count))| (cell, sum.map(|sum| sum / count))).collect())
    }
}

impl LightShare {
    fn of(directions: f64, radiance: f64, place: [usize; 2]) -> Self {
        let light = directions * radiance;
        Self { directions, light, brightest: (light, place) }
    }

    fn add(&mut self, other: Self) {
        self.directions += other.directions;
        self.light += other.light;
        if other.brightest.0 > self.brightest.0 {
            self.brightest = other.brightest;
        }
    }
}

fn cell(at: Vec3, front: Vec3) -> Cell {
    ((at / CELL).floor().as_ivec3().to_array(), facing(front) as u8)
}

/// Whether a value is another, but for what resampling does to it.
fn is_at(value: f32, other: f32) -> bool {
    (value - other).abs() <= 1e-3 * other
}

/// The largest value of an image, and the share of its pixels that have it in two channels or more.
fn largest(image: &Rgb) -> (f32, f64) {
    let most = image.data.iter().flatten().copied().filter(|v| v.is_finite()).fold(0.0, f32::max);
    let at_it = |pixel: &&[f32; 3]| pixel.iter().filter(|v| is_at(**v, most)).count() >= 2;
    let count = if most > 0.0 { image.data.iter().filter(at_it).count() } else { 0 };
    (most, count as f64 / image.data.len().max(1) as f64)
}

/// Compares the views by cells that several of them show; tells nothing where exposures cannot be told.
fn agreements(shown: &mut [ViewSurvey], mut cells: Vec<(Cell, Sighting)>) {
    cells.sort_unstable_by_key(|(cell, sighting)| (*cell, sighting.view));
    let of_cell = |cell: &[(Cell, Sighting)]| cell.iter().map(|(_, sighting)| *sighting).collect();
    let places: Vec<Vec<Sighting>> = cells.chunk_by(|a, b| a.0 == b.0).filter(|c| c.len() > 1).map(of_cell).collect();
    let Ok(exposures) = exposure::exposures(&places, shown.len()) else { return };
    let mut differences = vec![Vec::new(); shown.len()];
    for place in places.iter().filter(|place| place.len() >= JUDGES) {
        let rest = |s: &Sighting| (0..3).map(|c| s.log[c] - exposures[s.view][c]).sum::<f64>() as f32 / 3.0;
        let typical = median(&mut place.iter().map(rest).collect::<Vec<_>>());
        let of_view = |s: &Sighting| Some((s.view, (rest(s) - typical?).abs()));
        place.iter().filter_map(of_view).for_each(|(view, difference)| differences[view].push(difference));
    }
    for ((shown, exposure), mut off) in
        shown.iter_mut().zip(exposures).zip(differences).filter(|(_, d)| d.len() >= ENOUGH)
    {
        let exposure = exposure.map(|e| e as f32);
        shown.agreement = median(&mut off).map(|spread| Agreement { exposure, spread });
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use glam::{Mat4, Vec2};

    use super::*;
    use crate::camera::{Camera, Projection};
    use crate::capture::Split;
    use crate::cpu::CpuBackend;
    use crate::image_io::{write_png_mask, write_rgb};
    use crate::mesh::Mesh;
    use crate::progress::Silent;
    use crate::raster::Mask;
    use crate::scene::Scene;

    /// What a view shows of the square [−1, 1]² at z = 0, which faces up; its image is `1` but for one pixel, and
    /// masked where asked.
    fn shown(camera: Camera, bright: [usize; 2], masked: bool) -> ViewSurvey {
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let mesh = Mesh {
            positions: corners.map(|(x, y)| Vec3::new(x, y, 0.0)).to_vec(),
            normals: vec![Vec3::Z; 4],
            uvs: corners.map(|(x, y)| Vec2::new(0.5 * x + 0.5, 0.5 * y + 0.5)).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
        };
        let folder = tempfile::tempdir().unwrap();
        let [photo, mask] = ["photo.exr", "mask.png"].map(|name| folder.path().join(name));
        let (width, height) = (camera.width, camera.height);
        let mut image = Rgb::filled(width, height, [1.0; 3]);
        image.data[bright[1] * width + bright[0]] = [1e6; 3];
        write_rgb(&photo, &image).unwrap();
        write_png_mask(&mask, &Mask::filled(width, height, false)).unwrap();
        let view = View { mask: masked.then_some(mask), ..View::new("view".to_owned(), camera, Split::Train, photo) };
        let survey = Survey::new(&mut CpuBackend::new(Scene::new(mesh).unwrap()), &[view], &Silent).unwrap();
        survey.views()[0].clone()
    }

    #[test]
    fn a_wide_panorama_is_told_of_in_its_own_pixels() {
        let world_from_camera = Mat4::from_translation(Vec3::Z);
        let camera = Camera { projection: Projection::Equirectangular, width: 600, height: 300, world_from_camera };
        for masked in [false, true] {
            // 600 columns are looked at as 200, the third row and column of each three.
            let ViewSurvey { all, open, behind, .. } = shown(camera, [451, 44], masked);
            assert!((all.directions / (4.0 * PI) - 1.0).abs() < 1e-3, "{}", all.directions);
            // A square of 2 × 2 m, 1 m away, is a sixth of all directions.
            assert!((open.directions / all.directions - 5.0 / 6.0).abs() < 0.01, "{}", open.directions);
            assert_eq!((open.brightest.1, behind.directions), ([450, 42], 0.0));
            assert!(open.light > 0.9 * all.light);
        }
    }

    #[test]
    fn noise_is_told_of_where_most_views_have_it() {
        let camera = Camera {
            projection: Projection::Equirectangular,
            width: 256,
            height: 128,
            world_from_camera: Mat4::from_translation(Vec3::Z),
        };
        let sound = shown(camera, [0, 0], false);
        let told = |noises: [Option<f32>; 3]| {
            let views = noises.map(|noise| ViewSurvey { noise, ..sound.clone() });
            Survey(views.to_vec()).warnings().iter().any(|told| told.contains("noisy, by 8 %"))
        };
        assert!(told([Some(0.08), Some(0.09), Some(0.01)]));
        assert!(!told([Some(0.01), Some(0.09), Some(0.01)]));
        assert!(!told([None; 3]));
    }

    #[test]
    fn views_out_of_place_are_told_of_with_the_worst() {
        let view = |name: &str, out_of_place| ViewSurvey {
            name: name.to_owned(),
            out_of_place,
            behind: LightShare::default(),
            open: LightShare::default(),
            all: LightShare::default(),
            largest: (1.0, 0.0),
            noise: None,
            agreement: None,
        };
        let told = |[a, b, c]: [Option<f32>; 3]| Survey(vec![view("a", a), view("b", b), view("c", c)]).warnings();
        let warnings = told([Some(1.0), Some(7.0), None]);
        assert!(warnings.len() == 1 && warnings[0].contains("2 of 3 training views"), "{warnings:?}");
        assert!(warnings[0].contains("\"b\" most, by 7.0"), "{warnings:?}");
        assert_eq!(told([None; 3]), [""; 0]);
    }

    #[test]
    fn a_portrait_is_told_of_in_its_own_pixels() {
        // From below, turned around to look up: all that it sees is the square's back.
        let world_from_camera = Mat4::from_translation(-Vec3::Z) * Mat4::from_rotation_x(std::f32::consts::PI);
        let projection = Projection::Pinhole { fx: 600.0, fy: 600.0, cx: 150.0, cy: 270.0 };
        let camera = Camera { projection, width: 300, height: 540, world_from_camera };
        let ViewSurvey { all, open, behind, .. } = shown(camera, [100, 401], false);
        assert_eq!((behind.directions, open.directions), (all.directions, 0.0));
        assert_eq!(behind.brightest.1, [100, 400]);
        // Negative control: from above, the same camera sees its front.
        let above = Camera { world_from_camera: Mat4::from_translation(Vec3::Z), ..camera };
        assert_eq!(shown(above, [100, 401], false).behind.directions, 0.0);
    }
}
