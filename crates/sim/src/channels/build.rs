//! A channel from its spec.

use super::{Bernoulli, Channel, DesignError, Duplication, GilbertElliott, RandomDelay, Trace, TracePacket};
use fixtrail_track::spec::{ChannelSpec, LossSpec};
use std::sync::Arc;

/// One of the channels that a [`ChannelSpec`] describes: a loss rate of its list, or its trace.
#[derive(Clone, Debug)]
pub struct Variant {
    spec: ChannelSpec,
    interval_s: f64,
    /// Loss rate of this one; of a trace, as counted.
    pub loss_rate: f64,
    trace: Option<Trace>,
}

impl Variant {
    /// The channels of a spec whose discrete delays are multiples of `interval_s`. `trace` holds the packets of a spec with a trace.
    ///
    /// # Errors
    /// [`DesignError`] when one of them cannot exist.
    pub fn all(
        spec: &ChannelSpec,
        interval_s: f64,
        trace: Option<Arc<[TracePacket]>>,
    ) -> Result<Vec<Variant>, DesignError> {
        let of = |loss_rate, trace| Variant { spec: spec.clone(), interval_s, loss_rate, trace };
        let variants: Vec<Variant> = match (&spec.loss, trace) {
            (LossSpec::Bernoulli { loss_rates } | LossSpec::GilbertElliott { loss_rates, .. }, _) => {
                loss_rates.iter().map(|rate| of(*rate, None)).collect()
            }
            (LossSpec::Trace { .. }, packets) => {
                let packets = packets.unwrap_or_else(|| Arc::new([]));
                let lost = packets.iter().filter(|p| !p.received).count();
                let rate = lost as f64 / packets.len().max(1) as f64;
                vec![of(rate, Some(Trace::new(packets, 0)?))]
            }
        };
        for variant in &variants {
            variant.open()?;
        }
        Ok(variants)
    }

    /// A channel before its first packet.
    ///
    /// # Errors
    /// [`DesignError`], not for one of [`Variant::all`].
    pub fn open(&self) -> Result<Box<dyn Channel>, DesignError> {
        self.open_part(0, 1)
    }

    /// The channel of one of `parts` senders: a trace is replayed by each from another place.
    ///
    /// # Errors
    /// [`DesignError`], not for one of [`Variant::all`].
    pub fn open_part(&self, part: usize, parts: usize) -> Result<Box<dyn Channel>, DesignError> {
        let mut channel: Box<dyn Channel> = match (&self.spec.loss, &self.trace) {
            (LossSpec::GilbertElliott { mean_burst, .. }, _) => {
                Box::new(GilbertElliott::new(self.loss_rate, *mean_burst)?)
            }
            (LossSpec::Trace { .. }, Some(trace)) => Box::new(trace.starting_at_part(part, parts)),
            _ => Box::new(Bernoulli::new(self.loss_rate)?),
        };
        if !self.spec.delays.is_empty() {
            channel = Box::new(RandomDelay::discrete(channel, &self.spec.delays, self.interval_s)?);
        }
        if let Some([least_s, most_s]) = self.spec.delay_s {
            channel = Box::new(RandomDelay::uniform(channel, least_s, most_s)?);
        }
        if self.spec.duplication > 0.0 {
            channel = Box::new(Duplication::new(channel, self.spec.duplication, self.spec.duplication_lag_s)?);
        }
        Ok(channel)
    }
}
