//! Help, lists, `check`, `demo` and `verify`, as a user calls them.

mod common;

use common::{Folder, SPEC, walk_folder};

#[test]
fn help_of_every_command_has_an_example_and_succeeds() {
    let folder = Folder::new();
    assert!(folder.run(&["--help"]).good().out.contains("Example"));
    for command in ["track", "compare", "check", "demo", "simulate", "verify", "list"] {
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
        &["compare"],
        &["compare", "m.csv", "-c", "spec.toml", "--write-spec", "s.toml"],
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
        ["estimators", "models", "sensors", "links", "schedulers", "channels", "motions"]
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

/// 200 instants of a target at 10 Hz, every fifth lost; instant 50 is half a second late, and one packet comes twice.
fn late_table() -> String {
    let mut rows: Vec<(f64, String)> = Vec::new();
    for k in (0..200).filter(|k| k % 5 != 4) {
        let (t, late) = (0.1 * f64::from(k), if k == 50 { 0.5 } else { 0.0 });
        let received = t + 0.02 + late;
        let row = |received: f64| (received, format!("{t:.1},T1,{:.3},{:.3},{k},{received:.2}\n", t.cos(), t.sin()));
        rows.push(row(received));
        if k == 100 {
            rows.push(row(received + 0.05));
        }
    }
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    rows.into_iter().fold("t,target,x,y,seq,received\n".to_owned(), |all, (_, row)| all + &row)
}

const POSITIONS: &str = "\
[model]
kind = \"random-walk\"
axes = 2
noise = 0.1

[sensor]
kind = \"position\"
sd = 0.5

[estimator]
kind = \"kalman\"
";

#[test]
fn check_tells_delays_repeats_and_disorder_as_text_and_json() {
    let folder = Folder::new();
    folder.write("m.csv", late_table());
    let text = folder.run(&["check", "m.csv"]).good().out;
    // t = 5.0 is received at 5.52, after t = 5.3 at 5.32; t = 5.4 is lost, and 5.5 comes at the same time.
    let delays = text.lines().find(|l| l.contains("0.520")).unwrap_or_else(|| panic!("{text}"));
    assert_eq!(
        delays.split_whitespace().collect::<Vec<_>>(),
        ["T1", "0.0200", "0.0200", "0.0200", "0.0200", "0.520", "1", "0.300", "0.3"]
    );
    assert!(text.contains("1 duplicate dropped, 1 out of order"), "{text}");
    assert!(!text.contains("theory"), "{text}");
    let json = folder.run(&["check", "m.csv", "--json"]).good().json();
    assert_eq!((&json["duplicates"], &json["out_of_order"]), (&1.into(), &1.into()));
    let late = &json["targets"][0]["late"];
    assert_eq!((&late["overtaken"], &late["needed_late_s"]), (&1.into(), &0.3.into()));
    assert!(json["theory"].is_null(), "{json}");
}

#[test]
fn check_with_a_spec_says_what_theory_promises_or_why_nothing() {
    let folder = Folder::new();
    folder.write("m.csv", late_table()).write("p.toml", POSITIONS);
    let json = folder.run(&["check", "m.csv", "-c", "p.toml", "--json"]).good().json();
    let theory = &json["theory"];
    // The last loss is never noticed: 160 of 199.
    assert!((theory["arrival"].as_f64().expect("a rate") - 160.0 / 199.0).abs() < 1e-12, "{theory}");
    assert_eq!((&theory["arrival_by"], &theory["error"]), (&"measured by sequence numbers".into(), &"bounded".into()));
    // λx² − w x − w r = 0 with w = 0.1·0.1 and r = 0.25.
    let sd = |name: &str| theory["states"][0]["predicted_sd"][name].as_f64().expect("a bound");
    for (name, arrival) in [("lossless", 1.0), ("upper", 160.0 / 199.0)] {
        let expected = ((0.01 + f64::sqrt(0.0001 + 4.0 * arrival * 0.0025)) / (2.0 * arrival)).sqrt();
        // The interval is a median of differences of decimal numbers, the bound itself good to 1e-9.
        assert!((sd(name) / expected - 1.0).abs() < 1e-8, "{name}: {}, expected {expected}", sd(name));
    }
    folder.write("p.toml", format!("{POSITIONS}\n[link]\narrival = 0.5\n"));
    let text = folder.run(&["check", "m.csv", "-c", "p.toml"]).good().out;
    assert!(
        text.contains("theory, when 50 % of the packets arrive (by `link.arrival`), an instant every 0.1 s:"),
        "{text}"
    );
    assert!(text.contains("any arrival rate above 0"), "{text}");
    let ranges = walk_folder();
    let text = ranges.run(&["check", "m.csv", "-c", "spec.toml"]).good().out;
    assert!(text.contains("Theory bounds no error of this spec: values of kind `range` are not linear"), "{text}");
    let json = ranges.run(&["check", "m.csv", "-c", "spec.toml", "--json"]).good().json();
    assert!(json["theory"]["not_defined_because"].as_str().is_some_and(|w| w.contains("range")), "{json}");
}

#[test]
fn report_has_a_link_section_with_theory_and_late_packets() {
    let folder = Folder::new();
    folder.write("m.csv", late_table()).write("p.toml", format!("{POSITIONS}\n[link]\nlate_s = 0.1\n"));
    folder.run(&["track", "m.csv", "-c", "p.toml", "-o", "t.csv", "--report", "r.html"]).good();
    let page = folder.text("r.html");
    for part in [
        "<h2>Link</h2>",
        "1 packet came too late to be used, the first of T1",
        "Theory, when 80.4 % of the packets arrive",
    ] {
        assert!(page.contains(part), "{part}");
    }
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
