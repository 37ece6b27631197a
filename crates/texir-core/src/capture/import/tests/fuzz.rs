//! Mutated files: whatever their bytes are, reading them ends in a result or an error, never in a panic, and never asks
//! for more memory than `LARGEST` plus some for every byte of the files.
//!
//! `TEXIR_FUZZ_CASES=100000 cargo test --release -p texir-core fuzz` runs longer than the short run of every test run.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::PathBuf;

use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::{Index, select};
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};

use super::formats;
use super::*;
use crate::capture::{Coverage, Tbl, nerfstudio};
use crate::raster::Raster;

/// Cases per file of a short run.
const CASES: u32 = 150;
/// Bytes that a single allocation may have, whatever the input.
const LARGEST: usize = 1 << 20;
/// And for every byte of the mutated file: text becomes numbers, entries become structures.
const PER_BYTE: usize = 64;
/// Images may be compressed: see `image_io::check_size`.
const PER_IMAGE_BYTE: usize = (1 << 14) * 16;

thread_local! {
    static REQUESTED: Cell<usize> = const { Cell::new(0) };
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
fn survives(folder: &TempDir, files: &[&str], per_byte: usize, read: impl Fn(&Path)) {
    let cases = std::env::var("TEXIR_FUZZ_CASES").ok().and_then(|n| n.parse().ok());
    for file in files {
        let path: PathBuf = folder.path().join(file);
        let seed = std::fs::read(&path).unwrap();
        let config = Config { cases: cases.unwrap_or(CASES), failure_persistence: None, ..Config::default() };
        // The short run is the same every time, the long one never.
        let mut runner = match cases {
            None => TestRunner::new_with_rng(config, TestRng::deterministic_rng(RngAlgorithm::ChaCha)),
            Some(_) => TestRunner::new(config),
        };
        let result = runner.run(&vec(edit(), 1..6), |edits| {
            let bytes = mutate(&seed, &edits);
            std::fs::write(&path, &bytes).unwrap();
            REQUESTED.set(0);
            read(folder.path());
            let (asked, allowed) = (REQUESTED.get(), LARGEST + per_byte * bytes.len());
            prop_assert!(asked <= allowed, "{}: asked for {asked} bytes, more than {allowed}", file);
            Ok(())
        });
        std::fs::write(&path, &seed).unwrap();
        result.unwrap_or_else(|e| panic!("{file}: {e}"));
        read(folder.path());
    }
}

/// As `texir import` starts, and with the lens that comes out of it.
fn import(folder: &Path) {
    let Ok(read) = read(folder, &ImportOptions::default(), &Silent) else { return };
    for shot in &read.shots {
        let lens = shot.distortion.and_then(|lens| super::lens::Undistortion::new(&shot.view.camera, lens));
        if let Some(lens) = lens {
            assert!(lens.pinhole.pixels() <= 16 * shot.view.camera.pixels());
        }
    }
}

#[test]
fn colmap() {
    let model = |extension| ["cameras", "images"].map(|name| format!("sparse/0/{name}.{extension}"));
    for (binary, files) in [(true, model("bin")), (false, model("txt"))] {
        survives(&formats::colmap(Vec3::Z, binary), &files.each_ref().map(String::as_str), PER_BYTE, import);
    }
}

#[test]
fn colmap_with_a_lens() {
    let folder = formats::colmap(Vec3::Z, false);
    let path = folder.path().join("sparse/0/cameras.txt");
    for line in
        ["7 FULL_OPENCV 8 4 5 5 4 2 0.1 0.01 0.001 0.002 0.03 0.1 0.02 0.003", "7 OPENCV_FISHEYE 8 4 5 5 4 2 .1 0 0 0"]
    {
        std::fs::write(&path, line).unwrap();
        survives(&folder, &["sparse/0/cameras.txt"], PER_BYTE, import);
    }
}

#[test]
fn nerfstudio_transforms() {
    survives(&formats::nerfstudio(), &["transforms.json"], PER_BYTE, |folder| {
        import(folder);
        drop(nerfstudio::read_transforms(folder.join("transforms.json")));
    });
}

#[test]
fn blender() {
    survives(&formats::blender_scene(), &["transforms_train.json"], PER_BYTE, import);
}

#[test]
fn panoramas() {
    let [json, quaternions, angles] = formats::panorama_lists();
    survives(&json, &["panoramas.json"], PER_BYTE, import);
    survives(&quaternions, &["panoramas.csv"], PER_BYTE, import);
    survives(&angles, &["panoramas.csv"], PER_BYTE, import);
}

#[test]
fn matterport() {
    let files = ["matterport_camera_poses/ab_pose_0_1.txt", "matterport_camera_intrinsics/ab_intrinsics_0.txt"];
    survives(&formats::matterport(), &files, PER_BYTE, import);
    survives(&formats::matterport_undistorted().0, &["undistorted_camera_parameters/xyz.conf"], PER_BYTE, import);
}

#[test]
fn texir_authors() {
    let files = ["info/aligned.txt", "info/final_extrinsics.txt"];
    survives(&formats::texir_authors().0, &files, PER_BYTE, import);
}

#[test]
fn gltf() {
    survives(&formats::gltf(true), &["scene.gltf"], PER_BYTE, import);
    survives(&formats::gltf(false), &["scene.gltf", "scene.bin"], PER_BYTE, import);
}

#[test]
fn textures_with_coverage() {
    let folder = tempfile::tempdir().unwrap();
    let coverage =
        Raster::new(4, 2, [Coverage::Seen, Coverage::Inpainted, Coverage::Outside, Coverage::Seen].repeat(2));
    let tbl = Tbl { radiance: Rgb::filled(4, 2, [0.5, 1.0, 7.0]), coverage: coverage.unwrap() };
    tbl.write(folder.path().join("t.exr")).unwrap();
    survives(&folder, &["t.exr", "t_mask.png"], PER_IMAGE_BYTE, |folder| {
        drop(Tbl::read(folder.join("t.exr"), &Silent));
    });
}

/// The watch sees what it is to see.
#[test]
fn large_requests_are_noticed() {
    REQUESTED.set(0);
    drop(std::hint::black_box(Vec::<u8>::with_capacity(3 << 20)));
    assert!(REQUESTED.get() >= 3 << 20);
}
