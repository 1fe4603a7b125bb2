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
    for (threads, results, report) in [("1", "a.parquet", "a.html"), ("2", "b.parquet", "b.html")] {
        run(&["--threads", threads, "--runs", "150", "--results", results, "--report", report]);
    }
    let bytes = |name: &str| folder.read(name);
    assert!(bytes("a.parquet") == bytes("b.parquet") && bytes("a.html") == bytes("b.html"));
}

#[test]
fn results_have_a_row_for_each_run_and_contender_that_adds_up_to_the_summary() {
    let folder = scenario();
    let json = folder.run(&["simulate", "-c", "s.toml", "--json", "--results", "runs.csv"]).good().json();
    let text = folder.text("runs.csv");
    let mut lines = text.lines().map(|l| l.split(',').map(str::to_owned).collect::<Vec<_>>());
    let header = lines.next().expect("a header");
    let at = |name: &str| header.iter().position(|h| h == name).unwrap_or_else(|| panic!("{name} in {header:?}"));
    let rows: Vec<Vec<String>> = lines.collect();
    assert_eq!(rows.len(), 2 * 30 * 2);
    for (rate, channel) in [("0.0", 0), ("0.4", 1)] {
        for (i, name) in ["lmmse", "told"].iter().enumerate() {
            let of_it = rows.iter().filter(|r| r[at("loss_rate")] == rate && r[at("contender")] == *name);
            let (mut mse, mut nees, mut runs) = (0.0, 0.0, Vec::new());
            for row in of_it {
                let value = |name: &str| row[at(name)].parse::<f64>().expect("a number");
                assert!((value("rmse").powi(2) / value("mse") - 1.0).abs() < 1e-12);
                mse += value("mse") / 30.0;
                nees += value("nees") / 30.0;
                runs.push(value("run") as usize);
            }
            let summary = &json["channels"][channel]["contenders"][i];
            let mean = |key: &str| summary[key]["mean"].as_f64().expect("a number");
            // Sums in another order.
            assert!((mse / mean("mse") - 1.0).abs() < 1e-12 && (nees / mean("anees") - 1.0).abs() < 1e-12, "{name}");
            assert_eq!(runs, (0..30).collect::<Vec<_>>());
        }
    }
    folder.run(&["simulate", "-c", "s.toml", "--runs", "2", "--results", "runs.ndjson"]).good();
    let first = folder.text("runs.ndjson").lines().next().expect("a line").to_owned();
    let first: serde_json::Value = serde_json::from_str(&first).expect("JSON");
    assert_eq!((&first["run"], &first["contender"], &first["energy_mj"]), (&0.into(), &"lmmse".into(), &().into()));
    folder.run(&["simulate", "-c", "s.toml", "--runs", "2", "--results", "runs.parquet"]).good();
    let file = std::fs::File::open(folder.path("runs.parquet")).expect("a file");
    let reader = parquet::file::reader::SerializedFileReader::new(file).expect("Parquet");
    use parquet::file::reader::FileReader;
    assert_eq!(reader.metadata().file_metadata().num_rows(), 8);
}

#[test]
fn the_report_stands_alone_and_has_bound_verdicts_and_charts() {
    let folder = scenario();
    folder.run(&["simulate", "-c", "s.toml", "--report", "r.html"]).good();
    let page = folder.text("r.html");
    for piece in
        ["told", "Cramér–Rao bound", "consistent", "Error over time", "What losses cost", "lag ∞", "chi-square"]
    {
        assert!(page.contains(piece), "{piece}");
    }
    let shown = page.split("<script>").next().expect("a page");
    assert!(!shown.contains("http") && !shown.contains("src=") && !shown.contains("href=") && !shown.contains("NaN"));
    // One against the loss rate, four for each channel, and the logo.
    assert_eq!(page.matches("<svg").count(), 10);
}

#[test]
fn a_table_fits_a_terminal_and_says_what_the_claims_are_worth() {
    let text = scenario().run(&["simulate", "-c", "s.toml"]).good().out;
    assert!(text.lines().all(|l| l.chars().count() <= 120), "{text}");
    for piece in ["RMSE", "95 % band", "ANIS/m", "Cramér–Rao bound", "lmmse: consistent", "lag ∞", "lost"] {
        assert!(text.contains(piece), "{piece} in {text}");
    }
}

#[test]
fn outputs_that_cannot_be_written_are_refused_before_the_run() {
    let folder = scenario();
    // A run of this length would take hours.
    folder.write("long.toml", SCENARIO.replace("runs = 30", "runs = 9000000"));
    for (arguments, says) in [
        (["--report", "gone/r.html"], ["gone/r.html", "the folder `gone` does not exist"]),
        (["--results", "gone/r.csv"], ["gone/r.csv", "the folder `gone` does not exist"]),
        (["--results", "r.xlsx"], ["r.xlsx", "`.csv`, `.parquet` or `.ndjson`"]),
        (["--results", "r.geojson"], ["r.geojson", "`.csv`, `.parquet` or `.ndjson`"]),
        (["--report", "long.toml"], ["long.toml", "would overwrite the scenario"]),
        (["--runs", "0"], ["0", "--runs"]),
    ] {
        let ran = folder.run(&[&["simulate", "-c", "long.toml"][..], &arguments].concat());
        assert_eq!(ran.code, Some(2), "{ran:?}");
        assert!(says.iter().all(|piece| ran.err.contains(piece)) && ran.out.is_empty(), "{ran:?}");
    }
    let both = folder.run(&["simulate", "-c", "long.toml", "--results", "a.csv", "--report", "a.csv"]);
    assert!(both.code == Some(2) && both.err.contains("is both the results and the report"), "{both:?}");
    let none = folder.run(&["simulate", "-c", "turn.toml", "--report", "r.html"]);
    assert!(none.code == Some(2) && none.err.contains("`contender`: is missing"), "{none:?}");
    assert_eq!(folder.names(), ["long.toml", "s.toml", "turn.toml"]);
}

#[test]
fn targets_move_as_the_motion_says() {
    let folder = Folder::new();
    let circle = "[motion]\nkind = \"circle\"\ncentre_m = [50, 50]\nradius_m = 10\nspeed_mps = 5\n";
    folder.write("c.toml", TURN.replace("[[sensor]]", &format!("{circle}[[sensor]]")));
    folder.run(&["simulate", "-c", "c.toml", "-o", "out"]).good();
    let truth = folder.text("out/truth.csv");
    for line in truth.lines().skip(1) {
        let cells: Vec<f64> = line.split(',').filter_map(|c| c.parse().ok()).collect();
        let [t, x, y] = cells[..] else { panic!("{line}") };
        assert!(((x - 50.0).hypot(y - 50.0) - 10.0).abs() < 1e-9);
        assert!((x - 50.0 - 10.0 * (0.5 * t).cos()).abs() < 1e-9, "{line}");
    }
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
    let motion = |motion: &str| TURN.replacen("[[sensor]]", &format!("[motion]\n{motion}\n[[sensor]]"), 1);
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
        (change("steps = 60", "steps = 0"), &["s.toml:3", "scenario.steps", "is 0", "from 1"]),
        (change("steps = 60", "steps = 60\nlost_m = 0"), &["scenario.lost_m", "is 0", "positive distance"]),
        (
            change("[[contender]]", "duplication = 1.5\n[[contender]]"),
            &["channel.duplication", "is 1.5", "from 0 to 1"],
        ),
        (
            change("[[contender]]", "delays = [0.5, 1.5]\n[[contender]]"),
            &["channel.delays[1]", "is 1.5", "from 0 to 1"],
        ),
        (change("stamped = false", "stamped = false, arrival = 1.2"), &["contender[0].link.arrival", "is 1.2"]),
        (change("name = \"told\"", "smoothed = true"), &["contender[1].smoothed", "`kalman`, which has no smoother"]),
        (
            change("estimator = { kind = \"kalman\" }", "estimator = { kind = \"rts\" }\nsmoothed = false"),
            &["contender[1].smoothed", "is false", "`kalman` or `ekf`"],
        ),
        (
            change("[channel]", "[motion]\nkind = \"circle\"\n[channel]"),
            &["motion.kind", "is \"circle\"", "linear model"],
        ),
        (motion("kind = \"circel\""), &["motion.kind", "did you mean `circle`?"]),
        (motion("centre_m = [0, 0]"), &["motion.kind", "is missing"]),
        (motion("kind = \"circle\"\ncentre_m = [0]"), &["motion.centre_m", "two coordinates"]),
        (motion("kind = \"circle\"\ncentre_m = [0, 0]\nradius_m = -1"), &["motion.radius_m", "is -1", "positive"]),
        (motion("kind = \"circle\"\nwalls = \"random\""), &["motion.walls", "not a key of a motion of kind `circle`"]),
        (motion("kind = \"constant-speed\""), &["motion.position_sd_m", "is missing"]),
        (motion("kind = \"acceleration\"\nacceleration_sd_mps2 = -0.4"), &["acceleration_sd_mps2", "is -0.4"]),
        (
            motion("kind = \"constant-speed\"\nposition_sd_m = 1\nvelocity_mps = [1]"),
            &["motion.velocity_mps", "2 numbers"],
        ),
        (
            motion("kind = \"bouncing\"\nspeed_mps = 1\narea_m = [20, 100]"),
            &["motion.area_m", "the start, [30.0, 70.0], inside"],
        ),
        (
            motion("kind = \"bouncing\"\nspeed_mps = 1\narea_m = [99, 99]\nwalls = \"soft\""),
            &["motion.walls", "`random`, `mirror`"],
        ),
        (
            motion("kind = \"profile\"\nshape = \"step\"\nacceleration_mps2 = [1, 0]\nfrom_s = 3\nuntil_s = 3"),
            &["motion.until_s", "is 3", "after `from_s`, 3"],
        ),
        (motion("kind = \"profile\"\nshape = \"wave\""), &["motion.shape", "`triangle`"]),
        (
            motion("kind = \"model\"").replace("steps = 20", "steps = 20\nnoise = 1"),
            &["scenario.noise", "true or false"],
        ),
        (
            motion("kind = \"acceleration\"\nacceleration_sd_mps2 = 1")
                .replace("steps = 20", "steps = 20\nnoise = false"),
            &["scenario.noise", "`[motion]`, which has its own"],
        ),
        (recording("kind = \"bernoulli\"\nloss_rate = 0.1\n[motion]\nkind = \"model\""), &["motion", "`[recording]`"]),
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
