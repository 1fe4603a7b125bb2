//! Specs that are wrong: each names its file, line and key, the value and what was expected.

use super::parse_with;
use std::path::Path;

struct Broken {
    text: String,
    steps: &'static [u8],
    file: &'static str,
    line: Option<u64>,
    key: Option<&'static str>,
    says: &'static [&'static str],
}

const KINEMATIC: &str = "[model]\nkind = \"constant-velocity\"\nnoise = 0.5\n";
const POSITION: &str = "[sensor]\nkind = \"position\"\nsd = 0.1\n";

fn spec(text: impl Into<String>, line: u64, key: &'static str, says: &'static [&'static str]) -> Broken {
    Broken { text: text.into(), steps: b"", file: "site/spec.toml", line: Some(line), key: Some(key), says }
}

/// A spec without a line or a key to point at.
fn bare(text: &str, line: Option<u64>, key: Option<&'static str>, says: &'static [&'static str]) -> Broken {
    Broken { text: text.into(), steps: b"", file: "site/spec.toml", line, key, says }
}

/// A good model on lines 1 to 3, `line 4 …` under test in it, then a good sensor.
fn model(line_4: &str, key: &'static str, says: &'static [&'static str]) -> Broken {
    spec(format!("{KINEMATIC}{line_4}\n{POSITION}"), 4, key, says)
}

/// `lines` under test, from line 2, are the whole model; its matrices are valid unless they say otherwise.
fn linear(lines: &str, line: u64, key: &'static str, says: &'static [&'static str]) -> Broken {
    let mut text = format!("[model]\n{lines}\nkind = \"linear\"\n");
    for (name, value) in [("A", "[[1, 1], [0, 1]]"), ("C", "[[1, 0]]"), ("Q", "[[1, 0], [0, 1]]"), ("R", "[[1]]")] {
        if !lines.lines().any(|l| l.starts_with(name)) {
            text += &format!("{name} = {value}\n");
        }
    }
    spec(text, line, key, says)
}

/// A good model and sensor on lines 1 to 6, then `lines` from line 7.
fn after(lines: &str, line: u64, key: &'static str, says: &'static [&'static str]) -> Broken {
    spec(format!("{KINEMATIC}{POSITION}{lines}"), line, key, says)
}

/// A good model and sensor, then from line 9 the estimator's `keys` under test.
fn own(estimator: &str, keys: &str, key: &'static str, says: &'static [&'static str]) -> Broken {
    after(&format!("[estimator]\nkind = {estimator:?}\n{keys}"), 9, key, says)
}

/// A good model and sensor, then on line 9 a good mode of `imm` and one with `keys` under test.
fn mode(keys: &str, key: &'static str, says: &'static [&'static str]) -> Broken {
    after(&format!("[estimator]\nkind = \"imm\"\nmode = [{{ mean_s = 2 }}, {{ {keys} }}]"), 9, key, says)
}

/// A good model on lines 1 to 3, then `lines` from line 4.
fn sensor(lines: &str, line: u64, key: &'static str, says: &'static [&'static str]) -> Broken {
    spec(format!("{KINEMATIC}{lines}"), line, key, says)
}

/// A linear model without `Q`, with `steps` beside it.
fn steps(steps: &'static [u8], line: Option<u64>, key: Option<&'static str>, says: &'static [&'static str]) -> Broken {
    let text = "[model]\nkind = \"linear\"\nA = [[1]]\nC = [[1]]\nR = [[1]]\nsequence = \"steps.ndjson\"".into();
    Broken { text, steps, file: "site/steps.ndjson", line, key, says }
}

fn documents() -> Vec<Broken> {
    vec![
        bare("", None, Some("model"), &["is missing", "a table `[model]` with a `kind`"]),
        bare("[model]\nkind = \"random-walk", Some(2), None, &["is no TOML", "invalid basic string"]),
        bare("[model]\nkind = \"random-walk\"\nkind = \"linear\"", Some(3), None, &["duplicate key"]),
        bare("[model]\nnoise = 1\n\n[model]\nkind = \"linear\"", Some(4), None, &["duplicate key"]),
        spec("version = 2\n", 1, "version", &["is 2", "expected 1"]),
        spec("version = \"1\"\n", 1, "version", &["is \"1\"", "expected 1"]),
        spec("anchors = 3\n", 1, "anchors", &["is 3", "CSV file"]),
        spec("anchors = \"\"\n", 1, "anchors", &["is \"\"", "CSV file"]),
        spec("model = 3\n", 1, "model", &["is 3", "a table"]),
        spec("[modle]\nkind = \"linear\"\n", 1, "modle", &["expected `version`", "did you mean `model`?"]),
        spec("[[model]]\nkind = \"linear\"\n", 1, "model", &["is a list of 1 value", "a table"]),
        spec("[model]\nnoise = 1\n", 1, "model.kind", &["is missing", "name of a model"]),
        spec("[model]\nkind = 3\n", 2, "model.kind", &["is 3", "`constant-velocity`"]),
        spec(
            "[model]\nkind = \"constant_velocity\"",
            2,
            "model.kind",
            &["`linear`", "did you mean `constant-velocity`?"],
        ),
        spec("[model]\nkind = \"singer\"", 2, "model.kind", &["is \"singer\", expected one of `random-walk`"]),
    ]
}

fn kinematic_models() -> Vec<Broken> {
    vec![
        model("axis = 2", "model.axis", &["the model `constant-velocity`", "`noise`", "did you mean `axes`?"]),
        model("turn_noise = 2", "model.turn_noise", &["not a key of the model `constant-velocity`"]),
        model("axes = 4", "model.axes", &["is 4", "from 1 to 3"]),
        model("axes = 1.5", "model.axes", &["is 1.5", "a whole number"]),
        model("x0 = [0, 0, 0, 0]", "model.P0", &["is missing", "covariance of `x0`"]).at(1),
        model("P0 = [[1]]", "model.x0", &["is missing"]).at(1),
        model("side = [1]", "model.side", &["is a list of 1 value", "a list of 2, a point on the side"]).at(4),
        model("side = 1", "model.side", &["is 1", "a list of 2"]).at(4),
        model("P0 = [[1]]\nx0 = [1, 2]", "model.x0", &["is a list of 2 values", "a list of 4"]).at(5),
        model("x0 = [0, 0, 0, 0]\nP0 = [[1, 0], [0, 1]]", "model.P0", &["is 2 × 2", "expected 4 × 4"]).at(5),
        spec("[model]\nkind = \"random-walk\"\n", 1, "model.noise", &["is missing", "finite power spectral density"]),
        spec("[model]\nkind = \"random-walk\"\nnoise = -1", 3, "model.noise", &["is -1", "at least 0"]),
        spec("[model]\nkind = \"random-walk\"\nnoise = nan", 3, "model.noise", &["is nan", "at least 0"]),
        spec("[model]\nkind = \"random-walk\"\nnoise = 1e999", 3, "model.noise", &["is 1e999"]),
        spec("[model]\nkind = \"random-walk\"\nnoise = true", 3, "model.noise", &["is true"]),
        spec(
            "[model]\nkind = \"random-walk\"\nnoise = [1, 2, 3]",
            3,
            "model.noise",
            &["list of 3 values", "a list of 2"],
        ),
        spec("[model]\nkind = \"random-walk\"\nnoise = [\n1,\n-2]", 5, "model.noise[1]", &["is -2", "at least 0"]),
        spec("[model]\nkind = \"gauss-markov\"\nnoise = 1", 3, "model.noise", &["not a key", "`spread_m`"]),
        spec(
            "[model]\nkind = \"gauss-markov\"\ncentre_m = 0\nspread_m = 0\nspeed_mps = 1",
            4,
            "model.spread_m",
            &["is 0", "1e-9"],
        ),
        spec(
            "[model]\nkind = \"gauss-markov\"\ncentre_m = [0, 0, 0]\nspread_m = 1\nspeed_mps = 1",
            3,
            "model.centre_m",
            &["one number or a list of 2"],
        ),
        spec("[model]\nkind = \"gauss-markov\"\ncentre_m = 0\nspread_m = 1", 1, "model.speed_mps", &["is missing"]),
        spec("[model]\nkind = \"coordinated-turn\"\nnoise = 1", 1, "model.turn_noise", &["is missing"]),
        spec(
            "[model]\nkind = \"coordinated-turn\"\nnoise = 1\nturn_noise = { per_step = -1 }",
            4,
            "model.turn_noise.per_step",
            &["-1", "a finite variance"],
        ),
        spec(
            "[model]\nkind = \"coordinated-turn\"\nnoise = 1\nturn_noise = { per_step = 1, power = 3 }",
            4,
            "model.turn_noise.power",
            &["3", "0 to 2"],
        ),
        spec("[model]\nkind = \"coordinated-turn\"\naxes = 2", 3, "model.axes", &["not a key", "`turn_noise`"]),
        spec("[model]\nkind = \"fms-paper\"\nT = 0", 3, "model.T", &["is 0", "positive finite number of seconds"]),
        spec("[model]\nkind = \"fms-paper\"\nT = 1e200", 3, "model.T", &["is 1e200", "finite"]),
        spec("[model]\nkind = \"fms-paper\"\nQ = [[1]]", 3, "model.Q", &["is 1 × 1", "expected 2 × 2"]),
        spec("[model]\nkind = \"fms-paper\"\nC = [[1]]", 3, "model.C", &["the model `fms-paper`", "`T`"]),
    ]
}

fn linear_models() -> Vec<Broken> {
    vec![
        spec("[model]\nkind = \"linear\"", 1, "model.A", &["is missing", "n × n"]),
        spec("[model]\nkind = \"linear\"\nA = [[1]]", 1, "model.C", &["is missing", "q × n"]),
        linear("A = [[1, 1]]", 2, "model.A", &["is 1 × 2", "n × n"]),
        linear("A = 1.0", 2, "model.A", &["is 1.0", "a list of rows"]),
        linear("A = []", 2, "model.A", &["an empty list", "a matrix"]),
        linear("A = [[]]", 2, "model.A[0]", &["an empty list", "a row"]),
        linear("A = [[1, 1],\n[0]]", 3, "model.A[1]", &["has 1 entry,", "2 as in the first row"]),
        linear("A = [[1, 1],\n[0, \"1\"]]", 3, "model.A[1][1]", &["is \"1\"", "a finite number"]),
        linear("A = [[1, inf], [0, 1]]", 2, "model.A[0][1]", &["is inf", "a finite number"]),
        linear("C = [[1, 0, 0]]", 2, "model.C", &["is 1 × 3", "q × 2", "`A` is 2 × 2"]),
        linear("C = [[1,0],[1,0],[1,0],[1,0],[1,0],[1,0],[1,0]]", 2, "model.C", &["is 7 × 2", "at most 6"]),
        linear("B = [[1]]", 2, "model.B", &["is 1 × 1", "2 × p", "`A` is 2 × 2"]),
        linear("G = [[1, 0, 0]]", 2, "model.G", &["is 1 × 3", "2 × p", "`A` is 2 × 2"]),
        linear("Q = [[1]]", 2, "model.Q", &["is 1 × 1", "2 × 2", "`G` is 2 × 2 by default"]),
        linear("G = [[1], [0]]\nQ = [[1, 0], [0, 1]]", 3, "model.Q", &["is 2 × 2", "1 × 1", "`G` is 2 × 1"]),
        linear("R = [[1, 0], [0, 1]]", 2, "model.R", &["is 2 × 2", "1 × 1", "`C` is 1 × 2"]),
        linear("R = [[1, 0]]", 2, "model.R", &["is 1 × 2", "a square matrix"]),
        linear("R = [[0]]", 2, "model.R[0][0]", &["is 0.0", "a positive number", "positive definite"]),
        linear("Q = [[1, 0],\n[0, -1]]", 3, "model.Q[1][1]", &["is -1.0", "at least 0", "positive semidefinite"]),
        linear("Q = [[1, 2], [0, 1]]", 2, "model.Q[1][0]", &["is 0.0", "expected 2.0 as [0][1]", "symmetric"]),
        linear("Q = [[1, 2], [2, 1]]", 2, "model.Q[0][1]", &["is 2.0", "at most 1.0", "not positive semidefinite"]),
        linear("Q = [[0, 1e-9], [1e-9, 1]]", 2, "model.Q[0][1]", &["is 1e-9", "at most 0.0"]),
        // Eigenvalues of the matrix with 1 on and r off the diagonal: 1 + 2r and 1 − r.
        linear(
            "G = [[1, 0, 0], [0, 1, 0]]\nQ = [[1, -0.9, -0.9], [-0.9, 1, -0.9], [-0.9, -0.9, 1]]",
            3,
            "model.Q",
            &["eigenvalue -8.000e-1", "positive semidefinite"],
        ),
        linear("C = [[1, 0], [0, 1]]\nR = [[1, 1], [1, 1]]", 3, "model.R", &["eigenvalue", "positive definite"]),
        linear("x0 = [0, 0]\nP0 = [[1, 0], [0, -1]]", 3, "model.P0[1][1]", &["is -1.0", "at least 0"]),
        linear("x0 = [0, nan]\nP0 = [[1, 0], [0, 1]]", 2, "model.x0[1]", &["is nan", "a finite number"]),
        linear("S0 = [[1]]", 2, "model.S0", &["no `S0` without `x0`"]),
        linear("noise = 1", 2, "model.noise", &["the model `linear`", "`A`, `B`"]),
        linear("a = [[1]]", 2, "model.a", &["did you mean `A`?"]),
        linear(
            &format!("A = [{}]", vec![format!("[{}]", ["0"; 13].join(",")); 13].join(",")),
            2,
            "model.A",
            &["13 × 13", "12"],
        ),
        spec(
            "[model]\nkind = \"linear\"\nA = [[1]]\nC = [[1]]\nQ = [[1]]\nR = [[1]]\n[sensor]\nkind = \"position\"\nsd = 1",
            7,
            "sensor",
            &["does not fit a linear model", "`C` and `R` in `[model]`"],
        ),
    ]
}

fn sequences() -> Vec<Broken> {
    vec![
        linear("sequence = \"other.ndjson\"", 2, "model.sequence", &["is \"other.ndjson\"", "a file that can be read"]),
        linear("sequence = 3", 2, "model.sequence", &["is 3", "NDJSON"]),
        steps(b"", None, None, &["is empty", "one step per line"]),
        steps(b"{\"Q\": [[1]]}\n{\"R\": [[1]]}", Some(2), Some("Q"), &["is missing", "in every step", "has none"]),
        steps(b"{\"Q\": [[1]]}\n\n{\"q\": [[1]]}", Some(3), Some("q"), &["not a key of a step", "did you mean `Q`?"]),
        steps(b"{\"Q\": [[1]], \"R\": [[-1]]}", Some(1), Some("R[0][0]"), &["is -1.0", "a positive number"]),
        steps(b"{\"Q\": [[null]]}", Some(1), Some("Q[0][0]"), &["is null", "a finite number"]),
        steps(b"{\"Q\": [[1]]}\n[1]", Some(2), None, &["a JSON object", "column"]),
        steps(b"{\"Q\": [[1]]}\n{\"Q\": [[1]", Some(2), None, &["a JSON object", "EOF"]),
        steps(b"{\"Q\": [[1]], \"Q\": [[2]]}", Some(1), None, &["duplicate key `Q`"]),
        steps(b"{\"Q\": [[1]], \"A\": [[1e999]]}", Some(1), None, &["number out of range"]),
        steps(b"{\"Q\": [[1]]}\n{\"\xff\": 1}", Some(2), None, &["a JSON object", "unicode"]),
        steps(b"{\"Q\": [[1]]}\n{\"Q\": [[1]], \"B\": [[1]]}", Some(2), Some("B"), &["is 1 × 1", "expected 1 × 0"]),
        steps(
            b"{\"Q\": [[1]]}\n{\"Q\": [[1]], \"C\": [[1], [1]], \"R\": [[1, 0], [0, 1]]}",
            Some(2),
            Some("C"),
            &["is 2 × 1", "expected 1 × 1"],
        ),
    ]
}

fn estimators() -> Vec<Broken> {
    vec![
        after("[estimator]\n", 7, "estimator.kind", &["is missing", "`kalman`"]),
        spec(format!("estimator = 3\n{KINEMATIC}{POSITION}"), 1, "estimator", &["is 3", "a table `[estimator]`"]),
        after(
            "[estimator]\nkind = \"kalmn\"",
            8,
            "estimator.kind",
            &["is \"kalmn\"", "`ufir`", "did you mean `kalman`?"],
        ),
        spec(
            format!("{}{POSITION}[estimator]\nkind = \"fosb\"", KINEMATIC.replace("velocity", "acceleration")),
            8,
            "estimator.kind",
            &["is \"fosb\"", "constant velocity and positions", "number of derivatives", "`kalman`"],
        ),
        spec(
            "[model]\nkind = \"fms-paper\"\n[estimator]\nkind = \"alpha-beta\"",
            4,
            "estimator.kind",
            &["is \"alpha-beta\"", "the model gives matrices", "`kalman`"],
        ),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\n[estimator]\nkind = \"fosb\"",
            8,
            "estimator.kind",
            &["is \"fosb\"", "`sensor.kind` is another", "expected `ekf`"],
        ),
        sensor(
            "[sensor]\nkind = \"position\"\nsd = 1\nrobust = \"gate\"\n[estimator]\nkind = \"fosb\"",
            9,
            "estimator.kind",
            &["is \"fosb\"", "`sensor.robust`", "expected `kalman`"],
        ),
        spec(
            format!(
                "{KINEMATIC}axes = 1\nx0 = [0, 0]\nP0 = [[1, 0.5], [0.5, 1]]\n{POSITION}[estimator]\nkind = \"fosb\""
            ),
            11,
            "estimator.kind",
            &["is \"fosb\"", "`model.P0` has covariances", "a diagonal `P0`"],
        ),
        spec(
            format!(
                "{KINEMATIC}x0 = [0, 0, 0, 0]\nP0 = [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0.1, 0, 0, 1]]\n{POSITION}\
                 [estimator]\nkind = \"alpha-beta\""
            ),
            10,
            "estimator.kind",
            &["is \"alpha-beta\"", "`model.P0` has covariances"],
        ),
        after(
            "[estimator]\nkind = \"fosb\"\n[link]\nstamped = false",
            8,
            "estimator.kind",
            &["is \"fosb\"", "when values were sensed", "`stamped = true`"],
        ),
        own("fosb", "alpha = 1", "estimator.alpha", &["not a key of the estimator `fosb`", "`q33`"]),
        own("fosb", "q = -1", "estimator.q", &["is -1", "a variance in m²/s⁴"]),
        own("fosb", "q = 1\nq33 = 1", "estimator.q", &["is 1 beside `q11` or `q33`", "only one"]),
        after("[estimator]\nkind = \"fosb\"\nq11 = 1", 7, "estimator.q33", &["is missing", "together"]),
        after("[estimator]\nkind = \"fosb\"\nq33 = 1", 7, "estimator.q11", &["is missing", "together"]),
        own("fosb", "speed_sd = 0", "estimator.speed_sd", &["is 0", "a standard deviation in m/s"]),
        after(
            "[estimator]\nkind = \"alpha-beta\"\nalpha = 0.5",
            7,
            "estimator.beta",
            &["is missing", "beside `alpha`"],
        ),
        after("[estimator]\nkind = \"alpha-beta\"\nbeta = 0.5", 7, "estimator.alpha", &["is missing", "beside `beta`"]),
        own(
            "alpha-beta",
            "beta = 1 # too steep\nalpha = 1.5",
            "estimator.beta",
            &["is 1", "2 `alpha` + `beta` below 4"],
        ),
        own("alpha-beta", "alpha = 0\nbeta = 1", "estimator.alpha", &["is 0", "a positive number"]),
        own("alpha-beta", "interval_s = 0", "estimator.interval_s", &["is 0", "seconds between fixes"]),
        spec(
            format!("{}{POSITION}[estimator]\nkind = \"alpha-beta\"", KINEMATIC.replace("0.5", "0")),
            8,
            "estimator.kind",
            &["is \"alpha-beta\"", "`model.noise` of 0", "`alpha` and `beta`"],
        ),
        spec(
            "[model]\nkind = \"fms-paper\"\n[estimator]\nkind = \"imm\"",
            4,
            "estimator.kind",
            &["is \"imm\"", "kinematic models", "`kalman`"],
        ),
        after(
            "[estimator]\nkind = \"imm\"\n[link]\nstamped = false",
            8,
            "estimator.kind",
            &["is \"imm\"", "when values were sensed", "`stamped = true`", "`gpb1`"],
        ),
        after(
            "[estimator]\nkind = \"imm\"\n[[estimator.mode]]\nmean_s = 1",
            9,
            "estimator.mode",
            &["a list of 1 value", "2 to 4 tables `[[estimator.mode]]`"],
        ),
        after(
            "[estimator]\nkind = \"imm\"\nmode = [{ mean_s = 1 }, { mean_s = 1 }, { mean_s = 1 }, { mean_s = 1 }, { mean_s = 1 }]",
            9,
            "estimator.mode",
            &["a list of 5 values", "2 to 4 tables"],
        ),
        after(
            "[estimator]\nkind = \"imm\"\n[estimator.mode]\nmean_s = 1",
            9,
            "estimator.mode",
            &["is a table", "2 to 4"],
        ),
        after("[estimator]\nkind = \"imm\"\nmode = [1, 2]", 9, "estimator.mode[0]", &["is 1", "2 to 4 tables"]),
        mode("noise = 1", "estimator.mode[1].mean_s", &["is missing", "how long the mode lasts"]),
        mode("mean_s = 0", "estimator.mode[1].mean_s", &["is 0", "from 1e-9"]),
        mode("mean_s = inf", "estimator.mode[1].mean_s", &["is inf", "seconds"]),
        mode("mean_s = 1, noise = -1", "estimator.mode[1].noise", &["is -1", "at least 0"]),
        mode("mean_s = 1, noise = [1, 2, 3]", "estimator.mode[1].noise", &["a list of 3 values", "a list of 2"]),
        mode(
            "mean_s = 1, turn_noise = 1",
            "estimator.mode[1].turn_noise",
            &["not a key of a mode", "`noise`, `mean_s`"],
        ),
        after("[estimator]\nkind = \"ekf\"\nmode = []", 9, "estimator.mode", &["the estimator `ekf`"]),
        after(
            "[estimator]\nkind = \"lmvf\"\nlag = 3",
            9,
            "estimator.lag",
            &["not a key of the estimator `lmvf`", "`square_root`"],
        ),
        after("[estimator]\nkind = \"ekf\"\nlag = 3", 9, "estimator.lag", &["the estimator `ekf`", "expected `kind`"]),
        after("[estimator]\nkind = \"fms\"", 7, "estimator.window", &["is missing", "`window_s`"]),
        after("[estimator]\nkind = \"fms\"\nwindw = 3", 9, "estimator.windw", &["did you mean `window`?"]),
        after("[estimator]\nkind = \"fms\"\nwindow = 0", 9, "estimator.window", &["is 0", "from 1"]),
        after("[estimator]\nkind = \"ufir\"\nwindow = 1e9", 9, "estimator.window", &["is 1e9", "to 100000"]),
        after(
            "[estimator]\nkind = \"ufir\"\nwindow = 5\nwindow_s = 1",
            10,
            "estimator.window_s",
            &["is 1", "only one"],
        ),
        after(
            "[estimator]\nkind = \"ufir\"\nwindow_s = 0",
            9,
            "estimator.window_s",
            &["is 0", "a positive finite number"],
        ),
        after("[estimator]\nkind = \"ufir\"\nwindow_s = inf", 9, "estimator.window_s", &["is inf", "seconds"]),
        after(
            "[estimator]\nkind = \"fms\"\nwindow = 5\nlag = 5",
            10,
            "estimator.lag",
            &["is 5", "at most 4", "`window` of 5"],
        ),
        after(
            "[estimator]\nkind = \"fms\"\nwindow = 5\nalign = \"predicted\"\nlag = 6",
            11,
            "estimator.lag",
            &["is 6", "at most 5"],
        ),
        after("[estimator]\nkind = \"fms\"\nwindow_s = 5\nlag_s = 6", 10, "estimator.lag_s", &["is 6", "at most 5.0"]),
        after("[estimator]\nkind = \"fms\"\nwindow = 5\nlag = -1", 10, "estimator.lag", &["is -1", "from 0"]),
        after(
            "[estimator]\nkind = \"fms\"\nwindow = 5\nalign = \"predict\"",
            10,
            "estimator.align",
            &["mean `predicted`?"],
        ),
        after("[estimator]\nkind = \"fixed-lag-kalman\"", 7, "estimator.lag", &["is missing", "`lag_s`"]),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\n[estimator]\nkind = \"kalman\"",
            8,
            "estimator.kind",
            &["is \"kalman\"", "`sensor.kind` is \"range\"", "expected `ekf`"],
        ),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\n[estimator]\nkind = \"ufir\"\nwindow = 9",
            8,
            "estimator.kind",
            &["is \"ufir\"", "`sensor.kind` is \"range\"", "`fms`"],
        ),
        spec(
            format!(
                "[estimator]\nkind = \"kalman\"\n{POSITION}[model]\nkind = \"coordinated-turn\"\nnoise = 1\nturn_noise = 1"
            ),
            2,
            "estimator.kind",
            &["is \"kalman\"", "`model.kind` is \"coordinated-turn\"", "expected `ekf`"],
        ),
    ]
}

fn sensors() -> Vec<Broken> {
    vec![
        bare(KINEMATIC, None, Some("sensor"), &["is missing", "a table `[sensor]`"]),
        spec(format!("sensor = []\n{KINEMATIC}"), 1, "sensor", &["an empty list", "a table `[sensor]`"]),
        spec(format!("sensor = [1]\n{KINEMATIC}"), 1, "sensor[0]", &["is 1", "a table `[sensor]`"]),
        sensor("[sensor]\nsd = 1", 4, "sensor.kind", &["is missing", "\"range\""]),
        sensor("[sensor]\nkind = \"rang\"\nsd = 1", 5, "sensor.kind", &["is \"rang\"", "did you mean `range`?"]),
        sensor("[sensor]\nkind = \"rsi\"\nsd = 1", 5, "sensor.kind", &["is \"rsi\"", "did you mean `rssi`?"]),
        sensor("[sensor]\nkind = \"rssi\"\nsd = 2", 4, "sensor.path_loss", &["is missing", "exponent", "at_1m_dbm"]),
        sensor("[sensor]\nkind = \"rssi\"", 4, "sensor.sd", &["is missing", "standard deviation in dB"]),
        sensor(
            "[sensor]\nkind = \"rssi\"\nsd = 2\npath_loss = 2.5",
            7,
            "sensor.path_loss",
            &["is 2.5", "exponent", "at_1m_dbm"],
        ),
        sensor(
            "[sensor]\nkind = \"rssi\"\nsd = 2\npath_loss = { exponent = 2.5 }",
            7,
            "sensor.path_loss.at_1m_dbm",
            &["is missing", "dBm"],
        ),
        sensor(
            "[sensor]\nkind = \"rssi\"\nsd = 2\npath_loss = { at_1m_dbm = -40 }",
            7,
            "sensor.path_loss.exponent",
            &["is missing", "from 0.1 to 100"],
        ),
        sensor(
            "[sensor]\nkind = \"rssi\"\nsd = 2\npath_loss = { exponent = 0, at_1m_dbm = -40 }",
            7,
            "sensor.path_loss.exponent",
            &["is 0", "from 0.1 to 100"],
        ),
        sensor(
            "[sensor]\nkind = \"rssi\"\nsd = 2\npath_loss = { n = 2, at_1m_dbm = -40 }",
            7,
            "sensor.path_loss.n",
            &["a key of `path_loss`", "`exponent`"],
        ),
        sensor(
            "[sensor]\nkind = \"rssi\"\nsd = 2\npath_loss = { exponent = 2, at_1m_dbm = -40 }\nbias = { A1 = \"x\" }",
            8,
            "sensor.bias.A1",
            &["is \"x\"", "number of dB"],
        ),
        sensor("[sensor]\nkind = \"tdoa\"\nsd = 1\nbias = { A1 = 1 }", 7, "sensor.bias", &["a `tdoa` sensor"]),
        sensor("[sensor]\nkind = \"bearing\"\nsd = 0", 6, "sensor.sd", &["is 0", "in radians"]),
        sensor(
            "[sensor]\nkind = \"bearing\"\nsd = 1\ndrift = { sd = 1, time_s = 1 }",
            7,
            "sensor.drift",
            &["a `bearing` sensor"],
        ),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\ndrift = 0.3",
            7,
            "sensor.drift",
            &["is 0.3", "{ sd = 0.3, time_s = 30 }"],
        ),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\ndrift = { sd = 0.3 }",
            7,
            "sensor.drift.time_s",
            &["is missing", "how long"],
        ),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\ndrift = { sd = 0, time_s = 1 }",
            7,
            "sensor.drift.sd",
            &["metres", "1e-9"],
        ),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\ndrift = { sd = 1, time_s = 0 }",
            7,
            "sensor.drift.time_s",
            &["seconds"],
        ),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\ndrift = { sd = 1, time_s = 9, shared_sd = 1 }",
            7,
            "sensor.drift.shared_time_s",
            &["is missing", "how long"],
        ),
        sensor("[sensor]\nkind = \"bearing\"\nsd = 1\nheight_m = 1", 7, "sensor.height_m", &["a `bearing` sensor"]),
        sensor(
            "axes = 1\n[sensor]\nkind = \"bearing\"\nsd = 1",
            6,
            "sensor.kind",
            &["is \"bearing\"", "`model.axes` is 1"],
        ),
        sensor("[sensor]\nkind = \"range\"", 4, "sensor.sd", &["is missing", "rows with an `sd` of their own"]),
        sensor("[sensor]\nkind = \"range\"\nsd = 0", 6, "sensor.sd", &["is 0", "a finite number from 1e-9"]),
        sensor("[sensor]\nkind = \"range\"\nsd = 1e-300", 6, "sensor.sd", &["is 1e-300", "a finite number from 1e-9"]),
        sensor("[sensor]\nkind = \"range\"\nsd = 1e300", 6, "sensor.sd", &["is 1e300", "at most 1e15 in size"]),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = \"1 m\"",
            6,
            "sensor.sd",
            &["is \"1 m\"", "a finite number from 1e-9"],
        ),
        sensor("[sensor]\nkind = \"range\"\nSD = 1", 6, "sensor.SD", &["a `range` sensor", "did you mean `sd`?"]),
        sensor("[sensor]\nkind = \"position\"\nsd = 1\nheight_m = 1", 7, "sensor.height_m", &["a `position` sensor"]),
        sensor("[sensor]\nkind = \"range\"\nsd = 1\nheight_m = nan", 7, "sensor.height_m", &["is nan", "metres"]),
        sensor("[sensor]\nkind = \"range\"\nsd = 1\npath_loss = {}", 7, "sensor.path_loss", &["a `range` sensor"]),
        sensor("[sensor]\nkind = \"range\"\nsd = 1\nbias = 0.1", 7, "sensor.bias", &["is 0.1", "anchors and metres"]),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\nbias = { A1 = \"x\" }",
            7,
            "sensor.bias.A1",
            &["is \"x\"", "metres"],
        ),
        sensor("[sensor]\nkind = \"range\"\nsd = 1\nlatency_s = inf", 7, "sensor.latency_s", &["is inf", "seconds"]),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\nrobust = \"huber\"\nthreshold = 0",
            8,
            "sensor.threshold",
            &["is 0", "standard deviations"],
        ),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\nrobust = \"gate\"\nthreshold = 2",
            8,
            "sensor.threshold",
            &["is 2", "\"huber\" or \"redescending\""],
        ),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\nrobust = \"huber\"\ngate = 9",
            8,
            "sensor.gate",
            &["is 9", "`robust = \"gate\"`"],
        ),
        sensor(
            "[[sensor]]\nkind = \"position\"\nsd = 1\nrobust = \"gate\"\n[[sensor]]\nkind = \"range\"\nsd = 2\nrobust = \"huber\"",
            11,
            "sensor[1].robust",
            &["differs from another sensor's"],
        ),
        sensor("[sensor]\nkind = \"range\"\nsd = 1\nrobust = \"gates\"", 7, "sensor.robust", &["did you mean `gate`?"]),
        sensor("[sensor]\nkind = \"range\"\nsd = 1\ngate = 9", 7, "sensor.gate", &["is 9", "`robust = \"gate\"`"]),
        sensor(
            "[sensor]\nkind = \"range\"\nsd = 1\ngate = 0\nrobust = \"gate\"",
            7,
            "sensor.gate",
            &["is 0", "positive"],
        ),
        sensor(
            "[[sensor]]\nkind = \"position\"\nsd = 1\n[[sensor]]\nkind = \"position\"\nsd = 2",
            8,
            "sensor[1].kind",
            &["is \"position\" a second time", "one `[[sensor]]` of each kind"],
        ),
        sensor(
            "axes = 1\n[sensor]\nkind = \"range\"\nsd = 1",
            6,
            "sensor.kind",
            &["is \"range\"", "`model.axes` is 1"],
        ),
        sensor(
            "axes = 3\n[sensor]\nkind = \"range\"\nsd = 1\nheight_m = 1.5",
            8,
            "sensor.height_m",
            &["is 1.5", "`model.axes` is 3"],
        ),
    ]
}

fn links_and_columns() -> Vec<Broken> {
    vec![
        after("[link]\nstamped = 1", 8, "link.stamped", &["is 1", "true or false"]),
        after("[link]\narrival = 1.5", 8, "link.arrival", &["is 1.5", "a probability"]),
        after("[link]\narrival = []", 8, "link.arrival", &["an empty list", "a probability"]),
        after("[link]\narrival = [0.5, -1]", 8, "link.arrival[1]", &["is -1", "from 0 to 1"]),
        after("[link]\narrival = \"guess\"", 8, "link.arrival", &["is \"guess\"", "\"estimate\""]),
        after("[link]\narrival = { col = \"p\" }", 8, "link.arrival.col", &["not a key of an arrival", "`column`"]),
        after("[link]\narrival = { column = \"\" }", 8, "link.arrival.column", &["is \"\"", "the name of a column"]),
        after("[link]\nduplicates = \"drop\"", 8, "link.duplicates", &["is \"drop\"", "`detect`"]),
        after("[link]\nhold = \"paper\"", 8, "link.hold", &["no `hold`", "`stamped = false`"]),
        after("[link]\nstamped = false\nhold = \"last\"", 9, "link.hold", &["is \"last\"", "`last-received`"]),
        after("[link]\nstamped = false\nlate_s = 5", 9, "link.late_s", &["no `late_s`", "`stamped = true`"]),
        after("[estimator]\nkind = \"lmmse\"", 8, "estimator.kind", &["is \"lmmse\"", "`stamped = false`"]),
        after("[estimator]\nkind = \"lmmse\"\n[link]\nstamped = false", 1, "model.x0", &["is missing", "`lmmse`"]),
        after(
            "[estimator]\nkind = \"lmvf\"\n[link]\nstamped = false\nhold = \"last-received\"",
            11,
            "link.hold",
            &["is \"last-received\"", "`gpb1`"],
        ),
        after("[link]\nlate = 1", 8, "link.late", &["not a key of a link", "`stamped`, `late_s`"]),
        after("[link]\nlate_s = -1", 8, "link.late_s", &["is -1", "at least 0"]),
        after("[columns]\ntime = \"t\"", 8, "columns.time", &["no column of ours", "`t`, `target`"]),
        after("[columns]\ntargte = \"t\"", 8, "columns.targte", &["did you mean `target`?"]),
        after("[columns]\nz7 = \"t\"", 8, "columns.z7", &["no column of ours", "`z6`"]),
        after("[columns]\nt = 3", 8, "columns.t", &["is 3", "the name of a column"]),
        after("[columns]\nt = \"\"", 8, "columns.t", &["is \"\"", "the name of a column"]),
    ]
}

impl Broken {
    fn at(self, line: u64) -> Broken {
        Broken { line: Some(line), ..self }
    }

    /// What is wrong with the error, if anything.
    fn complaint(&self) -> Option<String> {
        let error = match parse_with(&self.text, self.steps) {
            Ok(spec) => return Some(format!("accepted as {spec:?}")),
            Err(error) => error,
        };
        let message = error.to_string();
        let place = &error.place;
        let here =
            (place.file.as_path(), place.line, place.key.as_deref()) == (Path::new(self.file), self.line, self.key);
        let says = self.says.iter().all(|fragment| error.what.contains(fragment));
        let sentence =
            !message.contains('\n') && !message.ends_with('.') && !error.what.starts_with(char::is_uppercase);
        (!(here && says && sentence))
            .then(|| format!("{message}\n  expected line {:?}, key {:?}, {:?}", self.line, self.key, self.says))
    }
}

#[test]
fn broken_specs_name_place_value_and_expectation() {
    let tables =
        [documents(), kinematic_models(), linear_models(), sequences(), estimators(), sensors(), links_and_columns()];
    let complaints: Vec<String> = tables
        .iter()
        .flatten()
        .filter_map(|broken| broken.complaint().map(|complaint| format!("{}\n→ {complaint}\n", broken.text)))
        .collect();
    assert!(complaints.is_empty(), "{} wrong:\n{}", complaints.len(), complaints.join("\n"));
}
