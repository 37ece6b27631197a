//! Steps of a long computation that are kept until all of it is done, so that one that was stopped goes on where it
//! was.
//!
//! A step is one file of arrays in the safetensors format. What is read back is bit for bit what was computed: a step
//! that a failing disk or a power cut has changed does not have the sum that it was written with, and is computed
//! again.

use std::collections::{BTreeMap, HashMap};
use std::fmt;
use std::fs::{self, File, TryLockError};
use std::hash::{DefaultHasher, Hasher};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use bytemuck::Pod;
use half::f16;
use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensors, serialize};

use crate::atomic_file::write_atomic;
use crate::backend::Gathered;
use crate::error::{Error, Result};
use crate::progress::Progress;
use crate::specular_table::Curve;

/// Names the computation that the steps in a folder belong to.
const IDENTITY: &str = "identity.txt";
/// Locked by the run that keeps steps there.
const LOCK: &str = "lock";
/// Where a step's file holds the sum of its arrays.
const SUM: &str = "sum";
/// Ending of a step's file.
const ENDING: &str = "safetensors";

/// The steps that were done, or none that are kept.
#[derive(Clone, Debug)]
pub struct Checkpoints {
    folder: Option<PathBuf>,
    /// What the names of steps begin with.
    prefix: String,
    /// Held as long as one of these lives.
    _lock: Option<Arc<File>>,
}

/// What arrays hold.
pub trait Element: Pod + sealed::Scalars {}

mod sealed {
    use safetensors::Dtype;

    /// An element is one scalar or more.
    pub trait Scalars {
        const SCALAR: Dtype;
    }
}

macro_rules! element {
    ($($type:ty: $scalar:ident),*) => { $(
        impl Element for $type {}
        impl sealed::Scalars for $type { const SCALAR: Dtype = Dtype::$scalar; }
    )* };
}
element!(f32: F32, [f32; 2]: F32, [f32; 3]: F32, f16: F16, Curve: F16, u32: U32, u8: U8, Gathered: F32);

/// An array on its way to a file.
pub struct Array<'a> {
    scalar: Dtype,
    shape: Vec<usize>,
    bytes: &'a [u8],
}

impl fmt::Debug for Array<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { scalar, shape, .. } = self;
        f.debug_struct("Array").field("scalar", scalar).field("shape", shape).finish_non_exhaustive()
    }
}

impl<'a, T: Element> From<&'a [T]> for Array<'a> {
    fn from(values: &'a [T]) -> Self {
        let scalars = 8 * size_of::<T>() / T::SCALAR.bitsize();
        Self { scalar: T::SCALAR, shape: vec![values.len(), scalars], bytes: bytemuck::cast_slice(values) }
    }
}

/// The arrays of a step, as they were kept.
pub struct Step(Vec<u8>);

impl fmt::Debug for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Step").field("bytes", &self.0.len()).finish_non_exhaustive()
    }
}

impl Step {
    /// The array `name`; `None` where it is missing or of another type.
    pub fn array<T: Element>(&self, name: &str) -> Option<Vec<T>> {
        let arrays = SafeTensors::deserialize(&self.0).ok()?;
        let array = arrays.tensor(name).ok()?;
        let whole = array.data().len() % size_of::<T>() == 0;
        (array.dtype() == T::SCALAR && whole).then(|| bytemuck::pod_collect_to_vec(array.data()))
    }
}

impl Checkpoints {
    /// Keeps nothing.
    pub fn none() -> Self {
        Self { folder: None, prefix: String::new(), _lock: None }
    }

    /// Keeps steps in `folder`, and finds those that an earlier run left there; steps of a computation of another
    /// `identity` are removed, with a warning. Errors while another run keeps its steps there: the results of both
    /// would mix.
    pub fn open(folder: &Path, identity: &str, progress: &dyn Progress) -> Result<Self> {
        let failed = |e| Error::file(folder, format!("cannot be used to keep steps in: {e}"));
        let lock = lock(folder)?;
        let known = fs::read_to_string(folder.join(IDENTITY)).unwrap_or_default();
        let checkpoints = Self { folder: Some(folder.to_owned()), prefix: String::new(), _lock: Some(Arc::new(lock)) };
        if known != identity {
            if !known.is_empty() {
                progress.warn(&format!(
                    "{}: the steps of another run (another input, setting or version) are begun anew",
                    folder.display()
                ));
            }
            checkpoints.clear().map_err(failed)?;
            write_atomic(folder.join(IDENTITY), |sink| std::io::Write::write_all(sink, identity.as_bytes()))?;
        }
        Ok(checkpoints)
    }

    /// The steps of a part of the computation, whose names are its own.
    pub fn within(&self, part: &str) -> Self {
        Self { prefix: format!("{}{part}-", self.prefix), ..self.clone() }
    }

    /// A step that was done, as it was written.
    pub fn find(&self, step: &str) -> Option<Step> {
        let bytes = fs::read(self.file(step)?).ok()?;
        let (_, header) = SafeTensors::read_metadata(&bytes).ok()?;
        let sum = header.metadata().as_ref()?.get(SUM)?;
        let arrays = SafeTensors::deserialize(&bytes).ok()?;
        let names = header.offset_keys();
        let arrays: Option<BTreeMap<&str, &[u8]>> =
            names.iter().map(|name| Some((name.as_str(), arrays.tensor(name).ok()?.data()))).collect();
        (*sum == sum_of(arrays?.into_iter())).then_some(Step(bytes))
    }

    /// Keeps a step, in place of what is known of it.
    pub fn keep(&self, step: &str, arrays: &[(&str, Array<'_>)]) -> Result<()> {
        let Some(file) = self.file(step) else { return Ok(()) };
        let failed = |e| Error::cannot_write(&file, e);
        let mut views = BTreeMap::new();
        for (name, array) in arrays {
            let view = TensorView::new(array.scalar, array.shape.clone(), array.bytes);
            views.insert(*name, view.map_err(failed)?);
        }
        let sum = sum_of(views.iter().map(|(name, view)| (*name, view.data())));
        let bytes = serialize(views, Some(HashMap::from([(SUM.to_owned(), sum)]))).map_err(failed)?;
        write_atomic(&file, |sink| std::io::Write::write_all(sink, &bytes))
    }

    /// The one array of a step, of `len` elements: what `make` yields, or what it yielded in an earlier run.
    pub fn array<T: Element>(&self, step: &str, len: usize, make: impl FnOnce() -> Result<Vec<T>>) -> Result<Vec<T>> {
        if let Some(kept) = self.find(step).and_then(|kept| kept.array("values")).filter(|kept| kept.len() == len) {
            return Ok(kept);
        }
        let made = make()?;
        self.keep(step, &[("values", Array::from(&made[..]))])?;
        Ok(made)
    }

    /// Whether any step is kept: an earlier or this run has something to go on from.
    pub fn any(&self) -> bool {
        let is_step = |entry: fs::DirEntry| entry.path().extension().is_some_and(|e| e == ENDING);
        let entries = self.folder.as_ref().and_then(|folder| fs::read_dir(folder).ok());
        entries.into_iter().flatten().flatten().any(is_step)
    }

    /// Removes the steps: all is done.
    pub fn finish(self) {
        // What cannot be removed is in nobody's way. The lock goes last.
        let _ = self.clear();
        if let Some(folder) = &self.folder {
            let _ = fs::remove_file(folder.join(LOCK));
            let _ = fs::remove_dir(folder);
        }
    }

    fn file(&self, step: &str) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(format!("{}{step}.{ENDING}", self.prefix)))
    }

    /// Removes the steps.
    fn clear(&self) -> std::io::Result<()> {
        let Some(folder) = &self.folder else { return Ok(()) };
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            if path.extension().is_some_and(|e| e == ENDING) || path.ends_with(IDENTITY) {
                fs::remove_file(path)?;
            }
        }
        Ok(())
    }
}

/// Locks a folder of steps, and makes it where it is not there. Where the disk knows no locks there is none.
fn lock(folder: &Path) -> Result<File> {
    let path = folder.join(LOCK);
    loop {
        fs::create_dir_all(folder).map_err(|e| Error::file(folder, format!("cannot be used to keep steps in: {e}")))?;
        let file = File::create(&path).map_err(|e| Error::cannot_write(&path, e))?;
        if matches!(file.try_lock(), Err(TryLockError::WouldBlock)) {
            let what = "is where another run that is not finished keeps its steps; wait for it, or give this one another --output";
            return Err(Error::file(folder, what));
        }
        // Another run may have finished, and removed it, in between.
        if is_at(&file, &path) {
            return Ok(file);
        }
    }
}

/// Whether a path still leads to a file that was opened there.
#[cfg(unix)]
fn is_at(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let same = |a: fs::Metadata, b: fs::Metadata| (a.dev(), a.ino()) == (b.dev(), b.ino());
    file.metadata().ok().zip(fs::metadata(path).ok()).is_some_and(|(a, b)| same(a, b))
}

/// Open files are not removed elsewhere.
#[cfg(not(unix))]
fn is_at(_: &File, _: &Path) -> bool {
    true
}

/// A sum over arrays in the order of their names.
fn sum_of<'a>(arrays: impl Iterator<Item = (&'a str, &'a [u8])>) -> String {
    let mut hasher = DefaultHasher::new();
    for (name, bytes) in arrays {
        hasher.write(name.as_bytes());
        hasher.write(bytes);
    }
    format!("{:016x}", hasher.finish())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Silent;

    fn made(checkpoints: &Checkpoints, step: &str) -> bool {
        let mut made = false;
        let values = checkpoints.array(step, 5, || {
            made = true;
            Ok(vec![[0.1f32, f32::MIN_POSITIVE, -0.0]; 5])
        });
        assert_eq!(values.unwrap(), vec![[0.1f32, f32::MIN_POSITIVE, -0.0]; 5]);
        made
    }

    #[test]
    fn a_step_is_made_once_until_all_is_done() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("kept");
        let open = |identity| Checkpoints::open(&folder, identity, &Silent).unwrap();
        assert!(made(&open("a"), "one"));
        assert!(!made(&open("a"), "one"), "known from an earlier run");
        assert!(made(&open("a"), "two") && made(&open("a").within("part"), "two"));
        assert!(!made(&open("a").within("part"), "two"));
        assert!(made(&open("b"), "one"), "of another computation");
        fs::write(folder.join("one.safetensors"), "torn").unwrap();
        assert!(made(&open("b"), "one"), "not readable");
        let file = folder.join("one.safetensors");
        let mut bytes = fs::read(&file).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        fs::write(&file, bytes).unwrap();
        assert!(made(&open("b"), "one") && !made(&open("b"), "one"), "a bit has changed");
        assert!(
            open("b").array::<f32>("one", 15, || Ok(vec![])).unwrap().len() == 15 && open("b").find("two").is_none()
        );
        assert!(open("b").array("one", 2, || Ok(vec![1.0f32, 2.0])).unwrap() == [1.0, 2.0], "of another length");
        assert!(open("b").array::<u32>("one", 1, || Ok(vec![7])).unwrap() == [7], "of another type");
        open("b").finish();
        assert!(!folder.exists());
        assert!(made(&Checkpoints::none(), "one") && made(&Checkpoints::none(), "one"));
    }

    #[test]
    fn two_runs_do_not_mix() {
        let root = tempfile::tempdir().unwrap();
        let open = |identity| Checkpoints::open(root.path(), identity, &Silent);
        let first = open("a").unwrap();
        let part = first.within("part");
        drop(first);
        let error = open("b").unwrap_err().to_string();
        assert!(error.contains("another run") && error.contains("--output"), "{error}");
        drop(part);
        assert!(open("b").is_ok());
    }

    #[test]
    fn files_of_others_stay() {
        let root = tempfile::tempdir().unwrap();
        fs::write(root.path().join("notes.txt"), "mine").unwrap();
        let checkpoints = Checkpoints::open(root.path(), "a", &Silent).unwrap();
        checkpoints.keep("one", &[("x", Array::from(&[1.0f32][..]))]).unwrap();
        checkpoints.finish();
        let left: Vec<_> = fs::read_dir(root.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(left, ["notes.txt"]);
    }
}
