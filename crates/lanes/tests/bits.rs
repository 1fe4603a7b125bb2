//! Tracks side by side against each track alone, bit for bit.

use fixtrail_core::kernels::{Chain, Dense, Leap, Packed, Turn, series};
use fixtrail_core::models::CoordinatedTurn;
use fixtrail_core::{Belief, Matrix, Vector};
use fixtrail_lanes::{Integrators, Linear, Problem, Ranging, convolve, filter, integrators, linear, range};

fn each_track_is_as_alone<const N: usize>() {
    for (tracks, steps) in [(1, 5), (8, 1), (8, 8), (9, 17), (31, 40)] {
        let start = Belief { mean: Vector::<N>::repeat(1.0), cov: Matrix::<N, N>::identity() * 25.0 };
        let leap = Leap::new(0.3, 0.7);
        let problem = Problem { leap, var: 0.2, start };
        let z: Vec<f64> =
            (0..tracks * steps).map(|i| if i % 7 == 3 { f64::NAN } else { (i as f64 * 0.37).sin() * 5.0 }).collect();
        let mut out = vec![0.0; z.len() * N];
        filter(&problem, &z, steps, &mut out);
        for track in 0..tracks {
            let mut alone = vec![[0.0; N]; steps];
            series(&Chain::of(&start), &leap, problem.var, &z[track * steps..][..steps], &mut alone);
            for (k, alone) in alone.iter().enumerate() {
                let ours = &out[(track * steps + k) * N..][..N];
                assert_eq!(ours, alone, "track {track} of {tracks}, step {k} of {steps}");
            }
        }
    }
}

#[test]
fn each_track_is_as_it_would_be_alone() {
    each_track_is_as_alone::<1>();
    each_track_is_as_alone::<2>();
    each_track_is_as_alone::<3>();
}

fn each_linear_track_is_as_alone<const N: usize, const Q: usize>() {
    let number = |i: usize| (i as f64 * 0.61).sin();
    let a = Matrix::<N, N>::from_fn(|i, j| 0.9 * number(3 * i + 5 * j + 1) / N as f64);
    let start = Packed::of(&Belief { mean: Vector::repeat(1.0), cov: Matrix::<N, N>::identity() * 25.0 });
    let rows: [[f64; N]; Q] = std::array::from_fn(|i| std::array::from_fn(|j| number(7 * i + j + 2)));
    let vars: [f64; Q] = std::array::from_fn(|i| 0.1 + i as f64);
    let problem = Linear { motion: Dense::new(&a, &Matrix::identity()), rows, vars, start };
    for (tracks, steps) in [(1, 5), (8, 1), (8, 8), (9, 17), (31, 40)] {
        let z: Vec<f64> =
            (0..tracks * steps * Q).map(|i| if i % 7 == 3 { f64::NAN } else { 5.0 * number(i) }).collect();
        let mut out = vec![0.0; tracks * steps * N];
        linear(&problem, &z, steps, &mut out);
        for track in 0..tracks {
            let mut belief = start;
            for k in 0..steps {
                belief = belief.predict(&problem.motion);
                for i in 0..Q {
                    belief = belief.measure(&rows[i], z[(track * steps + k) * Q + i], vars[i]).0;
                }
                let ours = &out[(track * steps + k) * N..][..N];
                assert_eq!(ours, belief.mean, "track {track} of {tracks}, step {k} of {steps}");
            }
        }
    }
}

#[test]
fn each_linear_track_is_as_it_would_be_alone() {
    each_linear_track_is_as_alone::<2, 1>();
    each_linear_track_is_as_alone::<3, 3>();
    each_linear_track_is_as_alone::<4, 2>();
}

#[test]
fn each_turning_track_is_as_it_would_be_alone() {
    let motion = Turn::new(&CoordinatedTurn::new([0.1, 0.2], 0.05).unwrap(), 0.3);
    let anchors_m = [[-60.0, -50.0], [60.0, -60.0], [3.0, 70.0]];
    let problem = Ranging { motion, anchors_m: &anchors_m, var: 0.04 };
    for (tracks, steps) in [(1, 5), (8, 1), (8, 8), (9, 17), (31, 40)] {
        let starts: Vec<_> = (0..tracks)
            .map(|track| {
                let mut mean = Vector::<5>::from([1.0, 2.0 - track as f64, 3.0, -2.0, 0.1 * (track % 5) as f64]);
                // One of a few turns faster than the series goes: its neighbours keep theirs.
                if track % 6 == 4 {
                    mean[4] = 4.0;
                }
                Packed::of(&Belief { mean, cov: Matrix::identity() * (1.0 + track as f64) })
            })
            .collect();
        let z: Vec<f64> = (0..tracks * steps)
            .map(|i| if i % 7 == 3 { f64::NAN } else { 70.0 + 10.0 * (i as f64 * 0.37).sin() })
            .collect();
        let mut out = vec![0.0; z.len() * 5];
        range(&problem, &starts, &z, steps, &mut out);
        for track in 0..tracks {
            let mut belief = starts[track];
            for k in 0..steps {
                let anchor = &anchors_m[k % 3];
                belief = belief.predict(&motion).range(anchor, z[track * steps + k], problem.var).0;
                let ours = &out[(track * steps + k) * 5..][..5];
                assert!(belief.mean[0].is_finite());
                assert_eq!(ours, belief.mean, "track {track} of {tracks}, step {k} of {steps}");
            }
        }
    }
}

#[test]
#[should_panic(expected = "room for 2 numbers a step")]
fn too_little_room_is_refused() {
    let start = Belief { mean: Vector::<2>::zeros(), cov: Matrix::<2, 2>::identity() };
    filter(&Problem { leap: Leap::new(1.0, 1.0), var: 1.0, start }, &[0.0; 4], 2, &mut [0.0; 7]);
}

#[test]
fn every_instant_of_a_convolution_is_the_sum_written_out() {
    for (window, len) in [(1, 1), (3, 2), (3, 3), (15, 100), (40, 77)] {
        let gain: Vec<[f64; 3]> =
            (0..window).map(|j| [0.1 * j as f64, (j as f64).cos(), -1.0 / (1.0 + j as f64)]).collect();
        let z: Vec<f64> = (0..len).map(|k| (k as f64 * 0.7).sin() * 3.0 + k as f64).collect();
        let count = (len + 1_usize).saturating_sub(window);
        // One place more than there are windows: it stays as it is.
        let mut out = vec![[7.0; 3]; count + 1];
        convolve(&gain, &z, &mut out);
        for k in 0..count {
            let mut sum = [0.0; 3];
            for (gain, z) in gain.iter().zip(&z[k..]) {
                for (sum, gain) in sum.iter_mut().zip(gain) {
                    *sum += gain * z;
                }
            }
            assert_eq!(sum, out[k], "window {window}, instant {k} of {len}");
        }
        assert_eq!(out[count], [7.0; 3]);
    }
}

fn each_chain_is_as_alone<const N: usize, const M: usize>() {
    let mut start = Chain { mean: [0.0; N], cov: [[0.0; N]; N] };
    for i in 0..N {
        (start.mean[i], start.cov[i][i]) = (1.0 - i as f64, 25.0);
    }
    let problem = Integrators { psd: 0.3, var: 0.2, goes_on: false };
    for (tracks, steps) in [(1, 5), (8, 1), (8, 8), (9, 17), (31, 40)] {
        let input: Vec<f64> = (0..tracks * steps)
            .flat_map(|i| {
                let z = if i % 7 == 3 { f64::NAN } else { (i as f64 * 0.37).sin() * 5.0 };
                [0.1 + (i % 5) as f64, z]
            })
            .collect();
        let (mut out, mut beliefs) = (vec![0.0; tracks * steps * M], vec![start; tracks]);
        integrators::<N, M>(&problem, &mut beliefs, &input, steps, &mut out);
        for track in 0..tracks {
            let mut belief = start;
            for k in 0..steps {
                let [dt_s, z] = [0, 1].map(|i| input[(track * steps + k) * 2 + i]);
                if k > 0 {
                    belief = belief.predict(&Leap::new(problem.psd, dt_s));
                }
                let (e, s) = (z - belief.mean[0], belief.cov[0][0] + problem.var);
                belief = belief.update(z, problem.var).0;
                let mut alone = belief.mean.to_vec();
                (0..N).for_each(|i| alone.extend_from_slice(&belief.cov[i][i..]));
                alone.extend([e, s]);
                let bits =
                    |numbers: &[f64]| numbers.iter().map(|x| x.to_bits() | u64::from(x.is_nan())).collect::<Vec<_>>();
                let ours = &out[(track * steps + k) * M..][..M];
                assert_eq!(bits(ours), bits(&alone), "track {track} of {tracks}, step {k} of {steps}");
            }
            assert_eq!(beliefs[track].mean, belief.mean, "what is known of track {track} in the end");
            (0..N).for_each(|i| assert_eq!(beliefs[track].cov[i][i..], belief.cov[i][i..]));
        }
    }
}

#[test]
fn each_chain_at_instants_of_its_own_is_as_it_would_be_alone() {
    each_chain_is_as_alone::<1, 4>();
    each_chain_is_as_alone::<2, 7>();
    each_chain_is_as_alone::<3, 11>();
}
