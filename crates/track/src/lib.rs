//! Packets in, fixes out: the spec, the link that decides what a filter may believe, and the trackers.

pub mod anchors;
pub mod error;
pub mod fix;
pub mod layout;
pub mod mat;
pub mod packet;
pub mod spec;
pub mod target;
pub mod tracker;
pub mod trail;
pub mod truth;
