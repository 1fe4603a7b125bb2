//! Bounded memory against everything in memory: the same trails, whatever the order of rows, the room there is and the number of threads.

use super::{FileError, FileRun, track_sorted, track_within};
use crate::content::AnchorIds;
use crate::grouped::track_grouped;
use crate::store::Room;
use crate::{
    Input, Order, OutFormat, Output, ReadOptions, WriteOptions, read_anchors, read_table, run_tracks, write_trails,
};
use fixtrail_track::packet::Kind;
use fixtrail_track::pipeline::track;
use fixtrail_track::registry;
use fixtrail_track::spec::{self, Spec};
use fixtrail_track::trackers::LaggedMode;
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int64Type};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tempfile::TempDir;

/// Little room for everything: many runs, most of them spilled, and targets that are tracked in parts.
const TIGHT: Room = Room { run_words: 400, kept_words: 900, long: 23, fewest_rows: u64::MAX, loaded_words: 0 };
/// Targets are tracked out of the file wherever that is possible.
const TOGETHER: Room = Room { fewest_rows: 1, ..Room::BOUNDED };

/// Numbers without a pattern (Knuth's 64-bit congruence).
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        ((self.0 >> 33) as usize) % n
    }

    fn shuffle<T>(&mut self, list: &mut [T]) {
        (1..list.len()).for_each(|i| list.swap(i, self.below(i + 1)));
    }
}

fn spec_of(estimator: &str, prior: bool, sensors: &str) -> Spec {
    let prior = if prior {
        "x0 = [0.0, 0.0, 0.0, 0.0]\nP0 = [[100.0, 0, 0, 0], [0, 100.0, 0, 0], [0, 0, 4.0, 0], [0, 0, 0, 4.0]]\n"
    } else {
        ""
    };
    let text = format!("[model]\nkind = \"constant-velocity\"\naxes = 2\nnoise = 0.2\n{prior}{estimator}{sensors}");
    spec::parse(&text, Path::new("spec"), &mut |_| unreachable!("no file is named")).unwrap()
}

const KALMAN: &str = "[estimator]\nkind = \"kalman\"\n";
const EKF: &str = "[estimator]\nkind = \"ekf\"\n";
const RTS: &str = "[estimator]\nkind = \"rts\"\n";
const POSITIONS: &str = "[[sensor]]\nkind = \"position\"\nsd = 0.3\n";
const RANGES: &str = "[[sensor]]\nkind = \"range\"\nsd = 0.2\n";
const LATE: &str = "[link]\nlate_s = 0.25\n[[sensor]]\nkind = \"position\"\nsd = 0.3\n";

/// Rows of positions of some targets, by target.
fn positions(random: &mut Random, targets: usize, longest: usize) -> Vec<String> {
    let mut rows = Vec::new();
    for target in 0..targets {
        for i in 0..1 + random.below(longest) {
            let (x, y) = (random.below(4000) as f64 / 1000.0, random.below(4000) as f64 / 1000.0);
            rows.push(format!("{:?},{target},{x:?},{y:?}", (i * 10 + random.below(10)) as f64 / 100.0));
        }
    }
    rows
}

/// Rows of ranges of some targets to four anchors, by time.
fn ranges(random: &mut Random, targets: usize, instants: usize) -> Vec<String> {
    let mut rows = Vec::new();
    for i in 0..instants {
        for target in 0..targets {
            for anchor in 0..4 {
                if random.below(5) > 0 {
                    let value = 3.0 + random.below(400) as f64 / 100.0;
                    rows.push(format!("{:?},{target},A{anchor},{value:?}", i as f64 / 10.0));
                }
            }
        }
    }
    rows
}

struct Case {
    folder: TempDir,
    input: Input,
    spec: Spec,
    read: ReadOptions,
}

impl Case {
    fn new(name: &str, text: &(impl AsRef<[u8]> + ?Sized), spec: Spec) -> Case {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("anchors.csv"), "anchor,x,y\nA0,0,0\nA1,8,0\nA2,0,8\nA3,8,8\n").unwrap();
        let input = Input::File(folder.path().join(name));
        fs::write(input.name(), text).unwrap();
        let kinds: Vec<Kind> = spec.sensors.iter().map(|s| s.kind).collect();
        let latency_s = spec.sensors.iter().map(|s| (s.kind, s.latency_s)).collect();
        let read =
            ReadOptions { default_kind: Some(kinds[0]), kinds: Some(kinds), latency_s, ..ReadOptions::default() };
        Case { folder, input, spec, read }
    }

    fn output(&self, name: &str) -> (PathBuf, Output) {
        let path = self.folder.path().join(name);
        (path.clone(), Output::File(path))
    }

    /// Everything in memory.
    fn whole(&self, name: &str) -> Result<Vec<u8>, FileError> {
        let (path, output) = self.output(name);
        let table = read_table(&self.input, None, &self.read, &mut |_, _| {})?;
        let one = |target: &_| track(&self.spec, &table.anchors, target, LaggedMode::Own);
        let trails = run_tracks(&table, one, &|_| {})?;
        write_trails(&output, &trails, &registry::layout(&self.spec), &table, &options(&output))?;
        Ok(fs::read(path).unwrap())
    }

    /// Calls `with` with a run to an output.
    fn run<T: Send>(&self, name: &str, threads: usize, with: impl Fn(&FileRun<'_>) -> T + Sync) -> T {
        let (_, output) = self.output(name);
        let anchors = read_anchors(&self.input, None).unwrap();
        let run = FileRun {
            input: &self.input,
            anchors: &anchors,
            read: &self.read,
            spec: &self.spec,
            lagged: LaggedMode::Own,
            output: &output,
            write: &options(&output),
        };
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| with(&run))
    }

    /// In little memory.
    fn bounded(&self, name: &str, room: Room, threads: usize) -> Result<Vec<u8>, FileError> {
        self.run(name, threads, |run| track_within(run, room, &|_, _, _| {}).map(drop))?;
        Ok(fs::read(self.output(name).0).unwrap())
    }

    /// Whether targets can be tracked out of the file; if so, the trails and all that is told are those of the other way.
    fn is_together(&self) -> bool {
        let together = |threads| {
            let outcome = self.run("trail.csv", threads, |run| {
                track_grouped(run, &AnchorIds::new(run.anchors), TOGETHER, &|_, _, _| {}).unwrap()
            });
            outcome.map(|outcome| (outcome, fs::read(self.output("trail.csv").0).unwrap()))
        };
        let (one, three) = (together(1), together(3));
        assert_eq!(one.as_ref().map(|(outcome, _)| outcome), three.as_ref().map(|(outcome, _)| outcome));
        assert!(one == three, "trails depend on the number of threads");
        let Some((outcome, trail)) = one else { return false };
        let sorted = self.run("trail.csv", 1, |run| {
            track_sorted(run, &AnchorIds::new(run.anchors), Room::BOUNDED, &|_, _, _| {}).unwrap()
        });
        assert_eq!(outcome, sorted);
        assert!(trail == fs::read(self.output("trail.csv").0).unwrap());
        true
    }

    fn agrees(&self) {
        for name in ["trail.csv", "trail.ndjson"] {
            let whole = self.whole(name).unwrap();
            let rooms = [(TIGHT, 1), (TIGHT, 3), (Room::BOUNDED, 1), (Room::BOUNDED, 2), (TOGETHER, 1), (TOGETHER, 3)];
            for (room, threads) in rooms {
                let bounded = self.bounded(name, room, threads).unwrap();
                assert!(bounded == whole, "{name} with {room:?} on {threads} threads");
            }
        }
        // Row groups depend on the room, bytes do not on the threads.
        let one = self.bounded("trail.parquet", TIGHT, 1).unwrap();
        assert!(self.bounded("trail.parquet", TIGHT, 3).unwrap() == one);
    }
}

fn options(output: &Output) -> WriteOptions {
    WriteOptions { covariance: true, order: Order::Target, format: OutFormat::of(output).unwrap() }
}

fn table(header: &str, rows: &[String]) -> String {
    format!("{header}\n{}\n", rows.join("\n"))
}

#[test]
fn little_room_changes_nothing_whatever_the_order_of_rows() {
    let mut random = Random(1);
    let by_target = positions(&mut random, 37, 60);
    let mut by_time = by_target.clone();
    by_time.sort_by(|a, b| {
        let t = |row: &String| row.split(',').next().unwrap().parse::<f64>().unwrap();
        t(a).total_cmp(&t(b))
    });
    let mut shuffled = by_target.clone();
    random.shuffle(&mut shuffled);
    let mut copied = shuffled.clone();
    copied.extend_from_slice(&shuffled[..50]);
    // From the first quote on another reader takes over.
    let quote = |(i, row): (usize, &String)| match row.split_once(',') {
        Some((t, rest)) if i > 300 && i % 3 == 0 => format!("\"{t}\",{rest}"),
        _ => row.clone(),
    };
    let quoted: Vec<String> = shuffled.iter().enumerate().map(quote).collect();
    for rows in [&by_target, &by_time, &shuffled, &copied, &quoted] {
        let text = table("t,target,x,y", rows);
        for prior in [true, false] {
            Case::new("m.csv", &text, spec_of(KALMAN, prior, POSITIONS)).agrees();
        }
        Case::new("m.csv", &text, spec_of(RTS, false, POSITIONS)).agrees();
    }
    Case::new("m.csv", &table("t,target,x,y", &by_target), spec_of(KALMAN, true, LATE)).agrees();
}

#[test]
fn one_target_many_times_as_long_as_there_is_room_is_tracked_in_parts() {
    let mut random = Random(2);
    let mut rows = positions(&mut random, 1, 3000);
    while rows.len() < 1000 {
        rows = positions(&mut random, 1, 3000);
    }
    random.shuffle(&mut rows);
    let text = table("t,target,x,y", &rows);
    for prior in [true, false] {
        Case::new("m.csv", &text, spec_of(KALMAN, prior, POSITIONS)).agrees();
    }
    // The copies of a row may fall into different parts.
    let mut copied = rows.clone();
    copied.extend(rows.iter().step_by(3).cloned());
    random.shuffle(&mut copied);
    Case::new("m.csv", &table("t,target,x,y", &copied), spec_of(KALMAN, true, POSITIONS)).agrees();
    // So may the two sides of a contradiction, of which neither is kept.
    let mut refuted = rows.clone();
    refuted.extend(rows.iter().step_by(3).map(|row| format!("{}9", row)));
    random.shuffle(&mut refuted);
    let mut case = Case::new("m.csv", &table("t,target,x,y", &refuted), spec_of(KALMAN, true, POSITIONS));
    case.read.skip_bad_rows = true;
    case.agrees();
    // Without a target column, and with several rows an instant.
    let rows: Vec<String> = ranges(&mut random, 1, 400).iter().map(|r| r.replacen(",0,", ",", 1)).collect();
    Case::new("m.csv", &table("t,anchor,value", &rows), spec_of(EKF, false, RANGES)).agrees();
}

#[test]
fn ranges_dates_and_missing_cells_take_the_same_way() {
    let mut random = Random(3);
    let mut rows = ranges(&mut random, 11, 40);
    Case::new("m.csv", &table("t,target,anchor,value", &rows), spec_of(EKF, false, RANGES)).agrees();
    random.shuffle(&mut rows);
    let dated: Vec<String> = rows
        .iter()
        .map(|row| {
            let (t, rest) = row.split_once(',').unwrap();
            let ms = (t.parse::<f64>().unwrap() * 1000.0).round() as u64;
            format!("2026-03-01T12:00:{:02}.{:03}Z,{rest}", ms / 1000, ms % 1000)
        })
        .collect();
    let latency = format!("{RANGES}latency_s = 0.05\n");
    Case::new("m.csv", &table("t,target,anchor,value", &dated), spec_of(EKF, false, &latency)).agrees();

    let holes: Vec<String> = positions(&mut random, 9, 40)
        .into_iter()
        .map(|row| if random.below(4) == 0 { row.rsplit_once(',').unwrap().0.to_owned() + "," } else { row })
        .collect();
    Case::new("m.csv", &table("t,target,x,y", &holes), spec_of(KALMAN, true, POSITIONS)).agrees();
}

#[test]
fn rows_that_are_not_plain_say_what_plain_ones_say() {
    let mut random = Random(6);
    let rows = positions(&mut random, 9, 60);
    let odd: Vec<String> = rows
        .iter()
        .map(|row| {
            let cells: Vec<&str> = row.split(',').collect();
            match random.below(7) {
                5 => format!("{}, {} ,{},{}", cells[0], cells[1], cells[2], cells[3]),
                0 => cells.join(" , "),
                1 => format!("{row}\r"),
                2 => format!("+{row}"),
                3 => format!("{}e0,{},{},{}", cells[0], cells[1], cells[2], cells[3]),
                4 => format!("\n{row}"),
                _ => row.clone(),
            }
        })
        .collect();
    let plain = Case::new("m.csv", &table("t,target,x,y", &rows), spec_of(KALMAN, true, POSITIONS));
    let odd = Case::new("m.csv", &table("t,target,x,y", &odd), spec_of(KALMAN, true, POSITIONS));
    odd.agrees();
    assert!(odd.whole("trail.csv").unwrap() == plain.whole("trail.csv").unwrap());
}

#[test]
fn objects_whose_keys_come_late_are_read_as_they_are() {
    let mut random = Random(4);
    let rows = positions(&mut random, 7, 40);
    let objects: Vec<String> = rows
        .iter()
        .enumerate()
        .map(|(i, row)| {
            let cells: Vec<&str> = row.split(',').collect();
            let sd = if i > 60 && i % 3 == 0 { ",\"sd\":0.5" } else { "" };
            format!("{{\"t\":{},\"target\":\"{}\",\"x\":{},\"y\":{}{sd}}}", cells[0], cells[1], cells[2], cells[3])
        })
        .collect();
    Case::new("m.ndjson", &(objects.join("\n") + "\n"), spec_of(KALMAN, true, POSITIONS)).agrees();
}

#[test]
fn of_several_contradictions_the_first_in_the_file_is_told_and_nothing_is_left_behind() {
    let mut random = Random(5);
    let mut rows = positions(&mut random, 9, 60);
    let other: Vec<String> = [200, 20, 90]
        .iter()
        .map(|i| {
            let row = &rows[*i];
            format!("{},99", row.rsplit_once(',').unwrap().0)
        })
        .collect();
    rows.extend(other);
    random.shuffle(&mut rows);
    let case = Case::new("m.csv", &table("t,target,x,y", &rows), spec_of(KALMAN, true, POSITIONS));
    let whole = case.whole("trail.csv").unwrap_err().to_string();
    assert!(whole.contains("expected one value"), "{whole}");
    for threads in [1, 3] {
        assert_eq!(case.bounded("trail.csv", TIGHT, threads).unwrap_err().to_string(), whole);
    }
    let mut names: Vec<_> = fs::read_dir(case.folder.path()).unwrap().map(|f| f.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["anchors.csv", "m.csv"]);
}

/// Rows of some targets, each target's together, targets and their rows in any order, some of them twice, and blank lines between.
fn together(random: &mut Random) -> Vec<String> {
    let mut targets: Vec<Vec<String>> = (0..23)
        .map(|target| {
            let mut rows: Vec<String> = positions(random, 1, 300);
            rows.iter_mut().for_each(|row| *row = row.replacen(",0,", &format!(",{target},"), 1));
            let copies: Vec<String> = rows.iter().step_by(7).cloned().collect();
            rows.extend(copies);
            if target % 2 == 0 {
                random.shuffle(&mut rows);
            }
            rows
        })
        .collect();
    // One target stands in two lots.
    let half = targets[5].len() / 2;
    let rest = targets[5].split_off(half);
    targets.push(rest);
    random.shuffle(&mut targets);
    targets.concat()
}

fn objects(rows: &[String]) -> String {
    let object = |row: &String| {
        let cells: Vec<&str> = row.split(',').collect();
        format!("{{\"t\":{},\"target\":\"{}\",\"x\":{}, \"y\":{}}}\n", cells[0], cells[1], cells[2], cells[3])
    };
    rows.iter().map(object).collect()
}

#[test]
fn targets_whose_rows_stand_together_are_tracked_out_of_the_file() {
    let mut random = Random(7);
    let rows = together(&mut random);
    let text = table("t,target,x,y", &rows);
    for spec in [spec_of(KALMAN, true, POSITIONS), spec_of(KALMAN, false, LATE), spec_of(RTS, false, POSITIONS)] {
        let case = Case::new("m.csv", &text, spec.clone());
        assert!(case.is_together());
        case.agrees();
        assert!(Case::new("m.ndjson", &objects(&rows), spec).is_together());
    }
    // What a glance may take for the name of a target is none where it stands in another key's text.
    let tricky = objects(&rows).replace("{\"t\"", "{\"note\":\"\\\"target\\\":7\",\"t\"");
    let tricky = Case::new("m.ndjson", &tricky, spec_of(KALMAN, true, POSITIONS));
    tricky.agrees();

    let anchored: Vec<String> = (0..9)
        .flat_map(|target| {
            let rows = ranges(&mut random, 1, 60);
            rows.into_iter().map(move |row| row.replacen(",0,", &format!(",{target},"), 1)).collect::<Vec<_>>()
        })
        .collect();
    assert!(Case::new("m.csv", &table("t,target,anchor,value", &anchored), spec_of(EKF, false, RANGES)).is_together());
}

/// Rows `t,target,x,y` as a Parquet file of row groups of so many rows; an empty cell is a null, and targets may be whole numbers.
fn parquet_of(rows: &[String], group: usize, numbered: bool) -> Vec<u8> {
    let target = if numbered { "optional int64 target" } else { "optional byte_array target (UTF8)" };
    let schema = format!("message m {{ required double t; {target}; optional double x; optional double y; }}");
    let schema = Arc::new(parse_message_type(&schema).unwrap());
    let cells = |of: &[String], i: usize| -> (Vec<String>, Vec<i16>) {
        let all: Vec<String> = of.iter().map(|row| row.split(',').nth(i).unwrap().to_owned()).collect();
        let levels = all.iter().map(|cell| i16::from(!cell.is_empty())).collect();
        (all.into_iter().filter(|cell| !cell.is_empty()).collect(), levels)
    };
    let mut bytes = Vec::new();
    let mut file = SerializedFileWriter::new(&mut bytes, schema, Arc::default()).unwrap();
    for of in rows.chunks(group) {
        let mut columns = file.next_row_group().unwrap();
        for i in 0..4 {
            let (cells, levels) = cells(of, i);
            let levels = (i > 0).then_some(levels.as_slice());
            let numbers = || -> Vec<f64> { cells.iter().map(|cell| cell.parse().unwrap()).collect() };
            let mut column = columns.next_column().unwrap().unwrap();
            match (i, numbered) {
                (1, false) => {
                    let texts: Vec<ByteArray> = cells.iter().map(|cell| ByteArray::from(cell.as_str())).collect();
                    column.typed::<ByteArrayType>().write_batch(&texts, levels, None).unwrap();
                }
                (1, true) => {
                    let ids: Vec<i64> = cells.iter().map(|cell| cell.parse().unwrap()).collect();
                    column.typed::<Int64Type>().write_batch(&ids, levels, None).unwrap();
                }
                _ => {
                    column.typed::<DoubleType>().write_batch(&numbers(), levels, None).unwrap();
                }
            }
            column.close().unwrap();
        }
        columns.close().unwrap();
    }
    file.close().unwrap();
    bytes
}

#[test]
fn row_groups_of_targets_whose_rows_stand_together_are_loaded_when_they_are_needed() {
    let rows = together(&mut Random(9));
    for (group, numbered) in [(100_000, false), (500, false), (90, true)] {
        let file = parquet_of(&rows, group, numbered);
        let case = Case::new("m.parquet", &file, spec_of(KALMAN, true, POSITIONS));
        assert!(case.is_together(), "groups of {group}");
        case.agrees();
        assert!(Case::new("m.parquet", &file, spec_of(RTS, false, POSITIONS)).is_together());
    }
}

#[test]
fn row_groups_are_not_loaded_where_targets_are_apart_or_there_is_no_room() {
    let mut random = Random(10);
    let rows = together(&mut random);
    let case =
        |rows: &[String]| Case::new("m.parquet", &parquet_of(rows, 500, false), spec_of(KALMAN, true, POSITIONS));
    let tight = Room { loaded_words: 1000, ..TOGETHER };
    let run = |room: Room| {
        case(&rows).run("trail.csv", 2, |run| {
            track_grouped(run, &AnchorIds::new(run.anchors), room, &|_, _, _| {}).unwrap().is_some()
        })
    };
    assert!(run(TOGETHER) && !run(tight) && !run(Room { fewest_rows: 200, ..TOGETHER }));

    // A row of another target where no glance falls: these fall on rows 0, 64 and 128.
    let alone: Vec<String> = (0..200).map(|i| format!("{i}.5,a,{i}.25,1.0")).collect();
    let with = |at: usize, row: &str| {
        let mut rows = alone.clone();
        rows.insert(at, row.to_owned());
        case(&rows)
    };
    assert!(case(&alone).is_together());
    for (at, row) in [(100, "3.75,hidden,1.0,1.0"), (100, "99.75,,1.0,1.0"), (64, "63.75,,1.0,1.0")] {
        assert!(!with(at, row).is_together(), "{row}");
    }
    with(100, "3.75,hidden,1.0,1.0").agrees();
    let contradicted = with(100, "99.5,a,77.0,1.0").bounded("trail.csv", TOGETHER, 2).unwrap_err().to_string();
    assert!(contradicted.contains("m.parquet:101"), "{contradicted}");
    // Half a position is a row like any other, a number out of bounds a bad one.
    for row in ["99.75,a,1.0,", "99.75,a,,1.0"] {
        assert!(with(100, row).is_together(), "{row}");
        with(100, row).agrees();
    }
    for (at, row) in [(100, "99.75,a,1e300,1.0"), (0, "nan,a,1.0,1.0"), (200, "1e300,a,1.0,1.0")] {
        let mut case = with(at, row);
        assert!(!case.is_together(), "{row}");
        assert!(case.bounded("trail.csv", TOGETHER, 2).is_err(), "{row}");
        case.read.skip_bad_rows = true;
        case.agrees();
    }
}

#[test]
fn a_null_in_a_group_that_is_there_is_a_null() {
    let schema = "message m { required double t; required byte_array target (UTF8); optional group pos { optional double x; \
                  optional double y; } }";
    let schema = Arc::new(parse_message_type(schema).unwrap());
    let (mut bytes, rows) = (Vec::new(), 150);
    let mut file = SerializedFileWriter::new(&mut bytes, schema, Arc::default()).unwrap();
    let mut columns = file.next_row_group().unwrap();
    let numbers: Vec<f64> = (0..rows).map(f64::from).collect();
    // Row 70 has no x, and row 90 no position at all.
    for (i, absent) in [(0, [0, 0]), (1, [0, 0]), (2, [70, 90]), (3, [90, 90])] {
        let mut column = columns.next_column().unwrap().unwrap();
        if i == 1 {
            column
                .typed::<ByteArrayType>()
                .write_batch(&vec![ByteArray::from("a"); rows as usize], None, None)
                .unwrap();
        } else {
            let is_there = |row: i32| i == 0 || !absent.contains(&row);
            let level = |row| {
                if is_there(row) {
                    2
                } else if row == 90 {
                    0
                } else {
                    1
                }
            };
            let levels: Vec<i16> = (0..rows).map(level).collect();
            let there: Vec<f64> = numbers.iter().copied().filter(|x| is_there(*x as i32)).collect();
            column.typed::<DoubleType>().write_batch(&there, (i > 1).then_some(&levels), None).unwrap();
        }
        column.close().unwrap();
    }
    columns.close().unwrap();
    file.close().unwrap();
    let mut case = Case::new("m.parquet", &bytes, spec_of(KALMAN, true, POSITIONS));
    case.read.columns = [("x", "pos.x"), ("y", "pos.y")].map(|(a, b)| (a.to_owned(), b.to_owned())).into();
    case.read.skip_bad_rows = true;
    case.agrees();
    let text = String::from_utf8(case.bounded("trail.csv", TOGETHER, 1).unwrap()).unwrap();
    // The row without a position is bad; the one without x is updated by y alone, and those behind them are where they were.
    let row =
        |line: usize| text.lines().nth(line + 1).unwrap().split(',').take(3).map(str::to_owned).collect::<Vec<_>>();
    assert_eq!((text.lines().count(), row(70)[1].as_str(), row(90)[1].as_str()), (rows as usize, "70.0", "91.0"));
    assert!((row(148)[2].parse::<f64>().unwrap() - 149.0).abs() < 1.0, "{:?}", row(148));
}

#[test]
fn what_needs_the_whole_table_is_not_tracked_out_of_the_file() {
    let mut random = Random(8);
    let rows = together(&mut random);
    let with = |change: &dyn Fn(usize, &str) -> String| -> Vec<String> {
        rows.iter().enumerate().map(|(i, row)| change(i, row)).collect()
    };
    let refused = |header: &str, rows: &[String]| {
        let case = Case::new("m.csv", &table(header, rows), spec_of(KALMAN, true, POSITIONS));
        assert!(!case.is_together(), "{header}: {}", rows[0]);
        case
    };
    // A target within another's rows, where no glance falls.
    let mut hidden = rows.clone();
    let at = rows.iter().position(|row| row.contains(",7,")).unwrap() + 40;
    hidden.insert(at, "0.5,hidden,1.0,1.0".to_owned());
    refused("t,target,x,y", &hidden).agrees();
    // Times that are dates, no times in some rows, latitudes, a broken row, a contradiction.
    let date = |_: usize, row: &str| {
        let (t, rest) = row.split_once(',').unwrap();
        format!("2026-03-01T12:00:{:06.3}Z,{rest}", t.parse::<f64>().unwrap())
    };
    refused("t,target,x,y", &with(&date)).agrees();
    refused("t,target,lat,lon", &with(&|_, row| row.to_owned())).agrees();
    refused("k,target,x,y", &with(&|_, row| row.to_owned()));
    refused("t,target,x,y", &with(&|i, row| if i == 300 { format!("{row}?") } else { row.to_owned() }));
    refused("t,target,x,y", &with(&|i, row| if i == 300 { format!("{row},1") } else { row.to_owned() }));
    refused("t,target,x,y", &with(&|i, row| if i == 300 { row.replacen("", "\"", 1) } else { row.to_owned() }));
    // The first of two broken rows is that in the order of the file, not of the names.
    let broken = with(&|i, row| if i == 300 || i + 300 == rows.len() { format!("{row}?") } else { row.to_owned() });
    let mut case = Case::new("m.csv", &table("t,target,x,y", &broken), spec_of(KALMAN, true, POSITIONS));
    case.read.skip_bad_rows = true;
    assert!(!case.is_together());
    case.agrees();
    let mut contradicted = rows.clone();
    contradicted.insert(rows.len() - 1, format!("{}9", rows[rows.len() - 1]));
    let mut case = refused("t,target,x,y", &contradicted);
    case.read.skip_bad_rows = true;
    case.agrees();
}
