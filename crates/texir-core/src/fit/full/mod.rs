//! The fit in full mode: light samples drawn once, albedo by robust least squares, roughness by a scan per segment.
//!
//! observations → segments → scan → hierarchy → albedo. No ray is traced after the observations.

pub mod albedo;
pub mod hierarchy;
pub mod neighbours;
pub mod observations;
pub mod palette;
pub mod scan;
pub mod segments;

use glam::Vec3A;
use rayon::prelude::*;

use super::{Ground, Materials};
use crate::backend::Backend;
use crate::bake;
use crate::capture::View;
use crate::error::Result;
use crate::fit::settings::FullSettings;
use crate::progress::Progress;
use albedo::AlbedoProblem;
use hierarchy::{Level, settle};
use neighbours::{NONE, Neighbours};
use observations::{Observations, Observer};
use segments::Segments;

/// Fits the materials. The backend holds the full TBL and its lights.
pub fn fit(
    backend: &mut dyn Backend,
    ground: &Ground<'_>,
    training: &[View],
    settings: &FullSettings,
    progress: &dyn Progress,
) -> Result<Materials> {
    let Ground { scene, atlas, .. } = *ground;
    let observer = Observer { scene, atlas, emitters: ground.emitters, settings, seed: ground.seed };
    let seen = observer.observe(backend, training, progress)?;
    let neighbours = Neighbours::new(&scene.mesh, atlas);
    let segments = segments::segment(atlas, &neighbours, &seen, ground.plan);
    let irradiance: Vec<Vec3A> =
        atlas.texels.iter().map(|&t| Vec3A::from(ground.irradiance.data[t as usize])).collect();
    let segment = (&segments.segment[..], segments.count);
    let problem = AlbedoProblem::new(&seen, &irradiance, &neighbours, segment, &settings.albedo);

    let mut albedo = problem.start();
    let evidence = scan::scan(&problem, &settings.roughness, &mut albedo, progress)?;
    let roughness = roughness(&problem, &segments, &evidence, settings);

    let seen_roughness: Vec<f32> = looked_up(&seen, &roughness);
    let specular: Vec<Vec3A> =
        (&seen.curves, &seen_roughness).into_par_iter().map(|(c, r)| Vec3A::from(c.at(*r).0)).collect();
    let sigma = problem.noise(settings.albedo.image_noise);
    let AlbedoSettings { rounds, iterations, .. } = settings.albedo;
    problem.solve(&mut albedo, &specular, &sigma, rounds, iterations);

    let plain: Vec<[f32; 3]> = albedo.iter().map(|a| a.to_array()).collect();
    let all = vec![true; plain.len()];
    Ok(Materials {
        albedo: atlas.scatter_padded(&plain, &all, [0.0; 3], bake::PADDING),
        roughness: atlas.scatter_padded(&roughness, &all, 0.0, bake::PADDING),
        irradiance: ground.irradiance.clone(),
    })
}
use crate::fit::settings::AlbedoSettings;

fn looked_up(seen: &Observations, texels: &[f32]) -> Vec<f32> {
    (0..seen.len())
        .into_par_iter()
        .map(|p| seen.rows.row(p).iter().map(|tap| texels[tap.texel as usize] * tap.weight).sum())
        .collect()
}

/// Roughness of every texel: everything → class → class in a room → segment.
fn roughness(
    problem: &AlbedoProblem<'_>,
    segments: &Segments,
    evidence: &scan::Evidence,
    settings: &FullSettings,
) -> Vec<f32> {
    let s = &settings.roughness;
    // Any texel of a segment, for what all its texels share.
    let mut some_texel = vec![0usize; segments.count];
    segments.segment.iter().enumerate().for_each(|(t, s)| some_texel[*s as usize] = t);
    let of_pixels = |group: &dyn Fn(usize) -> u32| -> Vec<u32> {
        evidence.segment.iter().map(|&s| if s == NONE { NONE } else { group(some_texel[s as usize]) }).collect()
    };
    let _ = problem;
    let all = settle(
        evidence,
        &Level { group: &of_pixels(&|_| 0), parent: &[s.start], pull: s.class_pull, half_believed: 0.0 },
    );
    let classes = usize::from(segments.class.iter().copied().max().unwrap_or(0)) + 1;
    let class = settle(
        evidence,
        &Level {
            group: &of_pixels(&|t| u32::from(segments.class[t])),
            parent: &vec![all[0]; classes],
            pull: s.class_pull,
            half_believed: 0.0,
        },
    );
    let rooms = segments.class_in_room.iter().copied().max().unwrap_or(0) as usize + 1;
    let mut parent = vec![all[0]; rooms];
    for (t, r) in segments.class_in_room.iter().enumerate() {
        parent[*r as usize] = class[usize::from(segments.class[t])];
    }
    let room = settle(
        evidence,
        &Level {
            group: &of_pixels(&|t| segments.class_in_room[t]),
            parent: &parent,
            pull: s.room_pull,
            half_believed: 0.0,
        },
    );
    let parent: Vec<f32> = some_texel.iter().map(|&t| room[segments.class_in_room[t] as usize]).collect();
    let segment = settle(
        evidence,
        &Level { group: &evidence.segment, parent: &parent, pull: s.segment_pull, half_believed: 0.0 },
    );
    segments.segment.iter().map(|&i| segment[i as usize].min(s.cap)).collect()
}
