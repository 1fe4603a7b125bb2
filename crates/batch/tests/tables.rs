//! Good tables: every format, every harmless oddity, any order of rows.

mod common;

use common::{Folder, csv, read, without_lines};
use fixtrail_batch::{Input, LinearShape, ReadOptions, Table, TimeForm, read_table, read_truth, run_tracks};
use fixtrail_track::geo::{self, Origin};
use fixtrail_track::packet::{Content, Kind};
use fixtrail_track::target::TargetTrail;
use fixtrail_track::trail::Trail;
use std::collections::BTreeMap;

const MIXED: &str = "t,tag,kind,anchor_id,anchor_id2,value,x,y,z,sd,seq,received,note
0.5,T1,range,A0,,1.25,,,,0.1,1,0.6,a
0.5,T1,range,A1,,2.5,,,,,2,0.7,b
0.25,T0,position,,,,1,2,,0.5,,,c
0.5,T1,tdoa,A1,A2,-0.75,,,,,,,d
0.75,T0,rssi,A2,,-70.5,,,,,,,e
0.75,T0,bearing,A2,,0.1,,,,,,,\"f, g\"
";

fn names(table: &Table) -> Vec<Option<&str>> {
    table.targets.iter().map(|t| t.target.as_deref()).collect()
}

#[test]
fn every_kind_is_read_and_sorted() {
    let table = csv(MIXED);
    assert_eq!(names(&table), [Some("T0"), Some("T1")]);
    let contents: Vec<&Content> = table.targets.iter().flat_map(|t| &t.packets).map(|p| &p.content).collect();
    assert_eq!(
        contents,
        [
            &Content::Position([Some(1.0), Some(2.0), None]),
            &Content::Rssi { anchor: 2, value_dbm: -70.5 },
            &Content::Bearing { anchor: 2, value_rad: 0.1 },
            &Content::Range { anchor: 0, value_m: 1.25 },
            &Content::Range { anchor: 1, value_m: 2.5 },
            &Content::Tdoa { anchor: 1, reference: 2, value_m: -0.75 },
        ]
    );
    let first = &table.targets[1].packets[0];
    assert_eq!((first.t_s, first.sd, first.seq, first.received_s, first.line), (0.5, Some(0.1), Some(1), Some(0.6), 2));
    assert_eq!((table.time, table.has_target, table.origin), (TimeForm::Seconds, true, None));
    // The third row belongs to another target; only a row older than one of its own target is late.
    assert_eq!((table.counts.rows, table.counts.out_of_order), (6, 0));
    assert_eq!(table.counts.ignored_columns, ["note"]);
    assert_eq!(table.anchors.position_m(2), [0.0, 10.0, 2.5]);
}

#[test]
fn harmless_oddities_change_nothing() {
    let plain = without_lines(csv(MIXED));
    let body = MIXED.trim_end();
    let blank_lines = format!("\n{}\n\n", MIXED.replace('\n', "\n\n"));
    let spaces = MIXED.replace("0.5,T1,range", " 0.5 , T1 , range ");
    let quoted = MIXED.replace("0.5,T1,range", "\"0.5\",\"T1\",\"range\"");
    let odd = [
        MIXED.replace('\n', "\r\n"),
        format!("{}\r\n\r\n", body.replace('\n', "\r\n")),
        format!("\u{feff}{MIXED}"),
        format!("\u{feff}{}", body.replace('\n', "\r\n")),
        body.to_owned(),
        blank_lines,
        spaces,
        quoted,
    ];
    for text in odd {
        assert_eq!(without_lines(csv(&text)), plain, "{text:?}");
    }
    // Without a telling extension the first bytes tell.
    let sniffed = read("measurements", MIXED.as_bytes(), &ReadOptions::default()).unwrap();
    assert_eq!(without_lines(sniffed), plain);
}

#[test]
fn any_order_of_rows_gives_the_same_table() {
    let dated = "t,target,lat,lon,alt\n2025-03-01T12:00:03.5Z,b,47.1,8.1,400\n2025-03-01T12:00:01.25Z,b,47.2,8.2,\n2025-03-01T12:00:01.25Z,a,47.3,8.3,410\n2025-03-01T12:00:02.125Z,a,47.4,8.4,\n2025-03-01T12:00:02.125Z,a,47.4,8.4,\n";
    for text in [
        MIXED,
        dated,
        "k,z1,u1\n3,1,0\n0,2,1\n1,,\n7,4,2\n",
        "t,z1,z2\n0.5,1,\n0.25,,2\n4,3,3\n",
        "t,x,y,seq\n0,1,2,5\n0,1,2,3\n0,1,2,4\n1,1,2,\n",
    ] {
        let (header, rows) = text.split_once('\n').unwrap();
        let mut rows: Vec<&str> = rows.lines().collect();
        let expected = without_lines(csv(text));
        let mut random = 1_u64;
        for _ in 0..40 {
            for i in (1..rows.len()).rev() {
                // Knuth's MMIX generator; the high bits are the random ones.
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                rows.swap(i, (random >> 33) as usize % (i + 1));
            }
            let shuffled = without_lines(csv(&format!("{header}\n{}\n", rows.join("\n"))));
            assert_eq!(shuffled, expected, "{rows:?}");
        }
    }
}

#[test]
fn repeated_rows_are_dropped_and_counted() {
    let table = csv(
        "t,target,kind,anchor,value,received\n0,a,range,A0,1,3\n0,a,range,A0,1,2\n0,b,range,A0,1,\n0,a,range,A0,1.0,2\n",
    );
    assert_eq!((table.counts.rows, table.counts.duplicates), (4, 2));
    assert_eq!(table.targets[0].packets.len(), 1);
    // Zero has one sign.
    assert_eq!(csv("t,x,y\n0,0,1\n-0.0,0,1\n0,-0,1\n").counts.duplicates, 2);
    // Of several deliveries of one packet the first to arrive is kept.
    assert_eq!(table.targets[0].packets[0].received_s, Some(2.0));
}

#[test]
fn ndjson_and_csv_give_the_same_table() {
    let ndjson = r#"{"t":0.5,"tag":"T1","kind":"range","anchor_id":"A0","value":1.25,"sd":0.1,"seq":1,"received":0.6,"note":"a"}
{"t":0.5,"tag":"T1","kind":"range","anchor_id":"A1","value":"2.5","seq":2.0,"received":0.7,"note":null}

{"t":0.25,"tag":"T0","kind":"position","x":1,"y":2,"z":null,"sd":0.5}
{"t":0.5,"tag":"T1","kind":"tdoa","anchor_id":"A1","anchor_id2":"A2","value":-0.75}
{"t":0.75,"tag":"T0","kind":"rssi","anchor_id":"A2","value":-70.5}
{"value":0.1,"anchor_id":"A2","kind":"bearing","tag":"T0","t":0.75,"note":{"deep":[1,{}]}}"#;
    let expected = without_lines(csv(MIXED));
    for text in [ndjson.to_owned(), format!("\u{feff}{}\r\n", ndjson.replace('\n', "\r\n"))] {
        let table = read("m.ndjson", text.as_bytes(), &ReadOptions::default()).unwrap();
        assert_eq!(table.targets[0].packets[0].line, 4);
        assert_eq!(without_lines(table), expected);
        assert_eq!(without_lines(read("m", text.as_bytes(), &ReadOptions::default()).unwrap()), expected);
    }
}

#[test]
fn parquet_of_pyarrow_and_csv_give_the_same_table() {
    // tests/data/pyarrow.parquet: pyarrow 26.0.1, zstd, row groups of 4; dictionary, timestamp[us, UTC], float32, int32,
    // nulls and a list column. This is what it holds.
    let text = "t,tag,kind,anchor_id,value,x,y,seq,sd,note.list.element
2025-03-01T12:00:00Z,T1,range,A0,1.5,,,0,0.1,
2025-03-01T12:00:00.100001Z,T0,range,A1,2.25,,,1,,
2025-03-01T12:00:00.200002Z,T1,range,A2,3.1,,,2,,
2025-03-01T12:00:00.300003Z,T0,range,A0,4,,,,,
2025-03-01T12:00:00.400004Z,T1,range,A1,5,,,4,,
2025-03-01T12:00:00.500005Z,T0,position,,,7.5,8,5,0.5,
";
    let table = read("m.parquet", include_bytes!("data/pyarrow.parquet"), &ReadOptions::default()).unwrap();
    assert_eq!(table.targets[0].packets.iter().map(|p| p.line).collect::<Vec<_>>(), [2, 4, 6]);
    assert_eq!(without_lines(table), without_lines(csv(text)));
}

#[test]
fn kinds_nobody_asked_for_are_counted_and_need_no_anchors() {
    let text = "t,kind,anchor,value\n0,range,A0,1\n0,rssi,B7,-70\nnever,rssi,B8,?\n";
    let options = ReadOptions { kinds: Some(vec![Kind::Range]), ..ReadOptions::default() };
    let table = read("m.csv", text.as_bytes(), &options).unwrap();
    assert_eq!(table.counts.ignored_kinds, BTreeMap::from([("rssi".to_owned(), 2)]));
    assert_eq!((table.targets.len(), table.targets[0].packets.len(), table.counts.rows), (1, 1, 3));
}

#[test]
fn the_spec_names_columns_and_the_only_kind() {
    let columns = [("t", "timestamp"), ("anchor", "station"), ("value", "dist")];
    let options = ReadOptions {
        columns: columns.map(|(a, b)| (a.to_owned(), b.to_owned())).into(),
        default_kind: Some(Kind::Range),
        latency_s: BTreeMap::from([(Kind::Range, 0.25)]),
        ..ReadOptions::default()
    };
    let table = read("m.csv", b"timestamp,station,dist,t\n10,A1,2.5,99\n", &options).unwrap();
    let packet = &table.targets[0].packets[0];
    assert_eq!((packet.t_s, &packet.content), (9.75, &Content::Range { anchor: 1, value_m: 2.5 }));
    assert_eq!((table.targets[0].target.as_deref(), table.has_target), (None, false));
    assert_eq!(table.counts.ignored_columns, ["t"]);
}

#[test]
fn linear_rows_take_their_index_from_k_from_t_or_from_their_number() {
    let ks = |table: &Table| table.targets[0].packets.iter().map(|p| (p.k.unwrap(), p.t_s)).collect::<Vec<_>>();
    let table = csv("k,z1\n4,1\n0,\n2,3\n");
    assert_eq!((ks(&table), table.time), (vec![(0, 0.0), (2, 2.0), (4, 4.0)], TimeForm::Index));
    let table = csv("t,z1\n4.5,1\n0.5,\n2.5,3\n");
    assert_eq!((ks(&table), table.time), (vec![(0, 0.5), (1, 2.5), (2, 4.5)], TimeForm::Seconds));
    let table = csv("z1,z2\n1,2\n,\n3,4\n");
    assert_eq!((ks(&table), table.time), (vec![(0, 0.0), (1, 1.0), (2, 2.0)], TimeForm::Index));
    assert_eq!(table.targets[0].packets[1].content, Content::Linear { z: vec![None, None], u: vec![] });
    // A table of one column writes a lost value as "".
    let table = csv("z1\n1\n\"\"\n3\n\n");
    assert_eq!(ks(&table).len(), 3);
    let table = csv("target,z1\nb,1\na,2\nb,3\n");
    assert_eq!((ks(&table).len(), table.targets[1].packets[1].k), (1, Some(1)));
    // A bad row that is skipped still was an instant.
    let options = ReadOptions { skip_bad_rows: true, ..ReadOptions::default() };
    for text in ["z1,z2\n1,2\nx,\n3,4\n", "z1,z2\n1,2\nx\n3,4\n"] {
        assert_eq!(ks(&read("m.csv", text.as_bytes(), &options).unwrap()), [(0, 0.0), (2, 2.0)]);
    }
}

#[test]
fn empty_inputs_are_no_input_and_lost_components_are_absent() {
    let options = ReadOptions { linear: Some(LinearShape { q: 2, p_u: 1 }), ..ReadOptions::default() };
    let table = read("m.csv", b"k,z1,z2,u1,u2\n0,1,,5,9\n1,,,,\n", &options).unwrap();
    let contents: Vec<_> = table.targets[0].packets.iter().map(|p| p.content.clone()).collect();
    assert_eq!(contents[0], Content::Linear { z: vec![Some(1.0), None], u: vec![5.0] });
    assert_eq!(contents[1], Content::Linear { z: vec![None, None], u: vec![0.0] });
    assert_eq!(table.counts.ignored_columns, ["u2"]);
}

#[test]
fn dates_become_seconds_and_come_back() {
    let table = csv(
        "t,x,y\n2025-03-01T13:00:00.5+01:00,1,2\n2025-03-01T12:59:58.000000001+01:00,1,2\n2025-03-01T13:00:00.123456+01:00,1,2\n",
    );
    assert_eq!(table.time, TimeForm::Rfc3339 { epoch_unix_s: 1_740_830_398, offset_s: 3600 });
    let packets = &table.targets[0].packets;
    assert_eq!(packets.iter().map(|p| p.t_s).collect::<Vec<_>>(), [1e-9, 2.123456, 2.5]);
    let texts: Vec<String> = packets.iter().map(|p| table.time.text(p.t_s)).collect();
    assert_eq!(
        texts,
        ["2025-03-01T12:59:58.000000001+01:00", "2025-03-01T13:00:00.123456+01:00", "2025-03-01T13:00:00.500+01:00"]
    );
    // Offsets that differ are written in UTC, a year away a microsecond is still one.
    let table = csv("t,x,y\n2025-03-01T13:00:00+01:00,1,2\n2026-03-01T12:00:00.000001Z,1,2\n");
    assert_eq!(table.time.text(table.targets[0].packets[1].t_s), "2026-03-01T12:00:00.000001Z");
    assert_eq!(table.time.text(-0.25), "2025-03-01T11:59:59.750Z");
}

#[test]
fn latitudes_become_metres_about_the_earliest_position() {
    let table = csv("t,target,lat,lon,alt\n1,a,47.6,8.7,1234.5\n0,b,47.5,8.5,400\n2,a,47.6,8.7,\n0,c,47.5,8.6,\n");
    let origin = Origin { lat_deg: 47.5, lon_deg: 8.5, alt_m: 400.0 };
    assert_eq!(table.origin, Some(origin));
    let position = |i: usize, j: usize| match table.targets[i].packets[j].content {
        Content::Position(p) => p,
        _ => panic!("a position"),
    };
    assert_eq!(position(1, 0), [Some(0.0), Some(0.0), Some(0.0)]);
    // PROJ 9.5.1; both round coordinates of 6.4e6 m.
    for (got, proj) in position(0, 0).into_iter().zip([15042.952262362542, 11139.662407955759, 807.0580977171767]) {
        assert!((got.unwrap() - proj).abs() < 5e-9, "{got:?} {proj}");
    }
    let level = geo::enu_from_wgs84(&origin, 47.6, 8.7, 400.0);
    assert_eq!(position(0, 1), [Some(level[0]), Some(level[1]), None]);
}

#[test]
fn truth_is_read_in_the_frame_and_time_of_the_table() {
    let folder = Folder::new(&[
        ("local.csv", b"t,tag,x,y,z,n\n1,b,1,2,3,q\n0,b,4,5,,q\n0,a,6,7,8,q\n0,b,4,5,,q\n"),
        ("only.csv", b"t,x,y\n0.5,1,2\n"),
        ("earth.ndjson", b"{\"t\":\"2025-03-01T12:00:01.5Z\",\"lat\":47.5,\"lon\":8.5}\n"),
    ]);
    let two = csv("t,target,x,y\n0,a,1,2\n0,b,1,2\n");
    let truth = read_truth(&folder.path("local.csv"), &two).unwrap();
    assert_eq!(truth.iter().map(|t| t.target.as_deref()).collect::<Vec<_>>(), [Some("a"), Some("b")]);
    let points: Vec<_> = truth[1].points.iter().map(|p| (p.t_s, p.position_m)).collect();
    assert_eq!(points, [(0.0, [Some(4.0), Some(5.0), None]), (1.0, [Some(1.0), Some(2.0), Some(3.0)])]);
    // A truth without target column is about the only target.
    let one = csv("t,target,x,y\n0,a,1,2\n");
    assert_eq!(read_truth(&folder.path("only.csv"), &one).unwrap()[0].target.as_deref(), Some("a"));
    let earth = csv("t,lat,lon\n2025-03-01T12:00:00.25Z,47.5,8.5\n");
    let truth = read_truth(&folder.path("earth.ndjson"), &earth).unwrap();
    assert_eq!((truth[0].points[0].t_s, truth[0].points[0].position_m), (1.5, [Some(0.0), Some(0.0), None]));
}

#[test]
fn progress_ends_at_the_size_of_the_file() {
    let mut text = "t,x,y\n".to_owned();
    (0..400_000).for_each(|i| text.push_str(&format!("{i},1,2\n")));
    let folder = Folder::new(&[("m.csv", text.as_bytes())]);
    let mut calls = Vec::new();
    read_table(&Input::File(folder.path("m.csv")), None, &ReadOptions::default(), &mut |done, total| {
        calls.push((done, total));
    })
    .unwrap();
    let size = text.len() as u64;
    assert!(calls.len() >= 3 && calls.windows(2).all(|c| c[0].0 <= c[1].0), "{calls:?}");
    assert_eq!(calls.last(), Some(&(size, size)));
}

#[test]
fn tracks_come_in_table_order_and_the_first_error_wins_on_any_number_of_threads() {
    let rows: String = (0..50).map(|i| format!("0,{i:02},1,2\n")).collect();
    let table = csv(&format!("t,target,x,y\n{rows}"));
    for threads in [1, 2, 7] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let done = std::sync::atomic::AtomicU64::new(0);
        let count = |n: u64| {
            done.fetch_add(n, std::sync::atomic::Ordering::Relaxed);
        };
        let make = |t: &fixtrail_track::target::TargetPackets| {
            Ok::<_, String>(TargetTrail {
                target: t.target.clone(),
                trail: Trail::new(2, false),
                link: Default::default(),
            })
        };
        let trails = pool.install(|| run_tracks(&table, make, &count)).unwrap();
        assert!(trails.iter().zip(&table.targets).all(|(a, b)| a.target == b.target));
        assert_eq!(done.load(std::sync::atomic::Ordering::Relaxed), 50);
        let fails = |t: &fixtrail_track::target::TargetPackets| match t.target.as_deref() {
            Some(id @ ("17" | "03" | "44")) => Err(id.to_owned()),
            _ => make(t),
        };
        assert_eq!(pool.install(|| run_tracks(&table, fails, &|_| {})).unwrap_err(), "03");
    }
}
