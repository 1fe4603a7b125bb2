//! Times as files write them and as f64 seconds, without losing a microsecond between the two.

use chrono::{DateTime, FixedOffset, SecondsFormat};

const NS_PER_S: i64 = 1_000_000_000;

/// How the times of a table are written, and what second 0 is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeForm {
    /// Seconds, as they are.
    Seconds,
    /// RFC 3339 (or a Parquet timestamp); `t_s` counts from `epoch_unix_s`.
    Rfc3339 {
        /// Seconds from 1970-01-01T00:00:00Z to second 0: the whole second of the earliest time of the table.
        epoch_unix_s: i64,
        /// Offset from UTC in which times are written: the input's when all its rows have the same, else 0.
        offset_s: i32,
    },
    /// A linear run without times: `t_s` is `k`.
    Index,
}

impl TimeForm {
    /// The time `t_s` as files write it: a number, or the shortest RFC 3339 text that reads back to the same `t_s`.
    pub fn text(self, t_s: f64) -> String {
        match self {
            TimeForm::Seconds | TimeForm::Index => zmij::Buffer::new().format_finite(t_s).to_owned(),
            TimeForm::Rfc3339 { epoch_unix_s, offset_s } => utc_text(unix_ns(t_s, epoch_unix_s), offset_s),
        }
    }
}

/// A time as one cell says it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Stamp {
    /// Seconds of an unknown epoch.
    Seconds(f64),
    /// Nanoseconds since 1970-01-01T00:00:00Z, and the offset it was written in.
    Utc { ns: i64, offset_s: i32 },
}

/// Whether text is meant as a date rather than as a number of seconds.
pub(crate) fn looks_like_a_date(text: &str) -> bool {
    text.contains([':', 'T']) || text.bytes().skip(1).filter(|b| *b == b'-').count() == 2
}

/// Reads an RFC 3339 time, or says why it is none.
pub(crate) fn parse_rfc3339(text: &str) -> Result<Stamp, String> {
    let at = DateTime::parse_from_rfc3339(text).map_err(|e| match e.kind() {
        chrono::format::ParseErrorKind::TooShort => "it ends early (an offset such as `Z` is needed)".to_owned(),
        _ => e.to_string(),
    })?;
    let ns = at.timestamp_nanos_opt().ok_or("it is outside the years 1678 to 2261")?;
    Ok(Stamp::Utc { ns, offset_s: at.offset().local_minus_utc() })
}

/// RFC 3339 text of an instant, with as few digits of the second as it has.
pub(crate) fn utc_text(ns: i64, offset_s: i32) -> String {
    let utc = DateTime::from_timestamp_nanos(ns);
    let form = match ns.rem_euclid(NS_PER_S) {
        0 => SecondsFormat::Secs,
        n if n % 1_000_000 == 0 => SecondsFormat::Millis,
        n if n % 1_000 == 0 => SecondsFormat::Micros,
        _ => SecondsFormat::Nanos,
    };
    match FixedOffset::east_opt(offset_s).filter(|_| offset_s != 0) {
        Some(offset) => utc.with_timezone(&offset).to_rfc3339_opts(form, false),
        None => utc.to_rfc3339_opts(form, true),
    }
}

/// Seconds from the whole second `epoch_unix_s` to an instant.
pub(crate) fn seconds_since(ns: i64, epoch_unix_s: i64) -> f64 {
    let whole = ns.div_euclid(NS_PER_S) - epoch_unix_s;
    whole as f64 + ns.rem_euclid(NS_PER_S) as f64 / NS_PER_S as f64
}

/// The instant with the fewest digits of the second that [`seconds_since`] turns into `t_s`, else the nearest nanosecond.
pub(crate) fn unix_ns(t_s: f64, epoch_unix_s: i64) -> i64 {
    let whole = t_s.floor();
    let second = epoch_unix_s.saturating_add(whole as i64);
    let mut digits = 1_i64;
    for _ in 0..=9 {
        let ns = ((t_s - whole) * digits as f64).round() as i64 * (NS_PER_S / digits);
        let at = second.saturating_mul(NS_PER_S).saturating_add(ns);
        if digits == NS_PER_S || seconds_since(at, epoch_unix_s) == t_s {
            return at;
        }
        digits *= 10;
    }
    second.saturating_mul(NS_PER_S)
}

/// The whole second in which an instant lies.
pub(crate) fn whole_second(ns: i64) -> i64 {
    ns.div_euclid(NS_PER_S)
}
