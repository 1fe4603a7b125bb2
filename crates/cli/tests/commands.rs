//! Help, lists, `check`, `demo` and `verify`, as a user calls them.

mod common;

use common::{Folder, SPEC, walk_folder};

#[test]
fn help_of_every_command_has_an_example_and_succeeds() {
    let folder = Folder::new();
    assert!(folder.run(&["--help"]).good().out.contains("Example"));
    for command in ["track", "check", "demo", "verify", "list"] {
        let ran = folder.run(&[command, "--help"]).good();
        assert!(ran.out.contains(&format!("fixtrail {command}")), "{command}: {}", ran.out);
        assert!(ran.out.contains("Example"), "{command}: {}", ran.out);
    }
    assert!(folder.run(&["--version"]).good().out.starts_with("fixtrail "));
}

#[test]
fn bad_usage_is_exit_code_2_with_a_message() {
    let folder = walk_folder();
    let cases: &[&[&str]] = &[
        &[],
        &["fly"],
        &["track"],
        &["track", "m.csv"],
        &["track", "m.csv", "-o", "t.csv", "--lagged", "maybe"],
        &["track", "m.csv", "-o", "t.csv", "--threads", "0"],
        &["track", "m.csv", "-o", "t.csv", "-c", "spec.toml", "--write-spec", "s.toml"],
        &["list", "wishes"],
        &["verify"],
        &["demo", "--seed", "-1"],
    ];
    for arguments in cases {
        let ran = folder.run(arguments);
        assert_eq!(ran.code, Some(2), "{arguments:?}: {ran:?}");
        assert!(!ran.err.is_empty() && ran.out.is_empty(), "{arguments:?}: {ran:?}");
    }
    assert_eq!(folder.names(), ["anchors.csv", "m.csv", "spec.toml"]);
}

#[test]
fn list_prints_the_same_names_as_text_and_json() {
    let folder = Folder::new();
    let (text, json) = (folder.run(&["list"]).good().out, folder.run(&["list", "--json"]).good().json());
    let lists = json.as_object().expect("an object");
    assert_eq!(
        lists.keys().collect::<Vec<_>>(),
        ["estimators", "models", "sensors", "links", "schedulers", "channels"]
    );
    for entry in lists.values().flat_map(|l| l.as_array().expect("a list")) {
        let name = entry["name"].as_str().expect("a name");
        assert!(text.lines().any(|l| l.trim_start().starts_with(name)), "{name}");
    }
    let one = folder.run(&["list", "sensors", "--json"]).good().json();
    assert_eq!(one, serde_json::json!({ "sensors": lists["sensors"] }));
}

#[test]
fn check_finds_what_is_there_and_its_spec_tracks() {
    let folder = walk_folder();
    let json = folder.run(&["check", "m.csv", "--json", "--write-spec", "proposed.toml"]).good().json();
    assert_eq!(json["targets"].as_array().expect("targets").len(), 2);
    // 120 instants × 2 tags × 4 anchors less those with (i + j) % 11 = 3.
    let kept = (0..120).flat_map(|i| (0..4).map(move |j| (i + j) % 11)).filter(|r| *r != 3).count() as u64 * 2;
    assert_eq!(json["kinds"][0]["rows"], kept);
    // Every eleventh report of each anchor, those at the ends unseen.
    let rate = json["loss"]["rate"].as_f64().expect("a rate");
    assert!((rate - 1.0 / 11.0).abs() < 0.01, "{rate}");
    assert_eq!(json["proposed_spec"].as_str().expect("a spec"), folder.text("proposed.toml"));
    folder.run(&["check", "m.csv", "-c", "proposed.toml"]).good();
    folder.run(&["track", "-c", "proposed.toml", "m.csv", "-o", "by_spec.csv"]).good();
    let ran = folder.run(&["track", "m.csv", "-o", "without.csv"]).good();
    assert!(ran.err.contains("no spec given"), "{ran:?}");
    assert_eq!(folder.read("by_spec.csv"), folder.read("without.csv"));
}

#[test]
fn check_counts_rows_that_a_spec_leaves_out_and_refuses_one_that_does_not_fit() {
    let folder = walk_folder();
    let mut table = folder.text("m.csv");
    table += "1.0,T1,rssi,A0,-60\n2.0,T1,rssi,A0,-61\n";
    folder.write("m.csv", table);
    let json = folder.run(&["check", "m.csv", "-c", "spec.toml", "--json"]).good().json();
    assert_eq!(json["unused_kinds"], serde_json::json!({ "rssi": 2 }));
    folder.write("biased.toml", SPEC.replace("sd = 0.1", "sd = 0.1\nbias = { A9 = 0.2 }"));
    let ran = folder.run(&["check", "m.csv", "-c", "biased.toml"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("biased.toml") && ran.err.contains("A9"), "{ran:?}");
}

#[test]
fn demo_leaves_a_report_and_data_that_track_replays() {
    let folder = Folder::new();
    let ran = folder.run(&["demo", "--seed", "3", "-o", "walk"]).good();
    for name in ["ekf", "fms", "rts", "fixed-lag-kalman", "the true position is inside", "coverage"] {
        assert!(ran.out.contains(name), "{name}: {}", ran.out);
    }
    let page = folder.text("walk/report.html");
    assert!(page.starts_with("<!DOCTYPE html>") && page.contains("Seed 3"));
    let replay = [
        "track",
        "-c",
        "walk/spec.toml",
        "walk/measurements.csv",
        "-o",
        "t.csv",
        "--truth",
        "walk/truth.csv",
        "--json",
    ];
    let json = folder.run(&replay).good().json();
    let demo = folder.run(&["demo", "--seed", "3", "-o", "again", "--json"]).good().json();
    assert_eq!(json["truth"]["overall"]["rmse_m"], demo["estimators"][0]["rmse_m"]);
    // The walk is 12 × 20 m; an estimator that works errs by less than a metre.
    assert!(json["truth"]["overall"]["rmse_m"].as_f64().expect("an error") < 1.0);
    for file in ["report.html", "measurements.csv", "anchors.csv", "truth.csv", "spec.toml"] {
        assert_eq!(folder.read(&format!("walk/{file}")), folder.read(&format!("again/{file}")), "{file}");
    }
    folder.run(&["demo", "--seed", "4", "-o", "other"]).good();
    assert_ne!(folder.read("walk/measurements.csv"), folder.read("other/measurements.csv"));
}

#[test]
fn verify_tells_a_failure_from_a_file_it_does_not_understand() {
    // Conformance vectors lie beside the crates.
    let vectors = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../golden/fms/01_paper_model.json");
    let folder = Folder::new();
    folder.write("unknown.json", r#"{"format": "horoscope-1"}"#).write("broken.json", "{");
    for name in ["unknown.json", "broken.json", "absent.json"] {
        let ran = folder.run(&["verify", name]);
        assert_eq!(ran.code, Some(2), "{ran:?}");
        assert!(ran.err.starts_with("error: ") && ran.err.contains(name), "{ran:?}");
    }
    let vectors = vectors.to_str().expect("a name");
    let json = folder.run(&["verify", vectors, "--json"]).good().json();
    assert_eq!(json["passed"], true);
    assert!(!json["files"][0]["quantities"].as_array().expect("quantities").is_empty());
    // A true file beside one that is not understood is still run, and the exit code still says 2.
    let ran = folder.run(&["verify", vectors, "unknown.json"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.out.contains("01_paper_model.json"), "{ran:?}");
    // One estimate moved by 1 %, far beyond the file's tolerance.
    let text = std::fs::read_to_string(vectors).expect("vectors");
    let mut value: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let entry = &mut value["expected"]["estimates"]["xhat_filter"][3][0];
    *entry = (1.01 * entry.as_f64().expect("a number")).into();
    folder.write("wrong.json", value.to_string());
    let ran = folder.run(&["verify", "wrong.json"]);
    assert_eq!(ran.code, Some(1), "{ran:?}");
    assert!(ran.out.contains("FAILED"), "{ran:?}");
}
