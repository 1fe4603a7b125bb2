//! One self-contained page about a trail.
