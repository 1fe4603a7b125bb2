//! Row groups of a Parquet file as records, from shortly before the first target that needs them until the last has been read.

use crate::formats::Part;
use crate::formats::parquet::{Reader, groups::Groups};
use crate::formats::spans::Span;
use crate::rows::{Block, Rows};
use fixtrail_track::error::BuildError;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// The row groups of a file, and which of them are there.
pub(super) struct Loaded<'a> {
    pub groups: Groups<'a>,
    /// Words of a record.
    width: usize,
    slots: Vec<Slot>,
}

/// A row group.
struct Slot {
    /// Held while it is read: who needs it too waits.
    records: Mutex<Option<Arc<Vec<u64>>>>,
    /// How many spans of it have not been read.
    left: AtomicUsize,
}

impl<'a> Loaded<'a> {
    /// None of the row groups.
    pub fn new(groups: Groups<'a>, width: usize) -> Loaded<'a> {
        let mut left = vec![0; groups.len()];
        groups.list.iter().for_each(|span| left[groups.place(span).0] += 1);
        let slot = |left| Slot { records: Mutex::new(None), left: AtomicUsize::new(left) };
        Loaded { groups, width, slots: left.into_iter().map(slot).collect() }
    }

    /// The row groups to load before each piece of work, so that each is there `ahead` pieces before its first; `work` are the spans of each
    /// piece. `None` where more than about `most` words would have to be there at once.
    pub fn order<S: Iterator<Item = usize>>(
        &self,
        work: impl ExactSizeIterator<Item = S>,
        (ahead, most): (usize, usize),
    ) -> Option<Vec<Vec<usize>>> {
        let pieces = work.len();
        let mut used: Vec<Option<Range<usize>>> = vec![None; self.slots.len()];
        for (piece, spans) in work.enumerate() {
            for span in spans {
                let (group, _) = self.groups.place(&self.groups.list[span]);
                let first = used[group].as_ref().map_or(piece.saturating_sub(ahead), |used| used.start);
                used[group] = Some(first..piece + 1);
            }
        }
        let mut order = vec![Vec::new(); pieces];
        // Words that come with a piece, and that go after it.
        let (mut come, mut go) = (vec![0; pieces], vec![0; pieces]);
        for (group, used) in used.into_iter().enumerate() {
            let Some(used) = used else { continue };
            let words = self.width * self.groups.rows(group);
            come[used.start] += words;
            go[used.end - 1] += words;
            order[used.start].push(group);
        }
        let mut there = 0;
        for (come, go) in come.into_iter().zip(go) {
            there += come;
            if there > most {
                return None;
            }
            there -= go;
        }
        Some(order)
    }

    /// A row group, which is read through `part` unless it is there; what was seen then is added to `seen`. Empty once all of it has been read.
    ///
    /// # Errors
    /// [`BuildError`] when it cannot be read.
    pub fn load(
        &self,
        group: usize,
        reader: &mut Option<Reader>,
        part: &mut Rows<'_>,
        seen: &mut Vec<Block>,
    ) -> Result<Arc<Vec<u64>>, BuildError> {
        let Slot { records, left } = &self.slots[group];
        let mut slot = records.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(records) = &*slot {
            return Ok(records.clone());
        }
        // Who was to load it may come too late: those who needed it did so themselves.
        if left.load(Ordering::Relaxed) == 0 {
            return Ok(Arc::default());
        }
        part.use_room(Vec::with_capacity(self.width * self.groups.rows(group)));
        let read = self.groups.read(group, reader, part);
        let mut block = part.cut();
        let records = Arc::new(std::mem::take(&mut block.words));
        seen.push(block);
        read?;
        *slot = Some(records.clone());
        Ok(records)
    }

    /// Appends the records of a span to `out`; `None` where its row group has not one record for each row.
    ///
    /// # Errors
    /// As [`load`](Loaded::load).
    pub fn read(
        &self,
        span: &Span,
        reader: &mut Option<Reader>,
        part: &mut Rows<'_>,
        seen: &mut Vec<Block>,
        out: &mut Vec<u64>,
    ) -> Result<Option<()>, BuildError> {
        let (group, rows) = self.groups.place(span);
        let records = self.load(group, reader, part, seen)?;
        if records.len() != self.width * self.groups.rows(group) {
            return Ok(None);
        }
        out.extend_from_slice(&records[self.width * rows.start..self.width * rows.end]);
        let Slot { records, left } = &self.slots[group];
        if left.fetch_sub(1, Ordering::Relaxed) == 1 {
            *records.lock().unwrap_or_else(PoisonError::into_inner) = None;
        }
        Ok(Some(()))
    }
}
