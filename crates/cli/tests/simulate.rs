//! `fixtrail simulate`, as a user calls it.

mod common;

use common::{Folder, walk_folder};
use std::path::{Path, PathBuf};

const SCENARIO: &str = "\
[scenario]
runs = 30
steps = 60
[model]
kind = \"linear\"
A = [[0.9]]
C = [[1.0]]
Q = [[1.0]]
R = [[1.0]]
x0 = [0.0]
P0 = [[1.0]]
[channel]
kind = \"bernoulli\"
loss_rate = [0.0, 0.4]
[[contender]]
estimator = { kind = \"lmmse\" }
link = { stamped = false }
[[contender]]
name = \"told\"
estimator = { kind = \"kalman\" }
";

const TURN: &str = "\
[scenario]
steps = 20
interval_s = 0.1
[model]
kind = \"coordinated-turn\"
noise = 0.1
turn_noise = 0.02
x0 = [30, 70, 5, 5, -1]
P0 = [[1,0,0,0,0],[0,1,0,0,0],[0,0,1,0,0],[0,0,0,1,0],[0,0,0,0,0.1]]
[[sensor]]
kind = \"range\"
sd = 0.1
[field]
size_m = [100, 100]
sensors = 6
[channel]
kind = \"bernoulli\"
loss_rate = 0.2
";

fn scenario() -> Folder {
    let folder = Folder::new();
    folder.write("s.toml", SCENARIO).write("turn.toml", TURN);
    folder
}

#[test]
fn results_are_equal_bytes_for_equal_seeds_on_any_number_of_threads() {
    let folder = scenario();
    let run = |more: &[&str]| folder.run(&[&["simulate", "-c", "s.toml", "--json"], more].concat()).good().out;
    assert_eq!(run(&["--threads", "1"]), run(&["--threads", "3"]));
    assert_ne!(run(&[]), run(&["--seed", "2"]));
}

#[test]
fn without_losses_the_held_value_filter_is_the_kalman_filter() {
    let folder = scenario();
    let json = folder.run(&["simulate", "-c", "s.toml", "--json"]).good().json();
    let mse = |channel: usize, contender: usize| {
        json["channels"][channel]["contenders"][contender]["mse"]["mean"].as_f64().expect("a number")
    };
    // The same recursion in another order of operations.
    assert!((mse(0, 0) / mse(0, 1) - 1.0).abs() < 1e-9);
    assert!(mse(1, 0) > 1.01 * mse(1, 1));
    let text = folder.run(&["simulate", "-c", "s.toml", "--runs", "3"]).good().out;
    assert!(text.contains("loss rate 0.400") && text.contains("told") && text.contains("ANEES/n"), "{text}");
}

#[test]
fn what_is_written_can_be_tracked() {
    let folder = scenario();
    folder.run(&["simulate", "-c", "turn.toml", "-o", "turn"]).good();
    let spec = TURN.split("[field]").next().unwrap().replace("[scenario]\nsteps = 20\ninterval_s = 0.1\n", "");
    folder.write("spec.toml", format!("{spec}[link]\nlate_s = 1.0\n"));
    let json = folder
        .run(&[
            "track",
            "-c",
            "spec.toml",
            "turn/measurements.csv",
            "-o",
            "t.csv",
            "--truth",
            "turn/truth.csv",
            "--json",
        ])
        .good()
        .json();
    let rmse_m = json["truth"]["overall"]["rmse_m"].as_f64().expect("a number");
    // Six ranges of 0.1 m at most of twenty instants; without them the start's metre would grow to several.
    assert!(rmse_m < 0.5, "{rmse_m}");
    // What the receiver shows stands at every instant, what arrived does not.
    let rows = |name: &str| folder.text(name).lines().count() - 1;
    assert_eq!(rows("turn/held.csv"), 6 * 21);
    assert!(rows("turn/measurements.csv") < 6 * 20, "{}", rows("turn/measurements.csv"));

    folder.run(&["simulate", "-c", "s.toml", "-o", "linear"]).good();
    assert!(folder.text("linear/measurements.csv").starts_with("k,z1,seq,received\n1,"));
    assert!(folder.text("linear/held.csv").starts_with("k,z1\n0,"));
    assert_eq!(folder.text("linear/truth.csv").lines().count(), 62);
}

#[test]
fn a_recording_comes_through_a_channel_late_and_less() {
    let folder = walk_folder();
    folder.write("packets.csv", "link,received,delay,copies\na,1,0.5,1\na,0,,\na,1,0,2\na,1,0.05,1\n");
    folder.write(
        "r.toml",
        "[recording]\nmeasurements = \"m.csv\"\n[channel]\nkind = \"trace\"\nfile = \"packets.csv\"\nlink = \"a\"\n",
    );
    let json = folder.run(&["simulate", "-c", "r.toml", "-o", "out", "--json"]).good().json();
    assert_eq!((json["packets"].as_u64(), json["lost"].as_u64()), (Some(240), Some(60)));
    assert!(folder.text("out/measurements.csv").starts_with("t,target,kind,anchor,value,seq,received\n"));
    assert_eq!(folder.text("out/anchors.csv").lines().count(), 5);
    folder.write("late.toml", format!("{}[link]\nlate_s = 1.0\n", common::SPEC));
    folder.run(&["track", "-c", "late.toml", "out/measurements.csv", "-o", "t.csv"]).good();
    // A quarter of the instants of each tag is gone.
    assert_eq!(folder.text("t.csv").lines().count() - 1, 2 * 90);
}

#[test]
fn scenarios_of_the_examples_are_good() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../examples/scenarios");
    let names = std::fs::read_dir(&folder).expect("the folder of scenarios");
    for path in names.map(|entry| entry.expect("a file").path()) {
        let path: &Path = &path;
        let ran = Folder::new().run(&["simulate", "-c", &path.to_string_lossy(), "--runs", "1", "--json"]).good();
        assert!(ran.json()["channels"].as_array().is_some_and(|c| !c.is_empty()), "{}", path.display());
    }
}

#[test]
fn bad_scenarios_end_in_one_sentence_and_exit_code_2() {
    let change = |from: &str, to: &str| SCENARIO.replacen(from, to, 1);
    let turn = |from: &str, to: &str| TURN.replacen(from, to, 1);
    let recording = |channel: &str| format!("[recording]\nmeasurements = \"gone.csv\"\n[channel]\n{channel}\n");
    let cases: Vec<(String, &[&str])> = vec![
        (change("runs = 30", "runs = 0"), &["s.toml:2", "scenario.runs", "is 0", "from 1"]),
        (change("steps = 60\n", ""), &["scenario.steps", "is missing"]),
        (change("[0.0, 0.4]", "[0.0, 1.0]"), &["channel.loss_rate[1]", "is 1.0", "not including, 1"]),
        (change("[0.0, 0.4]", "-0.1"), &["channel.loss_rate", "is -0.1"]),
        (change("\"bernoulli\"", "\"gilbert-elliott\""), &["channel.mean_burst", "is missing"]),
        (change("\"bernoulli\"", "\"gilbert-elliott\"\nmean_burst = 0.5"), &["channel.mean_burst", "is 0.5"]),
        (change("\"bernoulli\"", "\"bernouli\""), &["channel.kind", "did you mean `bernoulli`?"]),
        (change("\"bernoulli\"", "\"random-delay\""), &["channel.kind", "`delays`"]),
        (change("[[contender]]", "delays = [0.5, 0.4]\n[[contender]]"), &["channel", "0.9"]),
        (change("[[contender]]", "delays = [1]\ndelay_s = [0, 1]\n[[contender]]"), &["channel.delay_s", "only one"]),
        (change("[[contender]]", "delay_s = [2, 1]\n[[contender]]"), &["channel.delay_s", "least"]),
        (change("[[contender]]", "shows = \"nothing\"\n[[contender]]"), &["channel.shows", "`last-received`"]),
        (change("x0 = [0.0]\nP0 = [[1.0]]\n", ""), &["model.x0", "is missing"]),
        (change("link = { stamped = false }", ""), &["contender[0].estimator.kind", "`stamped = false`"]),
        (change("name = \"told\"", "title = \"told\""), &["contender[1].title", "not a key of a contender"]),
        (change("name = \"told\"", "gate = 9"), &["contender[1].gate", "linear model"]),
        (change("name = \"told\"", "S0 = [[1, 0], [0, 1]]"), &["contender[1].S0", "size of the state"]),
        (change("A = [[0.9]]", "A = [[0.9, 0]]"), &["model.A", "1 × 2"]),
        (change("[scenario]", "[scenarios]"), &["scenarios", "did you mean `scenario`?"]),
        (turn("[field]\nsize_m = [100, 100]\nsensors = 6\n", ""), &["field", "is missing"]),
        (turn("sensors = 6", "sensors = 6\nnearest = 7"), &["field.nearest", "is 7", "from 1 to 6"]),
        (turn("[100, 100]", "[100]"), &["field.size_m", "two positive lengths"]),
        (TURN.to_owned(), &["contender", "is missing", "`-o DIR`"]),
        (recording("kind = \"bernoulli\"\nloss_rate = 0.1"), &["`-o DIR`"]),
        (recording("kind = \"bernoulli\"\nloss_rate = 0.1\n[model]\nkind = \"linear\""), &["model", "`[recording]`"]),
        ("[channel".to_owned(), &["s.toml:1", "no TOML"]),
    ];
    for (text, says) in cases {
        let folder = Folder::new();
        folder.write("s.toml", &text);
        let ran = folder.run(&["simulate", "-c", "s.toml"]);
        assert_eq!(ran.code, Some(2), "{text}\n{ran:?}");
        assert_eq!(ran.err.trim_end().lines().count(), 1, "{text}\n{ran:?}");
        for piece in says {
            assert!(ran.err.contains(piece), "{text}\nexpected {piece:?} in {}", ran.err);
        }
        assert!(ran.out.is_empty() && folder.names() == ["s.toml"], "{text}\n{ran:?}");
    }
    let folder = Folder::new();
    folder.write(
        "s.toml",
        SCENARIO.replacen("kind = \"bernoulli\"\nloss_rate = [0.0, 0.4]", "kind = \"trace\"\nfile = \"gone.csv\"", 1),
    );
    assert!(folder.run(&["simulate", "-c", "s.toml"]).err.contains("gone.csv"));
    folder.write("gone.csv", "link,received\na,1\n");
    folder.write("s.toml", folder.text("s.toml").replace("file = \"gone.csv\"", "file = \"gone.csv\"\nlink = \"b\""));
    let ran = folder.run(&["simulate", "-c", "s.toml"]);
    assert!(ran.code == Some(2) && ran.err.contains("no link `b`") && ran.err.contains("`a`"), "{ran:?}");
}
