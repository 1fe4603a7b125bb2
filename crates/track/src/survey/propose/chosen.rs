//! Which kinds of measurement a proposal uses.

use super::ProposeError;
use crate::packet::Kind;
use crate::survey::{KindSurvey, Survey};

/// The kinds that a proposal uses.
#[derive(Default)]
pub(super) struct Chosen<'a> {
    pub position: Option<&'a KindSurvey>,
    pub heights: Option<&'a KindSurvey>,
    pub range: Option<&'a KindSurvey>,
    pub rssi: Option<&'a KindSurvey>,
    pub tdoa: Option<&'a KindSurvey>,
    pub bearing: Option<&'a KindSurvey>,
    /// The others, and why not.
    pub left_out: Vec<(&'a KindSurvey, &'static str)>,
}

impl<'a> Chosen<'a> {
    pub fn of(survey: &'a Survey) -> Result<Self, ProposeError> {
        let of = |kind: Kind| survey.kinds.iter().find(|k| k.kind == kind);
        if of(Kind::Linear).is_some() {
            return Err(ProposeError::Linear);
        }
        let mut chosen = Chosen {
            position: of(Kind::Position).filter(|k| !k.only_heights),
            heights: of(Kind::Position).filter(|k| k.only_heights),
            range: of(Kind::Range),
            tdoa: of(Kind::Tdoa),
            bearing: of(Kind::Bearing),
            ..Chosen::default()
        };
        let metric = chosen.position.is_some()
            || chosen.range.is_some_and(|k| k.anchors >= 3)
            || chosen.tdoa.is_some_and(|k| k.anchors >= 4)
            || chosen.bearing.is_some_and(|k| k.anchors >= 2);
        match of(Kind::Rssi) {
            Some(rssi) if metric => {
                chosen.left_out.push((rssi, "a strength says far less of a distance than what stands beside it"));
            }
            rssi => chosen.rssi = rssi,
        }
        let others = [chosen.position, chosen.range, chosen.rssi, chosen.tdoa, chosen.bearing];
        let used: Vec<&KindSurvey> = others.into_iter().flatten().collect();
        match used.as_slice() {
            [] if chosen.heights.is_some() => Err(ProposeError::Heights),
            [] => Err(ProposeError::Empty),
            [only] => {
                let least = match only.kind {
                    Kind::Rssi | Kind::Tdoa => 3,
                    Kind::Bearing => 2,
                    _ => 0,
                };
                match only.anchors < least {
                    true => Err(ProposeError::FewAnchors { kind: only.kind.name(), anchors: only.anchors, least }),
                    false => Ok(chosen),
                }
            }
            _ => Ok(chosen),
        }
    }

    /// Axes of the track: positions decide where there are any.
    pub fn axes(&self) -> usize {
        match self.heights {
            Some(_) => 3,
            None => self.position.or(self.range).map_or(2, |k| k.axes),
        }
    }

    /// Whether nothing but strengths says where targets are.
    pub fn strengths_alone(&self) -> bool {
        self.rssi.is_some() && [self.position, self.range, self.tdoa, self.bearing].iter().all(Option::is_none)
    }

    /// The kind that shows best how targets move.
    pub fn lively(&self) -> Option<&'a KindSurvey> {
        let all = || [self.position, self.range, self.tdoa, self.bearing, self.rssi].into_iter().flatten();
        all().find(|k| k.psd.is_some()).or_else(|| all().next())
    }

    /// How updates treat what does not fit.
    pub fn robust(&self) -> &'static str {
        if self.tdoa.is_some() { "redescending" } else { "huber" }
    }
}
