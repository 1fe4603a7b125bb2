//! Speed beside the peers.
