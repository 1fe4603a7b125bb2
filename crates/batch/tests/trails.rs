//! Trails out: exact numbers, exact columns, whole files.

mod common;

use common::Folder;
use fixtrail_batch::{Order, OutFormat, Output, TableMeta, TimeForm, WriteError, WriteOptions, write_trails};
use fixtrail_track::fix::{Estimate, Fix, Lagged, Sink, Status};
use fixtrail_track::geo::{self, Origin};
use fixtrail_track::layout::Layout;
use fixtrail_track::target::TargetTrail;
use fixtrail_track::trail::Trail;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::Field;
use serde_json::Value;
use std::path::Path;

const META: TableMeta = TableMeta { time: TimeForm::Seconds, origin: None, has_target: true };
const ORIGIN: Origin = Origin { lat_deg: 47.5, lon_deg: 8.5, alt_m: 400.0 };

/// Numbers whose text is long, short, tiny, huge or subnormal.
const HARD: [f64; 6] = [0.1, 1.0 / 3.0, 1e-300, 6.02214076e23, 5e-324, -123456.78901234567];

fn push(trail: &mut Trail, k: u64, t_s: Option<f64>, mean: Option<&[f64]>, lagged: Option<Lagged<'_>>) {
    let n = trail.n();
    let cov: Vec<f64> = (0..n * n).map(|i| if i / n == i % n { 0.01 * (1 + i) as f64 } else { 1e-3 }).collect();
    let estimate = mean.map(|mean| Estimate { mean, cov: &cov });
    let status = if estimate.is_some() { Status::Updated } else { Status::Unobservable };
    let nis = estimate.map(|_| 1.0 / 3.0);
    trail.fix(&Fix { k, t_s, estimate, status, nis, nis_dof: 2, lagged });
}

fn planar(target: &str, times: &[f64]) -> TargetTrail {
    let mut trail = Trail::new(4, false);
    for (k, t) in times.iter().enumerate() {
        let mean = [HARD[k % 6], *t, HARD[(k + 1) % 6], -0.5];
        push(&mut trail, k as u64, Some(*t), (k != 1).then_some(&mean), None);
    }
    TargetTrail { target: Some(target.to_owned()), trail, link: Default::default() }
}

fn options(path: &Path, covariance: bool) -> WriteOptions {
    let format = OutFormat::of(&Output::File(path.to_owned())).unwrap();
    WriteOptions { covariance, order: Order::Target, format }
}

fn write(name: &str, trails: &[TargetTrail], layout: &Layout, meta: &TableMeta, covariance: bool) -> (Folder, Vec<u8>) {
    let folder = Folder::new(&[]);
    let path = folder.path(name);
    write_trails(&Output::File(path.clone()), trails, layout, *meta, &options(&path, covariance)).unwrap();
    assert_eq!(folder.names(), [name]);
    let bytes = std::fs::read(path).unwrap();
    (folder, bytes)
}

fn text(name: &str, trails: &[TargetTrail], layout: &Layout, meta: &TableMeta, covariance: bool) -> String {
    String::from_utf8(write(name, trails, layout, meta, covariance).1).unwrap()
}

#[test]
fn kinematic_csv_has_the_columns_of_the_contract() {
    let layout = Layout::kinematic(2, 2, &[]);
    let csv = text("out.csv", &[planar("b", &[0.0, 0.5]), planar("a", &[1.0])], &layout, &META, true);
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(
        lines[0],
        "target,t,x,y,vx,vy,sd_x,sd_y,sd_vx,sd_vy,status,nis,p_1_1,p_1_2,p_1_3,p_1_4,p_2_2,p_2_3,p_2_4,p_3_3,p_3_4,p_4_4"
    );
    // Sorted by target; the square roots of 0.01, 0.06, 0.11 and 0.16.
    let sds = [0.01_f64, 0.06, 0.11, 0.16].map(|v| format!("{:?}", v.sqrt())).join(",");
    assert!(
        lines[1]
            .starts_with(&format!("a,1.0,0.1,1.0,0.3333333333333333,-0.5,{sds},updated,0.3333333333333333,0.01,0.001"))
    );
    assert_eq!(lines[3], "b,0.5,,,,,,,,,unobservable,,,,,,,,,,,");
    assert_eq!((lines.len(), csv.ends_with('\n')), (4, true));
}

#[test]
fn a_table_without_targets_leaves_the_cells_empty() {
    let trail = TargetTrail { target: None, ..planar("", &[0.0]) };
    let meta = TableMeta { has_target: false, ..META };
    let csv = text("out.csv", &[trail], &Layout::kinematic(2, 2, &[]), &meta, false);
    assert!(csv.starts_with("target,t,x,y,vx,vy,sd_x,sd_y,sd_vx,sd_vy,status,nis\n,0.0,0.1,"), "{csv}");
}

#[test]
fn smoother_columns_stand_beside_the_filters() {
    let layout = Layout::kinematic(1, 2, &[]);
    let mut trail = Trail::new(2, true);
    push(&mut trail, 0, Some(0.0), Some(&[1.0, 2.0]), None);
    let estimate = Some(Estimate { mean: &[3.0, 4.0], cov: &[4.0, 1.0, 1.0, 9.0] });
    push(
        &mut trail,
        1,
        Some(0.5),
        Some(&[5.0, 6.0]),
        Some(Lagged { k: 0, t_s: Some(0.0), estimate, status: Status::Updated }),
    );
    let lost = Lagged { k: 1, t_s: Some(0.5), estimate: None, status: Status::Unobservable };
    push(&mut trail, 2, Some(1.0), None, Some(lost));
    let trail = TargetTrail { target: Some("a".to_owned()), trail, link: Default::default() };
    let csv = text("out.csv", std::slice::from_ref(&trail), &layout, &META, true);
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(
        lines[0],
        "target,t,x,y,sd_x,sd_y,status,nis,p_1_1,p_1_2,p_2_2,t_lag,x_lag,y_lag,sd_x_lag,sd_y_lag,lag_status,ps_1_1,ps_1_2,ps_2_2"
    );
    assert!(lines[1].ends_with(",0.01,0.001,0.04,,,,,,,,,"), "{}", lines[1]);
    assert!(lines[2].ends_with(",0.01,0.001,0.04,0.0,3.0,4.0,2.0,3.0,updated,4.0,1.0,9.0"), "{}", lines[2]);
    assert_eq!(lines[3], "a,1.0,,,,,unobservable,,,,,0.5,,,,,unobservable,,,");

    let csv = text("out.csv", &[trail], &Layout::linear(2), &TableMeta { has_target: false, ..META }, true);
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines[0], "k,t,x1,x2,status,nis,p_1_1,p_1_2,p_2_2,lag_k,s1,s2,ps_1_1,ps_1_2,ps_2_2,lag_status");
    assert!(lines[2].starts_with("1,0.5,5.0,6.0,updated,"), "{}", lines[2]);
    assert!(lines[2].ends_with(",0,3.0,4.0,4.0,1.0,9.0,updated"), "{}", lines[2]);
    assert_eq!(lines[3], "2,1.0,,,unobservable,,,,,1,,,,,,unobservable");
}

#[test]
fn linear_csv_counts_instants() {
    let mut trail = Trail::new(1, false);
    push(&mut trail, 0, Some(0.0), Some(&[1.5]), None);
    push(&mut trail, 1, None, Some(&[2.5]), None);
    let trails = [TargetTrail { target: None, trail, link: Default::default() }];
    let meta = TableMeta { time: TimeForm::Index, origin: None, has_target: false };
    let third = "0.3333333333333333";
    let csv = text("out.csv", &trails, &Layout::linear(1), &meta, false);
    assert_eq!(csv, format!("k,t,x1,status,nis\n0,0.0,1.5,updated,{third}\n1,1.0,2.5,updated,{third}\n"));
    // With times a lost row has none.
    let csv = text("out.csv", &trails, &Layout::linear(1), &TableMeta { time: TimeForm::Seconds, ..meta }, false);
    assert_eq!(csv, format!("k,t,x1,status,nis\n0,0.0,1.5,updated,{third}\n1,,2.5,updated,{third}\n"));
    let csv = text("out.csv", &trails, &Layout::linear(1), &META, false);
    assert!(csv.starts_with("target,k,t,x1"), "{csv}");
}

#[test]
fn numbers_read_back_to_the_same_bits_from_every_format() {
    let layout = Layout::kinematic(2, 2, &[]);
    let trails = [planar("a \"q\", b", &HARD.map(f64::abs)), planar("b", &[0.0, 1.0, 2.0])];
    let expected: Vec<Option<[u64; 2]>> = trails
        .iter()
        .flat_map(|t| (0..t.trail.len()).map(|row| t.trail.mean(row).map(|m| [m[0].to_bits(), m[2].to_bits()])))
        .collect();

    let (_folder, bytes) = write("out.csv", &trails, &layout, &META, true);
    let mut reader = csv::Reader::from_reader(&bytes[..]);
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    let bits = |r: &csv::StringRecord, i: usize| r[i].parse::<f64>().ok().map(f64::to_bits);
    let got: Vec<_> = rows.iter().map(|r| Some([bits(r, 2)?, bits(r, 4)?])).collect();
    assert_eq!((got, &rows[0][0]), (expected.clone(), "a \"q\", b"));

    let ndjson = text("out.ndjson", &trails, &layout, &META, true);
    let rows: Vec<Value> = ndjson.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let bits = |r: &Value, name: &str| r[name].as_f64().map(f64::to_bits);
    let got: Vec<_> = rows.iter().map(|r| Some([bits(r, "x")?, bits(r, "vx")?])).collect();
    assert_eq!((got, rows[0]["target"].as_str()), (expected.clone(), Some("a \"q\", b")));
    assert!(rows[1]["x"].is_null() && rows[1]["p_4_4"].is_null() && rows[1]["status"] == "unobservable");

    let (folder, _) = write("out.parquet", &trails, &layout, &META, true);
    let file = SerializedFileReader::new(std::fs::File::open(folder.path("out.parquet")).unwrap()).unwrap();
    let got: Vec<_> = file
        .get_row_iter(None)
        .unwrap()
        .map(|row| {
            let row = row.unwrap();
            let bits = |name: &str| match row.get_column_iter().find(|(n, _)| *n == name).unwrap().1 {
                Field::Double(x) => Some(x.to_bits()),
                Field::Null => None,
                other => panic!("{other:?}"),
            };
            Some([bits("x")?, bits("vx")?])
        })
        .collect();
    assert_eq!(got, expected);
}

#[test]
fn degrees_and_dates_come_back_as_they_came() {
    let mut trail = Trail::new(2, false);
    let at = geo::enu_from_wgs84(&ORIGIN, 47.6, 8.7, 400.0);
    push(&mut trail, 0, Some(1.25), Some(&at[..2]), None);
    push(&mut trail, 1, Some(2.0), None, None);
    let trails = [TargetTrail { target: Some("a".to_owned()), trail, link: Default::default() }];
    let time = TimeForm::Rfc3339 { epoch_unix_s: 1_740_830_398, offset_s: 0 };
    let meta = TableMeta { time, origin: Some(ORIGIN), has_target: true };
    let layout = Layout::kinematic(1, 2, &[]);
    let csv = text("out.csv", &trails, &layout, &meta, false);
    let lines: Vec<&str> = csv.lines().collect();
    assert_eq!(lines[0], "target,t,lat,lon,x,y,sd_x,sd_y,status,nis");
    let cells: Vec<&str> = lines[1].split(',').collect();
    assert_eq!(cells[1], "2025-03-01T11:59:59.250Z");
    // 1e-13 degrees are 1e-8 m; coordinates of 6.4e6 m are rounded to 1e-9 m several times over.
    let (lat, lon): (f64, f64) = (cells[2].parse().unwrap(), cells[3].parse().unwrap());
    assert!((lat - 47.6).abs() < 1e-13 && (lon - 8.7).abs() < 1e-13, "{lat} {lon}");
    assert_eq!(lines[2], "a,2025-03-01T12:00:00Z,,,,,,,unobservable,");
    let ndjson = text("out.ndjson", &trails, &layout, &meta, false);
    assert!(ndjson.starts_with("{\"target\":\"a\",\"t\":\"2025-03-01T11:59:59.250Z\",\"lat\":47."), "{ndjson}");

    let (folder, _) = write("out.parquet", &trails, &layout, &meta, false);
    let file = SerializedFileReader::new(std::fs::File::open(folder.path("out.parquet")).unwrap()).unwrap();
    let metadata = file.metadata().file_metadata().key_value_metadata().unwrap();
    let origin = metadata.iter().find(|kv| kv.key == "fixtrail.origin").unwrap().value.as_deref();
    assert_eq!(origin, Some(r#"{"lat":47.5,"lon":8.5,"alt":400.0}"#));
}

#[test]
fn geojson_breaks_where_there_is_no_estimate() {
    let mut trail = Trail::new(3, false);
    for k in 0..5_u64 {
        let mean = [k as f64, 0.0, 0.0];
        push(&mut trail, k, Some(k as f64), (k != 2).then_some(&mean), None);
    }
    let meta = TableMeta { origin: Some(ORIGIN), ..META };
    let short = TargetTrail {
        target: Some("b".to_owned()),
        trail: {
            let mut t = Trail::new(3, false);
            push(&mut t, 0, Some(0.0), None, None);
            t
        },
        link: Default::default(),
    };
    let trails = [short, TargetTrail { target: Some("a".to_owned()), trail, link: Default::default() }];
    let json: Value =
        serde_json::from_str(&text("out.geojson", &trails, &Layout::kinematic(1, 3, &[]), &meta, false)).unwrap();
    assert_eq!(json["type"], "FeatureCollection");
    let a = &json["features"][0];
    assert_eq!(
        (&a["geometry"]["type"], &a["properties"]["target"]),
        (&Value::from("MultiLineString"), &Value::from("a"))
    );
    let lines = a["geometry"]["coordinates"].as_array().unwrap();
    assert_eq!(lines.iter().map(|l| l.as_array().unwrap().len()).collect::<Vec<_>>(), [2, 2]);
    // Longitude first. The way back from metres rounds at 1e-9 m, 1e-14 degrees.
    let first = lines[0][0].as_array().unwrap();
    assert!((first[0].as_f64().unwrap() - 8.5).abs() < 1e-13 && (first[2].as_f64().unwrap() - 400.0).abs() < 5e-9);
    assert_eq!(a["properties"]["times"], serde_json::json!([0.0, 1.0, 3.0, 4.0]));
    assert_eq!(a["properties"]["sd"][0].as_array().unwrap().len(), 3);
    assert_eq!(a["properties"]["status"].as_array().unwrap().len(), 4);
    assert!(json["features"][1]["geometry"].is_null());
}

#[test]
fn order_time_interleaves_the_targets() {
    let folder = Folder::new(&[]);
    let path = folder.path("out.csv");
    let trails = [planar("a", &[0.0, 1.0, 2.0]), planar("b", &[0.0, 0.5, 2.0])];
    let layout = Layout::kinematic(2, 2, &[]);
    let by_time = WriteOptions { order: Order::Time, ..options(&path, false) };
    write_trails(&Output::File(path.clone()), &trails, &layout, META, &by_time).unwrap();
    let csv = std::fs::read_to_string(path).unwrap();
    let order: Vec<String> = csv.lines().skip(1).map(|l| l.split(',').take(2).collect::<Vec<_>>().join(" ")).collect();
    assert_eq!(order, ["a 0.0", "b 0.0", "b 0.5", "a 1.0", "a 2.0", "b 2.0"]);
}

#[test]
fn a_failing_write_leaves_the_old_file_and_nothing_else() {
    let layout = Layout::kinematic(2, 2, &[]);
    let mut bad = planar("a", &[0.0]);
    // Behind enough rows that some have left the buffer, one that must not be written.
    for k in 1..5000 {
        push(&mut bad.trail, k, Some(k as f64), Some(&[0.0; 4]), None);
    }
    push(&mut bad.trail, 5000, Some(5000.0), Some(&[0.0, f64::NAN, 0.0, 0.0]), None);
    for name in ["out.csv", "out.ndjson", "out.parquet"] {
        let folder = Folder::new(&[(name, b"old")]);
        let path = folder.path(name);
        let error = write_trails(
            &Output::File(path.clone()),
            std::slice::from_ref(&bad),
            &layout,
            META,
            &options(&path, false),
        );
        let message = error.unwrap_err().to_string();
        assert!(message.contains(name) && message.contains("`y` at t = 5000.0 of target `a`"), "{message}");
        assert_eq!((folder.names(), std::fs::read(&path).unwrap()), (vec![name.to_owned()], b"old".to_vec()));
    }
}

#[test]
fn what_is_not_finite_is_in_no_file() {
    let layout = Layout::kinematic(2, 2, &[]);
    // With a row that has no estimate, and without.
    for times in [&[0.0, 0.5, f64::INFINITY][..], &[f64::INFINITY]] {
        for name in ["out.csv", "out.ndjson", "out.parquet"] {
            let folder = Folder::new(&[]);
            let path = folder.path(name);
            let trails = [planar("a", times)];
            let error = write_trails(&Output::File(path.clone()), &trails, &layout, META, &options(&path, false));
            assert!(matches!(error, Err(WriteError::NotFinite { .. })), "{name}: {error:?}");
            assert!(folder.names().is_empty());
        }
    }
}

#[test]
fn rows_that_all_have_an_estimate_are_written_as_others_are() {
    let layout = Layout::kinematic(2, 2, &[]);
    // Names that need quotes, numbers of every length.
    for name in ["a", "a,\"b\"", ""] {
        let times: Vec<f64> = (0..40).map(|i| 1.0 / 3.0 * 10_f64.powi(i - 20)).collect();
        let mixed = text("out.csv", &[planar(name, &times)], &layout, &META, true);
        for (k, line) in mixed.lines().skip(1).enumerate().filter(|(k, _)| *k != 1) {
            let mut trail = Trail::new(4, false);
            let mean = [HARD[k % 6], times[k], HARD[(k + 1) % 6], -0.5];
            push(&mut trail, k as u64, Some(times[k]), Some(&mean), None);
            let alone = TargetTrail { target: Some(name.to_owned()), trail, link: Default::default() };
            let alone = text("out.csv", &[alone], &layout, &META, true);
            assert_eq!(alone.lines().nth(1), Some(line));
        }
    }
}

#[test]
fn outputs_that_cannot_be_are_refused_with_name_and_reason() {
    let layout = Layout::kinematic(2, 2, &[]);
    let trails = [planar("a", &[0.0])];
    let folder = Folder::new(&[("file", b""), ("keep.csv", b"old")]);
    let attempt = |path: &Path, format: OutFormat, layout: &Layout| {
        let options = WriteOptions { covariance: false, order: Order::Target, format };
        write_trails(&Output::File(path.to_owned()), &trails, layout, META, &options).unwrap_err().to_string()
    };
    let message = attempt(&folder.path("no/such/out.csv"), OutFormat::Csv, &layout);
    assert!(message.contains("out.csv: cannot be written") && message.contains("No such file"), "{message}");
    let message = attempt(&folder.path("file/out.csv"), OutFormat::Csv, &layout);
    assert!(message.contains("out.csv: cannot be written") && message.contains("Not a directory"), "{message}");
    let message = attempt(&folder.path(""), OutFormat::Csv, &layout);
    assert!(message.contains("cannot be written") && message.contains("directory"), "{message}");
    let message = attempt(&folder.path("out.geojson"), OutFormat::GeoJson, &layout);
    assert!(message.contains("needs positions in `lat`, `lon`"), "{message}");
    let message = attempt(&folder.path("out.geojson"), OutFormat::GeoJson, &Layout::linear(4));
    assert!(message.contains("a linear model has no positions"), "{message}");
    let message = OutFormat::of(&Output::File("out.xlsx".into())).unwrap_err().to_string();
    assert!(
        message.contains("`.xlsx`") && message.contains("`.csv`, `.parquet`, `.ndjson` or `.geojson`"),
        "{message}"
    );
    assert_eq!(folder.names(), ["file", "keep.csv"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error_and_a_device_is_written_directly() {
    let full = Output::File("/dev/full".into());
    let format = OutFormat::of(&full).unwrap();
    assert_eq!(format, OutFormat::Csv);
    for format in [OutFormat::Csv, OutFormat::Ndjson, OutFormat::Parquet] {
        let options = WriteOptions { covariance: false, order: Order::Target, format };
        let layout = Layout::kinematic(2, 2, &[]);
        let error = write_trails(&full, &[planar("a", &[0.0])], &layout, META, &options).unwrap_err();
        assert!(matches!(error, WriteError::Io { .. }), "{error:?}");
        assert!(error.to_string().contains("/dev/full: cannot be written: No space left"), "{error}");
        write_trails(&Output::File("/dev/null".into()), &[planar("a", &[0.0])], &layout, META, &options).unwrap();
    }
    // The device is still one.
    assert!(!std::fs::metadata("/dev/null").unwrap().is_file());
}

#[cfg(unix)]
#[test]
fn an_output_is_readable_by_others_and_a_link_stays_a_link() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new(&[("plain", b""), ("real.csv", b"old")]);
    std::os::unix::fs::symlink(folder.path("real.csv"), folder.path("link.csv")).unwrap();
    let layout = Layout::kinematic(2, 2, &[]);
    for name in ["new.csv", "link.csv"] {
        let path = folder.path(name);
        write_trails(&Output::File(path.clone()), &[planar("a", &[0.0])], &layout, META, &options(&path, false))
            .unwrap();
    }
    let mode = |name: &str| std::fs::metadata(folder.path(name)).unwrap().permissions().mode();
    assert_eq!(mode("new.csv"), mode("plain"));
    assert!(std::fs::symlink_metadata(folder.path("link.csv")).unwrap().is_symlink());
    assert!(std::fs::read_to_string(folder.path("real.csv")).unwrap().starts_with("target,t,"));
}
