//! Bad input never gives a wrong trail: one sentence that says where and what, exit code 2, nothing left behind.

mod common;

use common::{Folder, SPEC, walk};

/// One thing that is wrong.
struct Case {
    name: &'static str,
    /// Files that replace those of a good run.
    files: Vec<(&'static str, Vec<u8>)>,
    /// Arguments after `track`; `GOOD` when only files are wrong.
    arguments: &'static [&'static str],
    /// What the sentence must hold: the file, the place, the value.
    says: &'static [&'static str],
}

const GOOD: &[&str] = &["-c", "spec.toml", "m.csv", "-o", "t.csv"];
const WITH_TRUTH: &[&str] = &["-c", "spec.toml", "m.csv", "-o", "t.csv", "--truth", "truth.csv"];

fn case(name: &'static str, file: &'static str, content: impl Into<Vec<u8>>, says: &'static [&'static str]) -> Case {
    Case { name, files: vec![(file, content.into())], arguments: GOOD, says }
}

fn usage(name: &'static str, arguments: &'static [&'static str], says: &'static [&'static str]) -> Case {
    Case { name, files: Vec::new(), arguments, says }
}

/// The good spec with one line replaced.
fn spec(from: &str, to: &str) -> String {
    assert!(SPEC.contains(from), "{from}");
    SPEC.replace(from, to)
}

/// A linear spec with one line replaced; its table is `k.csv`.
fn linear(from: &str, to: &str) -> Vec<u8> {
    let good = "[model]\nkind = \"linear\"\nA = [[1.0, 1.0], [0.0, 1.0]]\nC = [[1.0, 0.0]]\nQ = [[0.1, 0.0], [0.0, 0.1]]\nR = [[1.0]]\n[estimator]\nkind = \"kalman\"\n";
    assert!(good.contains(from), "{from}");
    good.replace(from, to).into_bytes()
}

fn specs() -> Vec<Case> {
    let bad = |name, from: &str, to: &str, says| case(name, "spec.toml", spec(from, to), says);
    let linear_case = |name, from: &str, to: &str, says| case(name, "spec.toml", linear(from, to), says);
    let link = |name, estimator: &str, link: &str, says| {
        let estimator = if estimator.is_empty() { "ekf" } else { estimator };
        case(name, "spec.toml", format!("{}[link]\n{link}\n", spec("\"ekf\"", &format!("\"{estimator}\""))), says)
    };
    vec![
        bad("not TOML", "[model]", "[model", &["spec.toml:1"]),
        bad("unknown key", "axes = 2", "axis = 2", &["spec.toml", "axis", "axes"]),
        bad("unknown table", "[estimator]", "[estimators]", &["spec.toml", "estimators"]),
        bad("unknown model", "constant-velocity", "constant-speed", &["spec.toml", "model.kind", "constant-speed"]),
        bad("unknown estimator", "\"ekf\"", "\"ekff\"", &["spec.toml", "estimator.kind", "ekff", "`ekf`"]),
        bad("fosb on ranges", "\"ekf\"", "\"fosb\"", &["spec.toml", "fosb", "positions", "`sensor.kind`", "`ekf`"]),
        bad(
            "one mode",
            "\"ekf\"",
            "\"imm\"\n[[estimator.mode]]\nmean_s = 5",
            &["spec.toml:", "estimator.mode", "2 to 4 tables"],
        ),
        linear_case("modes of matrices", "\"kalman\"", "\"imm\"", &["spec.toml:", "estimator.kind", "kinematic"]),
        link(
            "modes without time stamps",
            "imm",
            "stamped = false",
            &["spec.toml:", "estimator.kind", "stamped = true"],
        ),
        bad("strengths without a law", "\"range\"", "\"rssi\"", &["spec.toml", "path_loss", "is missing"]),
        bad("no noise", "noise = 0.5\n", "", &["spec.toml", "noise"]),
        bad("negative noise", "noise = 0.5", "noise = -0.5", &["spec.toml", "model.noise", "-0.5"]),
        bad("NaN", "noise = 0.5", "noise = nan", &["spec.toml", "model.noise", "nan"]),
        bad("infinite", "sd = 0.1", "sd = inf", &["spec.toml", "sd", "inf"]),
        bad("zero sd", "sd = 0.1", "sd = 0", &["spec.toml", "sd", "0"]),
        bad("text for a number", "sd = 0.1", "sd = \"small\"", &["spec.toml", "sd", "small"]),
        bad("four axes", "axes = 2", "axes = 4", &["spec.toml", "model.axes", "4"]),
        bad("noise of another size", "noise = 0.5", "noise = [1, 2, 3]", &["spec.toml", "model.noise"]),
        bad("linear filter on ranges", "\"ekf\"", "\"kalman\"", &["spec.toml", "kalman", "range"]),
        bad("window of nothing", "\"ekf\"", "\"fms\"\nwindow = 0", &["spec.toml", "window", "0"]),
        bad("lag beyond window", "\"ekf\"", "\"fms\"\nwindow = 5\nlag = 9", &["spec.toml", "lag", "9"]),
        bad("bias of an unknown anchor", "sd = 0.1", "sd = 0.1\nbias = { A9 = 0.1 }", &["spec.toml", "A9"]),
        bad("column nobody knows", "[estimator]", "[columns]\ntt = \"time\"\n[estimator]", &["spec.toml", "tt"]),
        link("link with an unknown key", "", "late = 1", &["spec.toml:", "link.late"]),
        link("negative lateness", "", "late_s = -1", &["spec.toml:", "link.late_s", "-1"]),
        link(
            "lateness without time stamps",
            "",
            "stamped = false\nlate_s = 1",
            &["spec.toml:", "link.late_s", "stamped = true"],
        ),
        link("hold with time stamps", "", "hold = \"paper\"", &["spec.toml:", "link.hold", "stamped = false"]),
        link("unknown hold", "", "stamped = false\nhold = \"last\"", &["spec.toml:", "link.hold", "last-received"]),
        link("unknown duplicates", "", "duplicates = \"drop\"", &["spec.toml:", "link.duplicates", "drop", "detect"]),
        link("arrival beyond 1", "", "stamped = false\narrival = 1.5", &["spec.toml:", "link.arrival", "1.5"]),
        link("arrival in a list below 0", "", "arrival = [0.9, -0.1]", &["spec.toml:", "link.arrival[1]", "-0.1"]),
        link("arrival of no entries", "", "arrival = []", &["spec.toml:", "link.arrival"]),
        link("arrival by a word", "", "arrival = \"learn\"", &["spec.toml:", "link.arrival", "learn", "estimate"]),
        link("arrival by no column", "", "arrival = { columns = \"p\" }", &["spec.toml:", "link.arrival", "column"]),
        link(
            "held estimator with time stamps",
            "lmmse",
            "",
            &["spec.toml:", "estimator.kind", "lmmse", "stamped = false"],
        ),
        link("lmvf on ranges", "lmvf", "stamped = false", &["spec.toml:", "estimator.kind", "lmvf", "range", "gpb1"]),
        link(
            "emvf of no variant",
            "emvf\"\nvariant = \"model3",
            "stamped = false",
            &["spec.toml:", "estimator.variant", "model3"],
        ),
        link(
            "emvf with the last received",
            "emvf",
            "stamped = false\nhold = \"last-received\"",
            &["spec.toml:", "link.hold", "emvf", "paper"],
        ),
        link("held estimator without a start", "gpb1", "stamped = false", &["spec.toml", "model.x0", "gpb1", "P0"]),
        bad("S0 without x0", "axes = 2", "axes = 2\nS0 = [[1.0]]", &["spec.toml:", "model.S0", "x0"]),
        bad("version of the future", "[model]", "version = 2\n[model]", &["spec.toml", "version", "2"]),
        bad("missing anchors file", "[model]", "anchors = \"gone.csv\"\n[model]", &["gone.csv"]),
        linear_case("A not square", "A = [[1.0, 1.0], [0.0, 1.0]]", "A = [[1.0, 1.0]]", &["spec.toml", "model.A"]),
        linear_case("ragged C", "C = [[1.0, 0.0]]", "C = [[1.0, 0.0], [1.0]]", &["spec.toml", "model.C"]),
        linear_case("C of another size", "C = [[1.0, 0.0]]", "C = [[1.0]]", &["spec.toml", "model.C"]),
        linear_case("indefinite Q", "[0.0, 0.1]]\nR", "[0.0, -0.1]]\nR", &["spec.toml", "model.Q"]),
        linear_case("asymmetric Q", "Q = [[0.1, 0.0]", "Q = [[0.1, 0.05]", &["spec.toml", "model.Q"]),
        linear_case("singular R", "R = [[1.0]]", "R = [[0.0]]", &["spec.toml", "model.R"]),
        linear_case("NaN in A", "A = [[1.0, 1.0]", "A = [[1.0, nan]", &["spec.toml", "model.A", "nan"]),
        linear_case("no sequence file", "R = [[1.0]]", "R = [[1.0]]\nsequence = \"s.ndjson\"", &["s.ndjson"]),
        case("spec not UTF-8", "spec.toml", b"[model]\nkind = \"\xff\"".to_vec(), &["spec.toml:2", "0xff"]),
    ]
}

fn tables() -> Vec<Case> {
    let (good, _) = walk();
    let with = |row: &str| format!("{good}{row}\n");
    let last = good.lines().count() + 1;
    assert_eq!(last, 874, "the line in the sentences below");
    let rest = good.split_once('\n').expect("a header").1.to_owned();
    let header = |text: &str| format!("{text}\n{rest}");
    let row = |name, row: &str, says| case(name, "m.csv", with(row), says);
    vec![
        case("empty file", "m.csv", "", &["m.csv", "empty"]),
        case("header only", "m.csv", "t,target,kind,anchor,value\n", &["m.csv"]),
        case("column twice", "m.csv", header("t,t,kind,anchor,value"), &["m.csv", "`t`"]),
        case("no time", "m.csv", header("x,target,kind,anchor,value"), &["m.csv", "`t`"]),
        case("no value", "m.csv", header("t,target,kind,anchor,worth"), &["m.csv", "value"]),
        case("not UTF-8", "m.csv", [with("").into_bytes(), b"5,T\xff,range,A0,1\n".to_vec()].concat(), &["m.csv"]),
        row("word for a number", "1.0,T1,range,A0,lots", &["m.csv:874", "value", "lots"]),
        row("NaN value", "1.0,T1,range,A0,NaN", &["m.csv:874", "value", "NaN"]),
        row("infinite value", "1.0,T1,range,A0,inf", &["m.csv:874", "value", "inf"]),
        row("huge value", "1.0,T1,range,A0,1e300", &["m.csv:874", "value", "1e300"]),
        row("negative range", "1.05,T1,range,A0,-3", &["m.csv:874", "value", "-3"]),
        row("no time in a row", ",T1,range,A0,3", &["m.csv:874", "`t`"]),
        row("date among seconds", "2024-05-01T00:00:00Z,T1,range,A0,3", &["m.csv:874", "`t`", "2024-05-01"]),
        row("unknown anchor", "1.05,T1,range,A9,3", &["m.csv:874", "anchor", "A9"]),
        row("unknown kind", "1.05,T1,sonar,A0,3", &["m.csv:874", "kind", "sonar"]),
        row("two values at once", "0,T1,range,A0,99", &["m.csv:874", "99"]),
        row("too few cells", "1.05,T1", &["m.csv:874"]),
        row("too many cells", "1.05,T1,range,A0,3,4,5", &["m.csv:874"]),
        case("anchor twice", "anchors.csv", "anchor,x,y,z\nA0,0,0,0\nA0,1,0,0\n", &["anchors.csv:3", "A0"]),
        case("anchor nowhere", "anchors.csv", "anchor,x,y,z\nA0,0,,0\n", &["anchors.csv:2", "`y`"]),
        case("anchors without names", "anchors.csv", "x,y,z\n0,0,0\n", &["anchors.csv", "anchor"]),
        Case {
            name: "cut Parquet",
            files: vec![("m.parquet", b"PAR1\x15\x04\x15".to_vec())],
            arguments: &["-c", "spec.toml", "m.parquet", "-o", "t.csv"],
            says: &["m.parquet"],
        },
        Case {
            name: "broken NDJSON",
            files: vec![(
                "m.ndjson",
                b"{\"t\":0,\"kind\":\"range\",\"anchor\":\"A0\",\"value\":1}\n{\"t\":1,\n".to_vec(),
            )],
            arguments: &["-c", "spec.toml", "m.ndjson", "-o", "t.csv"],
            says: &["m.ndjson:2"],
        },
        Case {
            name: "rssi only, no spec",
            files: vec![("m.csv", b"t,kind,anchor,value\n0,rssi,A0,-60\n1,rssi,A0,-61\n".to_vec())],
            arguments: &["m.csv", "-o", "t.csv"],
            says: &["m.csv", "rssi", "1 anchor only", "position"],
        },
        Case {
            name: "rssi of an unknown anchor, no spec",
            files: vec![("m.csv", b"t,kind,anchor,value\n0,rssi,A0,-60\n1,rssi,A9,-61\n".to_vec())],
            arguments: &["m.csv", "-o", "t.csv"],
            says: &["m.csv:3", "anchor", "A9"],
        },
        Case {
            name: "tdoa without a reference, no spec",
            files: vec![("m.csv", b"t,kind,anchor,anchor2,value\n0,tdoa,A0,,1\n".to_vec())],
            arguments: &["m.csv", "-o", "t.csv"],
            says: &["m.csv:2", "anchor2"],
        },
        Case {
            name: "linear, no spec",
            files: vec![("m.csv", b"k,z1\n0,1.0\n1,1.1\n".to_vec())],
            arguments: &["m.csv", "-o", "t.csv"],
            says: &["m.csv", "z1", "-c"],
        },
        Case {
            name: "truth without time",
            files: vec![("truth.csv", b"target,x,y\nT1,0,0\n".to_vec())],
            arguments: WITH_TRUTH,
            says: &["truth.csv", "`t`"],
        },
        Case {
            name: "truth of another target",
            files: vec![("truth.csv", b"t,target,x,y\n1,T9,0,0\n".to_vec())],
            arguments: WITH_TRUTH,
            says: &["truth.csv", "T9"],
        },
        Case {
            name: "truth for a linear model",
            files: vec![
                ("truth.csv", b"t,x,y\n1,0,0\n".to_vec()),
                ("spec.toml", linear("R", "R")),
                ("m.csv", b"k,z1\n0,1.0\n1,1.1\n".to_vec()),
            ],
            arguments: WITH_TRUTH,
            says: &["spec.toml", "linear", "--truth"],
        },
    ]
}

/// A held linear run whose table is `m.csv`.
fn held(name: &'static str, arrival: &str, table: &str, says: &'static [&'static str]) -> Case {
    let prior = "R = [[1.0]]\nx0 = [0, 0]\nP0 = [[1, 0], [0, 1]]";
    let mut spec = linear("R = [[1.0]]", prior);
    spec.extend(format!("[link]\nstamped = false\narrival = {arrival}\n").into_bytes());
    Case { name, files: vec![("spec.toml", spec), ("m.csv", table.as_bytes().to_vec())], arguments: GOOD, says }
}

fn held_tables() -> Vec<Case> {
    let column = "{ column = \"p\" }";
    let untimed = format!("{SPEC}[link]\nstamped = false\n");
    vec![
        held("no arrival column", column, "k,z1\n0,1\n1,2\n", &["m.csv:1", "`p`", "link.arrival", "`k`, `z1`"]),
        held("arrival beyond 1", column, "k,z1,p\n0,1,1\n1,2,1.5\n", &["m.csv:3", "`p`", "1.5", "from 0 to 1"]),
        held("arrival below 0", column, "k,z1,p\n0,1,1\n1,2,-0.1\n", &["m.csv:3", "`p`", "-0.1", "from 0 to 1"]),
        held("arrival by a word", column, "k,z1,p\n0,1,often\n1,2,1\n", &["m.csv:2", "`p`", "often"]),
        held("no arrival in a row", column, "k,z1,p\n0,1,1\n1,2,\n", &["m.csv:3", "`p`", "empty"]),
        held("half a sequence number", "0.9", "k,z1,seq\n0,1,0\n1,2,1.5\n", &["m.csv:3", "`seq`", "1.5"]),
        Case {
            name: "neither t nor received",
            files: vec![("spec.toml", untimed.into_bytes()), ("m.csv", b"kind,anchor,value\nrange,A0,1\n".to_vec())],
            arguments: GOOD,
            says: &["m.csv:1", "`t`", "`received`"],
        },
        case(
            "received but no t on a link with time stamps",
            "m.csv",
            "received,kind,anchor,value\n0,range,A0,1\n",
            &["m.csv:1", "`t`"],
        ),
    ]
}

fn usages() -> Vec<Case> {
    vec![
        usage("no input", &["-c", "spec.toml", "gone.csv", "-o", "t.csv"], &["gone.csv"]),
        usage("no spec", &["-c", "gone.toml", "m.csv", "-o", "t.csv"], &["gone.toml"]),
        usage("no truth", &["-c", "spec.toml", "m.csv", "-o", "t.csv", "--truth", "gone.csv"], &["gone.csv"]),
        usage("folder as input", &["-c", "spec.toml", ".", "-o", "t.csv"], &["directory"]),
        usage("no folder for the output", &["-c", "spec.toml", "m.csv", "-o", "gone/t.csv"], &["gone/t.csv", "`gone`"]),
        usage("folder as output", &["-c", "spec.toml", "m.csv", "-o", "sub.csv"], &["sub.csv", "folder"]),
        usage("file as folder", &["-c", "spec.toml", "m.csv", "-o", "spec.toml/t.csv"], &["spec.toml/t.csv"]),
        usage("output of no kind", &["-c", "spec.toml", "m.csv", "-o", "t.xlsx"], &["t.xlsx", ".csv"]),
        usage("output over the input", &["-c", "spec.toml", "m.csv", "-o", "./m.csv"], &["m.csv", "overwrite"]),
        usage(
            "report over the spec",
            &["-c", "spec.toml", "m.csv", "-o", "t.csv", "--report", "spec.toml"],
            &["spec.toml", "overwrite"],
        ),
        usage(
            "one name for two",
            &["-c", "spec.toml", "m.csv", "-o", "t.csv", "--report", "./t.csv"],
            &["t.csv", "trail", "report"],
        ),
        usage(
            "no folder for the report",
            &["-c", "spec.toml", "m.csv", "-o", "t.csv", "--report", "gone/r.html"],
            &["gone/r.html"],
        ),
        usage("map of a room", &["-c", "spec.toml", "m.csv", "-o", "t.geojson"], &["t.geojson", "lat"]),
        usage("full disk", &["-c", "spec.toml", "m.csv", "-o", "/dev/full"], &["/dev/full", "space"]),
        usage(
            "full disk for the report",
            &["-c", "spec.toml", "m.csv", "-o", "/dev/null", "--report", "/dev/full"],
            &["/dev/full", "space"],
        ),
    ]
}

#[test]
fn bad_input_is_one_sentence_with_exit_code_2_and_nothing_left_behind() {
    let cases: Vec<Case> = specs().into_iter().chain(tables()).chain(held_tables()).chain(usages()).collect();
    assert!(cases.len() >= 40);
    let mut complaints = Vec::new();
    for case in &cases {
        let folder = Folder::new();
        let (table, anchors) = walk();
        folder.write("m.csv", table).write("anchors.csv", anchors).write("spec.toml", SPEC);
        std::fs::create_dir(folder.path("sub.csv")).expect("a folder");
        for (name, content) in &case.files {
            folder.write(name, content);
        }
        let before: Vec<_> =
            folder.names().into_iter().filter(|n| n != "sub.csv").map(|n| (folder.read(&n), n)).collect();
        let ran = folder.run(&[&["track"], case.arguments].concat());
        let after: Vec<_> =
            folder.names().into_iter().filter(|n| n != "sub.csv").map(|n| (folder.read(&n), n)).collect();
        let errors: Vec<&str> = ran.err.lines().filter(|l| l.starts_with("error: ")).collect();
        let mut wrong = Vec::new();
        if ran.code != Some(2) {
            wrong.push(format!("exit code {:?}", ran.code));
        }
        if errors.len() != 1 || ran.err.lines().last() != errors.first().copied() {
            wrong.push("not one sentence at the end".to_owned());
        }
        for what in case.says.iter().filter(|what| errors.first().is_none_or(|e| !e.contains(**what))) {
            wrong.push(format!("does not say {what:?}"));
        }
        if ran.err.contains("panicked") {
            wrong.push("panics".to_owned());
        }
        if !ran.out.is_empty() {
            wrong.push("prints results".to_owned());
        }
        if before != after {
            wrong.push(format!("leaves {:?}", folder.names()));
        }
        if !wrong.is_empty() {
            complaints.push(format!("{}: {}\n    {}", case.name, wrong.join(", "), ran.err.trim()));
        }
    }
    assert!(complaints.is_empty(), "{} of {}:\n{}", complaints.len(), cases.len(), complaints.join("\n"));
}

#[test]
fn what_was_there_stays_when_a_run_fails() {
    let folder = Folder::new();
    let (table, anchors) = walk();
    folder.write("m.csv", format!("{table}1,T1,range,A0,oops\n")).write("anchors.csv", anchors);
    folder.write("spec.toml", SPEC).write("t.csv", "yesterday's trail\n");
    assert_eq!(folder.run(&["track", "-c", "spec.toml", "m.csv", "-o", "t.csv"]).code, Some(2));
    assert_eq!(folder.text("t.csv"), "yesterday's trail\n");
}
