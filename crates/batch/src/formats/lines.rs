//! A text file as blocks of whole lines.

use memchr::{memchr_iter, memrchr};
use std::io::{self, BufRead, Read};

/// Bytes read at a time.
const BLOCK: usize = 1 << 20;

/// Cuts what a reader delivers after line feeds.
pub(super) struct Lines {
    reader: Box<dyn BufRead>,
    /// What follows the last line feed so far.
    rest: Vec<u8>,
    is_over: bool,
}

impl Lines {
    pub fn new(reader: Box<dyn BufRead>) -> Lines {
        Lines { reader, rest: Vec::new(), is_over: false }
    }

    /// The next lines; only the last block may end without a line feed.
    ///
    /// # Errors
    /// What the reader returns.
    pub fn next(&mut self) -> io::Result<Option<Vec<u8>>> {
        let mut block = std::mem::take(&mut self.rest);
        let mut searched = 0;
        while !self.is_over {
            let wanted = BLOCK.max(block.len());
            block.reserve(wanted);
            let read = self.reader.by_ref().take(wanted as u64).read_to_end(&mut block)?;
            self.is_over = read < wanted;
            if let Some(end) = memrchr(b'\n', &block[searched..]) {
                self.rest = block.split_off(searched + end + 1);
                if !self.is_over {
                    return Ok(Some(block));
                }
                block.append(&mut self.rest);
            }
            searched = block.len();
        }
        Ok(Some(block).filter(|block| !block.is_empty()))
    }

    /// A reader of `block` and everything after it.
    pub fn after(self, block: Vec<u8>) -> impl Read {
        io::Cursor::new(block).chain(io::Cursor::new(self.rest)).chain(self.reader)
    }
}

/// Number of line feeds.
pub(super) fn count(block: &[u8]) -> u64 {
    memchr_iter(b'\n', block).count() as u64
}

#[cfg(test)]
mod tests {
    use super::{BLOCK, Lines};
    use std::io::BufReader;

    #[test]
    fn blocks_are_whole_lines_and_nothing_is_lost() {
        let long = "x".repeat(3 * BLOCK);
        let many: String = (0..300_000_u64).map(|i| format!("{i},{}\n", i * i)).collect();
        for text in ["", "\n", "a", "a\nb", "a\nb\n", &format!("a\n{long}\nb"), &many, &format!("{many}end")] {
            let mut lines = Lines::new(Box::new(BufReader::new(std::io::Cursor::new(text.to_owned().into_bytes()))));
            let mut blocks = Vec::new();
            while let Some(block) = lines.next().unwrap() {
                blocks.push(block);
            }
            assert_eq!(blocks.concat(), text.as_bytes());
            assert!(blocks.iter().rev().skip(1).all(|b| b.ends_with(b"\n")));
        }
    }
}
