//! A survey as text.

use super::promise;
use crate::data::{Data, DataArguments};
use crate::figures::{counted, grouped, percent, short, short_or_dash};
use crate::output::table;
use fixtrail_track::packet::Kind;
use fixtrail_track::survey::{KindSurvey, Loss, Survey, TargetSurvey};
use fixtrail_track::theory::{Bounds, Source, Theory};

/// Most targets and anchors shown; `--json` has them all.
const MOST_ROWS: usize = 20;

/// Everything that `check` prints.
pub fn report(arguments: &DataArguments, data: &Data, survey: &Survey) -> String {
    let mut blocks = vec![headline(arguments, data, survey)];
    blocks.push(targets(&survey.targets));
    if survey.kinds.iter().any(|k| k.kind != Kind::Linear) {
        blocks.push(kinds(&survey.kinds));
    }
    if survey.anchors.iter().any(|a| a.rows > 0) {
        blocks.push(anchors(survey));
    }
    if let Some(loss) = survey.loss.as_ref().filter(|l| l.burst_count() > 0) {
        blocks.push(bursts(loss));
    }
    if survey.targets.iter().any(|t| t.late.delay_s.is_some()) {
        blocks.push(delays(&survey.targets));
    }
    let mut findings: Vec<String> =
        survey.findings.iter().map(|f| format!("{:8} {}", format!("{}:", f.severity.name()), f.text)).collect();
    findings.extend(table_notes(data).into_iter().map(|note| format!("note:    {note}")));
    if !findings.is_empty() {
        blocks.push(findings.join("\n"));
    }
    match promise(data, survey) {
        None => {}
        Some(Ok((told, source))) => blocks.push(theory(&told, source)),
        Some(Err(why)) => blocks.push(format!("Theory bounds no error of this spec: {why}.")),
    }
    blocks.push(spec(arguments, data));
    blocks.join("\n\n")
}

fn headline(arguments: &DataArguments, data: &Data, survey: &Survey) -> String {
    let mut line = format!("{}: {}", arguments.input.display(), counted(survey.rows, "row"));
    line += &format!(", {}", counted(survey.targets.len() as u64, "target"));
    let start = survey.targets.iter().map(|t| t.start_s).fold(f64::INFINITY, f64::min);
    let end = survey.targets.iter().map(|t| t.end_s).fold(f64::NEG_INFINITY, f64::max);
    if start <= end {
        let time = data.table.time;
        line += &format!(", t = {} to {} ({} s)", time.text(start), time.text(end), short(end - start));
    }
    let counts = &data.table.counts;
    if counts.duplicates > 0 {
        line += &format!(", {} dropped", counted(counts.duplicates, "duplicate"));
    }
    if counts.out_of_order > 0 {
        line += &format!(", {} out of order", grouped(counts.out_of_order));
    }
    line
}

fn targets(all: &[TargetSurvey]) -> String {
    let header = [
        "target",
        "rows",
        "instants",
        "seconds",
        "rate/Hz",
        "interval/s",
        "95 %",
        "lost",
        "longest silence/s",
        "at t/s",
    ];
    let mut rows: Vec<Vec<String>> = all.iter().take(MOST_ROWS).map(target).collect();
    if all.len() > MOST_ROWS {
        rows.push(vec![format!("… {} more (--json has all)", all.len() - MOST_ROWS)]);
    }
    table(&header, &rows)
}

fn target(t: &TargetSurvey) -> Vec<String> {
    let seconds = t.end_s - t.start_s;
    let rate = (seconds > 0.0).then(|| (t.instants.saturating_sub(1)) as f64 / seconds);
    let silence = t.interval_s.map(|_| t.silences);
    vec![
        t.target.clone().unwrap_or_else(|| "–".to_owned()),
        grouped(t.rows),
        grouped(t.instants),
        short(seconds),
        short_or_dash(rate),
        short_or_dash(t.interval_s.map(|q| q.p50)),
        short_or_dash(t.interval_s.map(|q| q.p95)),
        t.loss.as_ref().map_or("–".to_owned(), |l| percent(l.rate())),
        short_or_dash(silence.map(|s| s.longest_s)),
        short_or_dash(silence.map(|s| s.longest_at_s)),
    ]
}

fn kinds(all: &[KindSurvey]) -> String {
    let header = ["kind", "rows", "typical", "jitter", "misfit", "outliers", "speed", "unit"];
    let rows: Vec<Vec<String>> = all
        .iter()
        .filter(|k| k.kind != Kind::Linear)
        .map(|k| {
            let unit = match k.kind {
                Kind::Rssi => "dBm",
                Kind::Bearing => "rad",
                _ => "m",
            };
            vec![
                k.kind.name().to_owned(),
                grouped(k.rows),
                short_or_dash(k.typical),
                short_or_dash(k.quick_sd),
                short_or_dash(k.fit_sd),
                grouped(k.outliers),
                short_or_dash(k.speed),
                unit.to_owned(),
            ]
        })
        .collect();
    table(&header, &rows)
}

fn anchors(survey: &Survey) -> String {
    let mut rows: Vec<Vec<String>> = survey
        .anchors
        .iter()
        .take(MOST_ROWS)
        .map(|a| vec![a.name.clone(), grouped(a.rows), percent(a.share)])
        .collect();
    if survey.anchors.len() > MOST_ROWS {
        rows.push(vec![format!("… {} more (--json has all)", survey.anchors.len() - MOST_ROWS)]);
    }
    table(&["anchor", "rows", "share"], &rows)
}

fn bursts(loss: &Loss) -> String {
    let independent = loss.geometric_bursts();
    let rows: Vec<Vec<String>> = (0..10)
        .filter(|i| loss.bursts[*i] > 0 || independent[*i] >= 0.5)
        .map(|i| {
            let length = if i == 9 { "10 or more".to_owned() } else { format!("{}", i + 1) };
            vec![length, grouped(loss.bursts[i]), format!("{:.0}", independent[i])]
        })
        .collect();
    table(&["lost in a row", "times", "if independent"], &rows)
}

/// From sensing to reception, and what came after something newer.
fn delays(all: &[TargetSurvey]) -> String {
    let header =
        ["target", "delay/s: least", "5 %", "50 %", "95 %", "most", "overtaken", "latest by/s", "needs late_s"];
    let timed: Vec<&TargetSurvey> = all.iter().filter(|t| t.late.delay_s.is_some()).collect();
    let mut rows: Vec<Vec<String>> = timed
        .iter()
        .take(MOST_ROWS)
        .map(|t| {
            let mut row = vec![t.target.clone().unwrap_or_else(|| "–".to_owned())];
            row.extend(t.late.delay_s.iter().flat_map(|q| [q.min, q.p05, q.p50, q.p95, q.max]).map(short));
            row.extend([grouped(t.late.overtaken), short(t.late.worst_s), t.late.needed_late_s().to_string()]);
            row
        })
        .collect();
    if timed.len() > MOST_ROWS {
        rows.push(vec![format!("… {} more (--json has all)", timed.len() - MOST_ROWS)]);
    }
    table(&header, &rows)
}

/// The bounds of \[SIN04\] for the user's spec.
fn theory(told: &Theory, source: Source) -> String {
    let mut lines = vec![format!("theory, {}:", told.assumption(source))];
    lines.extend(told.sentences().into_iter().map(|s| format!("  {s}")));
    let header = [
        "sd of a Kalman filter's",
        "prediction: least",
        "most",
        "without loss",
        "estimate: least",
        "most",
        "without loss",
    ];
    let cells = |b: &Bounds| [b.lower, b.upper, b.lossless].map(short_or_dash);
    let rows: Vec<Vec<String>> = told
        .states
        .iter()
        .map(|s| [s.name.clone()].into_iter().chain(cells(&s.predicted)).chain(cells(&s.filtered)).collect())
        .collect();
    lines.push(table(&header, &rows));
    lines.join("\n")
}

/// What only the reader saw.
fn table_notes(data: &Data) -> Vec<String> {
    let counts = &data.table.counts;
    let mut notes = Vec::new();
    if counts.skipped_bad > 0 {
        let first = counts.first_bad.as_deref().unwrap_or_default();
        notes.push(format!("{} skipped as bad, the first: {first}", counted(counts.skipped_bad, "row")));
    }
    if !counts.ignored_columns.is_empty() {
        notes.push(format!("columns nobody asked for: {}", counts.ignored_columns.join(", ")));
    }
    if let Some(path) = data.spec.as_ref().ok().and_then(|spec| spec.path.as_ref()) {
        for (kind, rows) in &data.unused {
            notes.push(format!("{} of kind `{kind}` are not used by {}", counted(*rows, "row"), path.display()));
        }
    }
    notes
}

fn spec(arguments: &DataArguments, data: &Data) -> String {
    match &data.spec {
        Ok(spec) if spec.path.is_some() => format!("The spec {} fits these data.", spec.name().display()),
        Ok(_) if arguments.write_spec.is_some() => "A spec for these data is written.".to_owned(),
        Ok(spec) => {
            let indented: Vec<String> = spec.text.lines().map(|l| format!("  {l}").trim_end().to_owned()).collect();
            format!("A spec for these data (--write-spec FILE saves it):\n\n{}", indented.join("\n"))
        }
        Err(why) => format!("No spec can be proposed: {} {why}.", arguments.input.display()),
    }
}
