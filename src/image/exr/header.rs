//! The header of an EXR with its attributes sorted: the encoder keeps them in a hash map, and equal images give equal bytes.

use crate::image::file::WriteSeek;
use std::io::{Result, Seek, SeekFrom, Write};

/// Magic number and version.
const START: usize = 8;

/// Passes everything on and keeps the header, to write it once more when the rest is written.
pub struct SortedHeader<'a> {
    out: &'a mut dyn WriteSeek,
    header: Vec<u8>,
    at: u64,
    /// How the header ends in `header`, once it is all there.
    end: Option<usize>,
}

impl<'a> SortedHeader<'a> {
    /// Before the first byte.
    pub fn new(out: &'a mut dyn WriteSeek) -> Self {
        Self { out, header: Vec::new(), at: 0, end: None }
    }

    /// After the last byte.
    pub fn finish(mut self) -> Result<()> {
        if let Some(end) = self.end {
            sort_attributes(&mut self.header[..end]);
            self.out.seek(SeekFrom::Start(0))?;
            self.out.write_all(&self.header[..end])?;
            self.out.seek(SeekFrom::End(0))?;
        }
        Ok(())
    }
}

impl Write for SortedHeader<'_> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        let count = self.out.write(bytes)?;
        if self.end.is_none() && self.at == self.header.len() as u64 {
            self.header.extend(&bytes[..count]);
            self.end = end_of_attributes(&self.header);
        }
        self.at += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> Result<()> {
        self.out.flush()
    }
}

impl Seek for SortedHeader<'_> {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        self.at = self.out.seek(to)?;
        Ok(self.at)
    }
}

/// The end of the attribute that begins at `at` and of its name. Each is: name, 0, type, 0, length in 32 bits, value.
fn attribute(bytes: &[u8], at: usize) -> Option<(usize, usize)> {
    let end_of_text = |from: usize| Some(from + bytes.get(from..)?.iter().position(|&byte| byte == 0)?);
    let name_end = end_of_text(at)?;
    let length_at = end_of_text(name_end + 1)? + 1;
    let length = u32::from_le_bytes(*bytes.get(length_at..)?.first_chunk()?) as usize;
    let end = length_at + 4 + length;
    (end <= bytes.len()).then_some((end, name_end))
}

/// Where the list of attributes ends, which a 0 does; none where it is not whole.
fn end_of_attributes(bytes: &[u8]) -> Option<usize> {
    let mut at = START;
    while *bytes.get(at)? != 0 {
        at = attribute(bytes, at)?.0;
    }
    Some(at)
}

/// Sorts the attributes by name. The header keeps its length.
fn sort_attributes(header: &mut [u8]) {
    let mut attributes = Vec::new();
    let mut at = START;
    while let Some((end, name_end)) = attribute(header, at) {
        attributes.push((header[at..name_end].to_vec(), header[at..end].to_vec()));
        at = end;
    }
    attributes.sort();
    let sorted = attributes.into_iter().flat_map(|(_, attribute)| attribute);
    header[START..].iter_mut().zip(sorted).for_each(|(byte, new)| *byte = new);
}
