//! A recording sent through a channel once more.

use crate::channels::{DesignError, Variant};
use fixtrail_track::packet::{Packet, Source};
use fixtrail_track::spec::Per;
use fixtrail_track::target::TargetPackets;
use rand_pcg::Pcg64;

/// What a channel made of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Replay {
    /// What arrived of each target, in the order of arrival, with sequence numbers and times of reception.
    pub targets: Vec<TargetPackets>,
    /// Packets sent.
    pub sent: u64,
    /// Packets lost.
    pub lost: u64,
    /// Most packets of one sender lost in a row.
    pub longest_burst: u64,
}

/// Sends the packets of each target, sorted by time, through channels of their own. Equal seeds give equal bytes.
///
/// # Errors
/// [`DesignError`], not for a variant of [`Variant::all`].
pub fn replay(targets: &[TargetPackets], per: Per, channel: &Variant, seed: u64) -> Result<Replay, DesignError> {
    let mut out = Replay { targets: Vec::new(), sent: 0, lost: 0, longest_burst: 0 };
    for (number, target) in targets.iter().enumerate() {
        let mut sources: Vec<Source> = match per {
            Per::Instant => Vec::new(),
            Per::Row => target.packets.iter().map(Packet::source).collect(),
        };
        sources.sort();
        sources.dedup();
        let senders = sources.len().max(1);
        let mut arrived: Vec<Packet> = Vec::new();
        for sender in 0..senders {
            let stream = (number * senders + sender) as u128;
            let mut rng = Pcg64::new(u128::from(seed), stream);
            let mut medium = channel.open_part(number * senders + sender, targets.len() * senders)?;
            let of_sender = |p: &&Packet| sources.is_empty() || p.source() == sources[sender];
            let rows: Vec<&Packet> = target.packets.iter().filter(of_sender).collect();
            let mut burst = 0;
            for (seq, instant) in rows.chunk_by(|a, b| a.t_s == b.t_s && a.k == b.k).enumerate() {
                let arrivals = medium.transmit(&mut rng);
                out.sent += 1;
                if arrivals.is_lost() {
                    out.lost += 1;
                    burst += 1;
                    out.longest_burst = out.longest_burst.max(burst);
                    continue;
                }
                burst = 0;
                for delay_s in arrivals.delays_s() {
                    for packet in instant {
                        let received_s = Some(packet.t_s + delay_s);
                        arrived.push(Packet { seq: Some(seq as u64), received_s, ..(*packet).clone() });
                    }
                }
            }
        }
        // Stable: what arrives together stays in the order in which it was sent.
        arrived.sort_by(|a, b| a.received_s.unwrap_or(a.t_s).total_cmp(&b.received_s.unwrap_or(b.t_s)));
        out.targets.push(TargetPackets { target: target.target.clone(), packets: arrived });
    }
    Ok(out)
}
