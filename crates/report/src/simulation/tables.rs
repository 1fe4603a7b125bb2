//! Errors, consistency, verdicts and steady states as tables.

use crate::charts::series_class;
use crate::format::{count, number, percent};
use fixtrail_sim::monte_carlo::{Claim, Estimated, LOST_NEES, LongRun, Outcome, Summary};
use fixtrail_track::registry;
use fixtrail_track::spec::Simulated;
use maud::{Markup, html};

/// Components of a linear model's state with a column each.
const COLUMNS: usize = 4;

fn estimated(v: &Estimated) -> Markup {
    // What does not depend on chance has no error but rounding.
    html! { (number(v.mean)) @if v.se > 1e-9 * v.mean.abs() { small { "± " (number(v.se)) } } }
}

fn or_dash(v: Option<&Estimated>) -> Markup {
    html! { @match v { Some(v) => (estimated(v)), None => "–" } }
}

fn name(index: usize, s: &Summary) -> Markup {
    html! {
        span class={ "swatch " (series_class(index)) } {} (s.name)
        @if s.smoothed { small { "smoothed: knows what comes later" } }
    }
}

/// How large errors are; the bound in the last line.
pub fn errors(world: &Simulated, outcome: &Outcome) -> Markup {
    let layout = registry::layout(&world.truth);
    let all = &outcome.contenders;
    let unit = if layout.is_linear() { "" } else { " [m]" };
    let columns = if layout.is_linear() && layout.n() <= COLUMNS { layout.n() } else { 0 };
    let worst = all.iter().map(|s| s.rmse.mean).filter(|v| v.is_finite()).fold(0.0, f64::max);
    let energy = all.iter().any(|s| s.energy_mj.is_some());
    let steps = all.iter().any(|s| s.time_steps.is_some());
    let bar = |v: f64| format!("width:{:.0}%", (100.0 * v / worst).min(100.0));
    html! {
        div class="scroll" { table class="compared" {
            thead { tr {
                th { "errors" }
                th { "RMSE" (unit) } th { "claimed" (unit) }
                @for name in &layout.names[..columns] { th { "mean |" (name) "|" } }
                th { "50 %" (unit) } th { "60 %" (unit) } th { "90 %" (unit) } th { "95 %" (unit) }
                th { @if layout.is_linear() { "lost" } @else { "end > " (world.lost_m) " m off" } }
                @if energy { th { "energy [mJ]" } }
                @if steps { th { "time steps" } }
                th { "failed runs" } th { "instants missing" }
            } }
            tbody {
                @for (i, s) in all.iter().enumerate() { tr {
                    th { (name(i, s)) }
                    td { (estimated(&s.rmse)) @if worst > 0.0 && s.rmse.mean.is_finite() { i class="bar" { i style=(bar(s.rmse.mean)) {} } } }
                    td { (s.claimed_rms.map_or("–".to_owned(), number)) }
                    @for v in s.mean_abs.iter().take(columns) { td { (estimated(v)) } }
                    @for q in 0..4 { td { (s.quantiles.get(q).map_or("–".to_owned(), |v| number(*v))) } }
                    td { (percent(s.verdict.diverges.mean)) }
                    @if energy { td { (or_dash(s.energy_mj.as_ref())) } }
                    @if steps { td { (or_dash(s.time_steps.as_ref())) } }
                    td { (count(s.failed)) } td { (count(s.missing)) }
                } }
                @if let Ok(bound) = &outcome.bound { tr {
                    th { span class="swatch truth" {} "Cramér–Rao bound" }
                    td { (estimated(&bound.rms)) @if worst > 0.0 { i class="bar" { i style=(bar(bound.rms.mean)) {} } } }
                } }
            }
        } }
    }
}

/// Whether errors are as claimed.
pub fn consistency(outcome: &Outcome) -> Markup {
    let band = |band: Option<(f64, f64)>| html! { @if let Some((low, high)) = band { small { (number(low)) " – " (number(high)) } } };
    html! {
        div class="scroll" { table class="compared" {
            thead { tr {
                th { "consistency" } th { "ANEES" } th { "ANIS" }
                th { "inside 50 %" } th { "inside 95 %" } th class="text" { "verdict" }
            } }
            tbody { @for (i, s) in outcome.contenders.iter().enumerate() { tr {
                th { (name(i, s)) }
                td { (number(s.anees.mean)) " ± " (number(s.anees.se)) (band(s.anees_band)) }
                td { @match &s.anis { Some(v) => { (number(v.mean)) " ± " (number(v.se)) (band(s.anis_band)) }, None => "–" } }
                @for v in &s.coverage { td { (percent(v.mean)) small { "± " (percent(v.se)) } } }
                td class="text" { (badge(s)) }
            } } }
        } }
    }
}

fn badge(s: &Summary) -> Markup {
    let (class, word) = match (s.verdict.diverges.mean > 0.0, s.verdict.claim) {
        (true, _) => ("bad", "diverges"),
        (_, Claim::Optimistic) => ("bad", "optimistic"),
        (_, Claim::Consistent) => ("good", "consistent"),
        (_, Claim::Pessimistic) => ("mild", "pessimistic"),
        (_, Claim::NotJudged) => ("none", "not judged"),
    };
    html! { span class={ "badge " (class) } { (word) } }
}

/// The verdicts in words.
pub fn verdicts(outcome: &Outcome) -> Markup {
    html! {
        @for (i, s) in outcome.contenders.iter().enumerate() {
            p class="verdict" {
                span class={ "swatch " (series_class(i)) } {} b { (s.name) } " " (s.verdict.sentence) "."
                @if let Some(first) = &s.first_failure { " " (count(s.failed)) " runs failed, the first: " (first) "." }
            }
        }
    }
}

/// Steady states.
pub fn long_run(long_run: &LongRun) -> Markup {
    let or_dash = |v: Option<f64>| v.map_or("–".to_owned(), number);
    html! {
        div class="scroll" { table {
            thead { tr {
                th { "long run, standard deviation" } th { "predicted" } th { "filtered" }
                @for (lag, _) in &long_run.lags { th { @match lag { Some(lag) => { "lag " (lag) }, None => "lag ∞" } } }
                th { "with these losses: filtered, at least" } th { "at most" }
            } }
            tbody { @for (i, state) in long_run.theory.states.iter().enumerate() { tr {
                th { (state.name) }
                td { (or_dash(state.predicted.lossless)) } td { (or_dash(state.filtered.lossless)) }
                @for (_, sds) in &long_run.lags { td { (number(sds[i])) } }
                td { (or_dash(state.filtered.lower)) } td { (or_dash(state.filtered.upper)) }
            } } }
        } }
        p class="read" {
            "Steady states of the Riccati recursions by the scenario's own noise. Predicted, filtered and lagged: when nothing is lost, which no \
             estimator of that lag goes below in the long run. The last two columns: bounds on a Kalman filter that knows what has arrived, when \
             losses are independent."
        }
    }
}

/// What the figures mean.
pub fn reading(linear: bool, outcome: &Outcome) -> Markup {
    html! { p class="read" {
        "ANEES and ANIS are the mean squared errors and innovations in units of what is claimed for them: 1 is right, more is optimistic, less \
         pessimistic. Below each stands its chi-square band of 95 %: for ANEES by runs, because the instants of a run are correlated, for ANIS by \
         runs and instants. The verdict is by the 99 % interval of ANEES over the runs that kept their target. Percentiles are of the errors of all \
         instants and runs together."
        @if linear {
            " Errors are those of the whole state. A run is lost when its squared errors are " (number(LOST_NEES)) " times what is claimed over \
             its last tenth."
        }
        @match &outcome.bound {
            Ok(_) => " The Cramér–Rao bound is for causal estimates, at the true trajectories and averaged over the runs; a smoother may go below.",
            Err(why) => { " There is no Cramér–Rao bound: " (why) "." }
        }
    } }
}
