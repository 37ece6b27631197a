//! A bake of as many texels as there are, and the rows of its maps.

mod sums;

use std::ops::Range;

use super::store::Store;
use super::texels::{PIECE, Texels};
use super::{Baked, Buried, PADDING};
use crate::atlas::{BAND, bands};
use crate::error::{Error, Result};
use crate::raster::{Raster, Rgb};

/// A [`Baked`] that lies where its [`Texels`] do.
#[derive(Debug)]
pub struct BakedTexels {
    pub(super) irradiance: Store<'static, [f32; 3]>,
    /// 0 for texels inside other geometry, else 1.
    pub(super) outside: Store<'static, u8>,
    pub(super) standard_error: Option<Store<'static, f32>>,
    /// As [`Baked::rays`]: rays requested, not rays traced.
    pub rays: u64,
}

impl BakedTexels {
    /// [`Baked::map`], in memory; `texels` are those that were baked.
    pub fn map(&self, texels: &Texels<'_>, buried: Buried) -> Result<Rgb> {
        let [width, height] = texels.size();
        let mut map = Vec::with_capacity(width * height);
        for rows in bands(width, height, BAND) {
            map.extend(self.map_rows(texels, buried, rows)?);
        }
        Raster::new(width, height, map)
    }

    /// Some rows of [`Baked::map`]; `texels` are those that were baked.
    pub fn map_rows(&self, texels: &Texels<'_>, buried: Buried, rows: Range<usize>) -> Result<Vec<[f32; 3]>> {
        self.check(texels, &rows)?;
        texels.rows(&self.irradiance, (buried == Buried::Fill).then_some(&self.outside), rows, PADDING)
    }

    /// Some rows of the map of [`Baked::standard_error`], 0 outside the charts and where
    /// [`Quality::error`](super::Quality::error) did not ask for it.
    pub fn error_rows(&self, texels: &Texels<'_>, rows: Range<usize>) -> Result<Vec<f32>> {
        self.check(texels, &rows)?;
        match &self.standard_error {
            Some(errors) => texels.rows(errors, None, rows, 0),
            None => Ok(vec![0.0; rows.len() * texels.size()[0]]),
        }
    }

    /// That there are as many texels as were baked, and rows of theirs.
    fn check(&self, texels: &Texels<'_>, rows: &Range<usize>) -> Result<()> {
        let (baked, valid, height) = (self.irradiance.len(), texels.valid(), texels.size()[1]);
        if baked == valid && rows.start <= rows.end && rows.end <= height {
            return Ok(());
        }
        Err(Error::invalid(format!(
            "rows {rows:?} of {valid} texels on {height} rows are asked for; expected rows of the {baked} texels that were baked"
        )))
    }

    /// How many texels lie inside other geometry.
    pub fn buried(&self) -> Result<usize> {
        self.outside.pieces(PIECE).map(|outside| Ok(outside?.iter().filter(|outside| **outside == 0).count())).sum()
    }

    /// All of it, in memory.
    pub fn into_baked(self) -> Result<Baked> {
        Ok(Baked {
            irradiance: self.irradiance.into_vec()?,
            buried: self.outside.into_vec()?.into_iter().map(|outside| outside == 0).collect(),
            standard_error: self.standard_error.map(Store::into_vec).transpose()?,
            rays: self.rays,
        })
    }
}
