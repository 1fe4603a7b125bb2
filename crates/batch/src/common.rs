//! What holds of a whole table, block by block.

use crate::options::Counts;
use crate::rows::{self, Block, Seen};
use fixtrail_track::error::BuildError;
use std::path::Path;

/// The forms that all rows share, and what was counted.
pub(crate) struct Common<'a> {
    file: &'a Path,
    /// Form of the times.
    pub times: Option<Seen>,
    /// Form of the positions.
    pub positions: Option<Seen>,
    /// Line of the first row that refers to an anchor.
    pub anchored: Option<u64>,
    /// Offset of the dates from UTC; `Some(None)` when they differ.
    pub offset_s: Option<Option<i32>>,
    pub counts: Counts,
}

impl<'a> Common<'a> {
    pub fn new(file: &'a Path) -> Common<'a> {
        Common { file, times: None, positions: None, anchored: None, offset_s: None, counts: Counts::default() }
    }

    /// Whether times are dates.
    pub fn has_dates(&self) -> bool {
        self.times.as_ref().is_some_and(|seen| seen.form)
    }

    /// Whether positions are latitudes and longitudes.
    pub fn is_geodetic(&self) -> bool {
        self.positions.as_ref().is_some_and(|seen| seen.form)
    }

    /// Adds the next block.
    ///
    /// # Errors
    /// [`BuildError`] when its times or positions are written otherwise than those before.
    pub fn add(&mut self, block: &mut Block) -> Result<(), BuildError> {
        if let Some(now) = block.times.take() {
            match &self.times {
                Some(first) if first.form != now.form => return Err(rows::other_time_form(self.file, first, &now)),
                Some(_) => {}
                None => self.times = Some(now),
            }
        }
        if let Some(now) = block.positions.take() {
            match &self.positions {
                Some(first) if first.form != now.form => return Err(rows::other_position_form(self.file, first, &now)),
                Some(_) => {}
                None => self.positions = Some(now),
            }
        }
        let counts = std::mem::take(&mut block.counts);
        self.counts.rows += counts.rows;
        self.counts.skipped_bad += counts.skipped_bad;
        self.counts.out_of_order += counts.out_of_order;
        if self.counts.first_bad.is_none() {
            self.counts.first_bad = counts.first_bad;
        }
        for (kind, n) in counts.ignored_kinds {
            *self.counts.ignored_kinds.entry(kind).or_default() += n;
        }
        self.anchored = self.anchored.or(block.anchored);
        if let Some(offset) = block.offset_s {
            self.offset_s = Some(self.offset_s.unwrap_or(offset).filter(|before| Some(*before) == offset));
        }
        Ok(())
    }
}
