//! Tracks side by side against each track alone, bit for bit.

use fixtrail_core::kernels::{Chain, Leap, series};
use fixtrail_core::{Belief, Matrix, Vector};
use fixtrail_lanes::{Problem, convolve, filter};

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
