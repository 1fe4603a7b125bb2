//! Specs that mean something.

use super::parse_with;
use crate::mat::Mat;
use crate::packet::Kind;
use crate::spec::*;
use fixtrail_core::sensors::PathLoss;
use std::collections::BTreeMap;

fn good(text: &str) -> Spec {
    parse_with(text, b"").unwrap_or_else(|e| panic!("{e}\n{text}"))
}

fn mat(rows: usize, cols: usize, data: &[f64]) -> Mat {
    assert_eq!(data.len(), rows * cols);
    Mat { rows, cols, data: data.to_vec() }
}

const CV: &str = "[model]\nkind = \"constant-velocity\"\nnoise = 0.5\n[sensor]\nkind = \"position\"\nsd = 0.1\n";
const LINEAR: &str =
    "[model]\nkind = \"linear\"\nA = [[1, 2], [0, 1]]\nC = [[1, 0]]\nQ = [[1, 0], [0, 0]]\nR = [[0.25]]\n";

fn linear(spec: &Spec) -> &LinearSpec {
    match &spec.model {
        ModelSpec::Linear(linear) => linear,
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_side_of_targets_is_a_point_of_as_many_axes() {
    let model = |more: &str| {
        format!("[model]\nkind = \"constant-velocity\"\nnoise = 1\n{more}\n[[sensor]]\nkind = \"range\"\nsd = 1")
    };
    assert_eq!(good(&model("side = [1, -2]")).side_m, Some([1.0, -2.0, 0.0]));
    assert_eq!(good(&model("axes = 3\nside = [1, -2, 3]")).side_m, Some([1.0, -2.0, 3.0]));
    assert_eq!(good(&model("")).side_m, None);
}

#[test]
fn kinematic_models_have_order_axes_and_noise() {
    for (kind, order) in [("random-walk", 1), ("constant-velocity", 2), ("constant-acceleration", 3)] {
        let spec = good(&format!("[model]\nkind = \"{kind}\"\nnoise = 2\n[sensor]\nkind=\"position\"\nsd=1"));
        let expected = KinematicSpec { order, axes: 2, noise: vec![2.0, 2.0], prior: None };
        assert_eq!(spec.model, ModelSpec::Kinematic(expected));
    }
    let spec = good(
        "sensor = { kind = \"position\", sd = 1 }\n[model]\nkind = \"random-walk\"\naxes = 1\nnoise = [0.0]\nx0 = [3]\nP0 = [[4.0]]",
    );
    let prior = Some(Prior { mean: vec![3.0], cov: mat(1, 1, &[4.0]), second_moment: None });
    assert_eq!(spec.model, ModelSpec::Kinematic(KinematicSpec { order: 1, axes: 1, noise: vec![0.0], prior }));
}

#[test]
fn turn_noise_may_come_by_steps() {
    let text = |noise: &str| {
        format!(
            "[model]\nkind = \"coordinated-turn\"\nnoise = 0\nturn_noise = {noise}\n[sensor]\nkind = \"position\"\nsd = 1"
        )
    };
    for (noise, expected) in [
        ("{ per_step = 0.002 }", (0.002, Some(0))),
        ("{ per_step = 1, power = 2 }", (1.0, Some(2))),
        ("0.5", (0.5, None)),
    ] {
        let ModelSpec::Turn(turn) = good(&text(noise)).model else { panic!("a turn") };
        assert_eq!((turn.turn_noise, turn.per_step), expected, "{noise}");
    }
}

#[test]
fn coordinated_turn_has_two_axes_and_a_turn_noise() {
    let spec = good(
        "[model]\nkind = \"coordinated-turn\"\nnoise = [0.1, 0.2]\nturn_noise = 0.3\n[sensor]\nkind = \"position\"\nsd = 1",
    );
    assert_eq!(
        spec.model,
        ModelSpec::Turn(TurnSpec { noise: [0.1, 0.2], turn_noise: 0.3, per_step: None, prior: None })
    );
    assert_eq!(spec.estimator, EstimatorSpec::Ekf);
}

#[test]
fn linear_model_keeps_its_matrices_and_default_b_and_g() {
    let spec = good(&format!("{LINEAR}x0 = [1, 2]\nP0 = [[1, 0.5], [0.5, 1]]\n"));
    let expected = LinearSpec {
        base: LinearStep {
            a: mat(2, 2, &[1.0, 2.0, 0.0, 1.0]),
            b: mat(2, 0, &[]),
            g: Mat::identity(2),
            c: mat(1, 2, &[1.0, 0.0]),
            q: mat(2, 2, &[1.0, 0.0, 0.0, 0.0]),
            r: mat(1, 1, &[0.25]),
        },
        sequence: vec![],
        prior: Some(Prior { mean: vec![1.0, 2.0], cov: mat(2, 2, &[1.0, 0.5, 0.5, 1.0]), second_moment: None }),
    };
    assert_eq!(spec.model, ModelSpec::Linear(expected));
    assert_eq!(spec.estimator, EstimatorSpec::Kalman);
    assert!(spec.sensors.is_empty());
}

#[test]
fn linear_model_takes_inputs_and_noise_of_other_sizes() {
    let spec = good(
        "[model]\nkind = \"linear\"\nA = [[1.0]]\nB = [[1, 2, 3]]\nG = [[1, 1]]\nC = [[1], [2]]\nQ = [[2, 1], [1, 2]]\n\
         R = [[1, 0], [0, 1]]",
    );
    let base = &linear(&spec).base;
    assert_eq!((base.b.cols, base.g.cols, base.c.rows), (3, 2, 2));
}

#[test]
fn fms_paper_expands_to_the_papers_matrices() {
    let spec = good("[model]\nkind = \"fms-paper\"");
    let base = &linear(&spec).base;
    assert_eq!(base.a, mat(3, 3, &[1.0, 2.0, 2.0, 0.0, 1.0, 2.0, 0.0, 0.0, 1.0]));
    assert_eq!(base.g, mat(3, 2, &[1.0, 0.0, 1.0, 0.0, 0.0, 1.0]));
    assert_eq!(base.c, mat(1, 3, &[1.0, 0.0, 0.0]));
    assert_eq!(base.q, mat(2, 2, &[0.173 * 0.173, 0.0, 0.0, 0.01 * 0.01]));
    assert_eq!(base.r, mat(1, 1, &[0.05 * 0.05]));

    let spec = good("[model]\nkind = \"fms-paper\"\nT = 0.1\nQ = [[2, 1], [1, 2]]\nR = [[3]]");
    let base = &linear(&spec).base;
    assert_eq!(base.a.data[2], 0.1 * 0.1 / 2.0);
    assert_eq!(base.g.data[0], 0.05);
    assert_eq!((base.q.data[1], base.r.data[0]), (1.0, 3.0));
}

#[test]
fn estimators_have_windows_lags_and_alignment() {
    let cases = [
        ("kind = \"kalman\"", EstimatorSpec::Kalman),
        ("kind = \"ekf\"", EstimatorSpec::Ekf),
        ("kind = \"rts\"", EstimatorSpec::Rts),
        ("kind = \"fixed-lag-kalman\"\nlag = 5", EstimatorSpec::FixedLagKalman { lag: Span::Instants(5) }),
        ("kind = \"fixed-lag-kalman\"\nlag_s = 0", EstimatorSpec::FixedLagKalman { lag: Span::Seconds(0.0) }),
        (
            "kind = \"fms\"\nwindow = 15",
            EstimatorSpec::Fms { window: Span::Instants(15), lag: Span::Instants(0), align: Align::Filtered },
        ),
        (
            "kind = \"fms\"\nwindow = 15\nlag = 14\nalign = \"filtered\"",
            EstimatorSpec::Fms { window: Span::Instants(15), lag: Span::Instants(14), align: Align::Filtered },
        ),
        (
            "kind = \"fms\"\nwindow = 15\nlag = 15\nalign = \"predicted\"",
            EstimatorSpec::Fms { window: Span::Instants(15), lag: Span::Instants(15), align: Align::Predicted },
        ),
        (
            "kind = \"fms\"\nwindow_s = 2.5\nlag_s = 2.5",
            EstimatorSpec::Fms { window: Span::Seconds(2.5), lag: Span::Seconds(2.5), align: Align::Filtered },
        ),
        ("kind = \"ufir\"\nwindow = 1", EstimatorSpec::Ufir { window: Span::Instants(1) }),
    ];
    for (text, expected) in cases {
        assert_eq!(good(&format!("{CV}[estimator]\n{text}")).estimator, expected, "{text}");
        assert_eq!(good(&format!("{LINEAR}[estimator]\n{text}")).estimator, expected, "{text}");
    }
}

#[test]
fn sensors_have_every_key_and_their_order() {
    let spec = good(
        "[model]\nkind = \"constant-velocity\"\nnoise = 1\n[[sensor]]\nkind = \"range\"\nsd = 0.15\nheight_m = 1.0\n\
         latency_s = 0.08\nrobust = \"gate\"\ngate = 16\n[sensor.bias]\nA3 = 0.18\n\"B 1\" = -1\n[[sensor]]\nkind = \"position\"\n\
         sd = 2\nrobust = \"gate\"",
    );
    let range = SensorSpec {
        kind: Kind::Range,
        sd: 0.15,
        path_loss: None,
        drift: None,
        bias: BTreeMap::from([("A3".to_owned(), 0.18), ("B 1".to_owned(), -1.0)]),
        height_m: Some(1.0),
        latency_s: 0.08,
        robust: Robust::Gate(16.0),
    };
    let position = SensorSpec {
        kind: Kind::Position,
        sd: 2.0,
        path_loss: None,
        drift: None,
        bias: BTreeMap::new(),
        height_m: None,
        latency_s: 0.0,
        robust: Robust::Gate(9.0),
    };
    assert_eq!(spec.sensors, [range, position]);
    assert_eq!(spec.estimator, EstimatorSpec::Ekf);
}

#[test]
fn sensors_of_anchors_other_than_ranges_have_their_keys() {
    let spec = good(
        "[model]\nkind = \"constant-velocity\"\nnoise = 1\n[[sensor]]\nkind = \"rssi\"\nsd = 2.5\nheight_m = 1.0\n\
         path_loss = { exponent = 2.7, at_1m_dbm = -41 }\nbias = { A3 = 1.5 }\n[[sensor]]\nkind = \"tdoa\"\nsd = 0.3\nheight_m = 1.0\n\
         [[sensor]]\nkind = \"bearing\"\nsd = 0.05\nlatency_s = 0.1\nbias = { A3 = 0.2 }",
    );
    let plain = |kind: Kind, sd: f64| SensorSpec {
        kind,
        sd,
        path_loss: None,
        drift: None,
        bias: BTreeMap::new(),
        height_m: None,
        latency_s: 0.0,
        robust: Robust::None,
    };
    let rssi = SensorSpec {
        path_loss: Some(PathLoss { exponent: 2.7, at_1m_dbm: -41.0 }),
        bias: BTreeMap::from([("A3".to_owned(), 1.5)]),
        height_m: Some(1.0),
        ..plain(Kind::Rssi, 2.5)
    };
    let tdoa = SensorSpec { height_m: Some(1.0), ..plain(Kind::Tdoa, 0.3) };
    let bearing =
        SensorSpec { latency_s: 0.1, bias: BTreeMap::from([("A3".to_owned(), 0.2)]), ..plain(Kind::Bearing, 0.05) };
    assert_eq!(spec.sensors, [rssi, tdoa, bearing]);
    assert_eq!(spec.estimator, EstimatorSpec::Ekf);
}

#[test]
fn robust_sensors_have_their_thresholds() {
    for (text, expected) in [
        ("robust = \"huber\"", Robust::Huber(1.345)),
        ("robust = \"huber\"\nthreshold = 2", Robust::Huber(2.0)),
        ("robust = \"redescending\"", Robust::Redescending(4.685)),
        ("robust = \"redescending\"\nthreshold = 6.0", Robust::Redescending(6.0)),
        ("robust = \"none\"", Robust::None),
    ] {
        let spec = good(&format!(
            "[model]\nkind = \"constant-velocity\"\nnoise = 1\n[sensor]\nkind = \"range\"\nsd = 1\n{text}"
        ));
        assert_eq!(spec.sensors[0].robust, expected, "{text}");
    }
}

#[test]
fn defaults_are_kalman_for_positions_and_no_link_or_columns() {
    let spec = good(CV);
    assert_eq!(spec.estimator, EstimatorSpec::Kalman);
    assert_eq!((spec.link, spec.columns.len(), spec.anchors), (LinkSpec::default(), 0, None));
    assert_eq!(spec.sensors[0].robust, Robust::None);
}

#[test]
fn link_columns_anchors_and_version_are_read() {
    let spec = good(&format!(
        "version = 1\nanchors = \"site.csv\"\n{CV}[link]\nstamped = true\nlate_s = 5.0\n[columns]\nt = \"timestamp\"\nz6 = \"a\"\n\
         u12 = \"b\"\n"
    ));
    assert_eq!(spec.anchors.as_deref(), Some("site.csv"));
    assert_eq!(spec.link.receiver, Receiver::Stamped { late_s: Some(5.0) });
    assert_eq!(spec.columns["t"], "timestamp");
    assert_eq!((spec.columns["z6"].as_str(), spec.columns["u12"].as_str()), ("a", "b"));
}

#[test]
fn links_without_time_stamps_and_their_estimators_are_read() {
    let held = |link: &str, estimator: &str| {
        good(&format!(
            "{LINEAR}x0 = [3, 0]\nP0 = [[4, 0], [0, 1]]\n[estimator]\n{estimator}\n[link]\nstamped = false\n{link}\n"
        ))
    };
    let spec = held("arrival = 0.9", "kind = \"lmvf\"");
    assert_eq!(spec.estimator, EstimatorSpec::Lmvf { square_root: false });
    let unstamped = |hold| Receiver::Unstamped { hold };
    let link = LinkSpec {
        receiver: unstamped(Hold::Paper),
        arrival: Some(ArrivalSpec::Constant(0.9)),
        duplicates: Duplicates::Keep,
    };
    assert_eq!(spec.link, link);
    let spec = held("arrival = [1, 0.5, 0]\nduplicates = \"detect\"", "kind = \"lmvf\"\nsquare_root = true");
    assert_eq!(spec.estimator, EstimatorSpec::Lmvf { square_root: true });
    assert_eq!(spec.link.arrival, Some(ArrivalSpec::List(vec![1.0, 0.5, 0.0])));
    assert_eq!(spec.link.duplicates, Duplicates::Detect);
    let spec = held("arrival = { column = \"p\" }\nhold = \"last-received\"", "kind = \"lmmse\"");
    assert_eq!(spec.link.arrival, Some(ArrivalSpec::Column("p".to_owned())));
    assert_eq!((spec.link.receiver, spec.estimator), (unstamped(Hold::LastReceived), EstimatorSpec::Lmmse));
    let spec = held("arrival = \"estimate\"", "kind = \"emvf\"\nvariant = \"model1-skip\"\nrange_mixture = true");
    let variant = EmvfVariant::Model1Skip;
    assert_eq!(spec.estimator, EstimatorSpec::Emvf { variant, range_mixture: true });
    assert_eq!(spec.link.arrival, Some(ArrivalSpec::Estimate));
    assert_eq!(held("", "kind = \"gpb1\"").estimator, EstimatorSpec::Gpb1);
}

#[test]
fn the_second_moment_of_the_start_is_read_beside_the_prior() {
    let spec = good(&format!("{LINEAR}x0 = [3, 0]\nP0 = [[4, 0], [0, 1]]\nS0 = [[4, 0], [0, 1]]\n"));
    let cov = mat(2, 2, &[4.0, 0.0, 0.0, 1.0]);
    let second_moment = Some(cov.clone());
    assert_eq!(spec.model.prior(), Some(&Prior { mean: vec![3.0, 0.0], cov, second_moment }));
}

#[test]
fn byte_order_mark_and_carriage_returns_change_nothing() {
    let windows = format!("\u{feff}{}", LINEAR.replace('\n', "\r\n"));
    assert_eq!(good(&windows), good(LINEAR));
}

#[test]
fn numbers_in_every_notation_are_exact() {
    let spec = good(&CV.replace("0.5", "[0x10, 1_000.25e-1]").replace("sd = 0.1", "sd = 1_0"));
    let ModelSpec::Kinematic(model) = &spec.model else { panic!("{:?}", spec.model) };
    assert_eq!(model.noise, [16.0, 100.025]);
    assert_eq!(spec.sensors[0].sd, 10.0);
}

#[test]
fn nearly_symmetric_covariance_is_made_symmetric() {
    // A covariance printed with ten digits by a program that rounded its two halves differently.
    let text = LINEAR.replace("Q = [[1, 0], [0, 0]]", "Q = [[4.0, 0.3333333333], [0.3333333334, 1.0]]");
    let q = linear(&good(&text)).base.q.clone();
    assert_eq!(q.data[1], q.data[2]);
    assert!((q.data[1] - 0.333_333_333_35).abs() < 1e-12, "the mean of the two, to the last printed digit");
}

#[test]
fn singular_process_noise_of_any_unit_is_accepted() {
    // g gᵀ has rank 1 by construction; its diagonal spans 24 decades, so only a scaled test can accept it.
    let g = [1e6, 3.0, 1e-6];
    let rows: Vec<String> = g.iter().map(|a| format!("{:?}", g.map(|b| a * b))).collect();
    let spec = good(&format!(
        "[model]\nkind = \"linear\"\nA = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nC = [[1, 0, 0]]\nR = [[1]]\nQ = [{}]",
        rows.join(", ")
    ));
    assert_eq!(linear(&spec).base.q.data[2], 1e6 * 1e-6);
}

const VARYING: &str =
    "[model]\nkind = \"linear\"\nA = [[1.0]]\nC = [[1.0]]\nR = [[1.0]]\nsequence = \"steps.ndjson\"\n";

#[test]
fn sequence_with_a_whole_base_fills_what_a_step_leaves_out() {
    let text = format!("{VARYING}Q = [[1.0]]\n");
    let steps = b"\xef\xbb\xbf{\"A\": [[2]]}\r\n{}\n\n{\"R\": [[0.1]], \"G\": [[1, 2]], \"Q\": [[1, 0], [0, 1]]}";
    let spec = parse_with(&text, steps).unwrap();
    let LinearSpec { base, sequence, .. } = linear(&spec);
    assert_eq!(base.a.data, [1.0]);
    let a: Vec<f64> = sequence.iter().map(|step| step.a.data[0]).collect();
    assert_eq!(a, [2.0, 1.0, 1.0]);
    assert_eq!((sequence[2].r.data[0], sequence[2].q.rows, sequence[1].q.rows), (0.1, 2, 1));
}

#[test]
fn sequence_without_a_whole_base_makes_its_first_step_the_base() {
    let steps = b"{\"Q\": [[3]], \"B\": [[1, 2]]}\n{\"Q\": [[4]], \"B\": [[3, 4]]}\n";
    let spec = parse_with(VARYING, steps).unwrap();
    let LinearSpec { base, sequence, .. } = linear(&spec);
    assert_eq!(*base, sequence[0]);
    assert_eq!((base.q.data[0], base.b.cols, sequence[1].q.data[0]), (3.0, 2, 4.0));
}

#[test]
fn sequence_alone_may_bring_the_inputs() {
    let spec = parse_with(&format!("{VARYING}Q = [[1.0]]\n"), b"{\"A\": [[2]], \"B\": [[1, 2]]}\n{\"B\": [[3, 4]]}\n")
        .unwrap();
    let LinearSpec { base, sequence, .. } = linear(&spec);
    assert_eq!((base.a.data[0], base.b.cols, sequence[1].b.data[1]), (2.0, 2, 4.0));
}

#[test]
fn modes_take_the_place_of_the_noise_of_the_model() {
    let modes = |model: &str, lines: &str| {
        let sensor = "[sensor]\nkind = \"position\"\nsd = 0.1\n";
        match good(&format!("[model]\n{model}\n{sensor}[estimator]\nkind = \"imm\"\n{lines}")).estimator {
            EstimatorSpec::Imm { modes } => modes.map(|mode| mode.map(|m| (m.noise, m.turn_noise, m.mean_s))),
            other => panic!("{other:?}"),
        }
    };
    let velocity = "kind = \"constant-velocity\"\nnoise = [0.5, 3]";
    // Without modes: a tenth and ten times the model's, which on average over time is the model's.
    let [Some((quiet, none, quiet_s)), Some((agile, _, agile_s)), None, None] = modes(velocity, "") else {
        panic!("two modes")
    };
    assert_eq!(none, 0.0);
    for (axis, expected) in [0.5, 3.0, 0.0].into_iter().enumerate() {
        let mean = (quiet_s * quiet[axis] + agile_s * agile[axis]) / (quiet_s + agile_s);
        assert!((mean - expected).abs() < 1e-15 && (agile[axis] - 100.0 * quiet[axis]).abs() < 1e-14);
    }
    let two = "[[estimator.mode]]\nmean_s = 8\n[[estimator.mode]]\nnoise = 2\nmean_s = 1.5";
    let expected = [Some(([0.5, 3.0, 0.0], 0.0, 8.0)), Some(([2.0, 2.0, 0.0], 0.0, 1.5)), None, None];
    assert_eq!(modes(velocity, two), expected);
    let turn = "kind = \"coordinated-turn\"\nnoise = 0.5\nturn_noise = 0.25";
    let four =
        "mode = [{ mean_s = 1 }, { mean_s = 2, turn_noise = 1 }, { mean_s = 3, noise = [0, 1] }, { mean_s = 4 }]";
    let model = [0.5, 0.5, 0.0];
    let expected = [(model, 0.25, 1.0), (model, 1.0, 2.0), ([0.0, 1.0, 0.0], 0.25, 3.0), (model, 0.25, 4.0)];
    assert_eq!(modes(turn, four), expected.map(Some));
    assert_eq!(modes(turn, "")[1].map(|m| m.1), Some(2.5));
}

#[test]
fn stationary_motion_has_a_place_and_a_speed() {
    let spec = good(
        "[model]\nkind = \"gauss-markov\"\naxes = 3\ncentre_m = [1, 2, 3]\nspread_m = 4\nspeed_mps = [0.5, 0.5, 0.1]\n[sensor]\n\
         kind = \"position\"\nsd = 1",
    );
    let expected = GaussMarkovSpec {
        axes: 3,
        centre_m: vec![1.0, 2.0, 3.0],
        spread_m: vec![4.0; 3],
        speed_mps: vec![0.5, 0.5, 0.1],
        prior: None,
    };
    assert_eq!(spec.model, ModelSpec::GaussMarkov(expected));
    assert_eq!(spec.estimator, EstimatorSpec::Kalman);
}

#[test]
fn errors_that_last_have_a_size_and_a_time() {
    let lasting = |sd, time_s| Some(Lasting { sd, time_s });
    for kind in ["range", "rssi\"\npath_loss = { exponent = 2, at_1m_dbm = -40 }\nrobust = \"none"] {
        let spec = good(&format!(
            "[model]\nkind = \"constant-velocity\"\nnoise = 1\n[sensor]\nkind = \"{kind}\"\nsd = 1\ndrift = {{ sd = 0.3, time_s = 30 }}"
        ));
        assert_eq!(spec.sensors[0].drift, Some(DriftSpec { each: lasting(0.3, 30.0), shared: None }));
    }
    let spec = good(
        "[model]\nkind = \"constant-velocity\"\nnoise = 1\n[sensor]\nkind = \"range\"\nsd = 1\ndrift = { sd = 0.3, time_s = 30, shared_sd = 0.1, shared_time_s = 3 }",
    );
    assert_eq!(spec.sensors[0].drift, Some(DriftSpec { each: lasting(0.3, 30.0), shared: lasting(0.1, 3.0) }));
    let spec = good(
        "[model]\nkind = \"constant-velocity\"\nnoise = 1\n[sensor]\nkind = \"range\"\nsd = 1\ndrift = { shared_sd = 0.1, shared_time_s = 3 }",
    );
    assert_eq!(spec.sensors[0].drift, Some(DriftSpec { each: None, shared: lasting(0.1, 3.0) }));
}

#[test]
fn every_listed_name_parses() {
    let model = |kind: &str| match kind {
        "linear" => LINEAR.to_owned(),
        "gauss-markov" => {
            CV.replace("constant-velocity", kind).replace("noise = 0.5", "centre_m = 0\nspread_m = 5\nspeed_mps = 1")
        }
        "fms-paper" => "[model]\nkind = \"fms-paper\"\n".to_owned(),
        "coordinated-turn" => {
            CV.replace("constant-velocity", kind).replace("noise = 0.5", "noise = 0.5\nturn_noise = 0.5")
        }
        _ => CV.replace("constant-velocity", kind),
    };
    for (kind, _) in MODELS {
        good(&model(kind));
    }
    for (kind, _) in ESTIMATORS {
        let keys = match *kind {
            "fixed-lag-kalman" => "lag = 1",
            "fms" | "ufir" => "window = 5",
            "lmvf" | "lmmse" | "emvf" | "gpb1" => "[link]\nstamped = false",
            _ => "",
        };
        let model = CV.replace(
            "[sensor]",
            "x0 = [0, 0, 1, 1]\nP0 = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n[sensor]",
        );
        good(&format!("{model}[estimator]\nkind = \"{kind}\"\n{keys}"));
    }
    for (kind, _) in SENSORS {
        let law = if *kind == "rssi" { "path_loss = { exponent = 2.5, at_1m_dbm = -40 }\n" } else { "" };
        good(&format!("{}{law}", CV.replace("position", kind)));
    }
    for (kind, _) in LINKS {
        good(&format!("{CV}[link]\nstamped = {}", *kind == "stamped"));
    }
}
