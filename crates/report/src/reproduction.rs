//! The page of what comes of papers: for each its verdicts, a table of all that it prints and states, and our curves for its figures.

use crate::charts::{extent, figure, series_class};
use crate::format::{count, number};
use crate::page::shell;
use crate::svg::{Frame, Scale, dots, envelope, line};
use fixtrail_sim::papers::{Account, Entry, Figure, FigureKind, Measured, Printed, Verdict};
use maud::{Markup, html};

/// Height of a plan that is not wider than high.
const PLAN_HEIGHT: f64 = 560.0;

/// One HTML document about `accounts`; `how` says how they were made, as a command.
pub fn render_reproduction(accounts: &[Account], how: &str) -> String {
    let title = match accounts {
        [one] => format!("What comes of the {} paper", one.paper),
        many => format!("What comes of {} papers", many.len()),
    };
    let body = html! {
        (how_to_read(how))
        @for account in accounts {
            h2 class="target" { (account.title) }
            (verdicts(account))
            (table(account))
            section class="charts" {
                @for (i, figure) in account.figures.iter().enumerate() { (chart(account, figure, i)) }
            }
        }
    };
    shell(&title, "Every number that is printed and every claim about it, beside what our experiments give.", &body)
}

fn how_to_read(how: &str) -> Markup {
    html! {
        section class="card notes" {
            p { "Made by " code { (how) } ": the same command gives the same page." }
            p {
                "Ours is the mean of experiments of the paper's own size with its standard error, the text taken by its letter. A printed \
                 number is reproduced when it is within three standard deviations of ours: those of one experiment, of our mean and of the \
                 printing. Where the letter does not give it, another reading may. A bound is what theory says, without chance."
            }
        }
    }
}

fn verdicts(account: &Account) -> Markup {
    html! {
        section class="headline verdicts" {
            @for verdict in Verdict::ALL {
                @let n = account.entries.iter().filter(|e| e.verdict == verdict).count();
                @if n > 0 { div class="tile" { b { (count(n)) } span { (verdict.name()) } } }
            }
        }
    }
}

fn table(account: &Account) -> Markup {
    html! {
        section class="card" {
            div class="scroll" { table class="reproduction" {
                thead { tr {
                    th { "where" } th class="text" { "what" } th { "printed" } th { "ours, by the letter" } th { "read otherwise" } th { "bound" } th { "verdict" }
                } }
                tbody { @for (i, entry) in account.entries.iter().enumerate() { (row(entry, i.checked_sub(1).map(|i| &account.entries[i]))) } }
            } }
        }
    }
}

/// A line; what stands in the line `above` word by word is not said again.
fn row(entry: &Entry, above: Option<&Entry>) -> Markup {
    let (what, printed) = match &entry.printed {
        Printed::Number { value, digits } => (entry.what.clone(), format!("{value:.*}", *digits as usize)),
        Printed::Claim(claim) => (format!("“{claim}”"), String::new()),
        Printed::NotInText => (entry.what.clone(), "–".to_owned()),
    };
    let said = above.map_or(Vec::new(), notes);
    let remarks: Vec<String> = notes(entry).into_iter().filter(|n| !said.contains(n)).collect();
    let class = match entry.verdict {
        Verdict::Reproduced => "good",
        Verdict::UnderReading => "mild",
        Verdict::NotReproducible | Verdict::Contradicted => "bad",
        Verdict::NotInText => "none",
    };
    html! {
        tr {
            th { (entry.place) }
            td class="text" {
                (what)
                @for note in &remarks { small { (capitalised(note)) "." } }
            }
            td { (printed) }
            td { (cell(entry.literal.as_ref())) }
            td { (cell(entry.reading.as_ref().map(|r| &r.measured))) }
            td { @if let Some(bound) = &entry.bound { (Measured::exact(bound.value)) } }
            td class="text" { span class={ "badge " (class) } { (entry.verdict.name()) } }
        }
    }
}

/// What is to be said of an entry besides its numbers.
fn notes(entry: &Entry) -> Vec<String> {
    let reading = entry.reading.as_ref().map(|r| format!("read otherwise: {}", r.text));
    let bound = entry.bound.as_ref().map(|b| format!("bound: {}", b.text));
    let reason = (!entry.reason.is_empty()).then(|| entry.reason.clone());
    [reading, bound, reason].into_iter().flatten().collect()
}

/// A number with its standard error, and how far one experiment is off by chance.
fn cell(measured: Option<&Measured>) -> Markup {
    html! { @if let Some(m) = measured {
        (m)
        @if m.spread > 0.0 { small { "one experiment ± " (number(m.spread)) } }
    } }
}

fn capitalised(sentence: &str) -> String {
    let mut letters = sentence.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

fn chart(account: &Account, of: &Figure, index: usize) -> Markup {
    let values = |axis: usize| extent(of.curves.iter().flat_map(|c| c.points.iter().map(move |p| p[axis])));
    let (x, y) = match of.kind {
        FigureKind::Lines => (Scale::linear(values(0), Frame::X_PX), Scale::linear(widened(values(1)), Frame::Y_PX)),
        FigureKind::Logarithmic => {
            let [low, high] = values(1);
            (Scale::linear(values(0), Frame::X_PX), Scale::log([0.9 * low, 1.1 * high], Frame::Y_PX))
        }
        FigureKind::Plan => plan_scales(values(0), values(1)),
    };
    let body = html! {
        @for (i, curve) in of.curves.iter().enumerate().filter(|(_, c)| c.joined) {
            @let points: Vec<_> = curve.points.iter().map(|p| Some((p[0], p[1]))).collect();
            @let points = if of.kind == FigureKind::Plan { points } else { envelope(points) };
            path class={ "line " (series_class(i)) } data-name=(curve.name) d=(line(&points, x, y)) {}
        }
        // Marks stand on the lines.
        @for (i, curve) in of.curves.iter().enumerate().filter(|(_, c)| !c.joined) {
            @let points: Vec<_> = curve.points.iter().map(|p| (p[0], p[1])).collect();
            path class={ "dots marks " (series_class(i)) } d=(dots(&points, x, y)) {}
        }
    };
    let frame = Frame {
        width: Frame::WIDTH,
        height: y.from + (Frame::HEIGHT - Frame::Y_PX[0]),
        x,
        y,
        x_title: of.x.clone(),
        y_title: of.y.clone(),
        label: format!("{} of the {} paper, ours", of.place, account.paper),
        id: format!("{}-{index}", account.paper),
    };
    let drawn = html! {
        (frame.draw(&body, &html! {}))
        @if of.curves.len() > 1 {
            p class="key" { @for (i, curve) in of.curves.iter().enumerate() { span class=(series_class(i)) { (curve.name) } } }
        }
    };
    figure("", &of.place, &drawn, &of.caption)
}

/// A little room above and below.
fn widened([low, high]: [f64; 2]) -> [f64; 2] {
    let pad = 0.04 * (high - low);
    [if low >= 0.0 { (low - pad).max(0.0) } else { low - pad }, high + pad]
}

/// Both axes in one scale, as wide as a chart is.
fn plan_scales(x: [f64; 2], y: [f64; 2]) -> (Scale, Scale) {
    let [left, right] = Frame::X_PX;
    let top = Frame::Y_PX[1];
    let (x, y) = (widened_both(x), widened_both(y));
    let unit = ((right - left) / (x[1] - x[0])).min(PLAN_HEIGHT / (y[1] - y[0]));
    let spare = 0.5 * ((right - left) / unit - (x[1] - x[0]));
    let bottom = top + unit * (y[1] - y[0]);
    (Scale::linear([x[0] - spare, x[1] + spare], Frame::X_PX), Scale::linear(y, [bottom, top]))
}

fn widened_both([low, high]: [f64; 2]) -> [f64; 2] {
    let pad = (0.03 * (high - low)).max(1e-9);
    [low - pad, high + pad]
}
