//! How often what a receiver without time stamps shows is new.

use crate::merit::Recording;
use fixtrail_track::link::{Learnt, Link};
use fixtrail_track::spec::{ArrivalSpec, LinkSpec, Spec};
use std::convert::Infallible;

/// The arrival rate of all targets together; `None` where the spec gives one for every instant, or nothing tells.
///
/// Each target's link learns its own, from sequence numbers where the values have them, else from values that repeat, a uniform prior before.
/// Together each counts by its values: `p = Σ n_i p_i / Σ n_i`, with the standard error `√(Σ n_i² σ_i²) / Σ n_i`.
pub(crate) fn rate(spec: &Spec, recordings: &[Recording]) -> Option<Learnt> {
    if matches!(spec.link.arrival, Some(ArrivalSpec::List(_) | ArrivalSpec::Column(_))) {
        return None;
    }
    let asking = LinkSpec { arrival: Some(ArrivalSpec::Estimate), ..spec.link.clone() };
    let has_prior = spec.model.prior().is_some();
    let mut all = Learnt { rate: 0.0, sd: 0.0, values: 0.0, by_repeats: false };
    for target in recordings.iter().flat_map(|r| &r.targets) {
        let mut link = Link::new(&asking, has_prior);
        for packet in &target.packets {
            let Ok(()) = link.push(packet.clone(), |_| Ok::<_, Infallible>(()));
        }
        let Ok(()) = link.flush(|_| Ok::<_, Infallible>(()));
        let Some(own) = link.learnt() else { continue };
        all.rate += own.values * own.rate;
        all.sd += (own.values * own.sd).powi(2);
        all.values += own.values;
        all.by_repeats |= own.by_repeats;
    }
    (all.values > 0.0).then(|| Learnt { rate: all.rate / all.values, sd: all.sd.sqrt() / all.values, ..all })
}
