//! WGSL sources, how they are composed, and what naga knows of the result.
//!
//! `#import name` on a line of its own pulls in `shared/name.wgsl`, once. Some names are stand-ins, for which a
//! [`Variant`] chooses the module: that keeps a choice out of the compiled kernel altogether. Messages name the file
//! and line that a piece came from. With the environment variable `TEXIR_DUMP_WGSL=DIR`, every composed source is
//! written there.

use std::path::Path;

use texir_core::backend::RoughnessGradient;
use texir_core::error::{Error, Result};

use crate::scene::{BvhStorage, SceneOpacity};

/// Sources by name, as files on disk are: `shade`, or `shared/bvh`.
#[derive(Clone, Copy)]
pub struct Library<'a>(pub &'a [(&'a str, &'a str)]);

/// The sources that the crate was built with.
pub const SHADERS: Library<'static> = Library(texir_shaders::SOURCES);

/// Which modules stand behind the stand-in names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Variant {
    /// `fetch`: where the hierarchy lies.
    pub hierarchy: BvhStorage,
    /// `opacity` and `shadow`: what rays meet of triangles.
    pub opacity: SceneOpacity,
    /// `roughness`: which derivative with respect to roughness shading returns.
    pub roughness: RoughnessGradient,
}

impl Variant {
    /// Every variant.
    #[cfg(test)]
    pub fn all() -> impl Iterator<Item = Self> {
        [BvhStorage::Buffers, BvhStorage::Textures].into_iter().flat_map(|hierarchy| {
            SceneOpacity::ALL.into_iter().flat_map(move |opacity| {
                [RoughnessGradient::Exact, RoughnessGradient::Authors].map(|roughness| Self {
                    hierarchy,
                    opacity,
                    roughness,
                })
            })
        })
    }

    /// The module behind an imported name.
    fn module<'n>(&self, name: &'n str) -> &'n str {
        match name {
            "fetch" => match self.hierarchy {
                BvhStorage::Textures => "fetch_texture",
                BvhStorage::Buffers => "fetch_buffer",
            },
            "opacity" => match self.opacity {
                SceneOpacity::Opaque => "opaque",
                SceneOpacity::InParts | SceneOpacity::Translucent => "micromaps",
            },
            "shadow" => match self.opacity {
                SceneOpacity::Opaque | SceneOpacity::InParts => "shadow_sharp",
                SceneOpacity::Translucent => "shadow_translucent",
            },
            "roughness" => match self.roughness {
                RoughnessGradient::Exact => "roughness_exact",
                RoughnessGradient::Authors => "roughness_authors",
            },
            _ => name,
        }
    }
}

/// One WGSL source with all that it imports.
pub struct Composed {
    /// The text for the device.
    pub source: String,
    /// naga's reading of it.
    pub module: naga::Module,
    /// naga's analysis of it: what each entry point uses.
    pub info: naga::valid::ModuleInfo,
}

impl Library<'_> {
    /// Names of the sources that are passes, not shared modules.
    #[cfg(test)]
    pub fn passes(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(|(name, _)| *name).filter(|name| !name.starts_with("shared/"))
    }

    /// Composes and validates the pass `name`.
    pub fn compose(&self, name: &str, variant: Variant) -> Result<Composed> {
        let mut text = Text::default();
        self.append(name, variant, &mut text, None)?;
        dump(name, variant, &text.source)?;
        let module = naga::front::wgsl::parse_str(&text.source).map_err(|e| {
            let at = e.location(&text.source);
            text.error(name, at, e.message())
        })?;
        let mut validator =
            naga::valid::Validator::new(naga::valid::ValidationFlags::all(), naga::valid::Capabilities::default());
        let info = validator.validate(&module).map_err(|e| {
            let at = e.location(&text.source);
            text.error(name, at, &chain(e.as_inner()))
        })?;
        Ok(Composed { source: text.source, module, info })
    }

    fn append(&self, name: &str, variant: Variant, text: &mut Text, from: Option<(&str, usize)>) -> Result<()> {
        let Some(&(name, source)) = self.0.iter().find(|(n, _)| *n == name) else {
            let known: Vec<_> = self.0.iter().filter_map(|(n, _)| n.strip_prefix("shared/")).collect();
            let place = from.map_or(String::new(), |(file, line)| format!("{file}.wgsl:{line}: "));
            return Err(Error::device(format!("{place}there is no shader {name:?} (modules: {})", known.join(", "))));
        };
        if text.included.iter().any(|n| n == name) {
            return Ok(());
        }
        text.included.push(name.to_owned());
        for (i, line) in source.lines().enumerate() {
            match line.strip_prefix("#import ") {
                Some(import) => {
                    let module = format!("shared/{}", variant.module(import.trim()));
                    self.append(&module, variant, text, Some((name, i + 1)))?;
                }
                None => text.push(name, i + 1, line),
            }
        }
        Ok(())
    }
}

/// Composed text that remembers where its lines came from.
#[derive(Default)]
struct Text {
    source: String,
    included: Vec<String>,
    /// Per line, the file and the line in it.
    origins: Vec<(String, usize)>,
}

impl Text {
    fn push(&mut self, file: &str, number: usize, line: &str) {
        self.source.push_str(line);
        self.source.push('\n');
        self.origins.push((file.to_owned(), number));
    }

    /// A message of naga's, mapped back to the file and line that it is about.
    fn error(&self, name: &str, at: Option<naga::SourceLocation>, message: &str) -> Error {
        let origin = at.and_then(|l| Some((self.origins.get(l.line_number as usize - 1)?, l.line_position)));
        Error::device(match origin {
            Some(((file, line), column)) => format!("{file}.wgsl:{line}:{column}: {message} (composing {name})"),
            None => format!("{name}.wgsl: {message}"),
        })
    }
}

/// An error with all its causes.
fn chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(c) = cause {
        text.push_str(&format!(": {c}"));
        cause = c.source();
    }
    text
}

fn dump(name: &str, variant: Variant, source: &str) -> Result<()> {
    let Some(folder) = std::env::var_os("TEXIR_DUMP_WGSL") else { return Ok(()) };
    let Variant { hierarchy, opacity, roughness } = variant;
    let file = Path::new(&folder).join(format!("{name}_{hierarchy:?}_{opacity:?}_{roughness:?}.wgsl").to_lowercase());
    std::fs::create_dir_all(&folder)
        .and_then(|()| std::fs::write(&file, source))
        .map_err(|e| Error::file(&file, format!("cannot write the composed shader (TEXIR_DUMP_WGSL): {e}")))
}

#[cfg(test)]
mod tests;
