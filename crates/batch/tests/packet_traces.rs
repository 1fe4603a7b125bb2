//! Packet traces: what is read of them in every format, what is refused, and the real ones.

mod common;

use common::Folder;
use fixtrail_batch::read_packet_trace;
use fixtrail_track::error::BuildError;
use fixtrail_track::survey::Loss;
use fixtrail_track::trace::{TraceLink, TracePacket};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int32Type};
use parquet::file::writer::SerializedFileWriter;
use parquet::schema::parser::parse_message_type;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

const LOST: TracePacket = TracePacket { received: false, delay_s: 0.0, copies: 0 };

fn received(delay_s: f64, copies: u32) -> TracePacket {
    TracePacket { received: true, delay_s, copies }
}

fn link(name: &str, packets: &[TracePacket]) -> TraceLink {
    TraceLink { link: name.to_owned(), packets: packets.to_vec() }
}

fn read(name: &str, bytes: &[u8]) -> Result<Vec<TraceLink>, BuildError> {
    let folder = Folder::new(&[(name, bytes)]);
    read_packet_trace(&folder.path(name))
}

/// The trace that every format below tells.
fn two_links() -> Vec<TraceLink> {
    vec![link("m2.0", &[received(0.25, 1), LOST, received(1.5, 3)]), link("m1", &[LOST, received(0.0, 1)])]
}

#[test]
fn links_come_in_order_of_first_appearance_with_packets_in_order_of_rows() {
    let text = "\
link,seq,received,t_arr,delay,copies
m2.0,7,1,0.25,0.25,1
m1,1,0,,,0
m2.0,8,0,,,
m1,2,1,9,0,
m2.0,3,1,1.5,1.5,3
";
    assert_eq!(read("p.csv", text.as_bytes()).unwrap(), two_links());
    assert_eq!(read("p.csv", text.replace('\n', "\r\n").as_bytes()).unwrap(), two_links());
}

#[test]
fn objects_tell_the_same_trace_whatever_keys_they_leave_out() {
    let text = br#"{"received": 1, "link": "m2.0", "delay": 0.25}
{"link": "m1", "received": 0, "delay": null, "copies": 0, "hops": [1, 2]}
{"link": "m2.0", "received": 0.0}
{"link": "m1", "received": "1", "delay": 0}
{"link": "m2.0", "received": 1, "delay": 1.5, "copies": 3}
"#;
    assert_eq!(read("p.ndjson", text).unwrap(), two_links());
}

#[test]
fn parquet_tells_the_same_trace() {
    let schema = "message trace { required binary link (UTF8); required int32 received; optional double delay; }";
    let mut bytes = Vec::new();
    let schema = Arc::new(parse_message_type(schema).unwrap());
    let mut file = SerializedFileWriter::new(&mut bytes, schema, Arc::default()).unwrap();
    let mut group = file.next_row_group().unwrap();
    let mut column = group.next_column().unwrap().unwrap();
    let links = ["b", "a", "b", "b"].map(ByteArray::from);
    column.typed::<ByteArrayType>().write_batch(&links, None, None).unwrap();
    column.close().unwrap();
    let mut column = group.next_column().unwrap().unwrap();
    column.typed::<Int32Type>().write_batch(&[1, 1, 0, 1], None, None).unwrap();
    column.close().unwrap();
    let mut column = group.next_column().unwrap().unwrap();
    column.typed::<DoubleType>().write_batch(&[0.25, 0.5, 0.75], Some(&[1, 1, 0, 1]), None).unwrap();
    column.close().unwrap();
    group.close().unwrap();
    file.close().unwrap();
    let expected = [link("b", &[received(0.25, 1), LOST, received(0.75, 1)]), link("a", &[received(0.5, 1)])];
    assert_eq!(read("p.parquet", &bytes).unwrap(), expected);
}

#[test]
fn trace_without_delays_and_copies_arrives_at_once_and_once() {
    let links = read("p.csv", b"received,link\n1,5\n0,5\n1,5\n").unwrap();
    assert_eq!(links, [link("5", &[received(0.0, 1), LOST, received(0.0, 1)])]);
}

#[test]
fn what_a_table_says_of_the_delay_and_the_copies_of_a_lost_packet_is_ignored() {
    let links = read("p.csv", b"link,received,delay,copies\na,0,4.5,2\n").unwrap();
    assert_eq!(links, [link("a", &[LOST])]);
}

#[test]
fn broken_traces_end_in_one_sentence() {
    let cases: &[(&str, &[u8], &[&str])] = &[
        ("p.csv", b"", &["p.csv: is empty"]),
        ("p.csv", b"link,received\n", &["header but no rows"]),
        ("p.ndjson", b"\n", &["no rows"]),
        (
            "p.csv",
            b"link,delay\na,1\n",
            &["p.csv:1: `received`: is missing", "needs `link`, `received`", "`link`, `delay`"],
        ),
        ("p.csv", b"received\n1\n", &["p.csv:1: `link`: is missing"]),
        ("p.csv", b"link,received,link\na,1,a\n", &["p.csv:1: `link`", "columns 1 and 3"]),
        ("p.csv", b"link,received\na,1\n,1\n", &["p.csv:3: `link`", "is empty", "id of a link"]),
        ("p.csv", b"link,received\na,1\na,2\n", &["p.csv:3: `received`", "`2`", "expected 0 for a lost packet or 1"]),
        ("p.csv", b"link,received\na,\n", &["p.csv:2: `received`", "is empty", "expected 0 for a lost packet or 1"]),
        ("p.csv", b"link,received\na,yes\n", &["p.csv:2: `received`", "`yes`", "expected 0 for a lost packet or 1"]),
        ("p.csv", b"link,received\na,0.5\n", &["p.csv:2: `received`", "`0.5`", "expected 0 for a lost packet or 1"]),
        ("p.csv", b"link,received\na,-1\n", &["p.csv:2: `received`", "`-1`", "expected 0 for a lost packet or 1"]),
        ("p.ndjson", b"{\"link\":\"a\",\"received\":true}\n", &["p.ndjson:1: `received`", "a Boolean"]),
        ("p.ndjson", b"{\"link\":\"a\"}\n", &["p.ndjson:1: `received`", "is empty"]),
        ("p.csv", b"link,received,delay\na,1,-0.25\n", &["p.csv:2: `delay`", "`-0.25`", "a delay of 0 s or more"]),
        ("p.csv", b"link,received,delay\na,0,-0.25\n", &["p.csv:2: `delay`", "`-0.25`", "a delay of 0 s or more"]),
        ("p.csv", b"link,received,delay\na,1,soon\n", &["p.csv:2: `delay`", "`soon`", "a delay of 0 s or more"]),
        ("p.csv", b"link,received,delay\na,1,nan\n", &["p.csv:2: `delay`", "`nan`", "finite"]),
        ("p.csv", b"link,received,delay\na,1,2e12\n", &["p.csv:2: `delay`", "`2e12`", "too large"]),
        ("p.csv", b"link,received,delay\na,0,\na,1,\na,1,\n", &["p.csv:3: `delay`", "is empty", "packet that arrived"]),
        (
            "p.ndjson",
            b"{\"link\":\"a\",\"received\":1}\n{\"link\":\"a\",\"received\":1,\"delay\":2}\n",
            &["p.ndjson:1: `delay`", "is empty", "packet that arrived"],
        ),
        ("p.csv", b"link,received,copies\na,1,0\n", &["p.csv:2: `copies`", "`0`", "at least 1"]),
        ("p.csv", b"link,received,copies\na,1,1.5\n", &["p.csv:2: `copies`", "`1.5`", "number of copies"]),
        (
            "p.csv",
            b"link,received,copies\na,1,4294967296\n",
            &["p.csv:2: `copies`", "`4294967296`", "at most 4294967295"],
        ),
        ("p.csv", b"link,received\na,1,1\n", &["p.csv:2", "has 3 cells"]),
    ];
    for (name, bytes, fragments) in cases {
        let shown = String::from_utf8_lossy(bytes);
        let message = match read(name, bytes) {
            Ok(_) => panic!("no error for {shown:?}"),
            Err(error) => error.to_string(),
        };
        for fragment in *fragments {
            assert!(message.contains(fragment), "{shown:?}: no {fragment:?} in: {message}");
        }
        assert!(!message.contains('\n') && !message.ends_with('.'), "not one sentence: {message}");
    }
}

/// The folder of the recordings, if it is there; says so when it is not.
fn recordings() -> Option<PathBuf> {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let folder = workspace.join(std::env::var_os("FIXTRAIL_DATA").unwrap_or("../shared/data".into()));
    if folder.is_dir() {
        return Some(folder);
    }
    // Past the captured output of a test, which nobody sees when the test passes.
    let mut terminal = std::io::stderr();
    writeln!(terminal, "skipped: the real packet traces are absent (FIXTRAIL_DATA names their folder)").unwrap();
    None
}

#[test]
fn real_traces_have_the_packets_losses_delays_and_copies_that_another_reader_counts() {
    let Some(data) = recordings() else { return };
    // Counted by the `csv` module of Python: rows, links, lost, copies beyond the first, longest delay in s. The numbers are
    // counts or stand in the file, so there is no tolerance.
    let expected = [
        ("wsn_tsch_trace/tdma_high_load", 7596, 16, 2254, 1064, 118.365),
        ("wsn_tsch_trace/tdma_interference", 25899, 22, 2549, 4153, 85.365),
        ("sigfox_loss_trace/location0", 400, 4, 56, 0, 0.0),
        ("sigfox_loss_trace/office_sfxlib_norep_randfreq_randgain", 5000, 1, 351, 0, 0.0),
    ];
    for (name, rows, links, lost, repeated, longest_s) in expected {
        let trace = read_packet_trace(&data.join(name).join("packets.csv")).unwrap();
        let packets = || trace.iter().flat_map(|l| &l.packets);
        let losses: Vec<Loss> = trace.iter().map(|l| Loss::of(l.packets.iter().map(|p| !p.received))).collect();
        assert_eq!(losses.iter().map(|l| l.expected).sum::<u64>(), rows, "{name}");
        assert_eq!(losses.iter().map(|l| l.lost).sum::<u64>(), lost, "{name}");
        assert_eq!(trace.len(), links, "{name}");
        assert_eq!(packets().map(|p| p.copies.saturating_sub(1)).sum::<u32>(), repeated, "{name}");
        assert_eq!(packets().map(|p| p.delay_s).fold(0.0, f64::max), longest_s, "{name}");
    }
}
