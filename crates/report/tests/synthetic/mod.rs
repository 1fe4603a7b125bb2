//! Trails made of truth and noise, to see and test pages without an estimator.

use fixtrail_track::fix::{Estimate, Fix, Sink, Status};
use fixtrail_track::target::{TargetPackets, TargetTrail};
use fixtrail_track::trail::Trail;
use fixtrail_track::truth::{TargetTruth, TruthPoint};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// How an invented estimator errs.
#[derive(Clone, Copy)]
pub struct Errs {
    /// Real standard deviation of each coordinate when packets arrive, metres.
    pub sd_m: f64,
    /// Claimed over real standard deviation.
    pub claim: f64,
    /// Growth of the real standard deviation per instant without packets.
    pub growth: f64,
}

/// A trail beside `truth` with a fix every `step` points; packets decide which fixes are updates.
pub fn trail(truth: &TargetTruth, packets: &TargetPackets, step: usize, errs: Errs, seed: u64) -> TargetTrail {
    let mut rng = Pcg64::new(u128::from(seed), 9);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let mut out = Trail::new(4, false);
    let (mut ex, mut ey, mut age) = (normal(), normal(), 0);
    for (k, point) in truth.points.iter().step_by(step).enumerate() {
        let arrived = packets.packets.iter().filter(|p| (p.t_s - point.t_s).abs() < 1e-6).count();
        age = if arrived > 0 { 0 } else { age + 1 };
        // Autocorrelation 0.8 from fix to fix, unit variance.
        ex = 0.8 * ex + 0.6 * normal();
        ey = 0.8 * ey + 0.6 * normal();
        let (sx, sy) =
            (errs.sd_m * (1.0 + errs.growth * f64::from(age)), errs.sd_m * (1.0 + 0.4 * errs.growth * f64::from(age)));
        let at = |axis: usize| point.position_m[axis].unwrap_or(0.0);
        let mean = [at(0) + sx * (ex + 0.5 * ey) / 1.25_f64.sqrt(), at(1) + sy * ey, 0.0, 0.0];
        let c2 = errs.claim * errs.claim;
        let mut cov = [0.0; 16];
        (cov[0], cov[5], cov[10], cov[15]) = (c2 * sx * sx, c2 * sy * sy, 1.0, 1.0);
        (cov[1], cov[4]) = (c2 * sx * sy * 0.447, c2 * sx * sy * 0.447);
        let nis: f64 = (0..arrived).map(|_| (normal() / errs.claim).powi(2)).sum();
        out.fix(&Fix {
            k: k as u64,
            t_s: Some(point.t_s),
            estimate: Some(Estimate { mean: &mean, cov: &cov }),
            status: if arrived > 0 { Status::Updated } else { Status::Predicted },
            nis: (arrived > 0).then_some(nis),
            nis_dof: arrived as u32,
            lagged: None,
        });
    }
    TargetTrail { target: truth.target.clone(), trail: out, link: Default::default() }
}

/// A long random walk of `points` truth points, one a second.
pub fn long_walk(target: &str, points: usize, seed: u64) -> TargetTruth {
    let mut rng = Pcg64::new(u128::from(seed), 5);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let (mut x, mut y, mut heading) = (0.0, 0.0, 0.0_f64);
    let points = (0..points)
        .map(|k| {
            heading += 0.1 * normal();
            x += heading.cos() - 0.002 * x;
            y += heading.sin() - 0.002 * y;
            TruthPoint { t_s: k as f64, position_m: [Some(x), Some(y), None] }
        })
        .collect();
    TargetTruth { target: Some(target.to_owned()), points }
}

/// A trail of a two-state linear model with `rows` rows, of which every tenth is unobservable.
pub fn linear_trail(rows: usize) -> TargetTrail {
    let mut rng = Pcg64::new(3, 7);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let mut out = Trail::new(2, false);
    for k in 0..rows {
        let phase = k as f64 / 25.0;
        let mean = [5.0 * phase.sin() + 0.3 * normal(), 0.2 * phase.cos() + 0.02 * normal()];
        let lost = k % 10 == 9;
        out.fix(&Fix {
            k: k as u64,
            t_s: None,
            estimate: (!lost).then_some(Estimate { mean: &mean, cov: &[0.09, 0.0, 0.0, 0.0004] }),
            status: if lost { Status::Unobservable } else { Status::Updated },
            nis: (!lost).then(|| normal().powi(2)),
            nis_dof: u32::from(!lost),
            lagged: None,
        });
    }
    TargetTrail { target: None, trail: out, link: Default::default() }
}
