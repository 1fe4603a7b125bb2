//! Tables in, trails out.
//!
//! [`read_table`] turns a measurement table (CSV, NDJSON, Parquet) into the packets of each target, [`run_tracks`] tracks
//! the targets in parallel, [`write_trails`] writes what came out: everything in memory, for reports and comparisons. [`track_file`] does all three
//! in bounded memory. The order of rows in such a file never matters.
//! [`read_packet_trace`] reads what a network did to the packets of each link, in the order of the rows.

mod anchors;
mod cell;
mod columns;
mod common;
mod content;
mod formats;
mod gather;
mod grouped;
mod input;
mod job;
mod names;
mod options;
mod ordered;
mod record;
mod rows;
mod run;
mod schema;
mod settle;
mod store;
mod stream;
mod table;
mod time;
mod totals;
mod trace;
mod truth;
mod write;

pub use anchors::read_anchors;
pub use input::{Format, Input};
pub use options::{Counts, LinearShape, ReadOptions};
pub use run::run_tracks;
pub use stream::{FileError, FileOutcome, FileRun, Phase, track_file};
pub use table::{Table, TableMeta, read_table};
pub use time::TimeForm;
pub use totals::Totals;
pub use trace::read_packet_trace;
pub use truth::read_truth;
pub use write::{Cell, Holds, Order, OutFormat, Output, Plain, WriteError, WriteOptions, write_plain, write_trails};
