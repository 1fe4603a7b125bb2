//! Packets in, fixes out: the spec, the link that decides what a filter may believe, and the trackers.

pub mod anchors;
mod dims;
pub mod error;
pub mod filter;
pub mod fix;
pub mod geo;
pub mod heap;
pub mod layout;
pub mod linearised;
pub mod link;
pub mod mat;
pub mod model;
pub mod packet;
pub mod pipeline;
pub mod registry;
mod search;
pub mod simulator;
pub mod spec;
pub mod survey;
pub mod target;
pub mod theory;
pub mod trace;
pub mod tracker;
pub mod trackers;
pub mod trail;
pub mod truth;
pub mod verify;
