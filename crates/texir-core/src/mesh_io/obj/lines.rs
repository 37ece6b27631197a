//! The lines of an OBJ on their way to the parser. What one face of a group lacks, the parser takes from all of them
//! without a word, and it says of no error where it is. Faces of another form (`v`, `v/vt`, `v//vn`, `v/vt/vn`)
//! therefore get a group of their own here, lines are counted, and indices checked.

use std::io::{BufRead, Error, Read, Result};
use std::str::SplitWhitespace;

/// What begins lines whose rest is a name, which, like comments, some programs write in their country's code page.
const NAMING: [&[u8]; 5] = [b"g", b"o", b"s", b"usemtl", b"mtllib"];

/// What faces name.
const NAMES: [&str; 3] = ["v", "vt", "vn"];

/// An OBJ file, line by line.
pub(super) struct Lines<R> {
    reader: R,
    /// What is handed on, from `at`.
    line: Vec<u8>,
    at: usize,
    number: usize,
    form: Option<Form>,
    indices: Indices,
}

/// Which corners of a face have a `vt`, and which a `vn`.
#[derive(Clone, Copy, PartialEq, Eq)]
struct Form([Corners; 2]);

#[derive(Clone, Copy, PartialEq, Eq)]
enum Corners {
    All,
    Some,
    None,
}

/// What is there to be named, and what is named.
#[derive(Default)]
struct Indices {
    /// How many `v`, `vt` and `vn` there are.
    defined: [usize; 3],
    /// The largest index of each, and the first line that names it: lines may name what comes after them.
    largest: [(usize, usize); 3],
    /// The first index that cannot be.
    wrong: Option<String>,
}

impl<R: BufRead> Lines<R> {
    pub fn new(reader: R) -> Self {
        let indices = Indices::default();
        Self { reader, line: Vec::new(), at: 0, number: 0, form: None, indices }
    }

    /// The line that was read last, from 1.
    pub fn number(&self) -> usize {
        self.number
    }

    /// What is wrong with the indices up to here.
    pub fn wrong_index(&self) -> Option<String> {
        self.indices.wrong.clone().or_else(|| self.indices.missing(self.number))
    }

    fn next_line(&mut self) -> Result<()> {
        self.line.clear();
        self.at = 0;
        if self.reader.read_until(b'\n', &mut self.line)? == 0 {
            return self.wrong_index().map_or(Ok(()), |wrong| Err(Error::other(wrong)));
        }
        self.number += 1;
        // A line that ends in a backslash goes on in the next.
        while let Some(rest) = self.line.trim_ascii_end().strip_suffix(b"\\") {
            let end = rest.len();
            self.line.truncate(end);
            self.line.push(b' ');
            if self.reader.read_until(b'\n', &mut self.line)? == 0 {
                self.line.push(b'\n');
            }
            self.number += 1;
        }
        let first = self.line.split(u8::is_ascii_whitespace).find(|word| !word.is_empty()).unwrap_or_default();
        if first.starts_with(b"#") || NAMING.contains(&first) {
            self.line = String::from_utf8_lossy(&self.line).into_owned().into_bytes();
        }
        // What is no text, the parser refuses.
        let mut words = str::from_utf8(&self.line).unwrap_or_default().split_whitespace();
        let Some(first) = words.next() else { return Ok(()) };
        if let Some(kind) = NAMES.iter().position(|name| *name == first) {
            self.indices.defined[kind] += 1;
        } else if first == "f" || first == "l" {
            let form = Form::of(words.clone());
            if words.clone().next().is_none() {
                let wrong = || format!("line {}: an `{first}` line has no vertices", self.number);
                self.indices.wrong.get_or_insert_with(wrong);
            }
            self.indices.note(words, self.number);
            if let Some(wrong) = &self.indices.wrong {
                return Err(Error::other(wrong.clone()));
            }
            if self.form.replace(form).is_some_and(|before| before != form) {
                self.line.splice(0..0, *b"g\n");
            }
        }
        Ok(())
    }
}

impl<R: BufRead> BufRead for Lines<R> {
    fn fill_buf(&mut self) -> Result<&[u8]> {
        if self.at == self.line.len() {
            self.next_line()?;
        }
        Ok(&self.line[self.at..])
    }

    fn consume(&mut self, amount: usize) {
        self.at = self.line.len().min(self.at + amount);
    }
}

impl<R: BufRead> Read for Lines<R> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let amount = self.fill_buf()?.read(buffer)?;
        self.consume(amount);
        Ok(amount)
    }
}

impl Form {
    fn of(corners: SplitWhitespace<'_>) -> Self {
        let has = |part: usize| {
            let mut each = corners.clone().map(|corner| corner.split('/').nth(part).is_some_and(|i| !i.is_empty()));
            let first = each.next();
            match first {
                Some(first) if each.any(|other| other != first) => Corners::Some,
                Some(true) => Corners::All,
                _ => Corners::None,
            }
        };
        Self([has(1), has(2)])
    }
}

impl Indices {
    /// Takes note of what a face names. What is no number, the parser refuses.
    fn note(&mut self, corners: SplitWhitespace<'_>, line: usize) {
        for corner in corners {
            for (kind, index) in corner.split('/').take(NAMES.len()).enumerate() {
                if let Ok(index) = index.parse() {
                    self.note_index(kind, index, line);
                }
            }
        }
    }

    /// Positive indices count from the first line on, negative ones backwards from here.
    fn note_index(&mut self, kind: usize, index: i64, line: usize) {
        let (defined, number) = (self.defined[kind], usize::try_from(index.unsigned_abs()).unwrap_or(usize::MAX));
        let is_possible = match index {
            1.. => number <= u32::MAX as usize,
            0 => false,
            _ => number <= defined,
        };
        if !is_possible {
            let wrong = || format!("line {line} names `{}` {index}, after {defined} of them", NAMES[kind]);
            self.wrong.get_or_insert_with(wrong);
        } else if index > 0 && number > self.largest[kind].0 {
            self.largest[kind] = (number, line);
        }
    }

    /// What is named up to line `end` without being there. Where there are no `vt` or `vn` at all, faces that name them
    /// are taken to have none.
    fn missing(&self, end: usize) -> Option<String> {
        let is_missing = |&kind: &usize| {
            let defined = self.defined[kind];
            self.largest[kind].0 > defined && (kind == 0 || defined > 0)
        };
        let kind = (0..NAMES.len()).find(is_missing)?;
        let ((index, line), name, defined) = (self.largest[kind], NAMES[kind], self.defined[kind]);
        Some(format!(
            "line {line} names `{name}` {index}, and lines 1 to {end} have {defined} of them; is the file cut off?"
        ))
    }
}
