//! What a bake has gathered so far, in a file: an interrupted bake goes on where it was.
//!
//! A bake gathers its tiles one after another in an order that its settings determine, and a tile's result depends on its
//! texels alone. So the journal is the list of results so far: a resumed bake reads those and computes the rest, to the
//! same bits.

use std::collections::VecDeque;
use std::fs::{File, OpenOptions};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use bytemuck::{cast_slice, pod_collect_to_vec};

use crate::backend::Gathered;
use crate::error::{Error, Result};
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::raster::Rgb;

/// First bytes of a journal; then its identity, 8 bytes.
const MAGIC: [u8; 8] = *b"texirbk1";
/// Bytes before a tile's results: their number and their checksum, 8 each, little-endian.
const RECORD_HEAD: usize = 16;

/// The results of finished tiles.
pub struct Journal {
    path: PathBuf,
    file: File,
    /// Tiles of an earlier run that were not taken yet.
    earlier: VecDeque<Vec<Gathered>>,
}

impl Journal {
    /// Opens the journal of a bake, or begins it. The results depend on the mesh, the light and `settings`: a journal of
    /// others is overwritten, with a warning. A tile that was only partly written is gathered again.
    pub fn open(
        path: impl AsRef<Path>,
        mesh: &Mesh,
        radiance: &Rgb,
        settings: impl Hash,
        progress: &dyn Progress,
    ) -> Result<Self> {
        let path = path.as_ref().to_owned();
        let failed = |e| Error::file(&path, format!("the bake's progress cannot be kept: {e}"));
        let vectors: [&[u8]; 2] = [cast_slice(&mesh.positions), cast_slice(&mesh.normals)];
        let texels: &[u8] = cast_slice(&radiance.data);
        let uvs: &[u8] = cast_slice(&mesh.uvs);
        let light = (radiance.size(), texels);
        let identity = (env!("CARGO_PKG_VERSION"), vectors, uvs, &mesh.triangles, light, settings);
        let head = [MAGIC, hash_of(&identity).to_le_bytes()].concat();
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(failed)?;
        }
        let options = || OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
        let mut file = options().map_err(failed)?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).map_err(failed)?;
        let (mut earlier, mut kept) = (VecDeque::new(), head.len());
        if bytes.starts_with(&head) {
            while let Some((tile, length)) = record(&bytes[kept..]) {
                earlier.push_back(tile);
                kept += length;
            }
        } else {
            if !bytes.is_empty() {
                progress.warn(&format!(
                    "{}: the progress of another bake (another mesh, light, setting or version): begun anew",
                    path.display()
                ));
            }
            file.set_len(0).and_then(|()| file.rewind()).and_then(|()| file.write_all(&head)).map_err(failed)?;
        }
        file.set_len(kept as u64).and_then(|()| file.seek(SeekFrom::End(0))).map_err(failed)?;
        Ok(Self { path, file, earlier })
    }

    /// The next tile's results, where an earlier run gathered them.
    pub(super) fn next(&mut self) -> Option<Vec<Gathered>> {
        self.earlier.pop_front()
    }

    /// Adds the next tile's results.
    pub(super) fn push(&mut self, tile: &[Gathered]) -> Result<()> {
        let results: &[u8] = cast_slice(tile);
        let head = [(tile.len() as u64).to_le_bytes(), hash_of(&results).to_le_bytes()].concat();
        self.file
            .write_all(&[&head, results].concat())
            .map_err(|e| Error::file(&self.path, format!("the bake's progress cannot be kept: {e}")))
    }

    /// Removes the file: the bake's result is written.
    pub fn remove(self) -> Result<()> {
        std::fs::remove_file(&self.path).map_err(|e| Error::file(&self.path, format!("cannot be removed: {e}")))
    }
}

/// The first record of `bytes`, and its length; `None` where none is complete.
fn record(bytes: &[u8]) -> Option<(Vec<Gathered>, usize)> {
    let number = |at: usize| Some(u64::from_le_bytes(bytes.get(at..at + 8)?.try_into().ok()?));
    let length = usize::try_from(number(0)?).ok()?.checked_mul(size_of::<Gathered>())?.checked_add(RECORD_HEAD)?;
    let results = bytes.get(RECORD_HEAD..length)?;
    (hash_of(&results) == number(8)?).then(|| (pod_collect_to_vec(results), length))
}

fn hash_of(value: &impl Hash) -> u64 {
    let mut hasher = DefaultHasher::new();
    value.hash(&mut hasher);
    hasher.finish()
}
