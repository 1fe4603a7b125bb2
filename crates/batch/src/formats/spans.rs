//! Where the rows of each target stand in a text file that keeps them together.

use super::csv::{self, Header};
use super::lines::{self, Lines};
use super::{Part, Progress, TableSink, ndjson, unreadable};
use crate::columns::Extent;
use crate::input::{Format, Input, Source};
use crate::names::{Lookup, Names, TargetId};
use crate::ordered::ordered;
use fixtrail_track::error::BuildError;
use memchr::memmem::Finder;
use memchr::{memchr, memrchr};
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::Path;

/// Rows of one target, one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Span {
    /// As far as a glance tells: who reads the rows knows.
    pub target: TargetId,
    /// The first line, or the first row of a Parquet file.
    pub line: u64,
    /// How many there are.
    pub lines: u64,
}

/// Spans that are found, in the order of their file.
pub(crate) struct Listing<'n> {
    targets: &'n Names,
    lookup: Lookup,
    fewest_rows: u64,
    first: u64,
    line: u64,
    list: Vec<Span>,
}

/// Why a look through a file ends early.
pub(crate) enum Stop {
    /// Rows of a target do not stand together, or a closer look is needed.
    Apart,
    Failed(BuildError),
}

impl<'n> Listing<'n> {
    /// No spans yet; `first` is the first line of the first.
    pub fn new(targets: &'n Names, fewest_rows: u64, first: u64) -> Listing<'n> {
        Listing { targets, lookup: Lookup::default(), fewest_rows, first, line: first, list: Vec::new() }
    }

    /// Adds the next lines, to the last span where these `join` it and the target is the same; whether there is a new span.
    pub fn add(&mut self, name: &str, lines: u64, join: bool) -> bool {
        let target = self.lookup.id(self.targets, name);
        let line = self.line;
        self.line += lines;
        match self.list.last_mut() {
            Some(last) if join && last.target == target => {
                last.lines += lines;
                false
            }
            _ => {
                self.list.push(Span { target, line, lines });
                true
            }
        }
    }

    /// # Errors
    /// [`Stop::Apart`] when spans have too few rows on average.
    pub fn check(&self) -> Result<(), Stop> {
        // One target more than its rows may have come in.
        let fewest = self.fewest_rows.saturating_mul((self.list.len() as u64).saturating_sub(1));
        if self.line - self.first < fewest { Err(Stop::Apart) } else { Ok(()) }
    }

    /// All spans, unless the look ended early.
    pub fn finish(self, looked: Result<(), Stop>) -> Result<Option<Vec<Span>>, BuildError> {
        match looked {
            Ok(()) => Ok(Some(self.list)),
            Err(Stop::Apart) => Ok(None),
            Err(Stop::Failed(error)) => Err(error),
        }
    }
}

/// The spans of a text file, in its order.
pub(crate) struct Spans {
    pub list: Vec<Span>,
    /// Where each begins, and how long it is.
    bytes: Vec<(u64, u64)>,
    rows: Rows,
}

/// How the rows of a file are read.
enum Rows {
    /// By commas: cells of a row.
    Csv(usize),
    /// As objects with the keys of the first one.
    Ndjson(ndjson::Keys),
}

/// What a thread keeps while it reads spans.
#[derive(Default)]
pub(crate) struct Reading {
    /// The table, opened once more: where a file is read is not shared.
    file: Option<File>,
    bytes: Vec<u8>,
    keys: Option<ndjson::Keys>,
}

/// How a glance at a line finds the name of its target.
enum Glance {
    /// As the cell of a column.
    Csv(usize),
    /// Behind a key, which stands in quotes, with the colon.
    Ndjson(Box<Finder<'static>>),
}

/// The pieces of a block by themselves: name, bytes and lines; `None` where it needs a closer look.
type Found = Option<Vec<(String, u64, u64)>>;

impl Piece<'_> {
    fn owned(&self) -> (String, u64, u64) {
        (self.name.to_owned(), self.bytes, self.lines)
    }
}

/// A span within a block.
struct Piece<'a> {
    name: &'a str,
    bytes: u64,
    lines: u64,
}

impl Spans {
    /// Looks through a file and gives `part` its columns; `target` says which of them names the target, `targets` takes the names. `None` where
    /// a span has fewer than `fewest_rows` rows on average, where CSV has quotes, and in any other case that needs a closer look.
    ///
    /// # Errors
    /// [`BuildError`] when the file cannot be read, or from `part`.
    pub fn of<P: Part>(
        input: &Input,
        format: Option<Format>,
        part: &mut P,
        target: impl Fn(&P) -> Option<usize>,
        (targets, fewest_rows): (&Names, u64),
        progress: Progress<'_>,
    ) -> Result<Option<Spans>, BuildError> {
        let source = Source::open(input, format)?;
        let Input::File(path) = input else { return Ok(None) };
        let (file, total) = (source.file, source.total);
        if source.format == Format::Parquet {
            return Ok(None);
        }
        let is_csv = source.format == Format::Csv;
        let failed = |e: io::Error| unreadable(file, &e);
        let first = Lines::new(source.reader).next().map_err(failed)?.unwrap_or_default();
        let (names, rows, end, line) = if is_csv {
            let Some(Header { names, line, end }) = csv::header(&first) else { return Ok(None) };
            let columns = names.len();
            (names, Rows::Csv(columns), end, line)
        } else {
            let Some(keys) = ndjson::Keys::of_first(&first) else { return Ok(None) };
            (keys.names().to_vec(), Rows::Ndjson(keys), 0, 0)
        };
        part.columns(&names, Extent::Whole)?;
        let Some(column) = target(part) else { return Ok(None) };
        let glance = match is_csv {
            true => Glance::Csv(column),
            false => Glance::Ndjson(Box::new(Finder::new(format!("\"{}\":", names[column]).as_bytes()).into_owned())),
        };

        let mut blocks = (end as u64..total).step_by(BLOCK as usize).map(|from| from..total.min(from + BLOCK));
        let work = |(opened, bytes): &mut (Option<File>, Vec<u8>), block: Range<u64>| {
            let reader = match opened {
                Some(reader) => reader,
                None => opened.insert(File::open(path)?),
            };
            whole_lines(reader, block.clone(), block.start == end as u64, bytes)?;
            let pieces = pieces(bytes, &glance).map(|pieces| pieces.iter().map(Piece::owned).collect::<Vec<_>>());
            Ok((pieces, block.end))
        };
        let mut list = Listing::new(targets, fewest_rows, line + 1);
        let (mut from, mut places) = (end as u64, Vec::new());
        let take = |worked: io::Result<(Found, u64)>| {
            let (pieces, done) = worked.map_err(|e| Stop::Failed(failed(e)))?;
            for (name, bytes, lines) in pieces.ok_or(Stop::Apart)? {
                match (list.add(&name, lines, true), places.last_mut()) {
                    (false, Some((_, of_last))) => *of_last += bytes,
                    _ => places.push((from, bytes)),
                }
                from += bytes;
            }
            progress(done, total);
            list.check()
        };
        let kept = || (None, Vec::new());
        let found = ordered(rayon::current_num_threads(), kept, || Ok(blocks.next()), work, take);
        Ok(list.finish(found)?.map(|list| Spans { list, bytes: places, rows }))
    }

    /// Reads the lines of a span, given by its number, into `sink`.
    ///
    /// # Errors
    /// [`BuildError`] when the file cannot be read or is another one by now, when an object has a key that the first has not, and from `sink`.
    pub fn read<S: TableSink>(
        &self,
        span: usize,
        name: &Path,
        kept: &mut Reading,
        sink: &mut S,
    ) -> Result<(), BuildError> {
        let failed = |e: io::Error| unreadable(name, &e);
        let Reading { file, bytes, keys } = kept;
        let file = match file {
            Some(file) => file,
            None => file.insert(File::open(name).map_err(failed)?),
        };
        let ((from, length), line) = (self.bytes[span], self.list[span].line);
        bytes.clear();
        file.seek(SeekFrom::Start(from)).map_err(failed)?;
        file.take(length).read_to_end(bytes).map_err(failed)?;
        match &self.rows {
            Rows::Csv(columns) => {
                let text = std::str::from_utf8(bytes).map_err(|e| failed(io::Error::other(e)))?;
                csv::cut_rows(text, line, *columns, name, sink).1
            }
            Rows::Ndjson(first) => {
                ndjson::read_span(bytes, (name, line), keys.get_or_insert_with(|| first.fork()), sink)
            }
        }
    }
}

impl Glance {
    /// What stands from the name of a line's target on.
    #[inline]
    fn cell<'a>(&self, text: &'a [u8]) -> Option<&'a [u8]> {
        match self {
            Glance::Csv(column) => {
                let mut at = 0;
                for _ in 0..*column {
                    let skip = text[at..].iter().position(|b| matches!(b, b',' | b'\n'))?;
                    if text[at + skip] != b',' {
                        return None;
                    }
                    at += skip + 1;
                }
                Some(&text[at..])
            }
            Glance::Ndjson(key) => {
                let end = memchr(b'\n', text).unwrap_or(text.len());
                let at = key.find(&text[..end])? + key.needle().len();
                let blank = text[at..end].iter().position(|b| *b != b' ')?;
                Some(&text[at + blank..])
            }
        }
    }

    /// The bytes of a name at the beginning of a cell, quotes included, and the name.
    fn name<'a>(&self, cell: &'a [u8]) -> Option<(&'a [u8], &'a str)> {
        let length = cell.iter().position(|b| self.ends(*b)).unwrap_or(cell.len());
        let bytes = &cell[..length];
        let text = std::str::from_utf8(bytes).ok()?;
        let name = match self {
            Glance::Csv(_) => text,
            // A number that is written as names are, or a text without escapes.
            Glance::Ndjson(_) if text.bytes().all(|b| b.is_ascii_digit()) => text,
            Glance::Ndjson(_) => {
                text.strip_prefix('"')?.strip_suffix('"').filter(|name| !name.contains(['\\', '"']))?
            }
        };
        (!name.is_empty() && name.trim() == name).then_some((bytes, name))
    }

    #[inline]
    fn ends(&self, byte: u8) -> bool {
        match self {
            Glance::Csv(_) => matches!(byte, b',' | b'\n'),
            Glance::Ndjson(_) => matches!(byte, b',' | b'\n' | b'}'),
        }
    }
}

/// Bytes looked through at a time.
const BLOCK: u64 = 1 << 20;

/// Reads the lines that begin in a part of a file; the first of all begins with it.
fn whole_lines(file: &mut File, part: Range<u64>, is_first: bool, bytes: &mut Vec<u8>) -> io::Result<()> {
    bytes.clear();
    // The byte before tells whether a line begins with the part.
    let from = if is_first { part.start } else { part.start - 1 };
    file.seek(SeekFrom::Start(from))?;
    file.take(part.end - from).read_to_end(bytes)?;
    let begin = if is_first { Some(0) } else { memchr(b'\n', bytes).map(|end| end + 1) };
    let Some(begin) = begin.filter(|begin| *begin < bytes.len()) else {
        bytes.clear();
        return Ok(());
    };
    bytes.drain(..begin);
    while bytes.last() != Some(&b'\n') {
        let read = bytes.len();
        file.take(4096).read_to_end(bytes)?;
        match memchr(b'\n', &bytes[read..]) {
            Some(end) => bytes.truncate(read + end + 1),
            None if bytes.len() == read => break,
            None => {}
        }
    }
    Ok(())
}

/// The spans of whole lines; `None` where CSV has a quote, or the first line of a span no name that a glance finds.
///
/// Only some lines are looked at: the steps to the end of a span double as long as the target is the same, then halve (galloping search). What
/// stands between two lines of one target is taken to be its own.
fn pieces<'a>(block: &'a [u8], glance: &Glance) -> Option<Vec<Piece<'a>>> {
    if matches!(glance, Glance::Csv(_)) && memchr(b'"', block).is_some() {
        return None;
    }
    let after = |at: usize| memchr(b'\n', &block[at..]).map_or(block.len(), |end| at + end + 1);
    let mut pieces: Vec<Piece<'_>> = Vec::new();
    let (mut start, mut step) = (0, FIRST_STEP);
    while start < block.len() {
        let (bytes, name) = glance.name(glance.cell(&block[start..])?)?;
        let is_same = |at: usize| {
            let cell = glance.cell(&block[at..]);
            cell.is_some_and(|cell| {
                cell.starts_with(bytes) && cell.get(bytes.len()).is_none_or(|next| glance.ends(*next))
            })
        };
        // Lines up to `low` are the target's; the one at `high` is not, or there is none.
        let (mut low, mut high) = (after(start), block.len());
        while low < high {
            let at = after((low + step).min(high) - 1);
            if at >= high {
                break;
            }
            match is_same(at) {
                true => (low, step) = (after(at), 2 * step),
                false => high = at,
            }
        }
        while low < high {
            let middle = low + (high - low) / 2;
            let at = memrchr(b'\n', &block[low..middle]).map_or(low, |end| low + end + 1);
            match is_same(at) {
                true => low = after(at),
                false => high = at,
            }
        }
        // The next target has about as many rows.
        step = (low - start).max(FIRST_STEP);
        pieces.push(Piece { name, bytes: (low - start) as u64, lines: lines::count(&block[start..low]) });
        start = low;
    }
    // The last line of a file may lack its end.
    if let (Some(last), false) = (pieces.last_mut(), block.ends_with(b"\n")) {
        last.lines += 1;
    }
    Some(pieces)
}

/// Bytes of the first step to the end of a span.
const FIRST_STEP: usize = 256;

#[cfg(test)]
mod tests {
    use super::{Glance, pieces, whole_lines};
    use memchr::memmem::Finder;
    use std::io::{Seek, Write};

    #[test]
    fn parts_of_a_file_are_whole_lines_and_nothing_is_lost() {
        for text in ["", "\n", "a", "a\nbc\n", "a\n\n\nlonger than a part\nb\nend"] {
            let mut file = tempfile::tempfile().unwrap();
            file.write_all(text.as_bytes()).unwrap();
            for size in 1..=text.len() as u64 + 1 {
                let (mut all, mut bytes) = (Vec::new(), Vec::new());
                for from in (0..text.len() as u64).step_by(size as usize) {
                    file.rewind().unwrap();
                    let part = from..(from + size).min(text.len() as u64);
                    whole_lines(&mut file, part, from == 0, &mut bytes).unwrap();
                    all.extend_from_slice(&bytes);
                }
                assert_eq!(String::from_utf8(all).unwrap(), text, "in parts of {size}");
            }
        }
    }

    #[test]
    fn lines_of_a_target_make_one_span() {
        let list = |text: &str, column| {
            let pieces = pieces(text.as_bytes(), &Glance::Csv(column))?;
            Some(pieces.iter().map(|p| format!("{}:{}:{}", p.name, p.bytes, p.lines)).collect::<Vec<_>>().join(" "))
        };
        assert_eq!(list("1,a,2\n2,a,3\n3,ab,4\n4,a,5", 1).unwrap(), "a:12:2 ab:7:1 a:5:1");
        assert_eq!(list("a,1\na,2\nb,3\n", 0).unwrap(), "a:8:2 b:4:1");
        assert_eq!(list("1,a\r\n", 1), None, "white space is for a closer look");
        for odd in ["\n2,a,3\n", "1,\"a\",2\n", "1,,2\n", "1,a,2\n2\n"] {
            assert_eq!(list(odd, 1), None, "{odd}");
        }
        assert_eq!(list("", 1).unwrap(), "");
    }

    #[test]
    fn objects_are_told_apart_by_the_key_of_their_target() {
        let key = Glance::Ndjson(Box::new(Finder::new("\"tag\":").into_owned()));
        let list = |text: &str| {
            let pieces = pieces(text.as_bytes(), &key)?;
            Some(pieces.iter().map(|p| format!("{}:{}", p.name, p.lines)).collect::<Vec<_>>().join(" "))
        };
        let text = "{\"tag\":\"a\",\"x\":1}\n{\"x\":2,\"tag\": \"a\"}\n{\"tag\":\"ab\"}\n{\"tag\":12}\n{\"tag\":12}";
        assert_eq!(list(text).unwrap(), "a:2 ab:1 12:2");
        for odd in [
            "{\"x\":1}\n",
            "{\"tag\":null}",
            "{\"tag\":1.0}",
            "{\"tag\":\"a\\n\"}",
            "{\"tag\":\"a,b\"}",
            "{\"tag\":\"\"}",
        ] {
            assert_eq!(list(odd), None, "{odd}");
        }
    }

    #[test]
    fn spans_of_any_length_are_found() {
        let (mut text, mut expected) = (String::new(), Vec::new());
        for (i, rows) in [1, 2, 3, 700, 1, 1, 5000, 40, 41, 2, 1000, 1].into_iter().enumerate() {
            let of_target: String =
                (0..rows).map(|k| format!("{k},target{i},{}\n", "7".repeat(1 + (k * i) % 5))).collect();
            expected.push((format!("target{i}"), of_target.len() as u64, rows as u64));
            text += &of_target;
        }
        let found = pieces(text.as_bytes(), &Glance::Csv(1)).unwrap();
        let found: Vec<_> = found.into_iter().map(|p| (p.name.to_owned(), p.bytes, p.lines)).collect();
        assert_eq!(found, expected);
    }
}
