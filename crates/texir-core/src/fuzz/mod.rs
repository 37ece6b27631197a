//! Mutated files: whatever their bytes are, reading them ends in a result or an error, never in a panic, and never asks
//! for more memory at once than a [`Bound`] that grows with the file.
//!
//! `TEXIR_FUZZ_SECONDS=60 cargo test --release -p texir-core fuzz -- --show-output` mutates every file for a minute
//! instead of the few cases of every test run, and says how many there were.

mod files;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use rayon::{ThreadPool, ThreadPoolBuilder};
use tempfile::TempDir;

/// Cases per file of a short run, and between two looks at the clock of a long one.
const CASES: u32 = 150;

/// Bytes that a single allocation may have.
#[derive(Clone, Copy)]
pub struct Bound {
    /// Bytes for any input.
    whatever: usize,
    /// Bytes for every byte of the mutated file.
    per_byte: usize,
}

/// Text becomes numbers, entries become structures.
pub const TEXT: Bound = Bound { whatever: 1 << 20, per_byte: 64 };
/// Images may be compressed: see `image_io::limits`.
pub const IMAGE: Bound = Bound { per_byte: (1 << 14) * 16, ..TEXT };
/// A tag may announce as many values as its reader's own limit lets it, before they are looked for.
pub const TIFF: Bound = Bound { whatever: 256 << 20, ..IMAGE };

thread_local! {
    static REQUESTED: Cell<usize> = const { Cell::new(0) };
    /// What is done in parallel is done by the thread itself, whose requests are watched.
    static ALONE: ThreadPool = ThreadPoolBuilder::new().num_threads(1).use_current_thread().build().unwrap();
}

/// The system's allocator, which remembers the largest request of each thread.
struct Watched;

impl Watched {
    fn note(size: usize) {
        // A thread that ends has no memory left for notes.
        let _ = REQUESTED.try_with(|requested| requested.set(requested.get().max(size)));
    }
}

// SAFETY: all calls are handed on unchanged.
unsafe impl GlobalAlloc for Watched {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        Self::note(layout.size());
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        Self::note(layout.size());
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        Self::note(size);
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Watched = Watched;

/// A change somewhere in a file.
#[derive(Clone, Debug)]
enum Edit {
    Set(Index, u8),
    Insert(Index, Vec<u8>),
    Remove(Index, usize),
    Overwrite(Index, Vec<u8>),
    Cut(Index),
}

/// What parsers stumble over.
fn tokens() -> Vec<Vec<u8>> {
    let text = [
        "nan",
        "inf",
        "-inf",
        "-1",
        "0",
        "1e308",
        "1e-320",
        "18446744073709551615",
        "4294967296",
        "\n",
        " ",
        "\"",
        "null",
    ];
    let text = text.iter().map(|t| t.as_bytes().to_vec());
    let numbers = [0, 1, u64::from(u32::MAX), u64::MAX, 1 << 40, f64::NAN.to_bits(), f64::MAX.to_bits()];
    text.chain(numbers.map(|n| n.to_le_bytes().to_vec())).chain([vec![0xff; 4], vec![0], vec![b'['; 300]]).collect()
}

fn edit() -> impl Strategy<Value = Edit> {
    let at = any::<Index>;
    prop_oneof![
        4 => (at(), any::<u8>()).prop_map(|(i, b)| Edit::Set(i, b)),
        3 => (at(), select(tokens())).prop_map(|(i, t)| Edit::Overwrite(i, t)),
        2 => (at(), select(tokens())).prop_map(|(i, t)| Edit::Insert(i, t)),
        2 => (at(), 1..40_usize).prop_map(|(i, n)| Edit::Remove(i, n)),
        1 => at().prop_map(Edit::Cut),
    ]
}

fn mutate(bytes: &[u8], edits: &[Edit]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    for edit in edits {
        // One more place than there are bytes: the end.
        let place = |i: &Index| i.index(out.len() + 1);
        match edit {
            Edit::Set(i, b) => {
                let place = place(i);
                out.get_mut(place).into_iter().for_each(|byte| *byte = *b);
            }
            Edit::Insert(i, token) => {
                let place = place(i);
                out.splice(place..place, token.iter().copied());
            }
            Edit::Remove(i, n) => {
                let place = place(i);
                out.drain(place..(place + n).min(out.len()));
            }
            Edit::Overwrite(i, token) => {
                let place = place(i);
                out.splice(place..(place + token.len()).min(out.len()), token.iter().copied());
            }
            Edit::Cut(i) => out.truncate(place(i)),
        }
    }
    out
}

/// Mutates each of the files many times over and hands the folder to `read`.
#[track_caller]
pub fn survives(folder: &TempDir, files: &[&str], bound: Bound, read: impl Fn(&Path) + Sync) {
    let seconds: Option<f64> = std::env::var("TEXIR_FUZZ_SECONDS").ok().and_then(|n| n.parse().ok());
    for file in files {
        let path: PathBuf = folder.path().join(file);
        let seed = std::fs::read(&path).unwrap();
        let case = |edits: Vec<Edit>| {
            let bytes = mutate(&seed, &edits);
            std::fs::write(&path, &bytes).unwrap();
            REQUESTED.set(0);
            ALONE.with(|alone| alone.install(|| read(folder.path())));
            let (asked, allowed) = (REQUESTED.get(), bound.whatever + bound.per_byte * bytes.len());
            prop_assert!(asked <= allowed, "{}: asked for {asked} bytes, more than {allowed}", file);
            Ok(())
        };
        let (started, mut cases) = (Instant::now(), 0);
        loop {
            let config = Config { cases: CASES, failure_persistence: None, ..Config::default() };
            // The short run is the same every time, the long one never.
            let mut runner = match seconds {
                None => TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha)),
                Some(_) => TestRunner::new(config),
            };
            let result = runner.run(&vec(edit(), 1..6), case);
            result.unwrap_or_else(|e| panic!("{file}: {e}"));
            cases += CASES;
            if seconds.is_none_or(|seconds| started.elapsed() >= Duration::from_secs_f64(seconds)) {
                break;
            }
        }
        println!("{file}: {cases} cases in {:.1} s", started.elapsed().as_secs_f64());
        std::fs::write(&path, &seed).unwrap();
        read(folder.path());
    }
}

/// The watch sees what it is to see.
#[test]
fn large_requests_are_noticed() {
    REQUESTED.set(0);
    drop(std::hint::black_box(Vec::<u8>::with_capacity(3 << 20)));
    assert!(REQUESTED.get() >= 3 << 20);
}
