//! The texels of a map that is baked, and how the map is put together from their values.

use std::borrow::Cow;
use std::ops::Range;

use bytemuck::Pod;

use super::store::{Items, Store, Workspace};
use crate::atlas::{self, Atlas, TypicalTexel};
use crate::backend::Backend;
use crate::error::Result;
use crate::mesh::Mesh;
use crate::progress::{Progress, Task};
use crate::raster::Raster;
use crate::surface::SurfacePoint;

/// Texels that are gone through at a time: 16 rows of the largest maps, some 20 MB.
pub(super) const PIECE: usize = 1 << 18;

/// The valid texels of a map, in atlas order.
#[derive(Debug)]
pub struct Texels<'a> {
    size: [usize; 2],
    pub(super) points: Store<'a, SurfacePoint>,
    /// Valid texels before each row; and of all.
    rows: Vec<usize>,
    pub(super) workspace: Workspace,
}

impl<'a> Texels<'a> {
    /// Maps every texel of a map of `[width, height]` texels to the backend's mesh. Errors as [`Atlas::new`] does.
    pub fn map(
        backend: &mut dyn Backend,
        size: [usize; 2],
        workspace: Workspace,
        progress: &dyn Progress,
    ) -> Result<Texels<'static>> {
        let mut texels = Texels { size, points: workspace.empty()?, rows: vec![0; size[1] + 1], workspace };
        let task = Task::start(progress, "texels", (size[0] * size[1]) as u64, "texels");
        atlas::map(backend, size, |rows, points, _| {
            progress.check()?;
            texels.count(points.iter().map(|point| point.index));
            texels.points.extend(&points)?;
            progress.advance((rows.len() * size[0]) as u64);
            Ok(())
        })?;
        drop(task);
        texels.accumulate();
        Ok(texels)
    }

    /// Those of an atlas.
    pub fn of(atlas: &'a Atlas) -> Self {
        Self::of_points([atlas.width, atlas.height], atlas.points.as_slice())
    }

    /// Of a map of `[width, height]` texels, these points, row by row; a point's index is its texel's.
    pub(super) fn of_points(size: [usize; 2], points: impl Into<Cow<'a, [SurfacePoint]>>) -> Self {
        let points = points.into();
        let none = Store::Memory(Cow::Borrowed(&[]));
        let mut texels = Self { size, points: none, rows: vec![0; size[1] + 1], workspace: Workspace::Memory };
        texels.count(points.iter().map(|point| point.index));
        texels.accumulate();
        Self { points: Store::Memory(points), ..texels }
    }

    /// Columns and rows of the map.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// How many texels are valid.
    pub fn valid(&self) -> usize {
        self.points.len()
    }

    /// All of them, some at a time.
    pub(super) fn pieces(&self) -> impl Iterator<Item = Items> + use<> {
        let valid = self.valid();
        (0..valid).step_by(PIECE).map(move |start| Items::Range(start..(start + PIECE).min(valid)))
    }

    /// The surface points of all, some at a time; the index of one is that of its texel in the map.
    pub fn points(&self) -> impl Iterator<Item = Result<Cow<'_, [SurfacePoint]>>> {
        self.points.pieces(PIECE)
    }

    /// The surface points of those in some rows.
    pub(crate) fn points_in(&self, rows: Range<usize>) -> Result<Cow<'_, [SurfacePoint]>> {
        self.points.get(&Items::Range(self.rows[rows.start]..self.rows[rows.end]))
    }

    /// Edge of the median texel on the surface, metres.
    pub(super) fn typical(&self, mesh: &Mesh) -> Result<f32> {
        let mut typical = TypicalTexel::new(mesh, self.size);
        self.points.pieces(PIECE).try_for_each(|points| points.map(|points| typical.count(&points)))?;
        Ok(typical.edge())
    }

    /// Some rows of the map of one value per texel; the values flagged `known` (all without) continued `rings` texels
    /// beyond them, over others; 0 elsewhere.
    pub(super) fn rows<T: Pod>(
        &self,
        values: &Store<'_, T>,
        known: Option<&Store<'_, u8>>,
        rows: Range<usize>,
        rings: usize,
    ) -> Result<Vec<T>> {
        let [width, height] = self.size;
        // A ring depends on the rows beside it.
        let all = rows.start.saturating_sub(rings)..(rows.end + rings).min(height);
        let items = Items::Range(self.rows[all.start]..self.rows[all.end]);
        let (points, values) = (self.points.get(&items)?, values.get(&items)?);
        let known = known.map(|known| known.get(&items)).transpose()?;
        let mut raster = Raster::filled(width, all.len(), T::zeroed());
        let mut filled = vec![false; raster.data.len()];
        let is_known = |k: usize| known.as_ref().is_none_or(|known| known[k] != 0);
        for (k, (point, value)) in points.iter().zip(values.iter()).enumerate() {
            let at = point.index as usize - all.start * width;
            raster.data[at] = *value;
            filled[at] = is_known(k);
        }
        atlas::pad(&mut raster, &mut filled, rings);
        let first = (rows.start - all.start) * width;
        raster.data.truncate(first + rows.len() * width);
        Ok(raster.data.split_off(first))
    }

    /// An array of a zero for every valid texel.
    pub(super) fn zeroed<T: Pod>(&self) -> Result<Store<'static, T>> {
        self.workspace.zeroed(self.points.len())
    }

    fn count(&mut self, texels: impl Iterator<Item = u32>) {
        texels.for_each(|texel| self.rows[texel as usize / self.size[0] + 1] += 1);
    }

    fn accumulate(&mut self) {
        (1..self.rows.len()).for_each(|row| self.rows[row] += self.rows[row - 1]);
    }
}
