//! Images that are made while they are written, so that they need not be in memory.

use std::borrow::Cow;
use std::fmt;
use std::ops::Range;

use bytemuck::cast_slice;

use crate::error::Result;
use crate::raster::{Gray, Rgb};

/// Rows that are written at a time; whole blocks of every format.
const BAND: usize = 64;

/// Makes some rows.
type Make<'a, const N: usize> = dyn FnMut(Range<usize>) -> Result<Cow<'a, [[f32; N]]>> + 'a;

/// An image of `N` channels that is made from its top to its bottom, some rows at a time.
pub struct ImageRows<'a, const N: usize> {
    size: [usize; 2],
    make: Box<Make<'a, N>>,
}

impl<const N: usize> fmt::Debug for ImageRows<'_, N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ImageRows").field("size", &self.size).finish_non_exhaustive()
    }
}

impl<'a, const N: usize> ImageRows<'a, N> {
    /// An image of `[width, height]` pixels; `make` yields those of some rows, row by row.
    pub fn new(size: [usize; 2], mut make: impl FnMut(Range<usize>) -> Result<Vec<[f32; N]>> + 'a) -> Self {
        Self { size, make: Box::new(move |rows| Ok(Cow::Owned(make(rows)?))) }
    }

    /// Columns and rows.
    pub(super) fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Hands on all rows, some at a time.
    pub(super) fn each(mut self, mut take: impl FnMut(Range<usize>, &[[f32; N]]) -> Result<()>) -> Result<()> {
        for start in (0..self.size[1]).step_by(BAND) {
            let rows = start..(start + BAND).min(self.size[1]);
            take(rows.clone(), &(self.make)(rows)?)?;
        }
        Ok(())
    }

    fn of([width, height]: [usize; 2], pixels: &'a [[f32; N]]) -> Self {
        let make = move |rows: Range<usize>| Ok(Cow::Borrowed(&pixels[rows.start * width..rows.end * width]));
        Self { size: [width, height], make: Box::new(make) }
    }
}

impl<'a> From<&'a Rgb> for ImageRows<'a, 3> {
    fn from(image: &'a Rgb) -> Self {
        Self::of([image.width, image.height], &image.data)
    }
}

impl<'a> From<&'a Gray> for ImageRows<'a, 1> {
    fn from(image: &'a Gray) -> Self {
        Self::of([image.width, image.height], cast_slice(&image.data))
    }
}
