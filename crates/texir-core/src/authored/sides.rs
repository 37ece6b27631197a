//! Which sides of double-sided surfaces are baked.
//!
//! A lightmap holds the light of one side of a surface. That is its front, unless light reaches its back alone: a
//! ceiling that faces up. Of sheets whose other side is seen by what the lightmap holds, and lit, that side is baked as
//! well, in rows of its own, for what it reflects and emits: leaves, curtains, walls between two rooms.

use std::collections::HashMap;
use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use rayon::prelude::*;

use super::gltf::{Model, OtherSide, Part};
use super::reach::{Patch, Random, Reach, SidesOfTriangle};
use crate::atlas::MAX_SIDE;
use crate::disjoint_sets::DisjointSets;
use crate::environment::Environment;
use crate::error::{Result, listed};
use crate::mesh::weld;
use crate::progress::{Progress, Task};
use crate::rng::hash2;
use crate::scene::Scene;

/// A side is lit if this share of the walks from it finds light,
const LIT: f64 = 1.0 / 256.0;
/// and this share of those that do from the other side. What is inside of something has cracks.
const OF_THE_OTHER: f64 = 1.0 / 16.0;
/// Walks of all surfaces together, from each of their sides.
const WALKS: usize = 1 << 19;
/// Walks from a side of a surface.
const PER_SIDE: RangeInclusive<usize> = 16..=1024;
/// Surfaces that are looked at before progress is told.
const AT_ONCE: usize = 64;

/// A connected piece of a double-sided primitive.
struct Shell {
    part: usize,
    patch: Patch,
    /// Whether both of its sides shine. Nobody sees the inside of a lamp that is closed.
    is_lamp: bool,
}

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
    /// Without this, all surfaces have fronts alone. Says what the user should know of it; errors as [`Model::scene`].
    pub fn find_sides(&mut self, environment: Option<&Environment>, progress: &dyn Progress) -> Result<Option<String>> {
        let shells = self.shells();
        if shells.is_empty() {
            return Ok(None);
        }
        let scene = self.scene()?;
        let reach = self.reach(&scene, &shells, environment);
        let choices = choose(&reach, &shells, progress)?;
        let seen = self.seen(&reach, &shells, &choices, progress)?;
        drop(scene);

        let turned = || shells.iter().zip(&choices).filter(|(_, choice)| choice.is_turned).map(|(shell, _)| shell);
        self.turn(turned().flat_map(|shell| &shell.patch.triangles));
        let needed = |(shell, choice): &(&Shell, &Choice)| choice.is_other_lit && seen[shell.part];
        let others: Vec<&Shell> = shells.iter().zip(&choices).filter(needed).map(|(shell, _)| shell).collect();
        let mut told = Vec::new();
        let mut names: Vec<String> = turned().map(|shell| format!("\"{}\"", self.parts[shell.part].name)).collect();
        names.dedup();
        if !names.is_empty() {
            told.push(format!(
                "the lightmap holds the light on the backs of {} double-sided surfaces, whose fronts have none: {}",
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

    /// The pieces of all double-sided primitives.
    fn shells(&self) -> Vec<Shell> {
        let mut first = 0;
        let mut shells = Vec::new();
        for (i, part) in self.parts.iter().enumerate() {
            if self.is_double_sided(part) && !part.is_transparent() {
                let shines = self.shines(part);
                shells.extend(pieces(part).into_iter().map(|triangles| Shell {
                    part: i,
                    is_lamp: shines && !is_closed(&triangles),
                    patch: Patch::new(&self.mesh, triangles.iter().map(|(index, _)| first + index).collect()),
                }));
            }
            first += part.triangles.len() as u32;
        }
        shells
    }

    fn shines(&self, part: &Part) -> bool {
        self.shading[self.shading_of(part)].emission.mean(&self.images).max_element() > 0.0
    }

    /// What light comes from, and what it meets.
    fn reach<'a>(&self, scene: &'a Scene, shells: &[Shell], environment: Option<&Environment>) -> Reach<'a> {
        let mut sides = Vec::with_capacity(self.mesh.triangles.len());
        for part in &self.parts {
            let of_part = SidesOfTriangle {
                reflects: [true, self.is_double_sided(part)],
                shines: [self.shines(part) && !part.is_transparent(), false],
            };
            sides.extend(std::iter::repeat_n(of_part, part.triangles.len()));
        }
        for triangle in shells.iter().filter(|shell| shell.is_lamp).flat_map(|shell| &shell.patch.triangles) {
            sides[*triangle as usize].shines = [true; 2];
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

    /// Of every part, whether what the lightmap holds sees the other, lit side of one of its shells, directly or over
    /// other surfaces.
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
        let seen: Vec<AtomicBool> = self.parts.iter().map(|_| AtomicBool::new(false)).collect();
        let reflects = |triangle: u32, back: bool| {
            let Some(shell) = shell_of[triangle as usize].map(|shell| shell as usize) else {
                return !back;
            };
            let is_other = back != choices[shell].is_turned;
            if is_other && choices[shell].is_other_lit {
                seen[shells[shell].part].store(true, Relaxed);
            }
            !is_other || choices[shell].is_other_lit
        };
        let mut first = 0;
        let single_sided: Vec<Patch> = (self.parts.iter())
            .filter_map(|part| {
                let triangles = first..first + part.triangles.len() as u32;
                first = triangles.end;
                (!self.is_double_sided(part)).then(|| Patch::new(mesh, triangles.collect()))
            })
            .collect();
        let shown = shells.iter().zip(choices).map(|(shell, choice)| (&shell.patch, choice.is_turned));
        let shown: Vec<(&Patch, bool)> = shown.chain(single_sided.iter().map(|patch| (patch, false))).collect();
        from_each(&shown, "sides that are seen", progress, |index, (patch, back), walks| {
            for walk in 0..walks {
                let mut random = Random::new(hash2(walk, hash2(index, 2)));
                let place = patch.place(mesh, *back, &mut random);
                reach.walk(place, &mut random, reflects);
            }
        })?;
        Ok(seen.into_iter().map(AtomicBool::into_inner).collect())
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
        let (mut vertices, mut first_triangle) = (0..0, 0);
        for (i, part) in self.parts.iter().enumerate() {
            vertices = vertices.end..vertices.end + part.positions.len();
            if let Some(shells) = of_part.next_if(|shells| shells[0].part == i) {
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
                let triangles = triangles().map(|triangle| triangle - first_triangle).collect();
                self.other_sides.push(OtherSide { part: i, triangles });
            }
            first_triangle += part.triangles.len() as u32;
        }
    }
}

/// Which side of every shell the lightmap is to hold, and whether there is light on the other.
fn choose(reach: &Reach<'_>, shells: &[Shell], progress: &dyn Progress) -> Result<Vec<Choice>> {
    from_each(shells, "sides that are lit", progress, |index, shell, walks| {
        let found = [false, true].map(|back| {
            let finds_light = |walk: &u32| {
                let mut random = Random::new(hash2(*walk, hash2(index, u32::from(back))));
                let place = shell.patch.place(reach.scene.mesh(), back, &mut random);
                reach.finds_light(place, &mut random)
            };
            (0..walks).filter(finds_light).count() as f64
        });
        let is_lit = |side: usize| found[side] >= (LIT * f64::from(walks)).max(OF_THE_OTHER * found[1 - side]);
        let [front, back] = [0, 1].map(is_lit);
        let is_turned = back && !front;
        Choice { is_turned, is_other_lit: shell.is_lamp || (front && back) }
    })
}

/// What is found of surfaces, each by its index and with so many walks.
fn from_each<S: Sync, T: Send>(
    surfaces: &[S],
    label: &str,
    progress: &dyn Progress,
    find: impl Fn(u32, &S, u32) -> T + Sync,
) -> Result<Vec<T>> {
    let walks = (WALKS / surfaces.len().max(1)).clamp(*PER_SIDE.start(), *PER_SIDE.end()) as u32;
    let _task = Task::start(progress, label, surfaces.len() as u64, "surfaces");
    let mut found = Vec::with_capacity(surfaces.len());
    for (chunk, first) in surfaces.chunks(AT_ONCE).zip((0..).step_by(AT_ONCE)) {
        progress.check()?;
        found.par_extend(chunk.par_iter().enumerate().map(|(i, surface)| find(first + i as u32, surface, walks)));
        progress.advance(chunk.len() as u64);
    }
    Ok(found)
}

/// The connected pieces of a part, by the places of its vertices: the index of every triangle, and the places of its
/// corners.
fn pieces(part: &Part) -> Vec<Vec<(u32, [u32; 3])>> {
    // Zero has one sign.
    let (places, firsts) = weld(part.positions.iter().map(|p| p.to_array().map(|v| (v + 0.0).to_bits())));
    let mut sets = DisjointSets::new(firsts.len());
    let corners = |triangle: &[u32; 3]| triangle.map(|vertex| places[vertex as usize]);
    for [a, b, c] in part.triangles.iter().map(corners) {
        sets.join(a, b);
        sets.join(b, c);
    }
    let (mut pieces, mut numbers) = (Vec::<Vec<_>>::new(), HashMap::new());
    for (index, triangle) in (0..).zip(&part.triangles) {
        let corners = corners(triangle);
        let number = *numbers.entry(sets.root(corners[0])).or_insert_with(|| {
            pieces.push(Vec::new());
            pieces.len() - 1
        });
        pieces[number].push((index, corners));
    }
    pieces
}

/// Whether every edge of triangles is one of two that run opposite ways.
fn is_closed(triangles: &[(u32, [u32; 3])]) -> bool {
    let mut balance = HashMap::new();
    for (_, [a, b, c]) in triangles {
        for [from, to] in [[a, b], [b, c], [c, a]] {
            *balance.entry([from.min(to), from.max(to)]).or_insert(0i32) += if from < to { 1 } else { -1 };
        }
    }
    balance.values().all(|balance| *balance == 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A part of triangles whose corners are integers in the plane.
    fn part(triangles: &[[[i8; 3]; 3]]) -> Part {
        let corners = triangles.as_flattened().iter();
        Part {
            positions: corners.map(|corner| corner.map(f32::from).into()).collect(),
            normals: vec![],
            uvs: vec![],
            has_uvs: vec![],
            triangles: (0..triangles.len() as u32).map(|t| [0, 1, 2].map(|k| 3 * t + k)).collect(),
            material: None,
            name: String::new(),
            opacity: vec![],
        }
    }

    #[test]
    fn pieces_are_told_by_their_places_and_closed_ones_by_their_edges() {
        let [o, x, y, z] = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]];
        let tetrahedron = [[o, y, x], [o, x, z], [o, z, y], [x, y, z]];
        let far = [[9, 0, 0], [8, 0, 0], [9, 1, 0]];
        let [solid, alone] = &pieces(&part(&[&tetrahedron[..2], &[far], &tetrahedron[2..]].concat()))[..] else {
            panic!("two pieces");
        };
        assert_eq!(solid.iter().map(|(index, _)| *index).collect::<Vec<_>>(), [0, 1, 3, 4]);
        assert!(is_closed(solid) && !is_closed(alone));
        // Open on one side, and closed by a face that is turned around.
        let closed = |triangles: &[_]| is_closed(&pieces(&part(triangles))[0]);
        assert!(!closed(&tetrahedron[1..]));
        assert!(!closed(&[&tetrahedron[1..], &[[o, x, y]]].concat()));
    }
}
