//! `fixtrail compare` from end to end.

mod common;

use common::{Folder, walk_folder, walk_folder_with_truth};
use serde_json::Value;

const LINEAR: &str = "[model]\nkind = \"linear\"\nA = [[1.0, 1.0], [0.0, 1.0]]\nC = [[1.0, 0.0]]\nQ = [[0.01, 0.0], [0.0, 0.01]]\nR = [[1.0]]\n";
const HELD: &str = "x0 = [0.0, 0.0]\nP0 = [[1.0, 0.0], [0.0, 1.0]]\n[link]\nstamped = false\narrival = 0.9\n";

/// The walk with its truth.
fn with_truth() -> Folder {
    walk_folder_with_truth(115)
}

/// A row of a linear run, seen from a wave that its model follows.
fn linear_folder(spec: &str) -> Folder {
    let folder = Folder::new();
    let rows: String = (0..300)
        .filter(|k| k % 7 != 3)
        .map(|k| format!("{k},{}\n", 20.0 * (f64::from(k) / 15.0).sin() + (f64::from(k) * 1.7).sin()))
        .collect();
    folder.write("m.csv", format!("k,z1\n{rows}")).write("spec.toml", spec);
    folder
}

fn names(json: &Value) -> Vec<&str> {
    json["estimators"].as_array().expect("a list").iter().map(|e| e["name"].as_str().expect("a name")).collect()
}

fn entry<'a>(json: &'a Value, name: &str) -> &'a Value {
    json["estimators"].as_array().expect("a list").iter().find(|e| e["name"] == name).expect("the estimator")
}

#[test]
fn errors_are_those_of_track_and_the_best_is_marked() {
    let folder = with_truth();
    let list = "ekf,fms:window=12,lag=4,rts,fixed-lag-kalman:lag=3";
    let arguments = ["compare", "-c", "spec.toml", "m.csv", "--truth", "truth.csv", "--estimators", list];
    let json = folder.run(&[&arguments[..], &["--json", "--report", "r.html"]].concat()).good().json();
    assert_eq!(
        names(&json),
        ["ekf", "fms:window=12,lag=4", "fms:window=12,lag=4, smoothed", "rts", "fixed-lag-kalman:lag=3"]
    );
    // Each as `track` judges the same estimator.
    for (name, lines, key) in [
        ("ekf", "kind = \"ekf\"", "truth"),
        ("rts", "kind = \"rts\"", "truth"),
        ("fixed-lag-kalman:lag=3", "kind = \"fixed-lag-kalman\"\nlag = 3", "truth"),
        ("fms:window=12,lag=4", "kind = \"fms\"\nwindow = 12\nlag = 4", "truth"),
        ("fms:window=12,lag=4, smoothed", "kind = \"fms\"\nwindow = 12\nlag = 4", "truth_smoothed"),
    ] {
        folder.write("one.toml", common::SPEC.replace("kind = \"ekf\"", lines));
        let mut track = vec!["track", "-c", "one.toml", "m.csv", "-o", "t.csv", "--truth", "truth.csv", "--json"];
        if key == "truth_smoothed" {
            track.extend(["--lagged", "both"]);
        }
        let tracked = folder.run(&track).good().json();
        for figure in ["rmse_m", "p90_m", "coverage95", "mean_nees", "verdict", "instants"] {
            assert_eq!(entry(&json, name)[figure], tracked[key]["overall"][figure], "{name} {figure}");
        }
    }
    let later: Vec<bool> = ["ekf", "fms:window=12,lag=4, smoothed", "rts", "fixed-lag-kalman:lag=3"]
        .map(|name| entry(&json, name)["uses_later_data"].as_bool().expect("a flag"))
        .to_vec();
    assert_eq!(later, [false, true, true, true]);
    // A smoother of the whole run beats its filter by far, and so the comparison names two that are best.
    let order = json["ranking"]["order"].as_array().expect("a list");
    let best = order[0].as_str().expect("a name");
    assert!(entry(&json, best)["uses_later_data"] == true && entry(&json, best)["best"] == true, "{best}");
    let causal = json["ranking_without_later_data"]["order"][0].as_str().expect("a name");
    assert!(entry(&json, causal)["best"] == true && entry(&json, causal)["uses_later_data"] == false);
    let rmse = |name: &str| entry(&json, name)["rmse_m"].as_f64().expect("an error");
    assert!(names(&json).iter().all(|name| rmse(best) <= rmse(name)));

    let text = folder.run(&arguments).good().out;
    for part in ["RMSE/m", "in 95 %", "µs/instant", "rts (uses later data)", " *", "best: ", "blocks of 10 s"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(text.contains("best of those that use no later data: "), "{text}");
    let report = folder.text("r.html");
    for part in
        ["Error over time", "How large errors are", "Plan", "uses later data", ">best<", "fixed-lag-kalman:lag=3"]
    {
        assert!(report.contains(part), "{part}");
    }
}

#[test]
fn without_truth_smoothers_are_judged_by_their_filters() {
    let folder = walk_folder();
    let arguments =
        ["compare", "-c", "spec.toml", "m.csv", "--estimators", "rts,ekf,fixed-lag-kalman:lag=3,fms:window=3"];
    let json = folder.run(&[&arguments[..], &["--json", "--report", "r.html"]].concat()).good().json();
    // The same filter three times over: not a bit better for what came later.
    let figures = |name: &str| {
        let e = entry(&json, name);
        ["score", "mean_nis", "values", "not_foretold", "innovations"].map(|key| e[key].clone())
    };
    assert_eq!(figures("rts"), figures("ekf"));
    assert_eq!(figures("fixed-lag-kalman:lag=3"), figures("ekf"));
    assert_eq!(entry(&json, "rts")["filter_of_a_smoother"], true);
    let score = |name: &str| entry(&json, name)["score"].as_f64().expect("a score");
    // Three instants of four ranges make a worse estimate than all of them.
    assert!(score("ekf") > score("fms:window=3"), "{json}");
    let e = entry(&json, "ekf");
    // Sensors err by 0.035 m, and the walk turns as its model would not expect: more than that, less than the sensor's 0.1 m.
    let rms = e["innovations"]["range"]["rms"].as_f64().expect("metres");
    assert!(rms > 0.035 && rms < 0.15, "{rms}");
    assert!(e["not_foretold"].as_u64() > Some(2) && e["values"].as_u64() > Some(700), "{e}");
    let text = folder.run(&arguments).good().out;
    for part in ["score", "RMS range/m", "ν²/S", "rts (its filter alone)", "not foretold", "exactly as good"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    let report = folder.text("r.html");
    for part in ["Score over time", "its filter alone", "median range [m]", "not foretold"] {
        assert!(report.contains(part), "{part}");
    }
    assert!(!report.contains("Error over time"));
}

#[test]
fn without_a_list_what_suits_is_compared() {
    let folder = with_truth();
    let all = folder.run(&["compare", "-c", "spec.toml", "m.csv", "--truth", "truth.csv", "--json"]).good().json();
    // 40 values for four components, of nearly four ranges at an instant.
    assert_eq!(
        names(&all),
        ["ekf", "imm", "fms:window=11,lag=2", "fms:window=11,lag=2, smoothed", "fixed-lag-kalman:lag=2", "rts"]
    );
    let proposed = folder.run(&["compare", "m.csv", "--json", "--write-spec", "mine.toml"]).good();
    assert!(proposed.err.contains("no spec given"), "{proposed:?}");
    let json = proposed.json();
    assert!(json["proposed_spec"].as_str() == Some(&folder.text("mine.toml")) && json["measured_by"] == "prediction");

    let folder = linear_folder(LINEAR);
    let json = folder.run(&["compare", "-c", "spec.toml", "m.csv", "--json"]).good().json();
    assert_eq!(names(&json), ["kalman", "fms:window=20", "ufir:window=20"]);
    let text = folder.run(&["compare", "-c", "spec.toml", "m.csv", "--estimators", "kalman,ufir:window=40"]).good().out;
    assert!(text.contains("best: kalman") && text.contains(" instants)") && !text.contains("RMS linear/"), "{text}");
    // Of one there is nothing to say but how good it is.
    let text = folder.run(&["compare", "-c", "spec.toml", "m.csv", "--estimators", "kalman"]).good().out;
    assert!(text.contains("there is no other to compare with"), "{text}");
}

#[test]
fn bad_comparisons_are_one_sentence_with_exit_code_2_and_nothing_left_behind() {
    const WALK: &[&str] = &["-c", "spec.toml", "m.csv"];
    let cases: &[(&[&str], &[&str])] = &[
        (&["--estimators", "ekf,kalmann"], &["--estimators kalmann", "estimator.kind", "did you mean `kalman`"]),
        (&["--estimators", "ekf,kalman"], &["--estimators kalman", "linear models and sensors", "`ekf`"]),
        (&["--estimators", "ekf,ufir:window=9"], &["--estimators ufir:window=9", "linear"]),
        (&["--estimators", "ekf,lmmse"], &["--estimators lmmse", "stamped = false"]),
        (&["--estimators", "ekf,fms"], &["--estimators fms", "estimator.window", "is missing"]),
        (&["--estimators", "fms:window=9,lag=9"], &["estimator.lag", "is 9", "8"]),
        (&["--estimators", "fms:windw=9"], &["estimator.windw", "`window`"]),
        (&["--estimators", "ekf,rts,ekf"], &["--estimators ekf,rts,ekf", "`ekf` twice"]),
        (&["--estimators", ""], &["estimator.kind"]),
        (&["--truth", "others.csv"], &["others.csv", "no target in common", "`T9`"]),
        (&["--truth", "late.csv"], &["late.csv", "no instant"]),
        (&["--truth", "gone.csv"], &["gone.csv"]),
        (&["--truth", "empty.csv"], &["empty.csv", "is empty"]),
        (&["--report", "gone/r.html"], &["gone/r.html", "`gone`"]),
        (&["--report", "m.csv"], &["m.csv", "overwrite"]),
        (&["--report", "truth.csv", "--truth", "truth.csv"], &["truth.csv", "overwrite"]),
        (&["--report", "/dev/full"], &["/dev/full", "space"]),
    ];
    let folder = with_truth();
    folder.write("empty.csv", "").write("others.csv", "t,target,x,y\n1,T9,0,0\n");
    folder.write("late.csv", "t,target,x,y\n-5,T1,0,0\n");
    let before = folder.names();
    let check = |folder: &Folder, arguments: &[&str], says: &[&str]| {
        let ran = folder.run(&[&["compare"], arguments].concat());
        assert_eq!(ran.code, Some(2), "{arguments:?}: {ran:?}");
        let errors: Vec<&str> = ran.err.lines().filter(|l| l.starts_with("error: ")).collect();
        assert!(errors.len() == 1 && ran.out.is_empty() && !ran.err.contains("panicked"), "{arguments:?}: {ran:?}");
        for what in says {
            assert!(errors[0].contains(what), "{arguments:?}: {} does not say {what:?}", errors[0]);
        }
    };
    for (arguments, says) in cases {
        check(&folder, &[WALK, arguments].concat(), says);
    }
    check(&folder, &["-c", "spec.toml", "empty.csv"], &["empty.csv", "is empty"]);
    check(&folder, &["-c", "spec.toml", "gone.csv"], &["gone.csv"]);
    folder.write("one.csv", "t,target,kind,anchor,value\n1,T1,range,A0,3\n");
    check(&folder, &["-c", "spec.toml", "one.csv"], &["one.csv", "no measurement after"]);
    std::fs::remove_file(folder.path("one.csv")).expect("a file");
    assert_eq!(folder.names(), before);

    let linear = linear_folder(LINEAR);
    linear.write("truth.csv", "t,x,y\n1,0,0\n");
    check(&linear, &["-c", "spec.toml", "m.csv", "--truth", "truth.csv"], &["model.kind", "positions"]);
    let held = linear_folder(&format!("{LINEAR}{HELD}"));
    check(&held, &["-c", "spec.toml", "m.csv"], &["spec.toml", "link.stamped", "--truth"]);
}
