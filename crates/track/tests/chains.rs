//! Axes apart from each other: the kernels against the general filter, and a whole series against step by step.

use fixtrail_track::anchors::Anchors;
use fixtrail_track::chains::{Positions, Room, Series};
use fixtrail_track::error::StepError;
use fixtrail_track::packet::{Content, Packet};
use fixtrail_track::pipeline::track;
use fixtrail_track::spec::{self, Spec};
use fixtrail_track::target::TargetPackets;
use fixtrail_track::trackers::LaggedMode;
use fixtrail_track::trail::Trail;
use rand_distr::{Distribution, StandardUniform};
use rand_pcg::Pcg64;
use std::path::Path;

const MODELS: [&str; 3] = ["random-walk", "constant-velocity", "constant-acceleration"];

fn spec(model: usize, axes: usize, prior: bool, robust: &str) -> Spec {
    let n = (model + 1) * axes;
    let noise: Vec<String> = (0..axes).map(|a| format!("{:?}", 0.1 + 0.2 * a as f64)).collect();
    let mut text = format!("[model]\nkind = \"{}\"\naxes = {axes}\nnoise = [{}]\n", MODELS[model], noise.join(", "));
    if prior {
        let x0: Vec<String> = (0..n).map(|i| format!("{:?}", 0.01 * i as f64)).collect();
        // Derivatives of one axis are correlated, axes are not.
        let cov = |i: usize, j: usize| match (i == j, i % axes == j % axes) {
            (true, _) => 4.0 + i as f64,
            (false, true) => 0.7,
            (false, false) => 0.0,
        };
        let rows: Vec<String> = (0..n)
            .map(|i| format!("[{}]", (0..n).map(|j| format!("{:?}", cov(i, j))).collect::<Vec<_>>().join(", ")))
            .collect();
        text += &format!("x0 = [{}]\nP0 = [{}]\n", x0.join(", "), rows.join(", "));
    }
    text += &format!("[estimator]\nkind = \"kalman\"\n[[sensor]]\nkind = \"position\"\nsd = 0.3\n{robust}");
    spec::parse(&text, Path::new("spec"), &mut |_| unreachable!("no file is named")).unwrap()
}

fn uniform(rng: &mut Pcg64) -> f64 {
    StandardUniform.sample(rng)
}

/// Irregular instants, now and then a coordinate missing or a standard deviation of its own where that is asked for.
fn packets(rng: &mut Pcg64, axes: usize, whole: bool) -> TargetPackets {
    let mut t_s = uniform(rng) * 10.0;
    let packets = (0..120)
        .map(|i| {
            t_s += [0.1, 0.1, uniform(rng) * 3.0][i % 3];
            let mut xyz = [None; 3];
            for x in xyz.iter_mut().take(axes) {
                // Close to where the axis is, for what is far off is a lost track to a gate.
                let z = 3.0 * (0.05 * t_s).sin() + 0.4 * (uniform(rng) - 0.5);
                *x = (whole || uniform(rng) > 0.2).then_some(z);
            }
            let sd = (!whole && uniform(rng) < 0.3).then(|| 0.3 + uniform(rng));
            let content = Content::Position(xyz);
            Packet { sd, ..Packet::new(t_s, content, i as u64 + 2) }
        })
        .collect();
    TargetPackets { target: None, packets }
}

fn trail(spec: &Spec, packets: &TargetPackets) -> Trail {
    track(spec, &Anchors::default(), packets, LaggedMode::Own).unwrap().trail
}

#[test]
fn kernels_agree_with_the_general_filter() {
    let mut rng = Pcg64::new(1, 1);
    for model in 0..3 {
        for axes in 1..=3 {
            for prior in [true, false] {
                let packets = packets(&mut rng, axes, false);
                let kernel = trail(&spec(model, axes, prior, ""), &packets);
                // A gate that lets everything through asks for the general filter.
                let general = trail(&spec(model, axes, prior, "robust = \"gate\"\ngate = 1e9\n"), &packets);
                assert_eq!((&kernel.status, &kernel.nis_dof), (&general.status, &general.nis_dof));
                for row in 0..kernel.len() {
                    let (Some(a), Some(b)) = (kernel.cov(row), general.cov(row)) else {
                        assert!(kernel.cov(row).is_none() && general.cov(row).is_none());
                        continue;
                    };
                    let n = kernel.n();
                    let at = |i| Trail::packed_index(n, i, i);
                    for i in 0..n {
                        let sd = b[at(i)].sqrt();
                        let error = (kernel.mean(row).unwrap()[i] - general.mean(row).unwrap()[i]).abs();
                        assert!(error <= 1e-9 * sd.max(1e-3), "{model} {axes} {prior} {row} {i}: {error:e}");
                        for j in i..n {
                            let scale = (b[at(i)] * b[at(j)]).sqrt();
                            let p = Trail::packed_index(n, i, j);
                            assert!((a[p] - b[p]).abs() <= 1e-9 * scale, "{model} {axes} {prior} {row} {i} {j}");
                        }
                    }
                    match (kernel.nis[row], general.nis[row]) {
                        (Some(a), Some(b)) => assert!((a - b).abs() <= 1e-8 * b.max(1.0), "{a} {b}"),
                        (a, b) => assert_eq!(a, b),
                    }
                }
            }
        }
    }
}

/// The instants and positions of a target.
type Numbers = (Vec<f64>, Vec<f64>);

/// A trail, and where it ended before its time.
type Tracked = (Trail, Result<(), (usize, StepError)>);

fn series(spec: &Spec, targets: &[Numbers]) -> Vec<Tracked> {
    let all: Vec<Positions<'_>> = targets.iter().map(|(t_s, positions)| Positions { t_s, positions }).collect();
    let mut trails = Vec::new();
    // Room that other targets have had says nothing of these.
    let mut room = Room::default();
    Series::of(spec).unwrap().track(&all, &mut room, |_, _| {});
    Series::of(spec).unwrap().track(&all[..all.len() / 2], &mut room, |_, _| {});
    Series::of(spec).unwrap().track(&all, &mut room, |trail, end| trails.push((trail, end)));
    trails
}

fn numbers(packets: &TargetPackets) -> Numbers {
    let t_s = packets.packets.iter().map(|p| p.t_s).collect();
    (t_s, packets.packets.iter().flat_map(|p| p.content.values().flatten().collect::<Vec<_>>()).collect())
}

#[test]
fn a_series_gives_the_bits_of_its_steps() {
    let mut rng = Pcg64::new(2, 1);
    for model in 0..3 {
        for axes in 1..=3 {
            let spec = spec(model, axes, true, "");
            // Some that fill the registers, some that do not, of different lengths and at other instants each.
            let mut targets: Vec<TargetPackets> = (0..21).map(|_| packets(&mut rng, axes, true)).collect();
            targets.iter_mut().enumerate().for_each(|(i, target)| target.packets.truncate((i * 37) % 121));
            let all: Vec<_> = targets.iter().map(numbers).collect();
            for (i, (trail, end)) in series(&spec, &all).into_iter().enumerate() {
                assert!(end.is_ok());
                assert_eq!(trail, self::trail(&spec, &targets[i]), "target {i}");
            }
            assert!(series(&spec, &[]).is_empty() && series(&spec, &[Default::default()])[0].0.is_empty());
        }
    }
}

#[test]
fn a_series_ends_where_its_steps_end() {
    let spec = spec(1, 2, true, "");
    let mut rng = Pcg64::new(3, 1);
    let targets: Vec<TargetPackets> = (0..9).map(|_| packets(&mut rng, 2, true)).collect();
    let sound: Vec<_> = targets.iter().map(numbers).collect();
    let plain = series(&spec, &sound);
    // A position, its innovation or the covariance that is too large a number.
    for (row, t_s, position, component) in [(7, 0.0, f64::INFINITY, 0), (7, 0.0, f64::NAN, 0), (4, 1e200, 1.0, 0)] {
        let mut broken = sound.clone();
        broken[5].1[2 * row + 1] = position;
        broken[5].0[row..].iter_mut().for_each(|now| *now += t_s);
        for (i, (trail, end)) in series(&spec, &broken).into_iter().enumerate() {
            if i != 5 {
                assert_eq!((trail, end), plain[i], "target {i}");
                continue;
            }
            assert_eq!(trail.len(), row);
            let (at, error) = end.unwrap_err();
            let core = match error {
                StepError::Core(core) => core,
                other => panic!("{other}"),
            };
            assert_eq!(at, row);
            match t_s {
                0.0 => assert_eq!(core, fixtrail_core::StepError::NotFinite { component }),
                _ => assert!(matches!(core, fixtrail_core::StepError::InnovationVariance { .. }), "{core}"),
            }
        }
    }
}

#[test]
fn what_is_not_a_series_of_positions_is_left_to_the_steps() {
    assert!(Series::of(&spec(1, 2, true, "")).is_some());
    assert!(Series::of(&spec(1, 2, false, "")).is_none(), "an unknown start");
    assert!(Series::of(&spec(1, 2, true, "robust = \"huber\"\n")).is_none());
    let mut late = spec(1, 2, true, "");
    late.link.receiver = fixtrail_track::spec::Receiver::Stamped { late_s: Some(1.0) };
    assert!(Series::of(&late).is_none());
    let mut correlated = spec(1, 2, true, "");
    let spec::ModelSpec::Kinematic(model) = &mut correlated.model else { panic!("a kinematic model") };
    let prior = model.prior.as_mut().unwrap();
    (prior.cov.data[1], prior.cov.data[4]) = (0.1, 0.1);
    assert!(Series::of(&correlated).is_none(), "axes that are correlated");
}
