//! Kernels of any linear motion, of turns and of ranges against the general filter and numbers of twice the digits.

mod oracle;
mod splitmix;

use fixtrail_core::estimators::fms::Align;
use fixtrail_core::estimators::fms::gain::Shape;
use fixtrail_core::estimators::fms::invariant::{InvariantWindow, Model};
use fixtrail_core::estimators::kalman::{Robust, predict, update};
use fixtrail_core::kernels::{Arc, Dense, Packed, Sliding, Turn};
use fixtrail_core::models::{CoordinatedTurn, FmsPaper};
use fixtrail_core::sensors::{linear, range};
use fixtrail_core::{Belief, Matrix, StepError, Transition, Vector};
use oracle::twofold::Twofold;
use splitmix::Random;

fn start<const N: usize>(random: &mut Random) -> Belief<N> {
    let root = Matrix::<N, N>::from_fn(|i, j| if i == j { 1.0 } else { random.unit() - 0.5 });
    Belief { mean: Vector::from_fn(|_, _| 10.0 * random.unit()), cov: root * root.transpose() }
}

/// How far apart two beliefs are, in standard deviations and in correlation.
fn apart<const N: usize>(ours: &Belief<N>, theirs: &Belief<N>) -> f64 {
    let sd: [f64; N] = core::array::from_fn(|i| theirs.cov[(i, i)].sqrt());
    let mean = (0..N).map(|i| (ours.mean[i] - theirs.mean[i]).abs() / sd[i]);
    let pairs = (0..N).flat_map(|i| (0..N).map(move |j| (i, j)));
    let cov = pairs.map(|(i, j)| (ours.cov[(i, j)] - theirs.cov[(i, j)]).abs() / (sd[i] * sd[j]));
    mean.chain(cov).fold(0.0, f64::max)
}

fn any_linear_model_agrees<const N: usize, const Q: usize>() {
    let mut random = Random((10 * N + Q) as u64);
    let mut worst: f64 = 0.0;
    for case in 0..60 {
        // Columns that the motion shrinks or leaves as they are: what grows without being measured leaves the range of numbers.
        let a = Matrix::<N, N>::from_fn(|_, _| random.unit() - 0.5);
        let a = a * (1.0 / a.norm());
        // Every other noise moves one direction only, every fourth none.
        let g = Vector::<N>::from_fn(|_, _| random.unit() - 0.5);
        let q = match case % 4 {
            0 | 2 => g * g.transpose() + Matrix::identity() * random.decades(-3.0, 0.0),
            1 => g * g.transpose(),
            _ => Matrix::zeros(),
        };
        let c: [Vector<N>; Q] = core::array::from_fn(|_| Vector::from_fn(|_, _| random.unit() - 0.5));
        let rows = c.map(Into::<[f64; N]>::into);
        let var: [f64; Q] = core::array::from_fn(|_| random.decades(-3.0, 2.0));
        let motion = Dense::new(&a, &q);
        let mut theirs = start::<N>(&mut random);
        let mut ours = Packed::of(&theirs);
        // Without noise the covariance fades: compared for as long as there is something to compare.
        for _ in 0..if case % 4 == 3 { 12 } else { 200 } {
            theirs = predict(&theirs, &Transition { next: a * theirs.mean, f: a, q });
            ours = ours.predict(&motion);
            let mut kept = Vec::new();
            for i in 0..Q {
                let z = 5.0 * random.unit();
                let lost = random.unit() < 0.25;
                ours = ours.measure(&rows[i], if lost { f64::NAN } else { z }, var[i]).0;
                if !lost {
                    kept.push(linear(&c[i], &theirs.mean, z, var[i]));
                }
            }
            theirs = update(&theirs, &kept, Robust::None).unwrap().0;
            worst = worst.max(apart(&ours.belief(), &theirs));
        }
    }
    // A unit in the last place times the largest hᵀP h/r, 1e3, and the condition of what is left, a few hundreds.
    assert!(worst < 1e-10, "{N} states, {Q} measurements: {worst:e}");
}

#[test]
fn any_linear_model_agrees_with_the_general_filter() {
    any_linear_model_agrees::<1, 1>();
    any_linear_model_agrees::<2, 1>();
    any_linear_model_agrees::<3, 2>();
    any_linear_model_agrees::<4, 2>();
    any_linear_model_agrees::<6, 3>();
}

#[test]
fn turns_and_ranges_agree_with_the_general_filter() {
    let mut random = Random(7);
    let anchors_m = [[-30.0, -20.0], [40.0, -25.0], [5.0, 50.0]];
    let mut worst: f64 = 0.0;
    for case in 0..40 {
        let motion = CoordinatedTurn::new([random.decades(-2.0, 0.0), random.decades(-2.0, 0.0)], 0.01).unwrap();
        let (mut theirs, var) = (start::<5>(&mut random), random.decades(-2.0, 0.0));
        // Slow turns by the series, fast ones by the closed forms, and none.
        theirs.mean[4] = [0.0, 0.3, -4.0, 1e-9][case % 4];
        let mut ours = Packed::of(&theirs);
        for k in 0..60 {
            let dt_s = 0.1 + 0.3 * random.unit();
            let leap = motion.leap(&theirs.mean, dt_s);
            theirs = predict(&theirs, &leap);
            ours = ours.predict(&Turn::new(&motion, dt_s));
            let [x, y] = anchors_m[k % 3];
            let expected = (theirs.mean[0] - x).hypot(theirs.mean[1] - y);
            let (z, lost) = (expected + 0.2 * (random.unit() - 0.5), random.unit() < 0.2);
            let (next, s) = ours.range(&[x, y], if lost { f64::NAN } else { z }, var);
            ours = next;
            if !lost {
                let row = range(&theirs.mean, 2, [x, y, 0.0], None, z, var);
                let variance = (row.h.transpose() * theirs.cov * row.h)[0] + var;
                assert!((s / variance - 1.0).abs() < 1e-9, "case {case}, step {k}: {s} and {variance}");
                theirs = update(&theirs, &[row], Robust::None).unwrap().0;
            }
            worst = worst.max(apart(&ours.belief(), &theirs));
        }
    }
    // A rounding error of the mean turns the next linearisation by as much: it grows with the steps.
    assert!(worst < 1e-9, "{worst:e}");
}

#[test]
fn a_range_to_where_the_target_is_moves_nothing() {
    let belief = Packed::<f64, 5>::of(&start(&mut Random(1)));
    let here = [belief.mean[0], belief.mean[1]];
    let (next, s) = belief.range(&here, 3.0, 0.5);
    assert_eq!((next, s), (belief, 0.5));
    // Nor where rounding gives a direction, however little is known.
    let mut vague = Packed::<f64, 5> { mean: [0.0; 5], cov: belief.cov.map(|row| row.map(|p| 1e12 * p)) };
    vague.mean[0] = 5e-10;
    assert_eq!(vague.range(&[0.0; 2], 3.0, 0.01).0, vague);
}

#[test]
fn steps_that_cannot_be_taken_are_refused() {
    let belief = Packed::<f64, 2>::of(&start(&mut Random(2)));
    let take = |z, var| {
        let (next, s) = belief.measure(&[1.0], z, var);
        next.checked(s)
    };
    for var in [f64::NAN, -1e3, f64::INFINITY] {
        assert!(matches!(take(1.0, var), Err(StepError::InnovationVariance { .. })), "{var}");
    }
    assert_eq!(take(f64::INFINITY, 1.0), Err(StepError::NotFinite { component: 0 }));
    assert!(take(1.0, 1.0).is_ok() && take(f64::NAN, 1.0) == Ok(belief));
}

/// sin θ and cos θ in numbers of twice the digits, by their series at an eighth of the angle doubled three times.
fn sine(theta: f64) -> [Twofold; 2] {
    let of = Twofold::from;
    let x = of(theta / 8.0);
    let (mut term, mut sums) = (of(1.0), [of(0.0), of(0.0)]);
    for k in 0..30 {
        let sign = if k % 4 < 2 { term } else { -term };
        sums[1 - k % 2] = sums[1 - k % 2] + sign;
        term = term * x / of((k + 1) as f64);
    }
    for _ in 0..3 {
        let [sin, cos] = sums;
        sums = [of(2.0) * sin * cos, of(1.0) - of(2.0) * sin * sin];
    }
    sums
}

#[test]
fn arcs_are_as_exact_as_they_say() {
    let mut random = Random(3);
    let (mut worst, mut beyond): (f64, f64) = (0.0, 0.0);
    for case in 0..4000 {
        let sign = if case % 2 == 0 { 1.0 } else { -1.0 };
        let theta = sign * if case % 3 == 0 { random.decades(-6.0, -1.0) } else { 0.05 + 3.0 * random.unit() };
        let [sin, cos] = sine(theta);
        let t = Twofold::from(theta);
        // Twice the digits less the twelve that the smallest angles take.
        let (along, aside) = (sin / t, (Twofold::from(1.0) - cos) / t);
        let slopes = [(cos - along) / t, (sin - aside) / t];
        let arc = Arc::of(theta);
        let error = |ours: f64, exact: Twofold| {
            (Twofold::from(ours) - exact).near().abs() / exact.near().abs().max(1e-1 * theta.abs().min(1.0))
        };
        for (ours, exact) in [(arc.sin, sin), (arc.cos, cos), (arc.along, along), (arc.aside, aside)] {
            worst = worst.max(error(ours, exact));
        }
        for (ours, exact) in [arc.along_slope, arc.aside_slope].into_iter().zip(slopes) {
            let worst = if theta.abs() < 1.0 { &mut worst } else { &mut beyond };
            *worst = worst.max(error(ours, exact));
        }
    }
    assert!(worst < 6e-16 && beyond < 2e-15, "{worst:e}, slopes of large angles {beyond:e}");
    let turned = Arc::of(0.0);
    let all = [turned.sin, turned.cos, turned.along, turned.aside, turned.along_slope, turned.aside_slope];
    assert_eq!(all, [0.0, 1.0, 1.0, 0.0, 0.0, 0.5]);
}

#[test]
fn a_sliding_gain_is_the_window_while_nothing_is_lost() {
    const M: usize = 15;
    let paper = FmsPaper::new(2.0);
    let shape = Shape { window: M, lag: 5, align: Align::Predicted };
    let model = Model { a: &paper.a, w: &paper.motion().q, b: &[], c: &[paper.c], r: &[paper.r] };
    let mut window = InvariantWindow::<3, oracle::fixed::Heap>::new(&model, shape).unwrap();
    let columns = window.gain().unwrap().z.clone();
    let gain: [[f64; 6]; M] = core::array::from_fn(|j| {
        let (filter, lagged) = columns[j];
        [filter[0], filter[1], filter[2], lagged[0], lagged[1], lagged[2]]
    });
    let mut sliding = Sliding::new(&gain);
    let (mut random, mut last_loss, mut whole) = (Random(4), None, 0);
    for k in 0..200 {
        let lost = k == 3 || k == 60 || k == 70 || k == 71;
        let z = if lost { f64::NAN } else { 20.0 * random.unit() };
        last_loss = if lost { Some(k) } else { last_loss };
        window.push(&[(!lost).then_some(z)], &[]).unwrap();
        let ours = sliding.push(z);
        // The first whole window has no loss, and ends where it is full.
        assert_eq!(ours.is_some(), k - last_loss.map_or(-1, |last| last) >= M as i32, "step {k}");
        if let Some(ours) = ours {
            whole += 1;
            let joint = window.estimate();
            let (filter, lagged) = (joint.filter.unwrap().mean, joint.lagged.unwrap().mean);
            for (i, ours) in ours.iter().enumerate() {
                let theirs = if i < 3 { filter[i] } else { lagged[i - 3] };
                // Fifteen products of at most 20 times a gain below 2, in another order.
                assert!((ours - theirs).abs() < 1e-12, "step {k}, {i}: {ours} and {theirs}");
            }
        }
    }
    assert!(whole > 100);
}
