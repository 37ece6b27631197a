//! Text files in; [`crate::atomic_file`] writes them.

use std::path::Path;

use crate::error::{Error, Result};

/// What some programs, most of them on Windows, put before a text to say that it is UTF-8. It is no part of the text.
pub(crate) const BYTE_ORDER_MARK: &str = "\u{feff}";

/// A text, without a byte order mark.
pub fn read_text(path: impl AsRef<Path>) -> Result<String> {
    let path = path.as_ref();
    let mut text = std::fs::read_to_string(path).map_err(|e| Error::cannot_read(path, e))?;
    if text.starts_with(BYTE_ORDER_MARK) {
        text.drain(..BYTE_ORDER_MARK.len());
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_order_mark_is_no_part_of_the_text() {
        let file = tempfile::NamedTempFile::new().unwrap();
        for (bytes, text) in
            [("\u{feff}{}", "{}"), ("{}", "{}"), ("", ""), ("\u{feff}", ""), ("{\u{feff}", "{\u{feff}")]
        {
            std::fs::write(file.path(), bytes).unwrap();
            assert_eq!(read_text(file.path()).unwrap(), text);
        }
        std::fs::write(file.path(), b"\xff\xfe{\0").unwrap();
        let error = read_text(file.path()).unwrap_err().to_string();
        assert!(error.contains(&file.path().display().to_string()) && error.contains("UTF-8"), "{error}");
    }
}
