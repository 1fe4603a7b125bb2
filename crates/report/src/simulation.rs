//! The page of a simulated scenario: tables and verdicts for each channel, distribution of the errors, errors and consistency over time.

mod charts;
mod tables;

use crate::charts::series_class;
use crate::format::{count, shortened};
use crate::page::shell;
use fixtrail_sim::monte_carlo::Outcome;
use fixtrail_track::registry;
use fixtrail_track::spec::Simulated;
use maud::{Markup, html};

/// A scenario and what its runs say.
#[derive(Clone, Copy, Debug)]
pub struct Simulation<'a> {
    /// Its name.
    pub title: &'a str,
    /// What was simulated.
    pub world: &'a Simulated,
    /// Seed of all chance.
    pub seed: u64,
    /// One for each channel.
    pub channels: &'a [Channel<'a>],
}

/// One channel.
#[derive(Clone, Copy, Debug)]
pub struct Channel<'a> {
    /// Share of packets that it loses.
    pub loss_rate: f64,
    /// What the runs say.
    pub outcome: &'a Outcome,
}

/// Channels whose charts are drawn; tables are of all.
const DRAWN: usize = 4;

/// The page as one HTML document that refers to nothing outside itself. Equal results give equal bytes.
pub fn render_simulation(simulation: &Simulation<'_>) -> String {
    let Simulation { title, world, seed, channels } = *simulation;
    let linear = registry::layout(&world.truth).is_linear();
    let length = match &world.schedule {
        Some(schedule) => format!("{} s with scheduled sensors", schedule.duration_s),
        None => format!("{} instants, {} s apart", count(world.steps), world.interval_s),
    };
    let subtitle = format!(
        "{} runs of {length}, seed {seed}: errors with their standard errors over the runs, beside what theory allows",
        count(world.runs)
    );
    let drawn = evenly(channels.len());
    let body = html! {
        (legend(channels))
        @if channels.len() > 1 { section class="charts" { (charts::by_loss_rate(simulation)) } }
        @for (i, channel) in channels.iter().enumerate() {
            section class="card" {
                h2 { (heading(channel)) }
                (tables::errors(world, channel.outcome))
                (tables::consistency(channel.outcome))
                (tables::verdicts(channel.outcome))
                @if let Some(long_run) = &channel.outcome.long_run { (tables::long_run(long_run)) }
                (tables::reading(linear, channel.outcome))
            }
            @if drawn.contains(&i) { section class="charts" { (charts::of_channel(simulation, channel, i)) } }
        }
    };
    shell(title, &subtitle, &body)
}

/// Which of so many channels are drawn: the first and the last, and some between them.
fn evenly(channels: usize) -> Vec<usize> {
    if channels <= DRAWN {
        return (0..channels).collect();
    }
    (0..DRAWN).map(|i| i * (channels - 1) / (DRAWN - 1)).collect()
}

fn heading(channel: &Channel<'_>) -> String {
    match channel.loss_rate {
        0.0 => "Nothing lost".to_owned(),
        rate => format!("{} % of the packets lost", (1e4 * rate).round() / 100.0),
    }
}

fn legend(channels: &[Channel<'_>]) -> Markup {
    let contenders = channels.first().map_or(&[][..], |c| &c.outcome.contenders);
    html! {
        nav class="legend" aria-label="Legend" {
            @for (i, s) in contenders.iter().enumerate() {
                button type="button" aria-pressed="true" data-switch=(series_class(i)) {
                    span class={ "swatch " (series_class(i)) } {} (shortened(&s.name, 40))
                }
            }
            @if channels.iter().any(|c| c.outcome.bound.is_ok()) {
                button type="button" aria-pressed="true" data-switch="truth" { span class="swatch truth" {} "Cramér–Rao bound" }
            }
        }
    }
}
