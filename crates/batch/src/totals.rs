//! What a run over many targets comes to.

use fixtrail_track::fix::Status;
use fixtrail_track::link::LinkReport;
use fixtrail_track::target::TargetTrail;

/// Sums over the targets of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Totals {
    /// Targets.
    pub targets: u64,
    /// Packets of all targets, whether a sensor uses them or not.
    pub packets: u64,
    /// Fixes of each status: updated, predicted, rejected, unobservable.
    fixes: [u64; 4],
    /// How often a track was started anew.
    pub restarts: u64,
    /// What the links did, without their arrival rates.
    pub link: LinkReport,
    /// Arrival rates of the targets that learn one: how many, their sum, the least and the largest.
    arrivals: Option<(u64, f64, f64, f64)>,
    /// Instants with innovations, measurements behind them, and the sum of the normalised innovations squared.
    pub innovations: (usize, usize, f64),
}

impl Totals {
    /// The sums over `trails`, of that many packets.
    pub fn of<'a>(trails: impl IntoIterator<Item = &'a TargetTrail>, packets: u64) -> Totals {
        let mut totals = Totals { packets, ..Totals::default() };
        trails.into_iter().for_each(|trail| totals.add_target(trail));
        totals
    }

    /// Adds a target whose trail is whole.
    pub fn add_target(&mut self, target: &TargetTrail) {
        self.targets += 1;
        self.restarts += target.trail.restarts;
        self.add_rows(target);
        self.add_link(&target.link);
    }

    /// Adds the fixes of a part of a trail.
    pub(crate) fn add_rows(&mut self, target: &TargetTrail) {
        let trail = &target.trail;
        trail.status.iter().for_each(|status| self.fixes[*status as usize] += 1);
        for (nis, dof) in trail.nis.iter().zip(&trail.nis_dof) {
            if let (Some(nis), true) = (nis, *dof > 0) {
                let (instants, measurements, sum) = self.innovations;
                self.innovations = (instants + 1, measurements + *dof as usize, sum + nis);
            }
        }
    }

    pub(crate) fn add_link(&mut self, link: &LinkReport) {
        self.link.too_late += link.too_late;
        self.link.first_too_late = [self.link.first_too_late, link.first_too_late].into_iter().flatten().min();
        self.link.copies += link.copies;
        self.link.repeats += link.repeats;
        self.link.stale += link.stale;
        if let Some(rate) = link.arrival {
            self.add_arrivals((1, rate, rate, rate));
        }
    }

    fn add_arrivals(&mut self, (n, sum, least, most): (u64, f64, f64, f64)) {
        let (count, total, low, high) = self.arrivals.unwrap_or((0, 0.0, least, most));
        self.arrivals = Some((count + n, total + sum, low.min(least), high.max(most)));
    }

    /// Adds the sums over other targets.
    pub(crate) fn add(&mut self, other: &Totals) {
        self.targets += other.targets;
        self.packets += other.packets;
        self.restarts += other.restarts;
        self.fixes.iter_mut().zip(other.fixes).for_each(|(a, b)| *a += b);
        self.add_link(&other.link);
        if let Some(arrivals) = other.arrivals {
            self.add_arrivals(arrivals);
        }
        let (a, b) = (self.innovations, other.innovations);
        self.innovations = (a.0 + b.0, a.1 + b.1, a.2 + b.2);
    }

    /// Fixes of one status.
    pub fn count(&self, status: Status) -> u64 {
        self.fixes[status as usize]
    }

    /// Fixes in all.
    pub fn fixes(&self) -> u64 {
        self.fixes.iter().sum()
    }

    /// Mean, least and largest of the arrival rates that targets learnt, each counting once.
    pub fn arrival(&self) -> Option<(f64, f64, f64)> {
        self.arrivals.map(|(n, sum, least, most)| (sum / n as f64, least, most))
    }
}
