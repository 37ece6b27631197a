//! Finding files by their names, where formats leave it open how exactly they are called.

use std::collections::{HashMap, HashSet};
use std::path::{Component, Path, PathBuf};

/// Extensions of linear images, which are preferred to what a photo program was fed with.
const LINEAR: [&str; 4] = ["exr", "hdr", "tif", "tiff"];
/// Extensions of encoded images.
const ENCODED: [&str; 3] = ["png", "jpg", "jpeg"];
/// Extensions of meshes, in the order in which they are looked for.
const MESH: [&str; 4] = ["obj", "glb", "gltf", "ply"];

/// The path that `name` stands for in `folder`: where there is none with its backslashes, it was written on Windows.
pub(super) fn with_slashes(folder: &Path, name: &str) -> String {
    if name.contains('\\') && !folder.join(name).exists() { name.replace('\\', "/") } else { name.to_owned() }
}

/// `folder/<any of places>/name`, a linear image of the same stem before the named file itself. Where there is none,
/// the first place that it could have been in, of those that there are: whoever opens it says that it is missing.
pub(super) fn image(folder: &Path, places: &[&str], name: &str) -> PathBuf {
    let candidates =
        || places.iter().map(|place| if place.is_empty() { folder.join(name) } else { folder.join(place).join(name) });
    let with_extension = |extension: &str| candidates().map(|c| with_extension(&c, extension)).find(|c| c.is_file());
    let linear = LINEAR.iter().find_map(|extension| with_extension(extension));
    let found = linear.or_else(|| candidates().find(|c| c.is_file()));
    let found = found.or_else(|| ENCODED.iter().find_map(|extension| with_extension(extension)));
    if found.is_none() && name.contains('\\') {
        return image(folder, places, &name.replace('\\', "/"));
    }
    let is_there = |path: &PathBuf| path.parent().is_some_and(Path::is_dir);
    found.or_else(|| candidates().find(is_there)).unwrap_or_else(|| folder.join(name))
}

/// The image that `path`, below `folder`, names. For an encoded one what it was merged into: a linear image of the same
/// stem in `hdr/`, under the same path with or without its first folder, or beside it.
pub(super) fn rather_linear(folder: &Path, path: &Path) -> PathBuf {
    let named = folder.join(path);
    if !is_encoded(path) {
        return named;
    }
    let hdr = folder.join("hdr");
    let whole: PathBuf = path.components().filter(|part| *part != Component::CurDir).collect();
    let shorter: PathBuf = whole.components().skip(1).collect();
    let shorter = (shorter.file_name() == path.file_name()).then(|| hdr.join(&shorter));
    let places = shorter.into_iter().chain([hdr.join(&whole), named.clone()]);
    let mut candidates = places.flat_map(|place| LINEAR.map(|extension| place.with_extension(extension)));
    candidates.find(|path| path.is_file()).unwrap_or(named)
}

/// Replaces an image's extension; a name without one (`r_0`, `scan.12`) gets it.
fn with_extension(path: &Path, extension: &str) -> PathBuf {
    if is_image(path) {
        return path.with_extension(extension);
    }
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(extension);
    name.into()
}

/// The name ends as an image's does.
fn is_image(path: &Path) -> bool {
    ends_with(path, &LINEAR) || is_encoded(path)
}

/// The name ends as that of an image of 8 or 16-bit values does.
pub(super) fn is_encoded(path: &Path) -> bool {
    ends_with(path, &ENCODED)
}

fn ends_with(path: &Path, extensions: &[&str]) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    extensions.iter().any(|e| e.eq_ignore_ascii_case(extension))
}

/// `mesh.*`, else the only mesh among the folder's files.
pub(super) fn mesh(folder: &Path) -> Option<PathBuf> {
    let named = MESH.iter().map(|extension| folder.join("mesh").with_extension(extension)).find(|path| path.is_file());
    named.or_else(|| only(folder, &MESH))
}

/// The only file of the folder with one of these extensions.
pub(super) fn only(folder: &Path, extensions: &[&str]) -> Option<PathBuf> {
    let mut found = with_extensions(folder, extensions);
    if found.len() == 1 { found.pop() } else { None }
}

/// The folder's files with one of these extensions, sorted.
pub(super) fn with_extensions(folder: &Path, extensions: &[&str]) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut found: Vec<PathBuf> = entries.filter(|path| ends_with(path, extensions) && path.is_file()).collect();
    found.sort();
    found
}

/// Names for views from their file names: stems, and where two files share one, the whole path with `_` between its
/// parts, and a number behind those that still clash.
pub(super) fn view_names<'a>(files: impl Iterator<Item = &'a str> + Clone) -> Vec<String> {
    let stem = |file: &str| {
        let path = Path::new(file);
        let stem = if is_image(path) { path.file_stem() } else { path.file_name() };
        stem.map_or_else(|| "view".to_owned(), |s| s.to_string_lossy().into_owned())
    };
    let mut uses = HashMap::<String, usize>::new();
    for file in files.clone() {
        *uses.entry(stem(file)).or_default() += 1;
    }
    let mut taken = HashSet::new();
    let name = |file: &str| {
        let stem = stem(file);
        let parent = Path::new(file).parent().map(|p| p.to_string_lossy().into_owned()).unwrap_or_default();
        let mut name = stem.clone();
        if uses[&stem] > 1 && !parent.is_empty() {
            let parts: Vec<&str> = parent.split(['/', '\\']).filter(|p| !matches!(*p, "" | "." | "..")).collect();
            name = [parts.join("_"), stem].join("_");
        }
        let base = name.clone();
        let mut number = 2;
        while !taken.insert(name.clone()) {
            name = format!("{base}_{number}");
            number += 1;
        }
        name
    };
    files.map(name).collect()
}
