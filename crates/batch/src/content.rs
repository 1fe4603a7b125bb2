//! What one row says: its kind, and its measurement.

use crate::cell::clip;
use crate::columns;
use crate::formats::Row;
use crate::schema::{Col, Schema};
use fixtrail_track::anchors::Anchors;
use fixtrail_track::error::BuildError;
use fixtrail_track::packet::{AnchorId, Content, Kind};
use std::collections::HashMap;

/// Anchors by name.
pub(crate) struct AnchorIds<'a> {
    /// The anchors.
    pub anchors: &'a Anchors,
    ids: HashMap<&'a str, AnchorId>,
}

impl<'a> AnchorIds<'a> {
    /// The names of `anchors`.
    pub fn new(anchors: &'a Anchors) -> AnchorIds<'a> {
        let ids = anchors.names().iter().enumerate().map(|(i, n)| (n.as_str(), i as AnchorId)).collect();
        AnchorIds { anchors, ids }
    }
}

/// One row and where its columns stand.
pub(crate) struct Reading<'a, R> {
    /// The columns.
    pub schema: &'a Schema<'a>,
    /// The anchors it may refer to.
    pub anchors: &'a AnchorIds<'a>,
    /// Its line or row, from 1.
    pub line: u64,
    /// Its cells.
    pub row: &'a R,
}

impl<R: Row> Reading<'_, R> {
    /// An error about one of its columns.
    pub fn fail(&self, col: Col, what: impl Into<String>) -> BuildError {
        self.schema.at(self.line, col, what)
    }

    /// The number in a column, if there is one.
    pub fn number(&self, col: Col, expected: &str) -> Result<Option<f64>, BuildError> {
        self.schema.cell(self.row, col).number(expected).map_err(|what| self.fail(col, what))
    }

    fn needed(&self, col: Col, expected: &str, kind: Kind) -> Result<f64, BuildError> {
        let empty = || self.fail(col, format!("is empty, expected {expected} in a row of kind `{}`", kind.name()));
        self.number(col, expected)?.ok_or_else(empty)
    }

    /// The kind that the row names, or that rows without a name have.
    pub fn kind(&self) -> Result<Kind, BuildError> {
        let cell = self.schema.cell(self.row, Col::Kind);
        let fail = || {
            let expected = Kind::NAMES.map(|(n, _)| format!("`{n}`")).join(", ");
            self.fail(Col::Kind, format!("is {}, expected one of {expected}", cell.show()))
        };
        match cell.name("a kind").map_err(|_| fail())? {
            None => self.schema.kind.ok_or_else(fail),
            Some(word) => Kind::from_name(&word).ok_or_else(fail),
        }
    }

    /// Time index of a linear row: the `k` column, or the row's number; `None` when it will follow from `t`.
    pub fn k(&self, row_number: u64) -> Result<Option<u64>, BuildError> {
        const EXPECTED: &str = "a time index, a whole number from 0";
        match self.schema.cell(self.row, Col::K).count(EXPECTED).map_err(|what| self.fail(Col::K, what))? {
            Some(k) => Ok(Some(k)),
            None if self.schema.has(Col::K) => Err(self.fail(Col::K, format!("is empty, expected {EXPECTED}"))),
            None => Ok((!self.schema.has(Col::T)).then_some(row_number)),
        }
    }

    /// The standard deviation that came with the row.
    pub fn sd(&self) -> Result<Option<f64>, BuildError> {
        match self.number(Col::Sd, "a standard deviation")? {
            Some(sd) if sd <= 0.0 => {
                Err(self.fail(Col::Sd, format!("is `{sd:?}`, expected a positive standard deviation")))
            }
            sd => Ok(sd),
        }
    }

    /// The probability that the row's value is new.
    pub fn arrival(&self) -> Result<Option<f64>, BuildError> {
        const EXPECTED: &str = "a probability from 0 to 1, as `link.arrival` of the spec says";
        let Some(place) = self.schema.arrival else { return Ok(None) };
        let cell = self.row.cell(place);
        let fail = |what: String| {
            let name = self.schema.name(Some(place), "arrival");
            BuildError::new(self.schema.file, Some(self.line), Some(&name), what)
        };
        match cell.number(EXPECTED).map_err(fail)? {
            Some(p) if (0.0..=1.0).contains(&p) => Ok(Some(p)),
            _ => Err(fail(format!("is {}, expected {EXPECTED}", cell.show()))),
        }
    }

    /// The measurement of the row, and for a position whether it is in latitude and longitude (then the content holds
    /// degrees, degrees and metres until the origin is known).
    pub fn content(&self, kind: Kind) -> Result<(Content, Option<bool>), BuildError> {
        let value = |expected: &str| self.needed(Col::Value, expected, kind);
        let anchor = || self.anchor(Col::Anchor, kind);
        let content = match kind {
            Kind::Position => {
                let (position, is_geodetic) = self.position()?;
                return Ok((Content::Position(position), Some(is_geodetic)));
            }
            Kind::Linear => self.linear()?,
            Kind::Range => {
                let value_m = value("a range in metres")?;
                if value_m < 0.0 {
                    return Err(self.fail(Col::Value, format!("is `{value_m:?}`, expected a range of 0 m or more")));
                }
                Content::Range { anchor: anchor()?, value_m }
            }
            Kind::Rssi => Content::Rssi { value_dbm: value("a signal strength in dBm")?, anchor: anchor()? },
            Kind::Bearing => Content::Bearing { value_rad: value("a bearing in radians")?, anchor: anchor()? },
            Kind::Tdoa => {
                let value_m = value("a difference of distances in metres")?;
                let (anchor, reference) = (anchor()?, self.anchor(Col::Anchor2, kind)?);
                if anchor == reference {
                    let name = self.anchors.anchors.name(anchor);
                    return Err(self.fail(Col::Anchor2, format!("is `{name}` like `anchor`, expected another anchor")));
                }
                Content::Tdoa { anchor, reference, value_m }
            }
        };
        Ok((content, None))
    }

    fn anchor(&self, col: Col, kind: Kind) -> Result<AnchorId, BuildError> {
        let cell = self.schema.cell(self.row, col);
        let name = cell.name("the id of an anchor").map_err(|what| self.fail(col, what))?;
        let Some(name) = name else {
            let what = format!("is empty, expected the id of an anchor in a row of kind `{}`", kind.name());
            return Err(self.fail(col, what));
        };
        self.anchors.ids.get(&*name).copied().ok_or_else(|| {
            let names = self.anchors.anchors.names();
            let expected = match names.is_empty() {
                true => {
                    "expected an anchors table: `anchors.csv` beside the input, or one named in the spec".to_owned()
                }
                false => format!("expected one of {}", columns::list(names)),
            };
            self.fail(col, format!("is the unknown anchor `{}`, {expected}", clip(&name)))
        })
    }

    fn position(&self) -> Result<([Option<f64>; 3], bool), BuildError> {
        let metres = |col: Col| self.number(col, "metres");
        let local = [metres(Col::X)?, metres(Col::Y)?, metres(Col::Z)?];
        let (lat, lon) = (self.number(Col::Lat, "degrees")?, self.number(Col::Lon, "degrees")?);
        // A height alone is a position too: an altimeter's.
        let is_local = local[0].is_some() || local[1].is_some() || local[2].is_some() && lat.is_none() && lon.is_none();
        match (is_local, lat, lon) {
            (true, None, None) => Ok((local, false)),
            (false, Some(lat), Some(lon)) => {
                for (col, degrees, most) in [(Col::Lat, lat, 90.0), (Col::Lon, lon, 180.0)] {
                    if degrees.abs() > most {
                        let what = format!("is `{degrees:?}`, expected degrees from -{most} to {most}");
                        return Err(self.fail(col, what));
                    }
                }
                Ok(([Some(lat), Some(lon), metres(Col::Alt)?], true))
            }
            (true, _, _) => Err(self.fail(Col::Lat, "stands beside `x` and `y`, expected one form of position")),
            (false, Some(_), None) => Err(self.fail(Col::Lon, "is empty, expected degrees beside `lat`")),
            (false, None, Some(_)) => Err(self.fail(Col::Lat, "is empty, expected degrees beside `lon`")),
            (false, None, None) => {
                let (col, unit) = match self.schema.has(Col::Lat) && !self.schema.has(Col::X) {
                    true => (Col::Lat, "degrees"),
                    false => (Col::X, "metres"),
                };
                Err(self.fail(col, format!("is empty, expected {unit} in a row of kind `position`")))
            }
        }
    }

    fn linear(&self) -> Result<Content, BuildError> {
        let z = self.vector(&self.schema.z, "z")?;
        let u = self.vector(&self.schema.u, "u")?;
        if let (Some(empty), true) = (u.iter().position(Option::is_none), u.iter().any(Option::is_some)) {
            let what = "is empty beside other inputs, expected a number (or every `u` of the row empty, for no input)";
            let name = self.schema.name(self.schema.u[empty], "u");
            return Err(BuildError::new(self.schema.file, Some(self.line), Some(&name), what));
        }
        Ok(Content::Linear { z, u: u.into_iter().map(|x| x.unwrap_or(0.0)).collect() })
    }

    fn vector(&self, places: &[Option<usize>], ours: &str) -> Result<Vec<Option<f64>>, BuildError> {
        let component = |place: &Option<usize>| match place {
            None => Ok(None),
            Some(i) => self.row.cell(*i).number("a number").map_err(|what| {
                let name = self.schema.name(*place, ours);
                BuildError::new(self.schema.file, Some(self.line), Some(&name), what)
            }),
        };
        places.iter().map(component).collect()
    }
}
