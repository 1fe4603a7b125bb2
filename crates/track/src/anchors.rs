//! Where the fixed radios are.

use crate::packet::AnchorId;

/// The anchors of a site in a fixed order; an [`AnchorId`] is an index into them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Anchors {
    names: Vec<String>,
    positions_m: Vec<[f64; 3]>,
}

impl Anchors {
    /// Adds an anchor and returns its id, or `None` when the name is taken.
    pub fn add(&mut self, name: &str, position_m: [f64; 3]) -> Option<AnchorId> {
        if self.id(name).is_some() {
            return None;
        }
        self.names.push(name.to_owned());
        self.positions_m.push(position_m);
        Some(self.names.len() as AnchorId - 1)
    }

    /// The id of the anchor called `name`.
    pub fn id(&self, name: &str) -> Option<AnchorId> {
        self.names.iter().position(|n| n == name).map(|i| i as AnchorId)
    }

    /// The name of an anchor.
    ///
    /// # Panics
    /// When `id` is not of these anchors: a bug of ours, ids are made by [`Anchors::add`] alone.
    pub fn name(&self, id: AnchorId) -> &str {
        &self.names[id as usize]
    }

    /// The position of an anchor, metres in the local frame.
    ///
    /// # Panics
    /// When `id` is not of these anchors: a bug of ours, ids are made by [`Anchors::add`] alone.
    pub fn position_m(&self, id: AnchorId) -> [f64; 3] {
        self.positions_m[id as usize]
    }

    /// Names in order of their ids.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }
}
