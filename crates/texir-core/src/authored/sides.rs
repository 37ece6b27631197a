//! Which sides of double-sided surfaces are baked.
//!
//! A lightmap holds the light of one side of a surface. That is its front, unless light reaches its back alone: a
//! ceiling that faces up. Of sheets whose other side is seen by what the lightmap holds, and lit, that side is baked as
//! well, in rows of its own, for what it reflects and emits: leaves, curtains, walls between two rooms.

use std::collections::HashMap;
use std::ops::RangeInclusive;

use glam::{IVec3, Vec3};
use rayon::prelude::*;

use super::gltf::{Face, Model, OtherSide, Part};
use super::layout::{PlacedPart, placed};
use super::reach::{Patch, Random, Reach, SidesOfTriangle, Walk};
use super::shells::Shell;
use crate::atlas::MAX_SIDE;
use crate::environment::Environment;
use crate::error::{Result, listed};
use crate::progress::{Progress, Task};
use crate::rng::hash2;
use crate::scene::Scene;
use crate::surface::SurfacePoint;

/// A side is lit if this share of the walks from it finds light.
const LIT: f64 = 1.0 / 256.0;
/// It is dim if less than this share of those that find light from the other side do: what is inside of something has
/// cracks.
const OF_THE_OTHER: f64 = 1.0 / 16.0;
/// Other sides are left out over which, together, less than this share of the light comes to every place: what is seen
/// through cracks, and the backs of whole rooms.
const RARE: f64 = 1.0 / 32.0;
/// Places of all surfaces, about: a floor has little of its light from below one of its tables, but almost all of it
/// right there.
const CELLS: f32 = 2048.0;
/// Walks from a place.
const PER_CELL: f32 = 64.0;
/// At places that find less than this share of the light that the brightest surface does, that share of it counts.
const DARKEST: f64 = 1.0 / 16.0;
/// What emits at least this share of its material's mean is a lamp.
const SHINING: f32 = 1.0 / 16.0;
/// Walks of all double-sided surfaces together, from each of their sides, that ask whether it is lit.
const WALKS: u32 = 1 << 19;
/// Walks from a side of a surface.
const PER_SIDE: RangeInclusive<u32> = 16..=1024;
/// Surfaces that are looked at before progress is told.
const AT_ONCE: usize = 64;

/// What is baked of a shell.
#[derive(Clone, Copy)]
struct Choice {
    /// Whether the lightmap holds its back.
    is_turned: bool,
    /// Whether there is light on the side that the lightmap does not hold.
    is_other_lit: bool,
}

impl Model {
    /// Finds the sides of double-sided surfaces that are to be baked, under what rays see that leave the scene: those
    /// that the lightmap holds, which are fronts unless light reaches backs alone, and the others that matter to it.
    /// Without this, all surfaces have fronts alone; it is done once, before [`Model::scene`], whose errors it has. Says
    /// what the user should know of it.
    pub fn find_sides(&mut self, environment: Option<&Environment>, progress: &dyn Progress) -> Result<Option<String>> {
        let is_done = !self.other_sides.is_empty();
        if is_done || !self.parts.iter().any(|part| self.has_two_sides(part)) {
            return Ok(None);
        }
        let scene = self.scene()?;
        let shines = self.shining();
        let shells = self.shells(&shines);
        let reach = self.reach(&scene, &shells, shines, environment);
        let choices = choose(&reach, &shells, progress)?;
        let seen = self.seen(&reach, &shells, &choices, progress)?;
        drop(scene);

        let turned = || shells.iter().zip(&choices).filter(|(_, choice)| choice.is_turned).map(|(shell, _)| shell);
        self.turn(turned().flat_map(|shell| &shell.patch.triangles));
        let others: Vec<&Shell> = shells.iter().zip(seen).filter(|(_, seen)| *seen).map(|(shell, _)| shell).collect();
        let mut told = Vec::new();
        let mut names: Vec<String> = turned().map(|shell| format!("\"{}\"", self.parts[shell.part].name)).collect();
        names.dedup();
        if !names.is_empty() {
            told.push(format!(
                "the lightmap holds the light on the backs of double-sided surfaces whose fronts have none, in {} primitives: {}",
                names.len(),
                listed(&names)
            ));
        }
        if 2 * self.rows <= MAX_SIDE {
            self.add_other_sides(&others);
        } else if !others.is_empty() {
            told.push(format!(
                "double-sided surfaces reflect and emit light from the side that the lightmap holds alone: a map of {} rows leaves no \
                 room for the other; bake at most {}",
                self.rows,
                MAX_SIDE / 2
            ));
        }
        Ok((!told.is_empty()).then(|| told.join("; ")))
    }

    /// Whether triangles emit as much as their materials do on average, about.
    pub(super) fn shining(&self) -> Vec<bool> {
        let least = |part: &Part| {
            let emission = self.shading[self.shading_of(part)].emission.mean(&self.images).max_element();
            if emission > 0.0 && !part.is_transparent() { SHINING * emission } else { f32::INFINITY }
        };
        let least: Vec<f32> = self.parts.iter().map(least).collect();
        let shines = |(triangle, face): (usize, Face)| {
            least[face.part].is_finite() && self.emission(triangle as u32, face).max_element() >= least[face.part]
        };
        self.faces().into_par_iter().enumerate().map(shines).collect()
    }

    /// What light comes from, and what it meets.
    fn reach<'a>(
        &self,
        scene: &'a Scene,
        shells: &[Shell],
        shines: Vec<bool>,
        environment: Option<&Environment>,
    ) -> Reach<'a> {
        let of_triangle = |shines: bool| SidesOfTriangle { exist: [true, false], shines: [shines, false] };
        let mut sides: Vec<SidesOfTriangle> = shines.into_iter().map(of_triangle).collect();
        for shell in shells {
            for triangle in &shell.patch.triangles {
                let SidesOfTriangle { exist, shines } = &mut sides[*triangle as usize];
                exist[1] = true;
                shines[1] = shines[0] && shell.is_lamp;
            }
        }
        let lamps: Vec<u32> = (0..).zip(&sides).filter(|(_, sides)| sides.shines[0]).map(|(i, _)| i).collect();
        Reach {
            scene,
            sides,
            lamps: (!lamps.is_empty()).then(|| Patch::new(&self.mesh, lamps)),
            lights: self.lights.iter().map(|light| light.coefficients()).collect(),
            sky: environment.is_some_and(|sky| sky.radiance().data.iter().flatten().any(|v| *v > 0.0)),
        }
    }

    /// Of every shell, whether its other side matters to what the lightmap holds: whether light comes over it.
    fn seen(
        &self,
        reach: &Reach<'_>,
        shells: &[Shell],
        choices: &[Choice],
        progress: &dyn Progress,
    ) -> Result<Vec<bool>> {
        let mesh = &self.mesh;
        let mut shell_of: Vec<Option<u32>> = vec![None; mesh.triangles.len()];
        for (i, shell) in (0..).zip(shells) {
            shell.patch.triangles.iter().for_each(|triangle| shell_of[*triangle as usize] = Some(i));
        }
        let single_sided: Vec<Patch> = placed(&self.parts)
            .filter(|placed| !self.has_two_sides(placed.part))
            .map(|placed| Patch::new(mesh, placed.triangles.collect()))
            .collect();
        let shown = shells.iter().zip(choices).map(|(shell, choice)| (&shell.patch, choice.is_turned));
        let shown: Vec<(&Patch, bool)> = shown.chain(single_sided.iter().map(|patch| (patch, false))).collect();
        let area_of_all: f32 = shown.iter().map(|(patch, _)| patch.area).sum();
        let edge = (area_of_all / CELLS).sqrt();
        let walk_from = |mut cells: LightByCell, place: SurfacePoint, mut random: Random| {
            let light = cells.entry((Vec3::from(place.position) / edge).floor().as_ivec3()).or_default();
            let mut over = OverOthers { shell_of: &shell_of, choices, path: vec![], light };
            over.light.walks += 1;
            reach.walk(place, &mut random, &mut over);
            cells
        };
        let light = from_each(&shown, "sides that are seen", progress, |index, (patch, back)| {
            let walks = PER_CELL * CELLS * patch.area / area_of_all;
            let walks = 0..(walks as u32).max(*PER_SIDE.start());
            let add_walk = |cells: LightByCell, walk: u32| {
                let mut random = Random::new(hash2(walk, hash2(index, 2)));
                walk_from(cells, patch.place(mesh, *back, &mut random), random)
            };
            walks.into_par_iter().fold(LightByCell::new, add_walk).reduce(LightByCell::new, merged)
        })?;
        let share = |cells: &LightByCell| {
            let (found, walks) = cells.values().fold((0, 0), |(found, walks), l| (found + l.found, walks + l.walks));
            f64::from(found) / f64::from(walks.max(1))
        };
        let brightest = light.iter().map(share).fold(0.0, f64::max);
        let mut seen = vec![false; shells.len()];
        let essential = |light: LightOverOthers| {
            let found = f64::from(light.found).max(DARKEST * brightest * f64::from(light.walks));
            // One walk may be chance.
            light.essential((RARE * found).max(1.0), shells)
        };
        light.into_iter().flatten().flat_map(|(_, l)| essential(l)).for_each(|shell| seen[shell as usize] = true);
        Ok(seen)
    }

    /// Turns triangles of the mesh over, of which vertices are their own.
    fn turn<'a>(&mut self, triangles: impl Iterator<Item = &'a u32>) {
        let mut is_turned = vec![false; self.mesh.positions.len()];
        for triangle in triangles {
            let corners = &mut self.mesh.triangles[*triangle as usize];
            corners.swap(1, 2);
            for vertex in corners.map(|vertex| vertex as usize) {
                if !std::mem::replace(&mut is_turned[vertex], true) {
                    self.mesh.normals[vertex] = -self.mesh.normals[vertex];
                }
            }
        }
    }

    /// Adds the other sides of shells to the mesh, below the lightmap's rows.
    fn add_other_sides(&mut self, shells: &[&Shell]) {
        if shells.is_empty() {
            return;
        }
        let mesh = &mut self.mesh;
        self.size[1] = 2 * self.rows;
        mesh.uvs.iter_mut().for_each(|uv| uv.y *= 0.5);
        let mut of_part = shells.chunk_by(|a, b| a.part == b.part).peekable();
        for PlacedPart { index, vertices, triangles: of_mesh, .. } in placed(&self.parts) {
            let Some(shells) = of_part.next_if(|shells| shells[0].part == index) else { continue };
            let added = mesh.positions.len();
            mesh.positions.extend_from_within(vertices.clone());
            mesh.normals.extend_from_within(vertices.clone());
            mesh.uvs.extend_from_within(vertices.clone());
            mesh.normals[added..].iter_mut().for_each(|normal| *normal = -*normal);
            mesh.uvs[added..].iter_mut().for_each(|uv| uv.y += 0.5);
            let triangles = || shells.iter().flat_map(|shell| &shell.patch.triangles);
            for triangle in triangles() {
                let moved = (added - vertices.start) as u32;
                let [a, b, c] = mesh.triangles[*triangle as usize].map(|vertex| vertex + moved);
                mesh.triangles.push([a, c, b]);
            }
            let triangles = triangles().map(|triangle| triangle - of_mesh.start).collect();
            self.other_sides.push(OtherSide { part: index, triangles });
        }
    }
}

/// Which side of every shell the lightmap is to hold, and whether there is light on the other.
fn choose(reach: &Reach<'_>, shells: &[Shell], progress: &dyn Progress) -> Result<Vec<Choice>> {
    let walks = (WALKS / shells.len().max(1) as u32).clamp(*PER_SIDE.start(), *PER_SIDE.end());
    from_each(shells, "sides that are lit", progress, |index, shell| {
        let found = [false, true].map(|back| {
            let finds_light = |walk: &u32| {
                let mut random = Random::new(hash2(*walk, hash2(index, u32::from(back))));
                let place = shell.patch.place(reach.scene.mesh(), back, &mut random);
                let mut any = AnyLight { sides: &reach.sides, is_found: false };
                reach.walk(place, &mut random, &mut any);
                any.is_found
            };
            (0..walks).filter(finds_light).count() as f64
        });
        let is_lit = |side: usize| found[side] >= LIT * f64::from(walks);
        let is_dim = |side: usize| found[side] < OF_THE_OTHER * found[1 - side];
        Choice {
            is_turned: is_lit(1) && is_dim(0),
            is_other_lit: shell.is_lamp || [0, 1].into_iter().all(|side| is_lit(side) && !is_dim(side)),
        }
    })
}

/// A walk until there is light.
struct AnyLight<'a> {
    sides: &'a [SidesOfTriangle],
    is_found: bool,
}

impl Walk for AnyLight<'_> {
    fn meets(&mut self, triangle: u32, back: bool) -> bool {
        self.sides[triangle as usize].exist[usize::from(back)]
    }

    fn finds(&mut self, _: Option<(u32, bool)>) -> bool {
        self.is_found = true;
        false
    }
}

/// Walks over what the lightmap holds and over other sides that are lit.
struct OverOthers<'a> {
    shell_of: &'a [Option<u32>],
    choices: &'a [Choice],
    /// The shells whose other sides were met on the way.
    path: Vec<u32>,
    light: &'a mut LightOverOthers,
}

impl Walk for OverOthers<'_> {
    fn meets(&mut self, triangle: u32, back: bool) -> bool {
        let Some(shell) = self.shell_of[triangle as usize] else {
            return !back;
        };
        let Choice { is_turned, is_other_lit } = self.choices[shell as usize];
        let is_other = back != is_turned;
        if is_other && is_other_lit {
            self.path.push(shell);
        }
        !is_other || is_other_lit
    }

    fn finds(&mut self, lamp: Option<(u32, bool)>) -> bool {
        // The lamp's own side is on the way of this light alone.
        let length = self.path.len();
        if lamp.is_none_or(|(triangle, back)| self.meets(triangle, back)) {
            self.light.add(&self.path);
        }
        self.path.truncate(length);
        true
    }
}

/// What walks found, by the cell of space that they set out from.
type LightByCell = HashMap<IVec3, LightOverOthers>;

/// What all walks of both found.
fn merged(mut all: LightByCell, others: LightByCell) -> LightByCell {
    for (cell, others) in others {
        let light = all.entry(cell).or_default();
        (light.walks, light.found) = (light.walks + others.walks, light.found + others.found);
        others.over.into_iter().for_each(|(shell, walks)| *light.over.entry(shell).or_default() += walks);
    }
    all
}

/// How often walks from a place found light.
#[derive(Default)]
struct LightOverOthers {
    walks: u32,
    found: u32,
    /// By the shells over whose other sides they went.
    over: HashMap<u32, u32>,
}

impl LightOverOthers {
    /// Light was found over the other sides of shells.
    fn add(&mut self, path: &[u32]) {
        self.found += 1;
        let firsts = (0..path.len()).filter(|&i| !path[..i].contains(&path[i]));
        firsts.for_each(|i| *self.over.entry(path[i]).or_default() += 1);
    }

    /// Of the shells those that are worth their area: without those over which, together, so many walks went at most.
    fn essential(self, rare: f64, shells: &[Shell]) -> impl Iterator<Item = u32> {
        let per_area = |(shell, walks): (u32, u32)| (walks as f32 / shells[shell as usize].patch.area, shell, walks);
        let mut over: Vec<(f32, u32, u32)> = self.over.into_iter().map(per_area).collect();
        over.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut sum = 0.0;
        over.into_iter().filter_map(move |(_, shell, walks)| {
            sum += f64::from(walks);
            (sum > rare).then_some(shell)
        })
    }
}

/// What is found of surfaces, each by its index.
fn from_each<S: Sync, T: Send>(
    surfaces: &[S],
    label: &str,
    progress: &dyn Progress,
    find: impl Fn(u32, &S) -> T + Sync,
) -> Result<Vec<T>> {
    let _task = Task::start(progress, label, surfaces.len() as u64, "surfaces");
    let mut found = Vec::with_capacity(surfaces.len());
    for (chunk, first) in surfaces.chunks(AT_ONCE).zip((0..).step_by(AT_ONCE)) {
        progress.check()?;
        found.par_extend(chunk.par_iter().enumerate().map(|(i, surface)| find(first + i as u32, surface)));
        progress.advance(chunk.len() as u64);
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;

    #[test]
    fn shells_over_which_little_light_comes_are_left_out_those_of_the_largest_area_first() {
        // Triangles of 18, 2, 0.5 and 0.5 m².
        let corners = |size: f32| [glam::Vec3::ZERO, size * glam::Vec3::X, size * glam::Vec3::Y];
        let mesh = Mesh {
            positions: [6.0, 2.0, 1.0, 1.0].into_iter().flat_map(corners).collect(),
            triangles: (0..4).map(|t| [0, 1, 2].map(|k| 3 * t + k)).collect(),
            ..Mesh::default()
        };
        let shell = |t: u32| Shell { part: 0, patch: Patch::new(&mesh, vec![t]), is_lamp: false };
        let shells: Vec<Shell> = (0..4).map(shell).collect();
        let essential = |rare: f64| {
            let mut light = LightOverOthers::default();
            for (shell, walks) in [(0, 4), (1, 2), (3, 1), (2, 9)] {
                (0..walks).for_each(|_| light.add(&[shell, shell]));
            }
            assert_eq!(light.found, 16);
            light.essential(rare, &shells).collect::<Vec<_>>()
        };
        assert_eq!(essential(0.0), [0, 1, 3, 2]);
        assert_eq!(essential(4.0), [1, 3, 2]);
        assert_eq!(essential(6.9), [3, 2]);
        assert!(essential(16.0).is_empty());
    }
}
