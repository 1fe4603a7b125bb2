//! The fast kernels against the general filter, lane by lane and bit by bit.

mod splitmix;

use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::kernels::{Axes, Chain, FixedLag, Leap, Past, series, smooth, smooth_with};
use fixtrail_core::models::Integrators;
use fixtrail_core::sensors::position;
use fixtrail_core::{Belief, Matrix, StepError, Vector};
use splitmix::Random;

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
            let leap = general.leap(&Vector::zeros(), dt_s);
            let given: [[f64; N]; N] = core::array::from_fn(|i| core::array::from_fn(|j| leap.q[(i, j)]));
            let leap = if case % 2 == 0 { Leap::new(psd, dt_s) } else { Leap::with_noise(dt_s, &given) };
            ours = ours.predict(&leap).update(if lost { f64::NAN } else { z }, var).0;
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

/// Rauch, Tung and Striebel, written out with inverses; `dt_s` is the interval before each step.
fn rts<const N: usize>(
    start: &Belief<N>,
    general: &Integrators<N>,
    dt_s: impl Fn(usize) -> f64,
    var: f64,
    z: &[f64],
) -> Vec<(Vector<N>, Matrix<N, N>)> {
    let mut filtered = Vec::new();
    let mut priors = Vec::new();
    let mut belief = *start;
    for (k, z) in z.iter().enumerate() {
        let prior = predict(&belief, &general.leap(&belief.mean, dt_s(k)));
        belief = prior;
        if !z.is_nan() {
            belief = update(&prior, &[position(&prior.mean, 0, *z, var)], Robust::None).unwrap().0;
        }
        priors.push(prior);
        filtered.push(belief);
    }
    let mut out = vec![(belief.mean, belief.cov)];
    for k in (0..z.len() - 1).rev() {
        let (mean, cov) = out[out.len() - 1];
        let f = general.leap(&Vector::zeros(), dt_s(k + 1)).f;
        let gain = filtered[k].cov * f.transpose() * priors[k + 1].cov.try_inverse().unwrap();
        out.push((
            filtered[k].mean + gain * (mean - priors[k + 1].mean),
            filtered[k].cov + gain * (cov - priors[k + 1].cov) * gain.transpose(),
        ));
    }
    out.reverse();
    out
}

fn smooths_as_rts<const N: usize>() {
    let mut random = Random(120 + N as u64);
    for case in 0..30 {
        let (psd, var, dt_s) = (random.decades(-1.0, 1.0), random.decades(-1.0, 1.0), random.decades(-0.5, 0.5));
        let general = Integrators::<N>::new(N, 1, [psd, 0.0, 0.0]).unwrap();
        let belief = start::<N>(&mut random);
        // Lost at both ends and in between.
        let lost = |k: usize| case % 2 == 1 && (k == 0 || k % 7 == 3 || k == 59 || (20..25).contains(&k));
        let z: Vec<f64> = (0..60).map(|k| if lost(k) { f64::NAN } else { 10.0 * random.unit() }).collect();
        let theirs = rts(&belief, &general, |_| dt_s, var, &z);
        let mut past = vec![Past::EMPTY; z.len()];
        let mut ours = vec![[0.0; N]; z.len()];
        let mut seen = 0;
        let leap = Leap::new(psd, dt_s);
        smooth_with(&Chain::of(&belief), &leap, var, &z, &mut past, &mut ours, |k, cov| {
            seen += 1;
            for i in 0..N {
                for j in i..N {
                    let scale = (theirs[k].1[(i, i)] * theirs[k].1[(j, j)]).sqrt();
                    let off = (cov[i][j] - theirs[k].1[(i, j)]).abs() / scale;
                    assert!(off < 1e-8, "case {case}, step {k}, cov {i} {j}: {off:e}");
                }
            }
        });
        assert_eq!(seen, z.len());
        for (k, (ours, (mean, cov))) in ours.iter().zip(&theirs).enumerate() {
            for i in 0..N {
                let off = (ours[i] - mean[i]).abs() / cov[(i, i)].sqrt();
                assert!(off < 1e-8, "case {case}, step {k}, mean {i}: {off:e}");
            }
        }
        let mut means = vec![[0.0; N]; z.len()];
        smooth(&Chain::of(&belief), &leap, var, &z, &mut past, &mut means);
        assert_eq!(means, ours);
    }
}

#[test]
fn the_smoother_without_inverses_is_the_one_with_them() {
    smooths_as_rts::<1>();
    smooths_as_rts::<2>();
    smooths_as_rts::<3>();
}

fn lags_as_rts<const N: usize, const L: usize>() {
    let mut random = Random(150 + (10 * N + L) as u64);
    for case in 0..10 {
        let (psd, var) = (random.decades(-1.0, 1.0), random.decades(-1.0, 1.0));
        let general = Integrators::<N>::new(N, 1, [psd, 0.0, 0.0]).unwrap();
        let belief = start::<N>(&mut random);
        // Irregular, lost one by one and in a row longer than the lag.
        let dt_s: [f64; 50] = core::array::from_fn(|_| random.decades(-0.5, 0.5));
        let lost = |k: usize| case % 2 == 1 && (k == 0 || k % 7 == 3 || (20..28).contains(&k));
        let z: Vec<f64> = (0..50).map(|k| if lost(k) { f64::NAN } else { 10.0 * random.unit() }).collect();
        let mut ours = FixedLag::<N, L>::new(&Chain::of(&belief));
        for k in 0..z.len() {
            ours.push(&Leap::new(psd, dt_s[k]), var, z[k]);
            assert_eq!(ours.mean().is_some(), k + 1 >= L, "step {k}");
            if k < L {
                continue;
            }
            let (mean, cov) = rts(&belief, &general, |k| dt_s[k], var, &z[..=k])[k - L];
            let (ours_mean, ours_cov) = (ours.mean().unwrap(), ours.cov().unwrap());
            for i in 0..N {
                let off = (ours_mean[i] - mean[i]).abs() / cov[(i, i)].sqrt();
                assert!(off < 1e-8, "case {case}, step {k}, mean {i}: {off:e}");
                for j in i..N {
                    let off = (ours_cov[i][j] - cov[(i, j)]).abs() / (cov[(i, i)] * cov[(j, j)]).sqrt();
                    assert!(off < 1e-8, "case {case}, step {k}, cov {i} {j}: {off:e}");
                }
            }
        }
    }
}

#[test]
fn a_fixed_lag_is_the_whole_smoother_of_what_came_so_far() {
    lags_as_rts::<1, 3>();
    lags_as_rts::<2, 1>();
    lags_as_rts::<3, 5>();
}

#[test]
fn axes_that_are_alike_are_each_as_alone() {
    let mut random = Random(200);
    let belief = start::<2>(&mut random);
    let leap = Leap::<f64, 2>::new(0.3, 0.7);
    let mut each = [Chain::of(&belief); 3];
    let mut all = Axes { means: [each[0].mean; 3], cov: each[0].cov };
    for k in 0..200 {
        let z: [f64; 3] = core::array::from_fn(|_| if k % 6 == 2 { f64::NAN } else { 4.0 * random.unit() });
        all = all.predict(&leap).update(&z, 0.2);
        for axis in 0..3 {
            each[axis] = each[axis].predict(&leap).update(z[axis], 0.2).0;
            assert_eq!(each[axis].mean.map(f64::to_bits), all.means[axis].map(f64::to_bits), "step {k}");
            for i in 0..2 {
                assert_eq!(each[axis].cov[i][1].to_bits(), all.cov[i][1].to_bits(), "step {k}");
            }
        }
    }
}
