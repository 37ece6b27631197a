//! Mip-mapped textures over an atlas with holes: the pyramid's layout, and which texels a pixel sees with which weight.
//!
//! A lookup is linear in the texture, so it is stored as a sparse matrix over the pyramid: the forward pass multiplies
//! by it, the adjoint by its transpose. Both are gathers in a fixed order, so that gradients are reproducible.

use bytemuck::{Pod, Zeroable};
use glam::{Mat2, Vec2, Vec3};
use rayon::prelude::*;

use crate::camera::Camera;
use crate::mesh::Mesh;
use crate::surface::Hit;

/// One level of a [`Pyramid`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Level {
    /// Index of its first texel in the pyramid.
    pub offset: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

/// The mip pyramid of an atlas: level 0 is the atlas, each next level halves it (rounding up). A coarse texel is the
/// mean of its valid children, so that the empty space between charts does not bleed in.
#[derive(Clone, Debug, PartialEq)]
pub struct Pyramid {
    /// From finest to 1×1.
    pub levels: Vec<Level>,
    /// Per pyramid texel: the share of it that valid atlas texels cover; 0 where there are none.
    pub coverage: Vec<f32>,
}

impl Pyramid {
    /// The pyramid of a `width × height` atlas whose texel `i` holds data where `valid[i]`.
    pub fn new(width: usize, height: usize, valid: &[bool]) -> Self {
        assert_eq!(valid.len(), width * height, "one validity flag per texel");
        let mut levels = vec![Level { offset: 0, width, height }];
        let mut coverage: Vec<f32> = valid.iter().map(|&v| f32::from(u8::from(v))).collect();
        while let Some(&fine) = levels.last().filter(|l| l.width * l.height > 1) {
            let coarse = Level {
                offset: fine.offset + fine.width * fine.height,
                width: fine.width.div_ceil(2),
                height: fine.height.div_ceil(2),
            };
            for y in 0..coarse.height {
                for x in 0..coarse.width {
                    let children = Self::children(&fine, x, y);
                    let sum: f32 = children.iter().flatten().map(|&c| coverage[c]).sum();
                    coverage.push(sum / 4.0);
                }
            }
            levels.push(coarse);
        }
        Self { levels, coverage }
    }

    /// Texels of all levels together.
    pub fn len(&self) -> usize {
        self.coverage.len()
    }

    /// True for an atlas without texels.
    pub fn is_empty(&self) -> bool {
        self.coverage.is_empty()
    }

    /// Pyramid indices of the up to four children on level `fine` of texel (x, y) one level coarser.
    pub fn children(fine: &Level, x: usize, y: usize) -> [Option<usize>; 4] {
        [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(dx, dy)| {
            let (cx, cy) = (2 * x + dx, 2 * y + dy);
            (cx < fine.width && cy < fine.height).then_some(fine.offset + cy * fine.width + cx)
        })
    }

    /// Bilinear taps at `uv` on one level: up to four `(texel, weight)`, valid texels only, weights summing to 1 (or
    /// none).
    pub fn bilinear(&self, level: usize, uv: Vec2) -> Vec<Tap> {
        let l = self.levels[level];
        // A texel covers two by two of the finer level, also where sizes are odd and the last covers fewer.
        let atlas = self.levels[0];
        let p = uv * Vec2::new(atlas.width as f32, atlas.height as f32) / (1u64 << level) as f32 - 0.5;
        let base = p.floor();
        let f = p - base;
        let mut taps = Vec::with_capacity(4);
        for (dx, dy, w) in
            [(0, 0, (1.0 - f.x) * (1.0 - f.y)), (1, 0, f.x * (1.0 - f.y)), (0, 1, (1.0 - f.x) * f.y), (1, 1, f.x * f.y)]
        {
            let x = (base.x as i64 + dx).clamp(0, l.width as i64 - 1) as usize;
            let y = (base.y as i64 + dy).clamp(0, l.height as i64 - 1) as usize;
            let texel = l.offset + y * l.width + x;
            let weight = w * self.coverage[texel];
            if weight > 0.0 {
                taps.push(Tap { texel: texel as u32, weight });
            }
        }
        normalise(&mut taps, 1.0);
        taps
    }

    /// Trilinear taps at `uv` for a footprint `width` texels wide on level 0.
    fn trilinear(&self, uv: Vec2, width: f32) -> Vec<Tap> {
        let lod = width.max(1.0).log2().min((self.levels.len() - 1) as f32);
        let (fine, f) = (lod.floor() as usize, lod.fract());
        let mut taps = self.bilinear(fine, uv);
        if f > 0.0 && fine + 1 < self.levels.len() {
            normalise(&mut taps, 1.0 - f);
            let mut coarse = self.bilinear(fine + 1, uv);
            normalise(&mut coarse, f);
            taps.append(&mut coarse);
            normalise(&mut taps, 1.0);
        }
        taps
    }
}

fn normalise(taps: &mut [Tap], to: f32) {
    let sum: f32 = taps.iter().map(|t| t.weight).sum();
    for tap in taps {
        tap.weight *= to / sum;
    }
}

/// One entry of a sparse matrix: which item, with which weight.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Tap {
    /// Pyramid texel (in rows), or footprint (in columns).
    pub texel: u32,
    /// Share of it.
    pub weight: f32,
}

/// A list of rows of taps.
#[derive(Clone, Debug, PartialEq)]
pub struct SparseRows<T = Tap> {
    /// `rows + 1` offsets into `taps`.
    pub offsets: Vec<u32>,
    /// Entries, row by row.
    pub taps: Vec<T>,
}

impl<T> Default for SparseRows<T> {
    fn default() -> Self {
        Self { offsets: vec![0], taps: Vec::new() }
    }
}

impl<T> SparseRows<T> {
    /// Flattens one list of taps per row.
    pub fn from_lists(lists: impl IntoIterator<Item = Vec<T>>) -> Self {
        let mut rows = Self::default();
        lists.into_iter().for_each(|list| rows.push(list));
        rows
    }

    /// Adds a row at the end.
    pub fn push(&mut self, row: impl IntoIterator<Item = T>) {
        self.taps.extend(row);
        self.offsets.push(self.taps.len() as u32);
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.offsets.len() - 1
    }

    /// True without rows.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Entries of row `i`.
    pub fn row(&self, i: usize) -> &[T] {
        &self.taps[self.offsets[i] as usize..self.offsets[i + 1] as usize]
    }
}

impl SparseRows {
    /// The transpose of a matrix with `columns` columns: its row `j` lists the rows of `self` that have an entry in
    /// column `j`, ascending.
    pub fn transposed(&self, columns: usize) -> SparseRows {
        let mut offsets = vec![0u32; columns + 1];
        self.taps.iter().for_each(|tap| offsets[tap.texel as usize + 1] += 1);
        for j in 0..columns {
            offsets[j + 1] += offsets[j];
        }
        let mut next = offsets.clone();
        let mut taps = vec![Tap { texel: 0, weight: 0.0 }; self.taps.len()];
        for i in 0..self.len() {
            for tap in self.row(i) {
                let slot = &mut next[tap.texel as usize];
                taps[*slot as usize] = Tap { texel: i as u32, weight: tap.weight };
                *slot += 1;
            }
        }
        SparseRows { offsets, taps }
    }

    /// Footprints of the listed pixels of a view, a row each. `fine` is the view [`Camera::supersampled`] by `factor`,
    /// `hit` tells its primary hits by pixel: a pixel of the view sees the mean of its factor² trilinear sub-pixel
    /// footprints, as box-filtered images do. Sub-pixels without a hit are left out; a pixel without any gets an empty
    /// row.
    pub fn of_pixels(
        pyramid: &Pyramid,
        mesh: &Mesh,
        fine: &Camera,
        factor: usize,
        hit: impl Fn(usize) -> Hit + Sync,
        pixels: &[u32],
    ) -> Self {
        let width = fine.width / factor;
        let lists: Vec<Vec<Tap>> = pixels
            .par_iter()
            .map(|&pixel| {
                let (x, y) = (pixel as usize % width * factor, pixel as usize / width * factor);
                let mut taps: Vec<Tap> = (0..factor * factor)
                    .flat_map(|k| {
                        let (x, y) = (x + k % factor, y + k / factor);
                        let hit = hit(y * fine.width + x);
                        match hit.is_hit() {
                            true => Footprint::area(mesh, fine, &hit, x, y).taps(pyramid),
                            false => Vec::new(),
                        }
                    })
                    .collect();
                merge(&mut taps);
                taps
            })
            .collect();
        Self::from_lists(lists)
    }
}

/// The footprints of a list of pixels in a [`Pyramid`], as a sparse matrix and its transpose.
#[derive(Clone, Debug, PartialEq)]
pub struct Footprints {
    /// Per pixel, the pyramid texels it sees; empty for a pixel that sees no valid texel.
    pub rows: SparseRows,
    /// Pyramid texels seen by any pixel, ascending.
    pub touched: Vec<u32>,
    /// Per entry of `touched`, the pixels that see it ([`Tap::texel`] is a pixel index).
    pub columns: SparseRows,
}

impl Footprints {
    /// Builds the transpose of `rows`.
    pub fn new(rows: SparseRows) -> Self {
        let mut transposed: Vec<(u32, Tap)> = Vec::with_capacity(rows.taps.len());
        for pixel in 0..rows.len() {
            transposed.extend(rows.row(pixel).iter().map(|t| (t.texel, Tap { texel: pixel as u32, weight: t.weight })));
        }
        transposed.par_sort_by_key(|(texel, tap)| (*texel, tap.texel));
        let mut touched: Vec<u32> = Vec::new();
        let mut columns = SparseRows { offsets: Vec::new(), taps: Vec::with_capacity(transposed.len()) };
        for (texel, tap) in transposed {
            if touched.last() != Some(&texel) {
                touched.push(texel);
                columns.offsets.push(columns.taps.len() as u32);
            }
            columns.taps.push(tap);
        }
        columns.offsets.push(columns.taps.len() as u32);
        Self { rows, touched, columns }
    }

    /// Number of footprints.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// True without footprints.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }
}

/// What of the atlas a pixel sees.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Footprint {
    /// Where its centre lies.
    pub uv: Vec2,
    /// Offsets of the pixels one further along x and along y; `None`: the centre alone is looked at.
    spread: Option<(Vec2, Vec2)>,
}

impl Footprint {
    /// Of a pixel's centre.
    pub fn centre(mesh: &Mesh, hit: &Hit) -> Self {
        Self { uv: hit.uv(mesh), spread: None }
    }

    /// Of the area of pixel (x, y), from ray differentials (Igehy, "Tracing Ray Differentials", 1999).
    pub fn area(mesh: &Mesh, camera: &Camera, hit: &Hit, x: usize, y: usize) -> Self {
        let spread = uv_differentials(mesh, camera, hit, x as f32 + 0.5, y as f32 + 0.5);
        Self { uv: hit.uv(mesh), spread: Some(spread) }
    }

    /// Its taps in a pyramid: bilinear at the centre, trilinear over an area, whose longer axis tells the level.
    pub fn taps(&self, pyramid: &Pyramid) -> Vec<Tap> {
        let Some((du, dv)) = self.spread else { return pyramid.bilinear(0, self.uv) };
        let atlas = Vec2::new(pyramid.levels[0].width as f32, pyramid.levels[0].height as f32);
        let width = (du * atlas).length().max((dv * atlas).length());
        pyramid.trilinear(self.uv, if width.is_finite() { width } else { 1.0 })
    }
}

/// Joins taps on the same texel and makes the weights sum to 1.
pub(crate) fn merge(taps: &mut Vec<Tap>) {
    taps.sort_unstable_by_key(|t| t.texel);
    taps.dedup_by(|next, kept| {
        let same = next.texel == kept.texel;
        if same {
            kept.weight += next.weight;
        }
        same
    });
    normalise(taps, 1.0);
}

/// Change of the atlas coordinates per pixel step in x and in y, on the plane of the triangle that was hit.
fn uv_differentials(mesh: &Mesh, camera: &Camera, hit: &Hit, x: f32, y: f32) -> (Vec2, Vec2) {
    let [a, b, c] = mesh.corners(hit.triangle);
    let [ua, ub, uc] = mesh.corner_uvs(hit.triangle);
    let (e1, e2) = (b - a, c - a);
    let normal = e1.cross(e2);
    let origin = camera.position();
    let on_plane = |d: Vec3| origin + d * ((a - origin).dot(normal) / d.dot(normal));
    let p = on_plane(camera.direction(x, y));
    // Barycentric coordinates of a step in the plane: least squares over the two edges, exact as it lies in their span.
    let gram = Mat2::from_cols(Vec2::new(e1.dot(e1), e1.dot(e2)), Vec2::new(e1.dot(e2), e2.dot(e2)));
    let inverse = gram.inverse();
    let step = |q: Vec3| {
        let d = q - p;
        let bary = inverse * Vec2::new(d.dot(e1), d.dot(e2));
        (ub - ua) * bary.x + (uc - ua) * bary.y
    };
    (step(on_plane(camera.direction(x + 1.0, y))), step(on_plane(camera.direction(x, y + 1.0))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::lookup::reduce;

    /// A row of four texels that hold 0, 1, 2 and 3.
    fn ramp(taps: &[Tap]) -> f32 {
        taps.iter().map(|tap| tap.texel as f32 * tap.weight).sum()
    }

    #[test]
    fn texels_hold_what_is_at_their_centres() {
        let pyramid = Pyramid::new(4, 1, &[true; 4]);
        for (u, expected) in [(0.375, 1.0), (0.5, 1.5), (0.8125, 2.75), (0.0, 0.0), (1.0, 3.0)] {
            let found = ramp(&pyramid.bilinear(0, Vec2::new(u, 0.5)));
            assert!((found - expected).abs() < 1e-6, "{found} at {u}; expected {expected}");
        }
    }

    #[test]
    fn coarse_levels_of_odd_sizes_are_looked_up_where_they_are() {
        // Every texel holds its place, so that coarse texels hold the middle of what they cover.
        const SIDE: usize = 1000;
        let pyramid = Pyramid::new(SIDE, 1, &[true; SIDE]);
        let place: Vec<f32> = (0..SIDE).map(|x| (x as f32 + 0.5) / SIDE as f32).collect();
        let all = [&place[..], &reduce(&pyramid, &place, 1, pyramid.levels.len())].concat();
        for (level, u) in (0..7).flat_map(|level| [0.2, 0.55, 0.9].map(|u| (level, u))) {
            let found: f32 =
                pyramid.bilinear(level, Vec2::new(u, 0.5)).iter().map(|tap| all[tap.texel as usize] * tap.weight).sum();
            assert!((found - u).abs() < 1e-5, "{found} at {u} of level {level}");
        }
    }

    #[test]
    fn a_footprint_as_wide_as_a_levels_texels_is_looked_up_there() {
        let pyramid = Pyramid::new(4, 1, &[true; 4]);
        let share = |width: f32, level: usize| -> f32 {
            let Level { offset, width: columns, height } = pyramid.levels[level];
            let of_level = |tap: &&Tap| (offset..offset + columns * height).contains(&(tap.texel as usize));
            pyramid.trilinear(Vec2::new(0.3, 0.5), width).iter().filter(of_level).map(|tap| tap.weight).sum()
        };
        for (width, shares) in
            [(0.1, [1.0, 0.0, 0.0]), (1.0, [1.0, 0.0, 0.0]), (2.0, [0.0, 1.0, 0.0]), (9.0, [0.0, 0.0, 1.0])]
        {
            assert_eq!([0, 1, 2].map(|level| share(width, level)), shares, "{width} texels wide");
        }
        let between = std::f32::consts::SQRT_2;
        assert!((share(between, 0) - 0.5).abs() < 1e-6 && (share(between, 1) - 0.5).abs() < 1e-6);
    }

    #[test]
    fn coarse_texels_are_means_of_all_valid_texels_below() {
        // A quarter with one valid texel, which holds 4, beside three that are valid throughout and hold 0.
        let valid: Vec<bool> = (0..16).map(|i| i == 0 || i % 4 >= 2 || i / 4 >= 2).collect();
        let texture: Vec<f64> =
            (0..16).map(|i| if i == 0 { 4.0 } else { 9.0 * f64::from(u8::from(!valid[i])) }).collect();
        let pyramid = Pyramid::new(4, 4, &valid);
        let all = reduce(&pyramid, &texture, 1, pyramid.levels.len());
        assert!((all[all.len() - 1] - 4.0 / 13.0).abs() < 1e-7, "{}", all[all.len() - 1]);
    }
}
