//! `[schedule]` of a scenario.

use crate::closed_loop::Accuracy;
use crate::error::BuildError;
use crate::spec::{Scenario, Simulated, World, parse_scenario};
use fixtrail_core::schedule::{Choice, Radio};
use std::io::{Error, ErrorKind};
use std::path::Path;

const BASE: &str = "\
[scenario]
runs = 2
[model]
kind = \"constant-velocity\"
noise = 0.1
x0 = [1, 2, 0, 0]
P0 = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
[[sensor]]
kind = \"range\"
sd = 0.1
[field]
size_m = [50, 50]
sensors = 8
[channel]
kind = \"bernoulli\"
loss_rate = 0.1
";

const IDGSS: &str = "[schedule]\nkind = \"idgss\"\nintervals_s = [0.1, 0.2]\nenough = 2\nduration_s = 5\n";

fn parse(text: &str) -> Result<Scenario, BuildError> {
    parse_scenario(text, Path::new("site/scenario.toml"), &mut |_| Err(Error::from(ErrorKind::NotFound)))
}

fn good(text: &str) -> Simulated {
    match parse(text).unwrap_or_else(|e| panic!("{text}\n{e}")).world {
        World::Simulated(simulated) => *simulated,
        World::Recorded(_) => panic!("{text}"),
    }
}

#[test]
fn a_schedule_has_the_usual_defaults() {
    let schedule = good(&format!("{BASE}{IDGSS}")).schedule.unwrap();
    assert_eq!(schedule.choice, Choice::Cost { enough: 2.0, weight: 0.7 });
    assert_eq!((schedule.intervals_s.as_slice(), schedule.group), (&[0.1, 0.2][..], 5));
    assert_eq!((schedule.range_m, schedule.duration_s, schedule.accuracy), (f64::INFINITY, 5.0, Accuracy::Trace));
    assert_eq!((schedule.radio, schedule.residual_of(3)), (Radio::default(), f64::INFINITY));
    // As many instants as 0.1 s apart.
    assert_eq!(good(&format!("{BASE}{IDGSS}")).steps, 50);
    let nearest = "[schedule]\nkind = \"nearest\"\ninterval_s = 0.5\nduration_s = 5";
    let nearest = good(&format!("{BASE}{nearest}")).schedule.unwrap();
    assert_eq!((nearest.choice, nearest.group), (Choice::Nearest, 1));
}

#[test]
fn every_key_of_a_schedule_is_taken() {
    let text = "[schedule]\nkind = \"fixed-interval\"\ninterval_s = 0.3\ngroup = 3\nenough = 1.5\nweight = 0.25\naccuracy = \"sum\"\n\
                range_m = 12\nduration_s = 9\nresidual_mj = [1, 2, 3, 4, 5, 6, 7, 8]\nfailures = [[3, 0], [4, 7]]\n\
                radio = { sense_mj_per_bit = 1, receive_mj_per_bit = 2, send_mj_per_bit = 3, amplify_mj_per_bit = 4, path_exponent = 3, \
                sensed_bits = 5, sent_bits = 6, free_self = true }\n";
    let schedule = good(&format!("{BASE}{text}")).schedule.unwrap();
    assert_eq!(schedule.choice, Choice::Cost { enough: 1.5, weight: 0.25 });
    assert_eq!((schedule.intervals_s.as_slice(), schedule.group, schedule.range_m), (&[0.3][..], 3, 12.0));
    assert_eq!((schedule.accuracy, schedule.duration_s), (Accuracy::Sum, 9.0));
    assert_eq!((schedule.residual_of(0), schedule.residual_of(7)), (1.0, 8.0));
    assert_eq!(schedule.failures, [(3, 0), (4, 7)]);
    let radio = Radio {
        sense_mj_per_bit: 1.0,
        receive_mj_per_bit: 2.0,
        send_mj_per_bit: 3.0,
        amplify_mj_per_bit: 4.0,
        path_exponent: 3.0,
        sensed_bits: 5.0,
        sent_bits: 6.0,
        free_self: true,
    };
    assert_eq!(schedule.radio, radio);
}

#[test]
fn a_contender_changes_what_it_names() {
    let contender = |keys: &str| {
        let text = format!("{BASE}{IDGSS}[[contender]]\nestimator = {{ kind = \"ekf\" }}\nschedule = {{ {keys} }}\n");
        good(&text).contenders[0].schedule.clone().unwrap()
    };
    let enough = contender("enough = 0.5, group = 2");
    assert_eq!((enough.choice, enough.group), (Choice::Cost { enough: 0.5, weight: 0.7 }, 2));
    assert_eq!((enough.intervals_s.as_slice(), enough.duration_s), (&[0.1, 0.2][..], 5.0));
    let nearest = contender("kind = \"nearest\", interval_s = 0.4");
    assert_eq!(
        (nearest.choice, nearest.intervals_s.as_slice(), nearest.duration_s),
        (Choice::Nearest, &[0.4][..], 5.0)
    );
    // Of many intervals the shortest is the one.
    assert_eq!(contender("kind = \"minimum-trace\"").intervals_s, [0.1]);
    let plain = good(&format!("{BASE}{IDGSS}[[contender]]\nestimator = {{ kind = \"ekf\" }}\n"));
    assert_eq!(plain.contenders[0].schedule, plain.schedule);
}

#[test]
fn broken_schedules_say_what_is_wrong_where() {
    let plain = |text: &str| format!("{BASE}{text}");
    let changed = |from: &str, to: &str| {
        assert!(IDGSS.contains(from), "{from}");
        format!("{BASE}{}", IDGSS.replace(from, to))
    };
    let position = BASE.replace("kind = \"range\"", "kind = \"position\"");
    let position = position.replace("[field]\nsize_m = [50, 50]\nsensors = 8\n", "");
    for (text, key, parts) in [
        (changed("\"idgss\"", "\"idgs\""), "schedule.kind", &["idgs", "did you mean `idgss`"][..]),
        (changed("kind = \"idgss\"\n", ""), "schedule.kind", &["is missing", "`minimum-trace`"]),
        (changed("[0.1, 0.2]", "[0.2, 0.1]"), "schedule.intervals_s", &["ascending"]),
        (changed("[0.1, 0.2]", "[]"), "schedule.intervals_s", &["1 to 16"]),
        (changed("[0.1, 0.2]", "[0, 1]"), "schedule.intervals_s[0]", &["positive number of seconds"]),
        (changed("intervals_s = [0.1, 0.2]", "interval_s = 1"), "schedule.interval_s", &["not a key"]),
        (changed("enough = 2\n", ""), "schedule.enough", &["is missing"]),
        (changed("enough = 2", "enough = 0"), "schedule.enough", &["positive"]),
        (changed("duration_s = 5\n", ""), "schedule.duration_s", &["is missing"]),
        (changed("enough = 2", "enough = 2\ngroup = 9"), "schedule.group", &["9", "1 to 8"]),
        (changed("enough = 2", "enough = 2\ngroup = 0"), "schedule.group", &["0", "1 to 8"]),
        (changed("enough = 2", "enough = 2\nweight = 1.2"), "schedule.weight", &["1.2", "from 0 to 1"]),
        (changed("enough = 2", "enough = 2\naccuracy = \"det\""), "schedule.accuracy", &["`trace`, `sum`"]),
        (changed("enough = 2", "enough = 2\nrange_m = -3"), "schedule.range_m", &["-3", "metres"]),
        (changed("enough = 2", "enough = 2\nresidual_mj = [1, 2]"), "schedule.residual_mj", &["list of 8"]),
        (changed("enough = 2", "enough = 2\nfailures = [[1, 8]]"), "schedule.failures[0][1]", &["8", "0 to 7"]),
        (changed("enough = 2", "enough = 2\nfailures = [[1]]"), "schedule.failures[0]", &["pairs"]),
        (changed("enough = 2", "enough = 2\nradio = { bits = 3 }"), "schedule.radio.bits", &["not a key"]),
        (changed("enough = 2", "enough = 2\nradio = { sent_bits = -1 }"), "schedule.radio.sent_bits", &["-1"]),
        (plain("[schedule]\nkind = \"nearest\"\nduration_s = 1"), "schedule.interval_s", &["is missing"]),
        (
            plain("[schedule]\nkind = \"nearest\"\ninterval_s = 1\nenough = 1\nduration_s = 1"),
            "schedule.enough",
            &["not a key"],
        ),
        (format!("{position}{IDGSS}"), "schedule", &["no `[schedule]` without a `[field]`"]),
        (
            BASE.replace("runs = 2", "runs = 2\nsteps = 3") + IDGSS,
            "scenario.steps",
            &["no `steps` beside `[schedule]`"],
        ),
        (
            BASE.replace("runs = 2", "runs = 2\nsteps = 3") + "[[contender]]\nschedule = { group = 2 }",
            "contender[0].schedule",
            &["no `schedule` without"],
        ),
    ] {
        let error = parse(&text).expect_err(&text);
        let shown = error.to_string();
        assert_eq!(error.place.key.as_deref(), Some(key), "{shown}\n{text}");
        assert!(error.place.line.is_some(), "{shown}");
        for part in parts {
            assert!(shown.contains(part), "{shown}, expected {part}");
        }
    }
}
