//! Packs charts into one atlas, turns them into a mesh, and paints the ground-truth textures.

use glam::{IVec2, Vec2, Vec3};
use rayon::prelude::*;

use super::chart::{Chart, Point};
use super::paint::Texel;
use super::{Flat, FlatOptions, Room};
use crate::error::{Error, Result};
use crate::mesh::{Mesh, cross};
use crate::raster::{Gray, Labels, Raster, Rgb};

/// Charts start and end at multiples of this many texels, so that the atlas at half resolution, in which indirect light
/// is solved, has the same charts at whole texels.
const ALIGN: usize = 2;
/// Texels between charts, and half of it around the atlas.
pub(super) const GUTTER: usize = 4;
/// How far the textures continue beyond their charts, texels.
const DILATION: usize = 4;

/// A chart's rectangle in the atlas, texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ChartRect {
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
}

impl ChartRect {
    /// Chart coordinates (metres) of the centre of texel (`x`, `y`) of the atlas scaled by 1/`shrink`.
    pub fn chart_point(&self, size: Vec2, x: usize, y: usize, shrink: usize) -> Vec2 {
        let texel = Vec2::new(x as f32 + 0.5, y as f32 + 0.5) * shrink as f32;
        let along =
            (texel - Vec2::new(self.x as f32, self.y as f32)) / Vec2::new(self.width as f32, self.height as f32);
        Vec2::new(along.x, 1.0 - along.y) * size
    }

    /// Atlas coordinates (texels, y down) of chart coordinates `st`.
    fn texel(&self, size: Vec2, st: Vec2) -> Vec2 {
        let along = st / size;
        Vec2::new(self.x as f32 + along.x * self.width as f32, self.y as f32 + (1.0 - along.y) * self.height as f32)
    }
}

/// The area of a chart in texels at `density` texels per metre.
fn footprint(chart: &Chart, density: f32) -> [usize; 2] {
    let texels = |length: f32| ((length * density / ALIGN as f32).round() as usize).max(1) * ALIGN;
    let size = chart.size();
    [texels(size.x), texels(size.y)]
}

/// Places the charts, as large as they fit into a `side`² atlas. Returns the density in texels per metre.
pub(super) fn pack(charts: &[Chart], side: usize) -> Result<(Vec<ChartRect>, f32)> {
    let area: f32 = charts.iter().map(|c| c.size().x * c.size().y).sum();
    let mut best = None;
    let (mut low, mut high) = (0.0, side as f32 / area.max(1e-6).sqrt());
    for _ in 0..14 {
        let density = 0.5 * (low + high);
        match place_all(charts, side, density) {
            Some(places) => (low, best) = (density, Some((places, density))),
            None => high = density,
        }
    }
    best.ok_or_else(|| {
        Error::invalid(format!(
            "the demo's {} charts do not fit into an atlas of {side}²: use a larger atlas",
            charts.len()
        ))
    })
}

/// Skyline packing, bottom-left, tallest first (Jylänki, "A Thousand Ways to Pack the Bin", 2010).
fn place_all(charts: &[Chart], side: usize, density: f32) -> Option<Vec<ChartRect>> {
    let sizes: Vec<[usize; 2]> = charts.iter().map(|c| footprint(c, density)).collect();
    let mut order: Vec<usize> = (0..charts.len()).collect();
    order.sort_by_key(|&i| (std::cmp::Reverse(sizes[i][1]), std::cmp::Reverse(sizes[i][0]), i));
    // The skyline: (x, y) of every step, left to right; everything above y is taken.
    let mut steps = vec![(GUTTER / 2, GUTTER / 2)];
    let mut places = vec![ChartRect { x: 0, y: 0, width: 0, height: 0 }; charts.len()];
    for i in order {
        let [width, height] = sizes[i];
        let (w, h) = (width + GUTTER, height + GUTTER);
        let fit = |start: usize| {
            let x = steps[start].0;
            let y = steps[start..].iter().take_while(|step| step.0 < x + w).map(|step| step.1).max()?;
            (x + w <= side && y + h <= side).then_some((y, x))
        };
        let (y, x) = (0..steps.len()).filter_map(fit).min()?;
        places[i] = ChartRect { x, y, width, height };
        let level_behind = steps.iter().rev().find(|step| step.0 <= x + w).map_or(GUTTER / 2, |step| step.1);
        steps.retain(|step| step.0 < x || step.0 >= x + w);
        let at = steps.partition_point(|step| step.0 < x);
        steps.insert(at, (x, y + h));
        if x + w < side && steps.get(at + 1).is_none_or(|next| next.0 > x + w) {
            steps.insert(at + 1, (x + w, level_behind));
        }
    }
    Some(places)
}

/// The centre of every texel that lies on a chart, at 1/`shrink` of the atlas' resolution, in the order of the charts.
pub(super) struct TexelPoint {
    /// Index into the shrunken atlas, row by row.
    pub texel: usize,
    /// Which chart.
    pub chart: usize,
    /// The surface there; `None` in a hole of the chart.
    pub point: Option<Point>,
}

/// All texels on charts; see [`TexelPoint`].
pub(super) fn texel_points(charts: &[Chart], places: &[ChartRect], side: usize, shrink: usize) -> Vec<TexelPoint> {
    let side = side / shrink;
    let of_chart = |(chart, place): (usize, &ChartRect)| {
        let (x0, y0) = (place.x / shrink, place.y / shrink);
        let (w, h) = (place.width / shrink, place.height / shrink);
        let (shape, place) = (&charts[chart], *place);
        (y0..y0 + h).flat_map(move |y| {
            (x0..x0 + w).map(move |x| {
                let point = shape.at(place.chart_point(shape.size(), x, y, shrink));
                TexelPoint { texel: y * side + x, chart, point }
            })
        })
    };
    places.par_iter().enumerate().flat_map_iter(of_chart).collect()
}

/// Packs, meshes and paints: everything of a [`Flat`] that follows from its charts.
pub(super) fn build(charts: Vec<Chart>, rooms: Vec<Room>, options: &FlatOptions) -> Result<Flat> {
    let side = options.atlas;
    let (places, texels_per_metre) = pack(&charts, side)?;
    let mut mesh = Mesh::default();
    let mut chart_of = Vec::new();
    for (index, (chart, place)) in charts.iter().zip(&places).enumerate() {
        append(&mut mesh, chart, place, side);
        chart_of.resize(mesh.triangles.len(), index as u32);
    }

    let texels = texel_points(&charts, &places, side, 1);
    let painted: Vec<Texel> = texels
        .par_iter()
        .map(|t| {
            let (x, y) = (t.texel % side, t.texel / side);
            let size = charts[t.chart].size();
            let st = places[t.chart].chart_point(size, x, y, 1);
            charts[t.chart].look.paint.at(st, size, options.paint, options.roughness_variation)
        })
        .collect();
    let texture = |value: &dyn Fn(&Texel) -> [f32; 3]| {
        let mut map = Raster::filled(side, side, None);
        texels.iter().zip(&painted).for_each(|(t, painted)| map.data[t.texel] = Some(value(painted)));
        dilate(&mut map, DILATION);
        map.map(|v| v.unwrap_or([0.0; 3]))
    };
    let label = |value: &dyn Fn(&Chart) -> u16| {
        let mut map = Raster::filled(side, side, None);
        texels.iter().for_each(|t| map.data[t.texel] = Some(value(&charts[t.chart])));
        dilate(&mut map, DILATION);
        map.map(|v| v.unwrap_or(0))
    };
    let albedo: Rgb = texture(&|t| t.albedo.to_array());
    let roughness: Gray = texture(&|t| [t.roughness; 3]).map(|v| v[0]);
    let emission: Rgb = texture(&|t| t.emission.to_array());
    let semantic: Labels = label(&|c| c.look.class);
    let room: Labels = label(&|c| c.look.room);
    Ok(Flat { mesh, albedo, roughness, emission, semantic, room, rooms, texels_per_metre, charts, places, chart_of })
}

/// Appends a chart's triangles: every cell is cut along the diagonal from its lower left to its upper right corner.
fn append(mesh: &mut Mesh, chart: &Chart, place: &ChartRect, side: usize) {
    let base = mesh.positions.len() as u32;
    let (columns, rows) = (chart.columns.len(), chart.rows.len());
    for (r, &t) in chart.rows.iter().enumerate() {
        for (c, &s) in chart.columns.iter().enumerate() {
            let point = chart.corner(c, r);
            mesh.positions.push(point.position);
            mesh.normals.push(point.normal);
            mesh.uvs.push(place.texel(chart.size(), Vec2::new(s, t)) / side as f32);
        }
    }
    for r in 0..rows - 1 {
        for c in (0..columns - 1).filter(|&c| chart.is_solid(c, r)) {
            let at = |c: usize, r: usize| base + (r * columns + c) as u32;
            for corners in [[at(c, r), at(c + 1, r), at(c + 1, r + 1)], [at(c, r), at(c + 1, r + 1), at(c, r + 1)]] {
                // The poles of a sphere are rows of one point.
                if cross(corners.map(|i| mesh.positions[i as usize])) != Vec3::ZERO {
                    mesh.triangles.push(corners);
                }
            }
        }
    }
}

/// Fills empty texels from their known 8-neighbours' mean (labels: the first one), `rounds` texels far.
pub(super) fn dilate<T: Copy + Blend>(map: &mut Raster<Option<T>>, rounds: usize) {
    const AROUND: [IVec2; 8] = [
        IVec2::new(-1, 0),
        IVec2::new(1, 0),
        IVec2::new(0, -1),
        IVec2::new(0, 1),
        IVec2::new(-1, -1),
        IVec2::new(1, -1),
        IVec2::new(-1, 1),
        IVec2::new(1, 1),
    ];
    let [width, height] = map.size();
    for _ in 0..rounds {
        let filled: Vec<(usize, T)> = (0..map.data.len())
            .filter(|&i| map.data[i].is_none())
            .filter_map(|i| {
                let here = IVec2::new((i % width) as i32, (i / width) as i32);
                let known: Vec<T> = AROUND
                    .iter()
                    .map(|&d| here + d)
                    .filter(|p| p.x >= 0 && p.y >= 0 && p.x < width as i32 && p.y < height as i32)
                    .filter_map(|p| *map.at(p.x as usize, p.y as usize))
                    .collect();
                (!known.is_empty()).then(|| (i, T::blend(&known)))
            })
            .collect();
        if filled.is_empty() {
            return;
        }
        filled.into_iter().for_each(|(i, value)| map.data[i] = Some(value));
    }
}

/// How several known neighbours make one value.
pub(super) trait Blend: Sized {
    /// From at least one value.
    fn blend(known: &[Self]) -> Self;
}

impl Blend for [f32; 3] {
    fn blend(known: &[Self]) -> Self {
        let sum: Vec3 = known.iter().map(|&v| Vec3::from(v)).sum();
        (sum / known.len() as f32).to_array()
    }
}

impl Blend for u16 {
    fn blend(known: &[Self]) -> Self {
        known[0]
    }
}
