//! Axes, grid, ticks and titles around a chart.

use super::Scale;
use maud::{Markup, html};

/// The frame of a chart.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Width of the drawing.
    pub width: f64,
    /// Height of the drawing.
    pub height: f64,
    /// Horizontal scale.
    pub x: Scale,
    /// Vertical scale.
    pub y: Scale,
    /// Below the horizontal axis, with its unit.
    pub x_title: String,
    /// Beside the vertical axis, with its unit.
    pub y_title: String,
    /// What the chart shows, for those who hear it.
    pub label: String,
    /// Unique on the page.
    pub id: String,
}

impl Frame {
    /// Width of a chart of usual size.
    pub const WIDTH: f64 = 640.0;
    /// Height of a chart of usual size.
    pub const HEIGHT: f64 = 330.0;
    /// Left and right end of the horizontal axis of a chart of usual size.
    pub const X_PX: [f64; 2] = [64.0, 628.0];
    /// Lower and upper end of its vertical axis.
    pub const Y_PX: [f64; 2] = [276.0, 14.0];
    /// Width of a chart that takes the whole width of the page.
    pub const WIDE: f64 = 1100.0;
    /// Left and right end of its horizontal axis.
    pub const WIDE_X_PX: [f64; 2] = [66.0, 1084.0];

    /// The chart with `body` clipped to the axes and `over` on top, not clipped.
    pub fn draw(&self, body: &Markup, over: &Markup) -> Markup {
        let (x, y) = (self.x, self.y);
        let clip = format!("clip-{}", self.id);
        // One label per 90 units across and 45 upwards.
        let (x_ticks, y_ticks) = (((x.to - x.from) / 90.0) as usize, ((y.from - y.to) / 45.0) as usize);
        let middle_x = 0.5 * (x.from + x.to);
        let middle_y = 0.5 * (y.from + y.to);
        html! {
            svg viewBox=(format!("0 0 {} {:.0}", self.width, self.height)) role="img" aria-label=(self.label)
                data-x=(axis_data(x)) data-y=(axis_data(y)) {
                defs { clipPath id=(clip) {
                    rect x=(x.from) y=(y.to) width=(x.to - x.from) height=(y.from - y.to) {}
                } }
                g class="grid" {
                    @for (v, _) in y.ticks(y_ticks) { path d=(format!("M{} {:.1}H{}", x.from, y.at(v), x.to)) {} }
                    @for (v, _) in x.ticks(x_ticks) { path d=(format!("M{:.1} {:.1}V{:.1}", x.at(v), y.from, y.to)) {} }
                }
                g clip-path=(format!("url(#{clip})")) { (body) }
                path class="axis" d=(format!("M{} {:.1}H{}", x.from, y.from, x.to)) {}
                g class="ticks" {
                    @for (v, label) in x.ticks(x_ticks) {
                        text x=(format!("{:.1}", x.at(v))) y=(format!("{:.1}", y.from + 6.0)) dy="0.9em" text-anchor="middle" { (label) }
                    }
                    @for (v, label) in y.ticks(y_ticks) {
                        text x=(x.from - 8.0) y=(format!("{:.1}", y.at(v))) dy="0.35em" text-anchor="end" { (label) }
                    }
                }
                g class="titles" {
                    text class="x" x=(middle_x) y=(format!("{:.1}", self.height - 8.0)) text-anchor="middle" { (self.x_title) }
                    // The style sheet moves the group where letters are large.
                    g class="y" { text transform=(format!("translate(0 {middle_y:.1}) rotate(-90)")) dy="1.05em" text-anchor="middle" { (self.y_title) } }
                }
                (over)
            }
        }
    }
}

/// What the page's script needs to read values off a chart.
fn axis_data(s: Scale) -> String {
    format!("{} {} {:.1} {:.1} {}", s.low, s.high, s.from, s.to, u8::from(s.log))
}
