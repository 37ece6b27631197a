//! What a bake has of every texel, in memory or in a file without a name.

use std::borrow::Cow;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::marker::PhantomData;
use std::ops::Range;
use std::path::PathBuf;

use bytemuck::{Pod, cast_slice, cast_slice_mut};
use bytesize::ByteSize;

use crate::error::{Error, Result};

/// Bytes of a point of a neighbourhood while it is denoised, as measured: point, two gathers, what is found on the way,
/// entries of the search and while they are sorted, result. Where texels are much larger than a typical one, cells of
/// the search (408 bytes) hold few of them, and it is up to twice as much.
pub(super) const POINT: u64 = 212;

/// Items that are read from a file at once although nobody asked for them, as this takes less time than another read.
const GAP: u32 = 64;

/// Items that one read of a list spans at most.
const SPAN: usize = 1 << 16;

/// Where a bake holds what it has of every texel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Workspace {
    /// In memory.
    Memory,
    /// In files.
    Disk {
        /// The folder, made if need be, in which the files lie as long as they are used.
        folder: PathBuf,
        /// What neighbourhoods may take while they are worked on, a block of space at a time.
        memory: ByteSize,
    },
}

impl Workspace {
    /// An array that is empty.
    pub(super) fn empty<T: Pod>(&self) -> Result<Store<'static, T>> {
        self.zeroed(0)
    }

    /// An array of `len` zeros.
    pub(super) fn zeroed<T: Pod>(&self, len: usize) -> Result<Store<'static, T>> {
        match self {
            Self::Memory => Ok(Store::Memory(Cow::Owned(vec![T::zeroed(); len]))),
            Self::Disk { folder, .. } => {
                let failed = |e| Error::file(folder, format!("cannot hold a file for what a bake works on: {e}"));
                std::fs::create_dir_all(folder).map_err(failed)?;
                let file = tempfile::tempfile_in(folder).map_err(failed)?;
                file.set_len((len * size_of::<T>()) as u64).map_err(failed)?;
                Ok(Store::Disk { file, folder: folder.clone(), len, items: PhantomData })
            }
        }
    }

    /// Points that may be worked on at a time.
    pub(super) fn points(&self) -> usize {
        match self {
            Self::Memory => usize::MAX,
            Self::Disk { memory, .. } => (memory.0 / POINT) as usize,
        }
    }
}

/// Some items of an array, ascending.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Items {
    Range(Range<usize>),
    Listed(Vec<u32>),
}

impl Items {
    pub fn len(&self) -> usize {
        match self {
            Self::Range(range) => range.len(),
            Self::Listed(list) => list.len(),
        }
    }

    /// Those whose place in this selection is `wanted`.
    pub fn filter(&self, wanted: impl Fn(usize) -> bool) -> Self {
        let list: Vec<u32> = match self {
            Self::Range(range) => range.clone().zip(0..).filter(|&(_, k)| wanted(k)).map(|(i, _)| i as u32).collect(),
            Self::Listed(list) => list.iter().zip(0..).filter(|&(_, k)| wanted(k)).map(|(&i, _)| i).collect(),
        };
        if list.len() == self.len() { self.clone() } else { Self::Listed(list) }
    }
}

/// An array. What is read of it is bit for bit what was written.
#[derive(Debug)]
pub(super) enum Store<'a, T: Pod> {
    Memory(Cow<'a, [T]>),
    Disk { file: File, folder: PathBuf, len: usize, items: PhantomData<T> },
}

impl<T: Pod> Store<'_, T> {
    pub fn len(&self) -> usize {
        match self {
            Self::Memory(values) => values.len(),
            Self::Disk { len, .. } => *len,
        }
    }

    /// Some of the values, in the order of the items.
    pub fn get(&self, items: &Items) -> Result<Cow<'_, [T]>> {
        match (self, items) {
            (Self::Memory(values), Items::Range(range)) => Ok(Cow::Borrowed(&values[range.clone()])),
            (Self::Memory(values), Items::Listed(list)) => {
                Ok(Cow::Owned(list.iter().map(|&i| values[i as usize]).collect()))
            }
            (Self::Disk { .. }, Items::Range(range)) => {
                let mut values = vec![T::zeroed(); range.len()];
                self.read(range.start, &mut values)?;
                Ok(Cow::Owned(values))
            }
            (Self::Disk { .. }, Items::Listed(list)) => {
                let mut values = Vec::with_capacity(list.len());
                let mut buffer = Vec::new();
                for run in list.chunk_by(|a, b| b - a <= GAP).flat_map(|run| run.chunks(SPAN / GAP as usize)) {
                    let first = run[0];
                    buffer.clear();
                    buffer.resize((run[run.len() - 1] - first) as usize + 1, T::zeroed());
                    self.read(first as usize, &mut buffer)?;
                    values.extend(run.iter().map(|i| buffer[(i - first) as usize]));
                }
                Ok(Cow::Owned(values))
            }
        }
    }

    /// All values.
    pub fn all(&self) -> Result<Cow<'_, [T]>> {
        self.get(&Items::Range(0..self.len()))
    }

    /// All values, some of them at a time.
    pub fn pieces(&self, len: usize) -> impl Iterator<Item = Result<Cow<'_, [T]>>> {
        (0..self.len()).step_by(len).map(move |start| self.get(&Items::Range(start..(start + len).min(self.len()))))
    }

    /// Replaces some of the values.
    pub fn set(&mut self, items: &Items, new: &[T]) -> Result<()> {
        match (&mut *self, items) {
            (Self::Memory(values), Items::Range(range)) => values.to_mut()[range.clone()].copy_from_slice(new),
            (Self::Memory(values), Items::Listed(list)) => {
                let values = values.to_mut();
                list.iter().zip(new).for_each(|(&i, &value)| values[i as usize] = value);
            }
            (Self::Disk { .. }, Items::Range(range)) => self.write(range.start, new)?,
            (Self::Disk { .. }, Items::Listed(list)) => {
                let mut done = 0;
                for run in list.chunk_by(|a, b| a + 1 == *b) {
                    self.write(run[0] as usize, &new[done..done + run.len()])?;
                    done += run.len();
                }
            }
        }
        Ok(())
    }

    /// Puts values at the end.
    pub fn extend(&mut self, new: &[T]) -> Result<()> {
        match self {
            Self::Memory(values) => values.to_mut().extend_from_slice(new),
            Self::Disk { len, .. } => {
                let start = *len;
                *len += new.len();
                self.write(start, new)?;
            }
        }
        Ok(())
    }

    /// The values in memory.
    pub fn into_vec(self) -> Result<Vec<T>> {
        match self {
            Self::Memory(values) => Ok(values.into_owned()),
            Self::Disk { .. } => Ok(self.all()?.into_owned()),
        }
    }

    fn read(&self, start: usize, values: &mut [T]) -> Result<()> {
        self.access(start, "read", |mut file| file.read_exact(cast_slice_mut(values)))
    }

    fn write(&self, start: usize, values: &[T]) -> Result<()> {
        self.access(start, "written", |mut file| file.write_all(cast_slice(values)))
    }

    /// Does something with the file, if there is one, where item `start` is.
    fn access(&self, start: usize, what: &str, act: impl FnOnce(&File) -> std::io::Result<()>) -> Result<()> {
        let Self::Disk { file, folder, .. } = self else { return Ok(()) };
        let mut at = file;
        let found = at.seek(SeekFrom::Start((start * size_of::<T>()) as u64)).and_then(|_| act(file));
        found.map_err(|e| Error::file(folder, format!("what a bake works on cannot be {what}: {e}; is the disk full?")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_array_in_a_file_is_one_in_memory() {
        let folder = tempfile::tempdir().unwrap();
        let disk = Workspace::Disk { folder: folder.path().to_owned(), memory: ByteSize(1) };
        let values: Vec<u32> = (0..200_000).map(|i| i * 7919).collect();
        // Single items, runs, gaps above and below those that are read over.
        let list: Vec<u32> =
            (0..200_000).filter(|i| i % 1000 < 3 || i % 977 == 5 || (70_000..150_000).contains(i)).collect();
        let [memory, disk] = [Workspace::Memory, disk].map(|workspace| {
            let mut store = workspace.zeroed::<u32>(3).unwrap();
            store.extend(&values[3..]).unwrap();
            store.set(&Items::Range(1..3), &values[1..3]).unwrap();
            let listed = Items::Listed(list.clone());
            let before = store.get(&listed).unwrap().into_owned();
            store.set(&listed, &before.iter().map(|v| v ^ 1).collect::<Vec<_>>()).unwrap();
            let pieces: Vec<u32> = store.pieces(999).flat_map(|piece| piece.unwrap().into_owned()).collect();
            assert!(store.len() == values.len() && pieces == *store.all().unwrap());
            (before, store.get(&Items::Range(5..9)).unwrap().into_owned(), store.into_vec().unwrap())
        });
        assert!(memory == disk);
        assert_eq!(memory.0, list.iter().map(|&i| values[i as usize]).collect::<Vec<_>>());
        assert!(memory.2[list[7] as usize] == values[list[7] as usize] ^ 1 && memory.2[4] == values[4]);
        assert!(std::fs::read_dir(folder.path()).unwrap().next().is_none(), "files have no name");
    }

    #[test]
    fn items_are_filtered_by_their_place() {
        let even = |items: Items| items.filter(|k| k % 2 == 0);
        assert_eq!(even(Items::Range(5..9)), Items::Listed(vec![5, 7]));
        assert_eq!(even(Items::Listed(vec![1, 4, 8])), Items::Listed(vec![1, 8]));
        assert_eq!(Items::Range(2..4).filter(|_| true), Items::Range(2..4));
    }
}
