//! Finding files by their names, where formats leave it open how exactly they are called.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

/// Extensions of linear images, which are preferred to what a photo program was fed with.
const LINEAR: [&str; 4] = ["exr", "hdr", "tif", "tiff"];
/// Extensions of encoded images.
const ENCODED: [&str; 3] = ["png", "jpg", "jpeg"];
/// Extensions of meshes, in the order in which they are looked for.
const MESH: [&str; 4] = ["obj", "glb", "gltf", "ply"];

/// `folder/<any of places>/name`, a linear image of the same stem before the named file itself. Where there is none,
/// the first place that it could have been in: whoever opens it says that it is missing.
pub(super) fn image(folder: &Path, places: &[&str], name: &str) -> PathBuf {
    let candidates =
        || places.iter().map(|place| if place.is_empty() { folder.join(name) } else { folder.join(place).join(name) });
    let with_extension = |extension: &str| candidates().map(|c| with_extension(&c, extension)).find(|c| c.is_file());
    let linear = LINEAR.iter().find_map(|extension| with_extension(extension));
    let found = linear.or_else(|| candidates().find(|c| c.is_file()));
    let found = found.or_else(|| ENCODED.iter().find_map(|extension| with_extension(extension)));
    found.or_else(|| candidates().next()).unwrap_or_else(|| folder.join(name))
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
    let extension = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    extension.is_some_and(|extension| LINEAR.iter().chain(&ENCODED).any(|e| *e == extension))
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
    let wanted = |path: &PathBuf| {
        let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        extensions.contains(&extension.as_str()) && path.is_file()
    };
    let mut found: Vec<PathBuf> = entries.filter(wanted).collect();
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
