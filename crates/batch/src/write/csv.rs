//! A trail as CSV.

use super::columns::OutCell;
use super::{Job, To, WriteError};
use crate::time::{self, TimeForm};

pub(super) fn write(job: &Job<'_>, to: To<'_>) -> Result<(), WriteError> {
    let columns = job.columns();
    let failed = |e: csv::Error| match e.into_kind() {
        csv::ErrorKind::Io(e) => job.io(e),
        other => job.io(std::io::Error::other(format!("{other:?}"))),
    };
    let offset_s = match job.meta.time {
        TimeForm::Rfc3339 { offset_s, .. } => offset_s,
        TimeForm::Seconds | TimeForm::Index => 0,
    };
    let mut csv = csv::Writer::from_writer(to);
    csv.write_record(&columns.names).map_err(failed)?;
    let (mut cells, mut float) = (Vec::new(), ryu::Buffer::new());
    job.rows(|target, row| {
        columns.fill(job, target, row, &mut cells)?;
        write_cells(&mut csv, &cells, &mut float, offset_s).map_err(failed)
    })?;
    csv.flush().map_err(|e| job.io(e))
}

/// Writes one row.
pub(super) fn write_cells(
    csv: &mut csv::Writer<To<'_>>,
    cells: &[OutCell<'_>],
    float: &mut ryu::Buffer,
    offset_s: i32,
) -> csv::Result<()> {
    for cell in cells {
        match cell {
            OutCell::Absent => csv.write_field(""),
            OutCell::Float(x) => csv.write_field(float.format_finite(*x)),
            OutCell::Text(text) => csv.write_field(text),
            OutCell::Index(k) => csv.write_field(k.to_string()),
            OutCell::Date(ns) => csv.write_field(time::utc_text(*ns, offset_s)),
        }?;
    }
    csv.write_record(None::<&[u8]>)
}
