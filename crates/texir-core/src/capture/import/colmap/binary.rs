//! `cameras.bin` and `images.bin`: little-endian, without a header. Nothing is allocated that is longer than the file.

use std::path::Path;

use super::{Image, Sensor, camera_model};
use crate::error::{Error, Result};

/// What is left of a file.
struct Rest<'a> {
    path: &'a Path,
    bytes: &'a [u8],
}

impl<'a> Rest<'a> {
    fn error(&self, what: impl std::fmt::Display) -> Error {
        Error::file(self.path, what)
    }

    fn cut_off(&self) -> Error {
        self.error("ends within its data; is it cut off?")
    }

    fn skip(&mut self, bytes: u64) -> Result<()> {
        let bytes = usize::try_from(bytes).map_err(|_| self.cut_off())?;
        self.bytes = self.bytes.get(bytes..).ok_or_else(|| self.cut_off())?;
        Ok(())
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        let (taken, rest) = self.bytes.split_first_chunk().ok_or_else(|| self.cut_off())?;
        self.bytes = rest;
        Ok(*taken)
    }

    fn u32(&mut self) -> Result<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Result<u64> {
        self.take().map(u64::from_le_bytes)
    }

    fn floats<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut floats = [0.0; N];
        for float in &mut floats {
            *float = f64::from_le_bytes(self.take()?);
        }
        Ok(floats)
    }

    /// Up to the next 0.
    fn string(&mut self) -> Result<String> {
        let end = self.bytes.iter().position(|b| *b == 0).ok_or_else(|| self.cut_off())?;
        let (text, rest) = self.bytes.split_at(end);
        self.bytes = rest.get(1..).unwrap_or_default();
        Ok(String::from_utf8_lossy(text).into_owned())
    }

    /// As many items as the file says, each of at least one byte.
    fn items<T>(&mut self, item: impl Fn(&mut Self) -> Result<T>) -> Result<Vec<T>> {
        let count = self.u64()?;
        if count > self.bytes.len() as u64 {
            return Err(self.error(format!("says that it has {count} entries, more than it has bytes; is it damaged?")));
        }
        (0..count).map(|_| item(self)).collect()
    }
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|e| Error::cannot_read(path, e))
}

pub(super) fn cameras(path: &Path) -> Result<Vec<Sensor>> {
    let bytes = read(path)?;
    Rest { path, bytes: &bytes }.items(|rest| {
        let (id, number) = (rest.u32()?, i32::from_le_bytes(rest.take()?));
        let model = camera_model(|m| m.number == number, format!("number {number}"))
            .map_err(|e| rest.error(format!("camera {id}: {e}")))?;
        let (width, height) = (rest.u64()?, rest.u64()?);
        let parameters = (0..model.parameters).map(|_| Ok(rest.floats::<1>()?[0])).collect::<Result<_>>()?;
        Ok(Sensor { id, model, width, height, parameters })
    })
}

pub(super) fn images(path: &Path) -> Result<Vec<Image>> {
    let bytes = read(path)?;
    Rest { path, bytes: &bytes }.items(|rest| {
        let _id = rest.u32()?;
        let (camera_from_world, translation) = (rest.floats()?, rest.floats()?);
        let (camera_id, name) = (rest.u32()?, rest.string()?);
        // Each point is x, y and the number of its 3-D point.
        let points = rest.u64()?;
        rest.skip(points.saturating_mul(3 * 8))?;
        Ok(Image { camera_id, camera_from_world, translation, name })
    })
}
