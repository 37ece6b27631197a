//! Writes the flat as a capture folder.
