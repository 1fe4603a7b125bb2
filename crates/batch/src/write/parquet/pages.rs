//! Column chunks of one page each, in the two encodings that trails need.
//!
//! The `parquet` crate writes any column, value by value; a trail is numbers that are copied as they are and words in long runs, and writing
//! those as such takes a third of the time. The crate still frames pages, keeps the metadata and writes the file.

use bytes::Bytes;
use parquet::basic::{Compression, Encoding};
use parquet::column::page::{CompressedPage, Page, PageWriter};
use parquet::column::writer::ColumnCloseResult;
use parquet::errors::ParquetError;
use parquet::file::metadata::ColumnChunkMetaData;
use parquet::file::statistics::Statistics;
use parquet::file::writer::{SerializedPageWriter, TrackedWrite};
use parquet::schema::types::ColumnDescPtr;
use std::collections::HashMap;

/// Small whole numbers in runs of equal ones.
#[derive(Default)]
pub(super) struct Runs {
    runs: Vec<(u32, u32)>,
}

impl Runs {
    #[inline]
    pub fn push(&mut self, value: u32, times: u32) {
        match self.runs.last_mut() {
            Some((last, count)) if *last == value => *count += times,
            _ => self.runs.push((value, times)),
        }
    }

    /// How many numbers there are, and how many of them are `value`.
    fn count(&self, value: u32) -> (u32, u32) {
        self.runs.iter().fold((0, 0), |(all, equal), (v, n)| (all + n, equal + if *v == value { *n } else { 0 }))
    }

    /// The runs of the RLE/bit-packing hybrid encoding: twice the count as LEB128, then the value in whole bytes.
    fn encode(&self, bits: u32, out: &mut Vec<u8>) {
        for (value, count) in &self.runs {
            let mut header = u64::from(*count) << 1;
            while header >= 0x80 {
                out.push(header as u8 | 0x80);
                header >>= 7;
            }
            out.push(header as u8);
            out.extend_from_slice(&value.to_le_bytes()[..bits.div_ceil(8) as usize]);
        }
    }
}

/// The values of one column of a row group.
pub(crate) struct Buffer {
    /// 1 where there is a value.
    levels: Runs,
    values: Values,
}

enum Values {
    /// Behind [`ROOM`] numbers that leave room for the levels.
    Floats(Vec<f64>),
    Ints(Vec<i64>),
    Texts(Texts),
}

/// Numbers before the first of a column: with the levels in front of it a buffer is a page as it stands.
const ROOM: usize = 8;

/// Numbers as the bytes of a page.
struct Numbers(Vec<f64>);

impl AsRef<[u8]> for Numbers {
    fn as_ref(&self) -> &[u8] {
        bytemuck::cast_slice(&self.0)
    }
}

/// Texts by their place in a dictionary.
#[derive(Default)]
struct Texts {
    dictionary: Vec<Box<str>>,
    places: HashMap<Box<str>, u32>,
    indices: Runs,
}

impl Buffer {
    /// Numbers, with room for about so many.
    pub fn floats(rows: usize) -> Buffer {
        let mut values = Vec::with_capacity(ROOM + rows);
        values.resize(ROOM, 0.0);
        Buffer { levels: Runs::default(), values: Values::Floats(values) }
    }

    pub fn ints() -> Buffer {
        Buffer { levels: Runs::default(), values: Values::Ints(Vec::new()) }
    }

    pub fn texts() -> Buffer {
        Buffer { levels: Runs::default(), values: Values::Texts(Texts::default()) }
    }

    #[inline]
    pub fn absent(&mut self) {
        self.levels.push(0, 1);
    }

    /// Appends a number to a column of such.
    #[inline]
    pub fn float(&mut self, x: f64) {
        if let Values::Floats(v) = &mut self.values {
            v.push(x);
            self.levels.push(1, 1);
        }
    }

    /// Appends numbers to a column of such; the place of the first that is not finite, if there is one.
    pub fn all_floats(&mut self, numbers: impl ExactSizeIterator<Item = f64>) -> Option<usize> {
        let Values::Floats(v) = &mut self.values else { return None };
        let (from, count) = (v.len(), numbers.len());
        v.extend(numbers);
        self.levels.push(1, count as u32);
        // A sum of what is not finite is not: one look for many numbers.
        let all = v[from..].iter().fold(0.0, |sum, x| sum + x * 0.0);
        if all == 0.0 { None } else { v[from..].iter().position(|x| !x.is_finite()) }
    }

    /// Appends cells of a column of numbers; the place of the first that is not finite, if there is one.
    pub fn floats_or_none(&mut self, cells: &[Option<f64>]) -> Option<usize> {
        if cells.iter().all(Option::is_some) {
            return self.all_floats(cells.iter().map(|x| x.unwrap_or(0.0)));
        }
        for cell in cells {
            match cell {
                Some(x) => self.float(*x),
                None => self.absent(),
            }
        }
        cells.iter().position(|cell| cell.is_some_and(|x| !x.is_finite()))
    }

    /// Appends a whole number to a column of such.
    #[inline]
    pub fn int(&mut self, i: i64) {
        if let Values::Ints(v) = &mut self.values {
            v.push(i);
            self.levels.push(1, 1);
        }
    }

    /// Appends a text to a column of such, several times.
    #[inline]
    pub fn text(&mut self, text: &str, times: u32) {
        let Values::Texts(texts) = &mut self.values else { return };
        self.levels.push(1, times);
        if let Some((last, count)) = texts.indices.runs.last_mut()
            && *texts.dictionary[*last as usize] == *text
        {
            *count += times;
            return;
        }
        let place = match texts.places.get(text) {
            Some(place) => *place,
            None => {
                let place = texts.dictionary.len() as u32;
                texts.dictionary.push(text.into());
                texts.places.insert(text.into(), place);
                place
            }
        };
        texts.indices.push(place, times);
    }

    /// The column as it stands in a file.
    pub fn chunk(self, column: ColumnDescPtr) -> Result<(Bytes, ColumnCloseResult), ParquetError> {
        let (rows, nulls) = self.levels.count(0);
        let mut levels = vec![0; 4];
        self.levels.encode(1, &mut levels);
        let length = levels.len() as u32 - 4;
        levels[..4].copy_from_slice(&length.to_le_bytes());
        let nulls = Some(u64::from(nulls));
        let mut dictionary = None;
        let (page, statistics) = match self.values {
            Values::Floats(mut v) => {
                let numbers = &v[ROOM..];
                // By the format the smallest of zeros is written as -0, the largest as +0.
                let (low, high) = range(numbers);
                let zero = |x: f64, zero: f64| if x == 0.0 { zero } else { x };
                let some = |x: f64| (!numbers.is_empty()).then_some(x);
                let statistics = Statistics::double(some(zero(low, -0.0)), some(zero(high, 0.0)), None, nulls, false);
                let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut v);
                let page = match (8 * ROOM).checked_sub(levels.len()) {
                    Some(from) => {
                        bytes[from..8 * ROOM].copy_from_slice(&levels);
                        Bytes::from_owner(Numbers(v)).slice(from..)
                    }
                    None => Bytes::from([&levels, &bytes[8 * ROOM..]].concat()),
                };
                (page, statistics)
            }
            Values::Ints(v) => {
                levels.extend_from_slice(bytemuck::cast_slice(&v));
                let (low, high) = (v.iter().min().copied(), v.iter().max().copied());
                (Bytes::from(levels), Statistics::int64(low, high, None, nulls, false))
            }
            Values::Texts(texts) => {
                let bits = usize::BITS - texts.dictionary.len().saturating_sub(1).leading_zeros();
                let bits = bits.max(1);
                levels.push(bits as u8);
                texts.indices.encode(bits, &mut levels);
                let mut plain = Vec::new();
                for text in &texts.dictionary {
                    plain.extend_from_slice(&(text.len() as u32).to_le_bytes());
                    plain.extend_from_slice(text.as_bytes());
                }
                dictionary = Some((plain, texts.dictionary.len() as u32));
                let bound = |text: Option<&Box<str>>| text.map(|t| t.as_bytes().to_vec().into());
                let (low, high) = (texts.dictionary.iter().min(), texts.dictionary.iter().max());
                (Bytes::from(levels), Statistics::byte_array(bound(low), bound(high), None, nulls, false))
            }
        };
        write(column, (page, rows), dictionary, statistics)
    }
}

/// The smallest and the largest of finite numbers.
fn range(numbers: &[f64]) -> (f64, f64) {
    // Several at a time: one after the other each would wait for the one before.
    let (mut low, mut high) = ([f64::INFINITY; 8], [f64::NEG_INFINITY; 8]);
    let chunks = numbers.chunks_exact(8);
    let rest = chunks.remainder();
    for chunk in chunks {
        for i in 0..8 {
            low[i] = if chunk[i] < low[i] { chunk[i] } else { low[i] };
            high[i] = if chunk[i] > high[i] { chunk[i] } else { high[i] };
        }
    }
    let all = |lanes: [f64; 8], pick: fn(f64, f64) -> f64| lanes.iter().chain(rest).copied().fold(lanes[0], pick);
    (all(low, f64::min), all(high, f64::max))
}

/// Bytes of a page that tell whether it can be packed.
const TRIED: usize = 1 << 14;

/// Frames the pages of a column chunk. They are packed where that makes them smaller by a tenth.
fn write(
    column: ColumnDescPtr,
    (page, rows): (Bytes, u32),
    dictionary: Option<(Vec<u8>, u32)>,
    statistics: Statistics,
) -> Result<(Bytes, ColumnCloseResult), ParquetError> {
    let mut packer = snap::raw::Encoder::new();
    let mut pack = |bytes: &[u8]| packer.compress_vec(bytes).map_err(|e| ParquetError::External(Box::new(e)));
    // Most columns cannot be made smaller: a part of one tells.
    let part = &page[page.len() / 2..page.len().min(page.len() / 2 + TRIED)];
    let worth = |packed: usize, whole: usize| packed < whole - whole / 10;
    let packed = match worth(pack(part)?.len(), part.len()) {
        true => Some(pack(&page)?).filter(|packed| worth(packed.len(), page.len())),
        false => None,
    };
    let is_packed = packed.is_some();
    let mut out = TrackedWrite::new(Vec::with_capacity(page.len() + 256));
    let mut pages = SerializedPageWriter::new(&mut out);
    let (mut raw, mut stored, mut bytes) = (0, 0, 0);
    let mut dictionary_at = None;
    let value_encoding = if dictionary.is_some() { Encoding::RLE_DICTIONARY } else { Encoding::PLAIN };
    let data_at;
    {
        let mut put = |page: CompressedPage| {
            let spec = pages.write_page(page)?;
            let header = spec.bytes_written - spec.compressed_size as u64;
            raw += spec.uncompressed_size as u64 + header;
            stored += spec.bytes_written;
            bytes += spec.bytes_written;
            Ok::<u64, ParquetError>(spec.offset)
        };
        if let Some((plain, count)) = dictionary {
            let size = plain.len();
            let buf = match is_packed {
                true => pack(&plain)?,
                false => plain,
            };
            let page = Page::DictionaryPage {
                buf: Bytes::from(buf),
                num_values: count,
                encoding: Encoding::PLAIN,
                is_sorted: false,
            };
            dictionary_at = Some(put(CompressedPage::new(page, size))?);
        }
        let size = page.len();
        let data = Page::DataPage {
            buf: packed.map_or(page, Bytes::from),
            num_values: rows,
            encoding: value_encoding,
            def_level_encoding: Encoding::RLE,
            rep_level_encoding: Encoding::RLE,
            statistics: None,
        };
        data_at = put(CompressedPage::new(data, size))?;
    }
    pages.close()?;
    let mut encodings = vec![Encoding::PLAIN, Encoding::RLE];
    if dictionary_at.is_some() {
        encodings.push(Encoding::RLE_DICTIONARY);
    }
    let metadata = ColumnChunkMetaData::builder(column)
        .set_compression(if is_packed { Compression::SNAPPY } else { Compression::UNCOMPRESSED })
        .set_encodings(encodings)
        .set_num_values(i64::from(rows))
        .set_total_compressed_size(stored as i64)
        .set_total_uncompressed_size(raw as i64)
        .set_data_page_offset(data_at as i64)
        .set_dictionary_page_offset(dictionary_at.map(|at| at as i64))
        .set_statistics(statistics)
        .build()?;
    let close = ColumnCloseResult {
        bytes_written: bytes,
        rows_written: u64::from(rows),
        metadata,
        bloom_filter: None,
        column_index: None,
        offset_index: None,
    };
    Ok((Bytes::from(out.into_inner()?), close))
}
