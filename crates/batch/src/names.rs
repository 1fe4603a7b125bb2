//! Targets by name: a number each, the same for all who read parts of a table.

use std::collections::HashMap;
use std::fmt::Write;
use std::sync::{Mutex, PoisonError};

/// The number of a target.
pub(crate) type TargetId = u32;

/// Most targets of a table: a record has 24 bits for the number of its target.
pub(crate) const MOST_TARGETS: usize = 1 << 24;

/// Every target seen so far. The number of a target depends on who came first; the order of targets is that of their names.
#[derive(Default)]
pub(crate) struct Names {
    inner: Mutex<Interner>,
}

#[derive(Default)]
struct Interner {
    ids: HashMap<Box<str>, TargetId>,
    list: Vec<Box<str>>,
}

impl Names {
    /// The names by number. The target of a table without a target column is called "", which is the name of no other.
    pub fn list(&self) -> Vec<Box<str>> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner).list.clone()
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner).list.len()
    }

    /// The name of a target.
    pub fn name(&self, id: TargetId) -> Option<Box<str>> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner).list.get(id as usize).cloned()
    }

    fn id(&self, name: &str) -> TargetId {
        let mut inner = self.inner.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(id) = inner.ids.get(name) {
            return *id;
        }
        let id = inner.list.len() as TargetId;
        inner.list.push(name.into());
        inner.ids.insert(name.into(), id);
        id
    }
}

/// One reader's way to [`Names`]: remembers what it has looked up, and which target came after which.
///
/// Rows of one target follow each other, or targets take turns: in both cases the guess is right and nothing is hashed.
#[derive(Default)]
pub(crate) struct Lookup {
    places: HashMap<Box<str>, u32>,
    known: Vec<Known>,
    last: u32,
    /// The text of the last number.
    number: Option<i64>,
    text: String,
}

struct Known {
    name: Box<str>,
    /// Its first eight bytes, zeros behind a shorter one, and which of them count.
    start: (u64, u64),
    id: TargetId,
    /// Place of the target that last came after this one.
    next: u32,
}

impl Lookup {
    /// The number of a target whose name is a whole number.
    pub fn numbered(&mut self, names: &Names, number: i64) -> TargetId {
        let mut text = std::mem::take(&mut self.text);
        if self.number != Some(number) {
            text.clear();
            // Writing to a string cannot fail.
            let _ = write!(text, "{number}");
            self.number = Some(number);
        }
        let id = self.id(names, &text);
        self.text = text;
        id
    }

    /// The number of the last target, and the length of its name, if `text` begins with the name as a cell of its own.
    #[inline]
    pub fn leads(&self, text: &[u8]) -> Option<(TargetId, usize)> {
        let last = self.known.get(self.last as usize)?;
        let (name, (start, mask)) = (last.name.as_bytes(), last.start);
        if !matches!(text.get(name.len()), Some(b',' | b'\n')) || name.is_empty() {
            return None;
        }
        // Names are short: one comparison of eight bytes tells.
        let is_same = match text.first_chunk::<8>() {
            Some(eight) if u64::from_le_bytes(*eight) & mask != start => false,
            Some(_) if name.len() <= 8 => true,
            _ => text.starts_with(name),
        };
        is_same.then_some((last.id, name.len()))
    }

    /// The number of a target.
    pub fn id(&mut self, names: &Names, name: &str) -> TargetId {
        if let Some(last) = self.known.get(self.last as usize) {
            if *last.name == *name {
                return last.id;
            }
            let next = last.next;
            if let Some(guess) = self.known.get(next as usize)
                && *guess.name == *name
            {
                self.last = next;
                return guess.id;
            }
        }
        let place = match self.places.get(name) {
            Some(place) => *place,
            None => {
                let place = self.known.len() as u32;
                self.places.insert(name.into(), place);
                self.known.push(Known { name: name.into(), start: start(name), id: names.id(name), next: place });
                place
            }
        };
        if let Some(last) = self.known.get_mut(self.last as usize) {
            last.next = place;
        }
        self.last = place;
        self.known[place as usize].id
    }
}

/// The first eight bytes of a name, zeros behind a shorter one, and which of them count.
fn start(name: &str) -> (u64, u64) {
    let (mut bytes, mut mask) = ([0; 8], [0; 8]);
    for ((byte, counts), of_name) in bytes.iter_mut().zip(&mut mask).zip(name.bytes()) {
        (*byte, *counts) = (of_name, u8::MAX);
    }
    (u64::from_le_bytes(bytes), u64::from_le_bytes(mask))
}
