//! Output files and folders that are either complete or absent: written beside their destination, then renamed onto it.

use std::ffi::{OsStr, OsString};
use std::fmt::Display;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use crate::error::{Error, Result};

/// What [`write_atomic`] hands to its closure: buffered, seekable.
pub type Sink<'a> = BufWriter<&'a mut File>;

/// What the names of temporary files and folders begin with.
const TEMPORARY: &str = ".texir-";

/// Symbolic links that lead from one to the next, at most, as Linux has it.
const MOST_LINKS: usize = 40;

/// Writes `path` through a temporary file in the same folder, which replaces `path` once `write` succeeded and every
/// byte is on its way to the disk. On any failure `path` is as it was. Missing folders are made. A symbolic link stays
/// one: what it names is written, whether that exists or not.
pub fn write_atomic<E: Display>(
    path: impl AsRef<Path>,
    write: impl FnOnce(&mut Sink) -> std::result::Result<(), E>,
) -> Result<()> {
    let path = path.as_ref();
    let failed = |what: &dyn Display| Error::cannot_write(path, what);
    let target = destination(path).ok_or_else(|| failed(&"it is a symbolic link that leads back to itself"))?;
    let folder = folder_of(&target);
    std::fs::create_dir_all(folder).map_err(|e| failed(&e))?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(TEMPORARY).suffix(".part");
    // A temporary file is private by default; an output is as readable as the user's umask allows.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut temporary = builder.tempfile_in(folder).map_err(|e| failed(&e))?;
    let mut sink = BufWriter::new(temporary.as_file_mut());
    write(&mut sink).map_err(|e| failed(&e))?;
    sink.flush().map_err(|e| failed(&e))?;
    drop(sink);
    temporary.persist(&target).map_err(|e| failed(&e.error))?;
    Ok(())
}

/// A folder that fills unseen, and goes unless what is in it is moved to its target: within that where it exists, which
/// may be another disk than its parent, else beside it.
#[derive(Debug)]
pub struct Stage {
    /// What goes when the stage does.
    hidden: TempDir,
    target: PathBuf,
}

/// The folder that fills, within the hidden one: it has the permissions of an ordinary new folder.
const FILLING: &str = "new";

impl Stage {
    /// Prepares to fill `target`, which may exist; missing folders above it are made.
    pub fn new(target: &Path) -> Result<Self> {
        let round = || Error::cannot_write(target, "it is a symbolic link that leads back to itself");
        let target = &destination(target).ok_or_else(round)?;
        if target.exists() && !target.is_dir() {
            return Err(Error::file(target, "is a file; expected a folder for the outputs, or a name for a new one"));
        }
        let (place, side) = if target.is_dir() { (target.as_path(), "in") } else { (folder_of(target), "beside") };
        let failed = |e| Error::file(target, format!("cannot be written {side}: {e}"));
        std::fs::create_dir_all(place).map_err(failed)?;
        let hidden = tempfile::Builder::new().prefix(TEMPORARY).tempdir_in(place).map_err(failed)?;
        std::fs::create_dir(hidden.path().join(FILLING)).map_err(failed)?;
        Ok(Self { hidden, target: target.to_owned() })
    }

    /// The folder to write to.
    pub fn folder(&self) -> PathBuf {
        self.hidden.path().join(FILLING)
    }

    /// Where that will be moved to.
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Makes the folder the target, at once, where nothing is there yet.
    pub fn place_whole(&self) -> Result<()> {
        std::fs::rename(self.folder(), &self.target).map_err(|e| Error::cannot_write(&self.target, e))
    }

    /// Moves a file or folder to the target, which is there, in place of a file of its name.
    pub fn place(&self, name: impl AsRef<Path>) -> Result<()> {
        let to = self.target.join(&name);
        std::fs::rename(self.folder().join(name), &to).map_err(|e| Error::cannot_write(&to, e))
    }

    /// Moves all to the target, which holds none of it; the file `last` after all others.
    pub fn place_all(self, last: &str) -> Result<()> {
        if !self.target.exists() {
            return self.place_whole();
        }
        let failed = |e| Error::cannot_write(&self.target, e);
        let entries = std::fs::read_dir(self.folder()).map_err(failed)?;
        let names = entries.map(|entry| Ok(entry?.file_name())).collect::<std::io::Result<Vec<OsString>>>();
        let mut names = names.map_err(failed)?;
        names.sort_by_key(|name| name == OsStr::new(last));
        names.iter().try_for_each(|name| self.place(name))
    }
}

/// Whether a file or folder of this name is one on its way. A run that is killed leaves such behind; the name does not
/// tell whether anybody still writes to it.
pub(crate) fn is_unfinished(name: &OsStr) -> bool {
    name.as_encoded_bytes().starts_with(TEMPORARY.as_bytes())
}

/// What symbolic links at `path` lead to in the end; `None` where they lead in circles.
fn destination(path: &Path) -> Option<PathBuf> {
    let mut target = path.to_owned();
    for _ in 0..=MOST_LINKS {
        match std::fs::read_link(&target) {
            // Relative to where the link lies.
            Ok(next) => target = folder_of(&target).join(next),
            Err(_) => return Some(target),
        }
    }
    None
}

/// The folder that a file or folder lies in.
pub(crate) fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect()
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.txt");
        write_atomic(&path, |w| w.write_all(b"first")).unwrap();
        let error = write_atomic(&path, |w| {
            w.write_all(b"half").map_err(|e| e.to_string())?;
            Err("no more paper".to_owned())
        })
        .unwrap_err()
        .to_string();
        assert!(error.contains("out.txt") && error.contains("no more paper"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"first");
        assert_eq!(names(folder.path()), ["out.txt"]);
    }

    #[test]
    fn missing_folders_are_made_and_success_replaces() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b/out.txt");
        for text in ["first", "second"] {
            write_atomic(&path, |w| w.write_all(text.as_bytes())).unwrap();
        }
        assert_eq!(std::fs::read(&path).unwrap(), b"second");
    }

    #[cfg(unix)]
    #[test]
    fn links_stay_and_what_they_name_is_written() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("disk")).unwrap();
        std::fs::write(at("disk/old.txt"), b"old").unwrap();
        // To a file, to nothing yet in a folder that is a link itself, and to a link.
        symlink(at("disk/old.txt"), at("to_old")).unwrap();
        symlink("disk", at("folder")).unwrap();
        symlink("folder/../disk/new.txt", at("to_new")).unwrap();
        symlink("to_old", at("to_link")).unwrap();
        for (link, named) in [("to_old", "disk/old.txt"), ("to_new", "disk/new.txt"), ("to_link", "disk/old.txt")] {
            write_atomic(at(link), |w| w.write_all(link.as_bytes())).unwrap();
            assert!(at(link).is_symlink() && !at(named).is_symlink(), "{link}");
            assert_eq!(std::fs::read(at(named)).unwrap(), link.as_bytes());
        }
        // Negative control: a failure leaves what is named as it was, and a link that is a file's neighbour is no
        // matter.
        write_atomic(at("to_old"), |_| Err("no more paper")).unwrap_err();
        assert_eq!(std::fs::read(at("disk/old.txt")).unwrap(), b"to_link");
        let mut left = names(&at("disk"));
        left.sort();
        assert_eq!(left, ["new.txt", "old.txt"]);
        symlink("round", at("round")).unwrap();
        let error = write_atomic(at("round"), |w| w.write_all(b"x")).unwrap_err().to_string();
        assert!(error.contains("round") && error.contains("back to itself"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn outputs_have_the_permissions_of_an_ordinary_new_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (ours, ordinary) = (folder.path().join("ours"), folder.path().join("ordinary"));
        write_atomic(&ours, |w| w.write_all(b"x")).unwrap();
        std::fs::write(&ordinary, b"x").unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&ordinary));
    }

    #[test]
    fn what_is_on_its_way_is_told_by_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let unfinished = || names(folder.path()).iter().filter(|name| is_unfinished(name.as_ref())).count();
        let stage = Stage::new(folder.path()).unwrap();
        write_atomic(folder.path().join("out.txt"), |w| {
            assert_eq!((unfinished(), names(folder.path()).len()), (2, 2));
            w.write_all(b"x")
        })
        .unwrap();
        drop(stage);
        assert_eq!((unfinished(), names(folder.path())), (0, vec!["out.txt".to_owned()]));
    }

    #[test]
    fn a_stage_becomes_its_target_at_once_or_fills_it() {
        let root = tempfile::tempdir().unwrap();
        let target = root.path().join("out");
        for text in ["first", "second"] {
            let stage = Stage::new(&target).unwrap();
            std::fs::write(stage.folder().join("a.txt"), text).unwrap();
            assert_eq!(target.exists(), text == "second");
            stage.place_all("a.txt").unwrap();
            assert_eq!(std::fs::read_to_string(target.join("a.txt")).unwrap(), text);
        }
        assert_eq!((names(&target), names(root.path())), (vec!["a.txt".to_owned()], vec!["out".to_owned()]));
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let ordinary = root.path().join("ordinary");
            std::fs::create_dir(&ordinary).unwrap();
            let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
            assert_eq!(mode(&target), mode(&ordinary));
        }
    }
}
