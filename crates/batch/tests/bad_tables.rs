//! Broken tables: each ends in one sentence with file, line, column, value and expectation.

mod common;

use common::{ANCHORS, Folder, read};
use fixtrail_batch::{Input, LinearShape, ReadOptions, read_table, read_truth};
use fixtrail_track::packet::Kind;
use std::collections::BTreeMap;

/// Name of the file, its bytes, and what the message must contain.
type Case<'a> = (&'a str, &'a [u8], &'a [&'a str]);

fn assert_messages(cases: &[Case<'_>], options: &ReadOptions) {
    for (name, bytes, fragments) in cases {
        let shown = String::from_utf8_lossy(bytes);
        let message = match read(name, bytes, options) {
            Ok(_) => panic!("no error for {shown:?}"),
            Err(error) => error.to_string(),
        };
        for fragment in fragments.iter().chain([name]) {
            assert!(message.contains(fragment), "{shown:?}: no {fragment:?} in: {message}");
        }
        assert!(!message.contains('\n') && !message.ends_with('.'), "not one sentence: {message}");
    }
}

#[test]
fn broken_tables_end_in_one_sentence() {
    let cases: &[Case<'_>] = &[
        // As a file.
        ("m.csv", b"", &["is empty", "expected a table"]),
        ("m.csv", b"\n\n", &["no header"]),
        ("m.csv", b"\xEF\xBB\xBF", &["no header"]),
        ("m.csv", b"t,x,y\n", &["header but no rows"]),
        ("m.csv", b"t,x,y\r\n\r\n", &["header but no rows"]),
        ("m.csv", b"t,x,y\n1,2,3\n2,\xFF,3\n", &["m.csv:3", "cell 2", "not UTF-8"]),
        ("m.csv", b"t,\xFF,y\n1,2,3\n", &["m.csv:1", "cell 2", "not UTF-8"]),
        ("m.ndjson", b"", &["is empty"]),
        ("m.ndjson", b"\n \n", &["no rows"]),
        ("m.ndjson", b"{\"t\":0,\"x\":1,\"y\":2}\n{\"t\":1,\"x\":\xFF}\n", &["m.ndjson:2", "not UTF-8"]),
        ("m.ndjson", b"[1,2]\n", &["m.ndjson:1", "`[1,2]`", "expected a JSON object"]),
        ("m.ndjson", b"{\"t\":0,\"x\":1,\"y\":2}\n{\"t\":1,\"x\":1,", &["m.ndjson:2", "expected a JSON object", "EOF"]),
        ("m.ndjson", b"{\"t\":0,\"x\":NaN,\"y\":2}\n", &["m.ndjson:1", "NaN", "expected a JSON object"]),
        ("m.ndjson", b"{\"t\":0,\"x\":1,\"x\":2,\"y\":2}\n", &["m.ndjson:1", "key `x` stands twice"]),
        ("m.ndjson", b"{\"t\":0,\"x\":1e999,\"y\":2}\n", &["m.ndjson:1", "1e999", "out of range"]),
        ("m.ndjson", b"{\"t\":0,\"x\":true,\"y\":2}\n", &["m.ndjson:1: `x`", "a Boolean", "expected metres"]),
        ("m.ndjson", b"{\"t\":0,\"x\":[1],\"y\":2}\n", &["m.ndjson:1: `x`", "a list", "expected metres"]),
        ("m.parquet", b"PAR1 and nothing more", &["no complete Parquet file"]),
        ("m.parquet", b"t,x,y\n1,2,3\n", &["no complete Parquet file"]),
        // The header.
        ("m.csv", b"t,x,x\n1,2,3\n", &["m.csv:1: `x`", "columns 2 and 3", "each name once"]),
        ("m.csv", b"t,tag,target,x,y\n1,a,a,2,3\n", &["`tag`", "beside `target`", "one of the two"]),
        ("m.csv", b"t,kind,anchor,anchor_id,value\n1,range,A0,A0,3\n", &["`anchor_id`", "beside `anchor`"]),
        ("m.csv", b"time,x,y\n1,2,3\n", &["m.csv:1: `t`: is missing", "`time`, `x`, `y`", "[columns]"]),
        ("m.csv", b"t,anchor,value\n1,A0,3\n", &["`kind`", "`anchor`, `value`", "expected a column `kind`"]),
        ("m.csv", b"t,foo\n1,2\n", &["`kind`: is missing", "no measurement", "`t`, `foo`"]),
        ("m.csv", b"t,lat\n1,47\n", &["`lon`: is missing", "beside `lat`"]),
        ("m.csv", b"t;x;y\n1;2;3\n", &["is missing", "`t;x;y`"]),
        ("m.csv", b"k,z1,z3\n1,2,3\n", &["`z2`: is missing", "`z1` … `z3`"]),
        ("m.csv", b"k,z99999999999999999\n1,2\n", &["`z1`: is missing"]),
        // Rows.
        ("m.csv", b"t,x,y\n1,2\n", &["m.csv:2", "has 2 cells", "`1,2`", "expected 3"]),
        ("m.csv", b"t,x,y\n1,2,3\n1,2,3,4\n", &["m.csv:3", "has 4 cells", "expected 3"]),
        ("m.csv", b"t,x,y\n1,2,3\n\n2,abc,3\n", &["m.csv:4: `x`", "`abc`", "expected metres"]),
        ("m.csv", b"t,x,y\r\n1,2,3\r\n\r\n2,abc,3\r\n", &["m.csv:4: `x`", "`abc`", "expected metres"]),
        ("m.csv", b"t,x,y\n\"1\",\"2\n\",3\n2,abc,3", &["m.csv:4: `x`", "`abc`"]),
        // A record over two lines is named by its first.
        ("m.csv", b"t,x,y\n1,2,3\n\"2\n\",abc,3\n", &["m.csv:3: `x`", "`abc`"]),
        ("m.csv", b"t,x,y\n1,nan,3\n", &["m.csv:2: `x`", "`nan`", "finite", "lost value is an empty cell"]),
        ("m.csv", b"t,x,y\n1,-inf,3\n", &["m.csv:2: `x`", "`-inf`", "finite"]),
        ("m.csv", b"t,x,y\n1,2e300,3\n", &["m.csv:2: `x`", "`2e300`", "too large", "1e12"]),
        ("m.csv", b"t,x,y\n1700000000000,2,3\n", &["m.csv:2: `t`", "`1700000000000`", "too large"]),
        ("m.csv", b"t,x,y\nnan,2,3\n", &["m.csv:2: `t`", "`nan`", "expected a time in seconds or RFC 3339"]),
        ("m.csv", b"t,x,y\n,2,3\n", &["m.csv:2: `t`", "is empty", "expected a time"]),
        ("m.csv", b"t,x,y\nyesterday,2,3\n", &["m.csv:2: `t`", "`yesterday`", "RFC 3339"]),
        ("m.csv", b"t,x,y\n2025-03-01T12:00:00,2,3\n", &["m.csv:2: `t`", "`2025-03-01T12:00:00`", "offset"]),
        ("m.csv", b"t,x,y\n2025-02-30T12:00:00Z,2,3\n", &["m.csv:2: `t`", "`2025-02-30T12:00:00Z`", "RFC 3339"]),
        (
            "m.csv",
            b"t,x,y\n0,1,2\n2025-03-01T12:00:00Z,2,3\n",
            &["m.csv:3: `t`", "2025-03-01T12:00:00Z", "line 2 has seconds"],
        ),
        (
            "m.csv",
            b"t,x,y,received\n0,1,2,2025-03-01T12:00:00Z\n",
            &["m.csv:2: `received`", "seconds", "one form of time"],
        ),
        ("m.csv", b"t,x,y\n1,,\n", &["m.csv:2: `x`", "is empty", "expected metres"]),
        ("m.csv", b"t,target,x,y\n1,,2,3\n", &["m.csv:2: `target`", "is empty", "expected the id of a target"]),
        ("m.csv", b"t,x,y,sd\n1,2,3,0\n", &["m.csv:2: `sd`", "`0.0`", "positive"]),
        ("m.csv", b"t,x,y,sd\n1,2,3,-1\n", &["m.csv:2: `sd`", "`-1.0`", "positive"]),
        ("m.csv", b"t,x,y,seq\n1,2,3,-7\n", &["m.csv:2: `seq`", "`-7`", "whole number from 0"]),
        ("m.csv", b"t,kind,anchor,value\n1,rang,A0,3\n", &["m.csv:2: `kind`", "`rang`", "`position`, `range`"]),
        ("m.csv", b"t,kind,anchor,value\n1,,A0,3\n", &["m.csv:2: `kind`", "is empty", "`range`"]),
        (
            "m.csv",
            b"t,kind,anchor,value\n1,range,A9,3\n",
            &["m.csv:2: `anchor`", "unknown anchor `A9`", "`A0`, `A1`, `A2`"],
        ),
        ("m.csv", b"t,kind,anchor,value\n1,range,,3\n", &["m.csv:2: `anchor`", "is empty", "kind `range`"]),
        ("m.csv", b"t,kind,anchor,value\n1,range,A0,\n", &["m.csv:2: `value`", "is empty", "a range in metres"]),
        ("m.csv", b"t,kind,anchor,value\n1,range,A0,-3\n", &["m.csv:2: `value`", "`-3.0`", "0 m or more"]),
        ("m.csv", b"t,kind,anchor,anchor2,value\n1,tdoa,A0,A0,3\n", &["m.csv:2: `anchor2`", "`A0`", "another anchor"]),
        ("m.csv", b"t,lat,lon\n1,91,8\n", &["m.csv:2: `lat`", "`91.0`", "-90 to 90"]),
        ("m.csv", b"t,lat,lon\n1,47,-181\n", &["m.csv:2: `lon`", "`-181.0`", "-180 to 180"]),
        ("m.csv", b"t,lat,lon\n1,47,\n", &["m.csv:2: `lon`", "is empty", "degrees"]),
        ("m.csv", b"t,x,y,lat,lon\n1,1,2,47,8\n", &["m.csv:2: `lat`", "one form of position"]),
        ("m.csv", b"t,x,y,lat,lon\n1,1,2,,\n2,,,47,8\n", &["m.csv:3: `lat`", "line 2 has `x` and `y`"]),
        (
            "m.csv",
            b"t,kind,anchor,value,lat,lon\n1,position,,,47,8\n1,range,A0,3,,\n",
            &["m.csv:3: `anchor`", "one frame"],
        ),
        // Rows against each other.
        (
            "m.csv",
            b"t,target,kind,anchor,value\n1,T0,range,A0,3\n1,T0,range,A1,3\n1,T0,range,A0,4\n",
            &["m.csv:4", "`4.0`", "target `T0`", "anchor `A0`", "line 2 says", "`3.0`", "one value"],
        ),
        ("m.csv", b"t,x,y\n1,2,3\n1,2,4\n", &["m.csv:3", "`2.0, 4.0, -`", "line 2 says", "`2.0, 3.0, -`"]),
        ("m.csv", b"t,x,y,sd\n1,2,3,1\n1,2,3,2\n", &["m.csv:3", "sd 2.0", "line 2", "sd 1.0"]),
        ("m.csv", b"k,z1\n0,1\n0,2\n", &["m.csv:3", "k = 0", "`2.0`", "line 2 says", "`1.0`"]),
        ("m.csv", b"k,z1\n-1,1\n", &["m.csv:2: `k`", "`-1`", "whole number from 0"]),
        ("m.csv", b"k,z1\n0.5,1\n", &["m.csv:2: `k`", "`0.5`", "whole number from 0"]),
        ("m.csv", b"k,z1\n,1\n", &["m.csv:2: `k`", "is empty", "time index"]),
        (
            "m.csv",
            b"k,z1\n0,1\n1700000000,1\n",
            &["m.csv:3: `k`", "is 1700000000", "1699999999 rows", "at most 10000000"],
        ),
        ("m.csv", b"k,t,z1\n0,5,1\n1,4,1\n", &["m.csv:3: `t`", "k = 1", "line 2", "order of k"]),
        ("m.csv", b"k,z1,u1,u2\n0,1,,3\n", &["m.csv:2: `u1`", "is empty beside other inputs"]),
        ("m.csv", b"z1\n1\n\n2\n", &["m.csv:3", "blank", "lost value"]),
    ];
    assert_messages(cases, &ReadOptions::default());
}

#[test]
fn tables_that_do_not_fit_the_linear_model_end_in_one_sentence() {
    let options = ReadOptions {
        default_kind: Some(Kind::Linear),
        linear: Some(LinearShape { q: 2, p_u: 1 }),
        ..ReadOptions::default()
    };
    let cases: &[Case<'_>] = &[
        ("m.csv", b"k,z1,u1\n0,1,0\n", &["`z2`: is missing", "2 rows of C"]),
        ("m.csv", b"k,z1,z2,z3,u1\n0,1,0,0,0\n", &["`z3`", "one too many", "2 rows"]),
        ("m.csv", b"k,z1,z2\n0,1,0\n", &["`u1`: is missing", "1 columns of B"]),
        ("m.ndjson", b"{\"k\":0,\"z1\":1,\"u1\":0}\n", &["`z2`: is missing"]),
        ("m.csv", b"k,z1,z2,u1\n0,1,x,0\n", &["m.csv:2: `z2`", "`x`", "expected a number"]),
    ];
    assert_messages(cases, &options);
}

#[test]
fn columns_of_the_spec_must_be_there() {
    let columns = BTreeMap::from([("t".to_owned(), "timestamp".to_owned())]);
    let options = ReadOptions { columns, ..ReadOptions::default() };
    assert_messages(
        &[("m.csv", b"t,x,y\n1,2,3\n", &["`timestamp`: is missing", "holds `t`", "`t`, `x`, `y`"])],
        &options,
    );
    let columns = BTreeMap::from([("tiem".to_owned(), "t".to_owned())]);
    let options = ReadOptions { columns, ..ReadOptions::default() };
    assert_messages(
        &[("m.csv", b"t,x,y\n1,2,3\n", &["`tiem`", "`[columns]`", "expected one of `t`, `target`"])],
        &options,
    );
    // The message speaks of the file's own column.
    let columns = BTreeMap::from([("x".to_owned(), "east".to_owned())]);
    let options = ReadOptions { columns, ..ReadOptions::default() };
    assert_messages(&[("m.csv", b"t,east,y\n1,q,3\n", &["m.csv:2: `east`", "`q`"])], &options);
}

#[test]
fn missing_files_and_folders_end_in_one_sentence() {
    let folder = Folder::new(&[]);
    for (path, fragments) in [
        (folder.path("no.csv"), ["no.csv", "cannot be read", "No such file"]),
        (folder.path(""), ["", "directory", "expected a table"]),
    ] {
        let message =
            read_table(&Input::File(path), None, &ReadOptions::default(), &mut |_, _| {}).unwrap_err().to_string();
        for fragment in fragments {
            assert!(message.contains(fragment), "no {fragment:?} in {message}");
        }
    }
}

#[test]
fn broken_anchors_end_in_one_sentence() {
    let table = b"t,kind,anchor,value\n1,range,A0,3\n";
    for (anchors, fragments) in [
        ("", ["anchors.csv", "is empty"]),
        ("anchor,x\nA0,1\n", ["`y`: is missing", "`anchor`, `x`"]),
        ("anchor,x,y,z\nA0,1,,2\n", ["anchors.csv:2: `y`", "is empty"]),
        ("anchor,x,y,z\nA0,1,east,2\n", ["anchors.csv:2: `y`", "`east`"]),
        ("anchor,x,y,z\n,1,2,2\n", ["anchors.csv:2: `anchor`", "is empty"]),
        ("anchor,x,y,z\nA0,1,2,2\nA0,1,2,3\n", ["anchors.csv:3: `anchor`", "line 2 puts it elsewhere"]),
        ("anchor,anchor_id,x,y,z\nA0,A0,1,2,2\n", ["`anchor_id`", "beside `anchor`"]),
    ] {
        let folder = Folder::new(&[("m.csv", table), ("anchors.csv", anchors.as_bytes())]);
        let input = Input::File(folder.path("m.csv"));
        let message = read_table(&input, None, &ReadOptions::default(), &mut |_, _| {}).unwrap_err().to_string();
        for fragment in fragments {
            assert!(message.contains(fragment), "no {fragment:?} in {message}");
        }
    }
    let folder = Folder::new(&[("m.csv", table)]);
    let read = |anchors: Option<&std::path::Path>| {
        let input = Input::File(folder.path("m.csv"));
        read_table(&input, anchors, &ReadOptions::default(), &mut |_, _| {}).unwrap_err().to_string()
    };
    let message = read(None);
    assert!(message.contains("m.csv:2: `anchor`") && message.contains("expected an anchors table"), "{message}");
    let message = read(Some(&folder.path("site.csv")));
    assert!(message.contains("site.csv: cannot be read"), "{message}");
}

#[test]
fn broken_truth_ends_in_one_sentence() {
    let folder = Folder::new(&[("anchors.csv", ANCHORS.as_bytes())]);
    let tables = [
        common::csv("t,x,y\n0,1,2\n"),
        common::csv("t,target,x,y\n0,a,1,2\n0,b,1,2\n"),
        common::csv("t,lat,lon\n2025-03-01T12:00:00Z,47,8\n"),
    ];
    for (table, truth, fragments) in [
        (0, "", ["truth.csv", "is empty"]),
        (0, "x,y\n1,2\n", ["`t`: is missing", "`x`, `y`"]),
        (0, "t,y\n1,2\n", ["`x`: is missing", "`t`, `y`"]),
        (0, "t,x,y\n1,2,q\n", ["truth.csv:2: `y`", "`q`"]),
        (0, "t,x,y\n,2,3\n", ["truth.csv:2: `t`", "is empty"]),
        (0, "t,x,y\n1,,\n", ["truth.csv:2: `x`", "is empty"]),
        (0, "t,x,y\n1,2\n", ["truth.csv:2", "has 2 cells"]),
        (0, "t,x,y\n1,2,3\n1,2,4\n", ["truth.csv:3", "line 2"]),
        (0, "t,target,x,y\n1,a,2,3\n1,b,2,4\n", ["`target`", "has 2 targets"]),
        (0, "t,lat,lon\n1,47,8\n", ["truth.csv:2: `lat`", "local metres"]),
        (0, "t,x,y\n2025-03-01T12:00:00Z,2,3\n", ["truth.csv:2: `t`", "expected seconds like the measurements"]),
        (1, "t,x,y\n1,2,3\n", ["`target`: is missing", "2 targets"]),
        (1, "t,target,x,y\n1,,2,3\n", ["truth.csv:2: `target`", "is empty"]),
        (2, "t,lat,lon\n0,47,8\n", ["truth.csv:2: `t`", "expected RFC 3339 like the measurements"]),
        (2, "t,lat,lon\n2025-03-01T12:00:00Z,97,8\n", ["truth.csv:2: `lat`", "-90 to 90"]),
    ] {
        let path = folder.path("truth.csv");
        std::fs::write(&path, truth).unwrap();
        let message = read_truth(&path, &tables[table]).unwrap_err().to_string();
        for fragment in fragments {
            assert!(message.contains(fragment), "{truth:?}: no {fragment:?} in {message}");
        }
    }
}

#[test]
fn skipping_bad_rows_counts_them_and_keeps_the_rest() {
    let text = "t,kind,anchor,value\n0,range,A0,1\n1,range,A9,1\n2,range,A0\n3,range,A0,nan\n4,range,A0,\u{e9}\n5,range,A0,2\n5,range,A0,3\n6,range,A0,4\n";
    let mut bytes = text.as_bytes().to_vec();
    bytes.extend(b"7,range,A0,\xFF\n8,range,A0,5\n");
    let options = ReadOptions { skip_bad_rows: true, ..ReadOptions::default() };
    let table = read("m.csv", &bytes, &options).unwrap();
    let times: Vec<f64> = table.targets[0].packets.iter().map(|p| p.t_s).collect();
    assert_eq!(times, [0.0, 6.0, 8.0]);
    // Five bad by themselves, and two that contradict each other.
    assert_eq!((table.counts.rows, table.counts.skipped_bad), (10, 7));
    let first = table.counts.first_bad.unwrap();
    assert!(first.contains("m.csv:3") && first.contains("A9"), "{first}");
    // What concerns the whole table stays an error, and so does a table with nothing left.
    for (text, fragment) in [
        ("t,x,x\n1,2,3\n", "each name once"),
        ("t,x,y\n0,1,2\n2025-03-01T12:00:00Z,2,3\n", "one form of time"),
        ("t,x,y\nq,1,2\n", "no good row"),
    ] {
        let message = read("m.csv", text.as_bytes(), &options).unwrap_err().to_string();
        assert!(message.contains(fragment), "{message}");
    }
}

#[test]
fn cut_and_flipped_parquet_never_panics() {
    let whole = include_bytes!("data/pyarrow.parquet");
    assert!(read("m.parquet", whole, &ReadOptions::default()).is_ok());
    for len in 0..whole.len() {
        assert!(read("m.parquet", &whole[..len], &ReadOptions::default()).is_err(), "cut at {len}");
    }
    for at in 0..whole.len() {
        let mut flipped = whole.to_vec();
        flipped[at] ^= 0x55;
        // A flip in a value may leave a good table; nothing may panic.
        let _ = read("m.parquet", &flipped, &ReadOptions::default());
    }
}
