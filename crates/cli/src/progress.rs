//! Progress bars on standard error, on a terminal only.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// A progress bar.
pub struct Progress(ProgressBar);

impl Progress {
    /// A bar for `total` units; `template` in the language of `indicatif`. Hidden unless standard error is a terminal.
    fn new(total: u64, template: &str) -> Progress {
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr_with_hz(10));
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        Progress(bar)
    }

    /// A bar for bytes read, of a total that becomes known as reading starts.
    pub fn bytes() -> Progress {
        Progress::new(0, "reading  [{bar:40}] {bytes} of {total_bytes}")
    }

    /// A bar for packets tracked.
    pub fn packets(total: u64) -> Progress {
        Progress::new(total, "tracking [{bar:40}] {human_pos} of {human_len} rows, {eta} left")
    }

    /// A bar for runs of a scenario.
    pub fn runs(total: u64) -> Progress {
        Progress::new(total, "simulating [{bar:40}] {human_pos} of {human_len} runs, {eta} left")
    }

    /// A bar for pieces of work.
    pub fn pieces(total: u64, what: &str) -> Progress {
        Progress::new(total, &format!("{what} [{{bar:40}}] {{pos}} of {{len}}"))
    }

    /// A counter of work whose end is not known.
    pub fn open(what: &str, unit: &str) -> Progress {
        Progress::new(0, &format!("{what} {{spinner}} {{human_pos}} {unit}, {{elapsed}}"))
    }

    /// Sets what is done and how much there is; a total of 0 is unknown.
    pub fn set(&self, done: u64, total: u64) {
        self.0.set_length(total.max(done));
        self.0.set_position(done);
    }

    /// Adds to what is done.
    pub fn add(&self, n: u64) {
        self.0.inc(n);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.0.finish_and_clear();
    }
}
