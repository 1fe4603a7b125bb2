//! The records of a table: as they come in, then target by target in order, however many there are.
//!
//! Records gather in runs. A run that is full is sorted by target and instant; runs that would take more memory than there is to spare go to a
//! temporary file. [`Merge`] reads all runs from front to back at once.

use crate::names::TargetId;
use crate::record::{self, Rule, Shape};
use std::cmp::Ordering;
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// Words of a run: 16 MiB.
const RUN_WORDS: usize = 1 << 21;
/// Words of all runs that may stay in memory: 64 MiB.
const KEPT_WORDS: usize = 1 << 23;
/// Records of a target that may be in memory at once.
const LONG: usize = 1 << 20;
/// Rows of a target that have to stand together, on average: the place of each lot is kept.
const FEWEST_ROWS: u64 = 64;
/// Words of row groups that may be there at once, where targets are tracked out of the file itself: 192 MiB.
const LOADED_WORDS: usize = 3 << 23;
/// Words read of a spilled run at a time.
const PAGE_WORDS: usize = 1 << 16;

/// How much is kept where.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Room {
    /// Words of a run.
    pub run_words: usize,
    /// Words of all runs that may stay in memory.
    pub kept_words: usize,
    /// Records of a target beyond which its rows are written while it is still tracked.
    pub long: usize,
    /// Rows of a target that stand together, at least and on average, where they are tracked out of the file itself.
    pub fewest_rows: u64,
    /// Words of row groups that may be there at once then.
    pub loaded_words: usize,
}

impl Room {
    /// Everything in memory.
    pub const UNLIMITED: Room = Room { kept_words: usize::MAX, long: usize::MAX, ..Room::BOUNDED };
    /// What does not fit goes to a file.
    pub const BOUNDED: Room = Room {
        run_words: RUN_WORDS,
        kept_words: KEPT_WORDS,
        long: LONG,
        fewest_rows: FEWEST_ROWS,
        loaded_words: LOADED_WORDS,
    };
}

/// A sorted run.
struct Run {
    shape: Shape,
    words: Vec<u64>,
    /// Where it begins in the file, and how many words there are of it: what is in memory then is nothing.
    spilled: Option<(u64, usize)>,
}

/// Records in runs.
pub(crate) struct Store {
    room: Room,
    /// Folder of the temporary file.
    folder: PathBuf,
    file: Option<File>,
    written: u64,
    runs: Vec<Run>,
    /// The run that is being filled.
    open: Vec<u64>,
    open_shape: Shape,
    scratch: Vec<u64>,
    kept: usize,
    /// Records in all.
    pub records: u64,
}

/// What the order of records depends on besides themselves.
pub(crate) struct SortBy<'a> {
    /// Place of each target in the order of their names.
    pub rank: &'a [u32],
    /// Whether the records of a target are ordered by `k`.
    pub by_k: &'a dyn Fn(TargetId) -> bool,
    /// How times are ordered.
    pub rule: &'a Rule,
}

impl Store {
    /// An empty store that spills to `folder`.
    pub fn new(room: Room, folder: &Path) -> Store {
        Store {
            room,
            folder: folder.to_owned(),
            file: None,
            written: 0,
            runs: Vec::new(),
            open: Vec::new(),
            open_shape: Shape::default(),
            scratch: Vec::new(),
            kept: 0,
            records: 0,
        }
    }

    /// Appends records of one shape; whether the run is full now and wants to be [closed](Store::close).
    pub fn append(&mut self, words: &[u64], shape: &Shape) -> bool {
        if words.is_empty() {
            return false;
        }
        if self.open.is_empty() {
            self.open_shape = *shape;
        }
        self.records += (words.len() / shape.width) as u64;
        if *shape == self.open_shape {
            self.open.extend_from_slice(words);
        } else {
            let wide = self.open_shape.union(shape);
            if wide != self.open_shape {
                let before = std::mem::take(&mut self.open);
                let records = before.chunks_exact(self.open_shape.width);
                records.for_each(|r| self.open_shape.widen(r, &wide, &mut self.open));
                self.open_shape = wide;
            }
            words.chunks_exact(shape.width).for_each(|r| shape.widen(r, &wide, &mut self.open));
        }
        self.open.len() >= self.room.run_words
    }

    /// Words of as many records of a shape as a run has room for, one at least.
    pub fn run_words(&self, shape: &Shape) -> usize {
        (self.room.run_words / shape.width.max(1)).max(1) * shape.width.max(1)
    }

    /// Whether runs are closed as soon as they are full.
    pub fn is_bounded(&self) -> bool {
        self.room.kept_words < usize::MAX
    }

    /// Sorts the open run and puts it away.
    ///
    /// # Errors
    /// What the system says when the temporary file cannot be written.
    pub fn close(&mut self, by: &SortBy<'_>) -> io::Result<()> {
        let shape = self.open_shape;
        sort(&mut self.open, &mut self.scratch, &shape, by);
        if self.kept + self.open.len() > self.room.kept_words {
            let at = self.spill()?;
            self.runs.push(Run { shape, words: Vec::new(), spilled: Some(at) });
        } else {
            self.kept += self.open.len();
            self.runs.push(Run { shape, words: std::mem::take(&mut self.open), spilled: None });
        }
        self.open.clear();
        Ok(())
    }

    fn spill(&mut self) -> io::Result<(u64, usize)> {
        let file = match &mut self.file {
            Some(file) => file,
            None => self.file.insert(tempfile::tempfile_in(&self.folder)?),
        };
        file.write_all(bytemuck::cast_slice(&self.open))?;
        let at = (self.written, self.open.len());
        self.written += 8 * self.open.len() as u64;
        Ok(at)
    }

    /// Ends the filling.
    ///
    /// # Errors
    /// As [`Store::close`].
    pub fn merge(mut self, by: &SortBy<'_>) -> io::Result<Merge> {
        if !self.open.is_empty() {
            self.close(by)?;
        }
        let shape = self.runs.iter().skip(1).fold(self.runs.first().map_or(Shape::default(), |r| r.shape), |all, r| {
            if all == r.shape { all } else { all.union(&r.shape) }
        });
        let mut merge = Merge { file: self.file, shape, cursors: Vec::new() };
        for run in self.runs {
            let (offset, left) = run.spilled.unwrap_or((0, 0));
            let mut cursor = Cursor { shape: run.shape, words: run.words, at: 0, offset, left };
            cursor.refill(merge.file.as_mut())?;
            merge.cursors.push(cursor);
        }
        Ok(merge)
    }
}

/// Sorts records by target, then as [`Shape::compare`] says; equal ones keep their order.
fn sort(words: &mut Vec<u64>, scratch: &mut Vec<u64>, shape: &Shape, by: &SortBy<'_>) {
    let width = shape.width;
    let rank = |r: &[u64]| by.rank[record::target(r) as usize];
    let mut is_grouped = true;
    let mut last = 0;
    for r in words.chunks_exact(width) {
        let now = rank(r);
        is_grouped &= now >= last;
        last = now;
    }
    if !is_grouped {
        // By counting: targets are many, and so are their records.
        let mut starts = vec![0_usize; by.rank.len() + 1];
        words.chunks_exact(width).for_each(|r| starts[rank(r) as usize + 1] += width);
        (1..starts.len()).for_each(|i| starts[i] += starts[i - 1]);
        scratch.clear();
        scratch.resize(words.len(), 0);
        for r in words.chunks_exact(width) {
            let start = &mut starts[rank(r) as usize];
            scratch[*start..*start + width].copy_from_slice(r);
            *start += width;
        }
        std::mem::swap(words, scratch);
    }
    let mut start = 0;
    while start < words.len() {
        let target = record::target(&words[start..]);
        let count = words[start..].chunks_exact(width).take_while(|r| record::target(r) == target).count();
        let of_target = &mut words[start..start + count * width];
        sort_target(of_target, shape, (by.by_k)(target), by.rule);
        start += count * width;
    }
}

/// Sorts records of one target as [`Shape::compare`] says; equal ones keep their order.
fn sort_target(records: &mut [u64], shape: &Shape, by_k: bool, rule: &Rule) {
    let compare = |a: &[u64], b: &[u64]| shape.compare(a, b, by_k, rule);
    let mut rows = records.chunks_exact(shape.width);
    let is_sorted = rows.next().is_none_or(|first| {
        let mut before = first;
        rows.all(|r| {
            let ordered = compare(before, r) != Ordering::Greater;
            before = r;
            ordered
        })
    });
    if !is_sorted {
        let mut order: Vec<&[u64]> = records.chunks_exact(shape.width).collect();
        order.sort_by(|a, b| compare(a, b));
        let sorted = order.concat();
        records.copy_from_slice(&sorted);
    }
}

/// Where a run is read.
struct Cursor {
    shape: Shape,
    words: Vec<u64>,
    at: usize,
    /// What of it is still in the file.
    offset: u64,
    left: usize,
}

impl Cursor {
    /// The next record.
    fn head(&self) -> Option<&[u64]> {
        self.words.get(self.at..self.at + self.shape.width)
    }

    fn step(&mut self, file: Option<&mut File>) -> io::Result<()> {
        self.at += self.shape.width;
        if self.at >= self.words.len() { self.refill(file) } else { Ok(()) }
    }

    fn refill(&mut self, file: Option<&mut File>) -> io::Result<()> {
        if self.left == 0 {
            if self.at >= self.words.len() {
                // What has been read is not needed any more.
                (self.words, self.at) = (Vec::new(), 0);
            }
            return Ok(());
        }
        let Some(file) = file else { return Ok(()) };
        let page = (PAGE_WORDS / self.shape.width * self.shape.width).min(self.left);
        self.words.resize(page, 0);
        file.seek(SeekFrom::Start(self.offset))?;
        file.read_exact(bytemuck::cast_slice_mut(&mut self.words))?;
        self.at = 0;
        self.offset += 8 * page as u64;
        self.left -= page;
        Ok(())
    }
}

/// Reads the records of all runs in order.
pub(crate) struct Merge {
    file: Option<File>,
    /// Shape of the records it hands out.
    pub shape: Shape,
    cursors: Vec<Cursor>,
}

impl Merge {
    /// The next target in order, if there is one.
    pub fn target(&self, by: &SortBy<'_>) -> Option<TargetId> {
        let heads = self.cursors.iter().filter_map(Cursor::head).map(record::target);
        heads.min_by_key(|target| by.rank[*target as usize])
    }

    /// Appends records of the next target to `out`, at most about `most`; whether these were its last.
    ///
    /// # Errors
    /// What the system says when the temporary file cannot be read.
    pub fn take(&mut self, target: TargetId, most: usize, by: &SortBy<'_>, out: &mut Vec<u64>) -> io::Result<bool> {
        let by_k = (by.by_k)(target);
        let mut left = most;
        // The runs that have records of the target, in the order of their heads.
        let of_target = |c: &Cursor| c.head().is_some_and(|r| record::target(r) == target);
        let mut order: VecDeque<usize> = (0..self.cursors.len()).filter(|i| of_target(&self.cursors[*i])).collect();
        order.make_contiguous().sort_by(|a, b| self.compare(*a, *b, by_k, by.rule));
        while left > 0 {
            let Some(first) = order.pop_front() else { return Ok(true) };
            let second = order.front().copied();
            let (shape, to) = (self.cursors[first].shape, self.shape);
            if second.is_none() && shape == to {
                // Nothing stands between: all that is at hand of the target at once.
                let cursor = &mut self.cursors[first];
                let rest = cursor.words[cursor.at..].chunks_exact(shape.width);
                let count = rest.take(left).take_while(|r| record::target(r) == target).count();
                let end = cursor.at + count * shape.width;
                out.extend_from_slice(&cursor.words[cursor.at..end]);
                left -= count;
                cursor.at = end - shape.width;
                cursor.step(self.file.as_mut())?;
                if of_target(&self.cursors[first]) {
                    order.push_front(first);
                }
                continue;
            }
            while let Some(r) = self.cursors[first].head().filter(|r| record::target(r) == target) {
                if let Some(second) = second
                    && self.compare(second, first, by_k, by.rule) == Ordering::Less
                {
                    break;
                }
                if left == 0 {
                    break;
                }
                if shape == to {
                    out.extend_from_slice(r)
                } else {
                    shape.widen(r, &to, out)
                }
                left -= 1;
                self.cursors[first].step(self.file.as_mut())?;
            }
            if of_target(&self.cursors[first]) {
                let place = order.partition_point(|i| self.compare(*i, first, by_k, by.rule) == Ordering::Less);
                order.insert(place, first);
            }
        }
        Ok(self.target(by) != Some(target))
    }

    /// Orders the heads of two cursors; of equal ones that of the earlier run comes first.
    fn compare(&self, a: usize, b: usize, by_k: bool, rule: &Rule) -> Ordering {
        let (Some(x), Some(y)) = (self.cursors[a].head(), self.cursors[b].head()) else { return Ordering::Equal };
        let (sx, sy) = (&self.cursors[a].shape, &self.cursors[b].shape);
        let order = if sx == sy {
            sx.compare(x, y, by_k, rule)
        } else {
            let (mut wide_x, mut wide_y) = (Vec::new(), Vec::new());
            sx.widen(x, &self.shape, &mut wide_x);
            sy.widen(y, &self.shape, &mut wide_y);
            self.shape.compare(&wide_x, &wide_y, by_k, rule)
        };
        order.then(a.cmp(&b))
    }
}
