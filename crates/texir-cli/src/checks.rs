//! What is refused before any work: outputs that would replace inputs, and what no output can be.

use std::path::{Path, PathBuf};

use crate::failure::Failure;

fn same(a: &Path, b: &Path) -> bool {
    a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b))
}

/// Errors where a folder that is to be written to has files that are read: before any work.
pub fn check_folder(folder: &Path, inputs: &[PathBuf]) -> Result<(), Failure> {
    let inside = |input: &&PathBuf| input.exists() && input.parent().is_some_and(|parent| same(parent, folder));
    inputs.iter().find(inside).map_or(Ok(()), |input| {
        let input = input.file_name().unwrap_or_default().display();
        Err(Failure::new(format!("{}: contains {input}, which this command reads", folder.display()))
            .help("give another folder, or one that does not exist yet"))
    })
}

/// Errors where a file that is to be written is one that is read, or a folder: before any work.
pub fn check_outputs(outputs: &[&Path], inputs: &[impl AsRef<Path>]) -> Result<(), Failure> {
    for output in outputs {
        if inputs.iter().any(|input| same(output, input.as_ref())) {
            return Err(Failure::new(format!("{}: the output would replace an input", output.display()))
                .help("give --output another name or folder"));
        }
        if output.is_dir() {
            return Err(Failure::new(format!("{}: this is a folder; expected the name of a file", output.display()))
                .help("give --output another name"));
        }
    }
    Ok(())
}

/// Errors where what is written as OpenEXR alone is to have another ending.
pub fn check_exr(output: &Path) -> Result<(), Failure> {
    if output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("exr")) {
        return Ok(());
    }
    Err(Failure::new(format!("{}: the output is an OpenEXR; expected a name that ends in .exr", output.display())))
}
