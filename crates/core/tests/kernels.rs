//! The fast kernels against the general filter, lane by lane and bit by bit.

use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::kernels::{Chain, Leap, series};
use fixtrail_core::models::Integrators;
use fixtrail_core::sensors::position;
use fixtrail_core::{Belief, Matrix, StepError, Vector};

/// Random numbers without a dependency: splitmix64.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// 10^u, u from `least` to `most`.
    fn decades(&mut self, least: f64, most: f64) -> f64 {
        10_f64.powf(least + (most - least) * self.unit())
    }
}

fn start<const N: usize>(random: &mut Random) -> Belief<N> {
    let mut root = Matrix::<N, N>::zeros();
    for i in 0..N {
        for j in 0..=i {
            root[(i, j)] = random.unit() - 0.5;
        }
        root[(i, i)] += 1.0;
    }
    Belief { mean: Vector::from_fn(|_, _| 10.0 * random.unit()), cov: root * root.transpose() }
}

fn agrees_with_the_general_filter<const N: usize>() {
    let mut random = Random(N as u64);
    for case in 0..60 {
        let (psd, var) = (random.decades(-3.0, 2.0), random.decades(-3.0, 2.0));
        let general = Integrators::<N>::new(N, 1, [psd, 0.0, 0.0]).unwrap();
        let mut theirs = start::<N>(&mut random);
        let mut ours = Chain::of(&theirs);
        for k in 0..200 {
            // Irregular, and every fifth is lost.
            let dt_s = random.decades(-2.0, 0.5);
            let z = 20.0 * random.unit();
            let lost = random.unit() < 0.2;
            theirs = predict(&theirs, &general.leap(&theirs.mean, dt_s));
            if !lost {
                theirs = update(&theirs, &[position(&theirs.mean, 0, z, var)], Robust::None).unwrap().0;
            }
            ours = ours.predict(&Leap::new(psd, dt_s)).update(if lost { f64::NAN } else { z }, var).0;
            let belief = ours.belief();
            for i in 0..N {
                let sd = theirs.cov[(i, i)].sqrt();
                // Both round a few times a step; what they lose is a part of what is known.
                assert!(
                    (belief.mean[i] - theirs.mean[i]).abs() < 1e-9 * sd.max(1e-6),
                    "case {case}, step {k}, mean {i}"
                );
                for j in 0..N {
                    let scale = sd * theirs.cov[(j, j)].sqrt();
                    let off = (belief.cov[(i, j)] - theirs.cov[(i, j)]).abs() / scale;
                    assert!(off < 1e-9, "case {case}, step {k}, cov {i} {j}: {off:e}");
                }
            }
        }
    }
}

#[test]
fn chains_agree_with_the_general_filter() {
    agrees_with_the_general_filter::<1>();
    agrees_with_the_general_filter::<2>();
    agrees_with_the_general_filter::<3>();
}

fn the_shortcut_changes_no_bit<const N: usize>(must_keep: bool) {
    let mut random = Random(80 + N as u64);
    let mut kept_in = 0;
    for case in 0..40 {
        let (psd, var, dt_s) = (random.decades(-3.0, 2.0), random.decades(-2.0, 2.0), random.decades(-1.5, 1.0));
        let leap = Leap::<f64, N>::new(psd, dt_s);
        let belief = start::<N>(&mut random);
        let losing = case % 2 == 1;
        let z: Vec<f64> = (0..4000)
            .map(|k| if losing && (k % 1500 == 1000 || k % 1500 == 1003) { f64::NAN } else { 3.0 * random.unit() })
            .collect();
        let mut out = vec![[0.0; N]; z.len()];
        let (last, kept) = series(&Chain::of(&belief), &leap, var, &z, &mut out);
        kept_in += usize::from(kept.is_some());
        let mut plain = Chain::of(&belief);
        for (k, (z, out)) in z.iter().zip(&out).enumerate() {
            plain = plain.predict(&leap).update(*z, var).0;
            assert_eq!(plain.mean.map(f64::to_bits), out.map(f64::to_bits), "case {case}, step {k}");
        }
        for i in 0..N {
            for j in i..N {
                assert_eq!(plain.cov[i][j].to_bits(), last.cov[i][j].to_bits(), "case {case}");
            }
        }
    }
    assert!(!must_keep || kept_in >= 36, "the gain was kept in {kept_in} of 40 series");
}

#[test]
fn a_kept_gain_gives_the_same_bits() {
    the_shortcut_changes_no_bit::<1>(true);
    the_shortcut_changes_no_bit::<2>(true);
    the_shortcut_changes_no_bit::<3>(true);
}

#[test]
fn a_variance_that_is_none_is_refused_and_nothing_is_changed() {
    let mut random = Random(5);
    let belief = Chain::<f64, 2>::of(&start::<2>(&mut random));
    for var in [f64::NAN, f64::NEG_INFINITY, -100.0] {
        assert!(matches!(belief.checked_update(1.0, var), Err(StepError::InnovationVariance { .. })), "{var}");
    }
    assert_eq!(belief.checked_update(f64::INFINITY, 1.0), Err(StepError::NotFinite { component: 0 }));
    let (next, s) = belief.checked_update(1.0, 0.5).unwrap();
    assert_eq!((next, s), (belief.update(1.0, 0.5).0, belief.cov[0][0] + 0.5));
}
