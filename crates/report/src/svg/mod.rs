//! Charts as inline SVG: scales, axes, paths. Colours are classes, so that the page's theme decides them.

mod decimate;
mod frame;
mod path;
mod scale;

pub use decimate::{envelope, envelope_band, thinned};
pub use frame::Frame;
pub use path::{area, bars, dots, line};
pub use scale::{Scale, TimeAxis};
