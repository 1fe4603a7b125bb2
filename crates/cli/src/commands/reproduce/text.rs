//! An account as text and as JSON.

use comfy_table::{CellAlignment, ColumnConstraint, ContentArrangement, Table, Width};
use fixtrail_sim::papers::{Account, Entry, Measured, Printed, Verdict};
use serde_json::{Value, json};

/// Columns of a line.
const WIDTH: u16 = 100;

/// Title, verdicts, a table of all entries, and the reasons.
pub fn text(account: &Account) -> String {
    let mut table = Table::new();
    table
        .load_style(comfy_table::presets::NOTHING)
        .set_content_arrangement(ContentArrangement::Dynamic)
        .set_width(WIDTH - 2)
        .set_header(["where", "what", "printed", "ours", "read otherwise", "verdict"]);
    for entry in &account.entries {
        table.add_row(cells(entry));
    }
    // Contents and the two spaces after them; what it is gets the rest.
    let widths = [13, 0, 9, 18, 18, 14];
    for (i, (column, width)) in table.column_iter_mut().zip(widths).enumerate() {
        column.set_padding((0, 2));
        column.set_cell_alignment(if (2..=4).contains(&i) { CellAlignment::Right } else { CellAlignment::Left });
        if width > 0 {
            column.set_constraint(ColumnConstraint::Absolute(Width::Fixed(width)));
        }
    }
    let lines: Vec<String> = table.lines().map(|l| format!("  {}", l.trim_end())).collect();
    format!("{}\n\n{}\n\n{}{}", wrapped(account.title, ""), verdicts(account), lines.join("\n"), reasons(account))
}

/// How many entries have each verdict.
fn verdicts(account: &Account) -> String {
    let count = |v: Verdict| account.entries.iter().filter(|e| e.verdict == v).count();
    let parts: Vec<String> =
        Verdict::ALL.into_iter().filter(|v| count(*v) > 0).map(|v| format!("{} {}", count(v), v.name())).collect();
    parts.join(", ")
}

fn cells(entry: &Entry) -> [String; 6] {
    let (what, printed) = match &entry.printed {
        Printed::Number { value, digits } => (entry.what.clone(), format!("{value:.*}", *digits as usize)),
        Printed::Claim(claim) => (claim.clone(), String::new()),
        Printed::NotInText => (entry.what.clone(), "–".to_owned()),
    };
    let number = |m: Option<&Measured>| m.map_or(String::new(), |m| m.to_string().replace(" ± ", "±"));
    [
        entry.place.clone(),
        what,
        printed,
        number(entry.literal.as_ref()),
        number(entry.reading.as_ref().map(|r| &r.measured)),
        match entry.verdict {
            Verdict::UnderReading => "under a reading".to_owned(),
            verdict => verdict.name().to_owned(),
        },
    ]
}

/// The readings and reasons of what is not simply reproduced, each once.
fn reasons(account: &Account) -> String {
    let mut out: Vec<String> = Vec::new();
    for entry in account.entries.iter().filter(|e| e.verdict != Verdict::Reproduced) {
        let reading = entry.reading.as_ref().map(|r| format!("read otherwise: {}", r.text));
        let reason = (!entry.reason.is_empty()).then(|| entry.reason.clone());
        let parts: Vec<String> = [reading, reason].into_iter().flatten().collect();
        if parts.is_empty() {
            continue;
        }
        let block = wrapped(&format!("{}: {}.", entry.place, parts.join("; ")), "  ");
        if !out.contains(&block) {
            out.push(block);
        }
    }
    if out.is_empty() { String::new() } else { format!("\n\n{}", out.join("\n")) }
}

/// Lines of at most [`WIDTH`] characters, the first with `indent` before it, the others with two spaces more.
fn wrapped(text: &str, indent: &str) -> String {
    let mut lines: Vec<String> = Vec::new();
    let mut line = indent.to_owned();
    let mut is_empty = true;
    for word in text.split_whitespace() {
        if !is_empty && line.chars().count() + 1 + word.chars().count() > usize::from(WIDTH) {
            lines.push(line);
            line = format!("{indent}  ");
            is_empty = true;
        }
        if !is_empty {
            line.push(' ');
        }
        line += word;
        is_empty = false;
    }
    lines.push(line);
    lines.join("\n")
}

/// An account for programs; curves are in the report only.
pub fn json(account: &Account) -> Value {
    json!({
        "paper": account.paper,
        "title": account.title,
        "entries": account.entries.iter().map(json_entry).collect::<Vec<_>>(),
        "figures": account.figures.iter().map(|f| json!({ "where": f.place, "caption": f.caption })).collect::<Vec<_>>(),
    })
}

fn json_entry(entry: &Entry) -> Value {
    let measured = |m: &Measured| json!({ "mean": m.mean, "se": m.se, "spread": m.spread });
    let (claim, printed) = match &entry.printed {
        Printed::Number { value, .. } => (None, Some(*value)),
        Printed::Claim(claim) => (Some(claim), None),
        Printed::NotInText => (None, None),
    };
    json!({
        "where": entry.place,
        "what": (!entry.what.is_empty()).then_some(&entry.what),
        "claim": claim,
        "printed": printed,
        "ours": entry.literal.as_ref().map(measured),
        "reading": entry.reading.as_ref().map(|r| {
            let mut object = measured(&r.measured);
            object["text"] = json!(r.text);
            object
        }),
        "bound": entry.bound.as_ref().map(|b| json!({ "value": b.value, "text": b.text })),
        "verdict": entry.verdict.name(),
        "reason": entry.reason,
    })
}
