//! Truth, channels and metrics.
