//! Packet traces: `link,received,delay,copies`.

use crate::cell::Cell;
use crate::columns::{self, Extent, HeaderError};
use crate::formats::{self, Row, TableSink};
use crate::input::Input;
use fixtrail_track::error::BuildError;
use fixtrail_track::trace::{TraceLink, TracePacket};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

const NAMES: [&str; 4] = ["link", "received", "delay", "copies"];
const LINK: usize = 0;
const RECEIVED: usize = 1;
const DELAY: usize = 2;
const COPIES: usize = 3;

/// What the messages expect of each column.
const OUTCOME: &str = "0 for a lost packet or 1 for one that arrived";
const DURATION: &str = "a delay of 0 s or more";
const NUMBER: &str = "the number of copies that arrived";

/// Returns the links of a packet trace in order of first appearance, the packets of each in the order of its rows.
///
/// A row is a packet sent, whether it arrived or not. Without a column `delay` packets arrive at once, without `copies` once. What
/// the table says of the delay and the copies of a lost packet must be possible, and is then ignored, as are other columns.
///
/// # Errors
/// [`BuildError`] with file, line, column, value and expectation; also when a table with delays lacks that of a packet that
/// arrived.
pub fn read_packet_trace(path: &Path) -> Result<Vec<TraceLink>, BuildError> {
    let mut sink = TraceRows {
        file: path,
        at: [None; NAMES.len()],
        links: Vec::new(),
        positions: HashMap::new(),
        without_delay: None,
    };
    formats::read(&Input::File(path.to_owned()), None, &mut sink, &mut |_, _| {})?;
    sink.finish()
}

struct TraceRows<'a> {
    file: &'a Path,
    /// Positions of the columns.
    at: [Option<usize>; NAMES.len()],
    links: Vec<TraceLink>,
    /// Where each link stands among `links`.
    positions: HashMap<String, usize>,
    /// The first line of a packet that arrived without saying when.
    without_delay: Option<u64>,
}

impl TraceRows<'_> {
    fn resolve(&mut self, names: &[String], extent: Extent) -> Result<(), HeaderError> {
        columns::check_unique(names)?;
        for (i, name) in NAMES.iter().enumerate() {
            self.at[i] = columns::find(names, name, None, &BTreeMap::new(), extent)?;
            if self.at[i].is_none() && i <= RECEIVED && extent == Extent::Whole {
                let what =
                    format!("is missing, a packet trace needs `link`, `received`; there are {}", columns::list(names));
                return Err((Some((*name).to_owned()), what));
            }
        }
        Ok(())
    }

    fn fail(&self, line: u64, i: usize, what: impl Into<String>) -> BuildError {
        BuildError::new(self.file, Some(line), Some(NAMES[i]), what)
    }

    fn packet<'c>(&mut self, line: u64, cell: impl Fn(usize) -> Cell<'c>) -> Result<TracePacket, BuildError> {
        let received = cell(RECEIVED);
        let outcome = received.count(OUTCOME).map_err(|what| self.fail(line, RECEIVED, what))?;
        let received = match outcome {
            Some(0) => false,
            Some(1) => true,
            _ => return Err(self.fail(line, RECEIVED, format!("is {}, expected {OUTCOME}", received.show()))),
        };

        let delay = cell(DELAY);
        let delay_s = delay.number(DURATION).map_err(|what| self.fail(line, DELAY, what))?;
        if delay_s.is_some_and(|d| d < 0.0) {
            return Err(self.fail(line, DELAY, format!("is {}, expected {DURATION}", delay.show())));
        }

        let cell = cell(COPIES);
        let copies = cell.count(NUMBER).map_err(|what| self.fail(line, COPIES, what))?;
        let copies = u32::try_from(copies.unwrap_or(1)).map_err(|_| {
            self.fail(line, COPIES, format!("is {}, expected {NUMBER}, at most {}", cell.show(), u32::MAX))
        })?;
        if !received {
            return Ok(TracePacket { received, delay_s: 0.0, copies: 0 });
        }
        if copies == 0 {
            return Err(self.fail(line, COPIES, "is `0`, expected at least 1 for a packet that arrived"));
        }
        if delay_s.is_none() {
            self.without_delay.get_or_insert(line);
        }
        Ok(TracePacket { received, delay_s: delay_s.unwrap_or(0.0), copies })
    }

    fn finish(self) -> Result<Vec<TraceLink>, BuildError> {
        match (self.at[DELAY], self.without_delay) {
            // Only now: the column may appear far down in a file of objects.
            (Some(_), Some(line)) => {
                Err(self.fail(line, DELAY, "is empty, expected the delay of a packet that arrived"))
            }
            _ => Ok(self.links),
        }
    }
}

impl TableSink for TraceRows<'_> {
    fn columns(&mut self, names: &[String], extent: Extent) -> Result<Vec<bool>, BuildError> {
        self.resolve(names, extent).map_err(|(key, what)| BuildError::new(self.file, None, key.as_deref(), what))?;
        Ok((0..names.len()).map(|i| self.at.contains(&Some(i))).collect())
    }

    fn row<R: Row>(&mut self, line: u64, row: &R) -> Result<(), BuildError> {
        let at = self.at;
        let cell = |i: usize| at[i].map_or(Cell::Absent, |c| row.cell(c));
        let id = cell(LINK);
        let link = id.name("the id of a link").map_err(|what| self.fail(line, LINK, what))?;
        let link = link.ok_or_else(|| self.fail(line, LINK, "is empty, expected the id of a link"))?;
        let packet = self.packet(line, cell)?;
        match self.positions.get(&*link) {
            Some(i) => self.links[*i].packets.push(packet),
            None => {
                let link = link.into_owned();
                self.positions.insert(link.clone(), self.links.len());
                self.links.push(TraceLink { link, packets: vec![packet] });
            }
        }
        Ok(())
    }

    fn malformed(&mut self, error: BuildError) -> Result<(), BuildError> {
        Err(error)
    }
}
