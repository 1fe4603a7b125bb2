//! `fixtrail simulate` with scheduled sensors, as a user calls it.

mod common;

use common::Folder;
use serde_json::Value;

const SCENARIO: &str = "\
[scenario]
runs = 6
start = \"mean\"
noise = false
[model]
kind = \"coordinated-turn\"
noise = 0.0
turn_noise = { per_step = 0.002 }
x0 = [30, 70, 20, 20, -1]
P0 = [[0.2,0,0,0,0],[0,0.2,0,0,0],[0,0,0.2,0,0],[0,0,0,0.2,0],[0,0,0,0,0.2]]
[[sensor]]
kind = \"range\"
sd = 0.03
[field]
size_m = [100, 100]
sensors = 20
[channel]
kind = \"bernoulli\"
loss_rate = 0.1
[schedule]
kind = \"idgss\"
intervals_s = [0.1, 0.2, 0.5]
enough = 0.5
duration_s = 3
[[contender]]
name = \"told\"
estimator = { kind = \"ekf\" }
[[contender]]
name = \"nearest\"
estimator = { kind = \"ekf\" }
schedule = { kind = \"nearest\", interval_s = 0.1 }
[[contender]]
name = \"held\"
estimator = { kind = \"emvf\" }
link = { stamped = false }
";

fn scenario() -> Folder {
    let folder = Folder::new();
    folder.write("s.toml", SCENARIO);
    folder
}

fn of(json: &Value, name: &str, key: &str) -> f64 {
    let all = json["channels"][0]["contenders"].as_array().expect("contenders");
    let one = all.iter().find(|c| c["name"] == name).unwrap_or_else(|| panic!("{name}"));
    one[key]["mean"].as_f64().unwrap_or_else(|| panic!("{name} {key}"))
}

#[test]
fn scheduled_sensors_have_energy_and_steps_on_any_number_of_threads() {
    let folder = scenario();
    let run = |threads: &str| {
        let results = format!("{threads}.csv");
        folder.run(&["simulate", "-c", "s.toml", "--json", "--threads", threads, "--results", &results]).good()
    };
    let (one, two) = (run("1"), run("2"));
    assert_eq!(one.out, two.out);
    assert!(folder.read("1.csv") == folder.read("2.csv"));
    let json = one.json();
    // 3 s at 0.1 s are 30 decisions, each of which pays for sensing, taking over and handing over.
    assert_eq!(of(&json, "nearest", "time_steps"), 30.0);
    let energy_mj = of(&json, "nearest", "energy_mj");
    assert!((30.0 * 0.2355..30.0 * 0.45).contains(&energy_mj), "{energy_mj}");
    // Longer intervals are cheaper; what does not know of losses claims more and asks more often.
    assert!(of(&json, "told", "energy_mj") < energy_mj);
    assert!(of(&json, "told", "time_steps") < of(&json, "held", "time_steps"));
}

#[test]
fn a_scheduled_run_is_written_and_can_be_tracked() {
    let folder = scenario();
    folder.run(&["simulate", "-c", "s.toml", "-o", "run"]).good();
    let rows = |name: &str| folder.text(name).lines().count() - 1;
    let (measured, instants) = (rows("run/measurements.csv"), rows("run/truth.csv") - 1);
    assert!(measured > 3 && measured <= instants, "{measured} of {instants}");
    let spec = SCENARIO
        .split("[field]")
        .next()
        .unwrap()
        .replace("[scenario]\nruns = 6\nstart = \"mean\"\nnoise = false\n", "");
    folder.write("spec.toml", spec);
    let track =
        ["track", "-c", "spec.toml", "run/measurements.csv", "-o", "t.csv", "--truth", "run/truth.csv", "--json"];
    let json = folder.run(&track).good().json();
    assert!(json["truth"]["overall"]["rmse_m"].as_f64().expect("a number").is_finite());
}

#[test]
fn schedules_that_cannot_be_run_end_in_one_sentence_and_exit_code_2() {
    let change = |from: &str, to: &str| {
        assert!(SCENARIO.contains(from), "{from}");
        SCENARIO.replacen(from, to, 1)
    };
    let without_contenders = SCENARIO.split("[[contender]]").next().unwrap().to_owned();
    let cases: Vec<(String, &[&str], &[&str])> = vec![
        (change("enough = 0.5", "enough = 0.5\ngroup = 21"), &[], &["schedule.group", "is 21", "from 1 to 20"]),
        (change("enough = 0.5", "enough = 0.5\nrange_m = 0.001"), &[], &["schedule.range_m", "out of range", "6 runs"]),
        (
            change("estimator = { kind = \"ekf\" }", "estimator = { kind = \"rts\" }"),
            &[],
            &["estimator.kind", "`ekf`, `emvf` or `lmmse`"],
        ),
        (
            change("link = { stamped = false }", "link = { stamped = false, arrival = [0.9, 0.8] }"),
            &[],
            &["link.arrival", "one number"],
        ),
        (without_contenders, &["-o", "run"], &["contender", "is missing"]),
    ];
    for (text, more, parts) in cases {
        let folder = Folder::new();
        folder.write("s.toml", &text);
        let ran = folder.run(&[&["simulate", "-c", "s.toml"], more].concat());
        assert_eq!(ran.code, Some(2), "{}", ran.err);
        for part in parts {
            assert!(ran.err.contains(part), "{}, expected {part}", ran.err);
        }
        assert_eq!(ran.err.trim_end().lines().count(), 1, "{}", ran.err);
    }
}
