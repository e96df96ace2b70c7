//! Words and numbers out of a file's bytes, text or binary, with the place for messages.

use crate::error::Defect;
use crate::files::quoted;
use glam::DVec3;
use std::str::FromStr;

pub(super) const DAMAGED: &str = "the file is truncated or damaged: export it again";

/// The type of a stored number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Number {
    pub(super) const fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    const fn is_real(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// The numbers in some bytes; a rest shorter than a number is passed over.
    pub(super) fn reals(self, bytes: &[u8], big_endian: bool) -> Vec<f64> {
        let numbers = bytes.chunks_exact(self.size());
        numbers
            .map(|number| match (self, little_endian(number, big_endian)) {
                (Self::F32, bits) => f64::from(f32::from_bits(bits as u32)),
                (Self::F64, bits) => f64::from_bits(bits),
                (_, bits) => self.integer(bits) as f64,
            })
            .collect()
    }

    /// Like [`Number::reals`], for whole numbers. Those past `i64` become its maximum, which is no index anywhere.
    pub(super) fn integers(self, bytes: &[u8], big_endian: bool) -> Result<Vec<i64>, Defect> {
        if self.is_real() {
            let problem = "there are real numbers where indices belong";
            return Err(Defect::new("header", problem, "export the file again"));
        }
        let numbers = bytes.chunks_exact(self.size());
        Ok(numbers
            .map(|number| self.integer(little_endian(number, big_endian)))
            .collect())
    }

    const fn integer(self, bits: u64) -> i64 {
        match self {
            Self::I8 => bits as i8 as i64,
            Self::I16 => bits as i16 as i64,
            Self::I32 => bits as i32 as i64,
            Self::U64 if bits > i64::MAX as u64 => i64::MAX,
            _ => bits as i64,
        }
    }
}

/// Up to eight bytes as one number.
fn little_endian(bytes: &[u8], big_endian: bool) -> u64 {
    let push = |bits: u64, &byte: &u8| bits << 8 | u64::from(byte);
    if big_endian {
        bytes.iter().fold(0, push)
    } else {
        bytes.iter().rev().fold(0, push)
    }
}

/// Threes of numbers as points; a rest of fewer is passed over.
pub(super) fn points(numbers: &[f64]) -> Vec<DVec3> {
    numbers.chunks_exact(3).map(DVec3::from_slice).collect()
}

/// Goes through a file. Memory grows with the bytes that are there, not with the counts that they claim.
#[derive(Debug, Clone)]
pub(super) struct Scanner<'a> {
    rest: &'a [u8],
    consumed: usize,
    /// Counted from 1, as long as the file is text.
    line: usize,
    /// Whether arrays of numbers are stored as in memory; single words are text all the same.
    pub(super) binary: bool,
    pub(super) big_endian: bool,
    /// Whether `#` starts a comment.
    comments: bool,
}

impl<'a> Scanner<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self {
            rest: bytes,
            consumed: 0,
            line: 1,
            binary: false,
            big_endian: false,
            comments: false,
        }
    }

    /// A scanner of text in which `#` starts a comment.
    pub(super) fn with_comments(bytes: &'a [u8]) -> Self {
        Self {
            comments: true,
            ..Self::new(bytes)
        }
    }

    pub(super) fn place(&self) -> String {
        if self.binary {
            format!("byte {}", self.consumed)
        } else {
            format!("line {}", self.line)
        }
    }

    pub(super) fn defect(&self, problem: impl Into<String>) -> Defect {
        Defect::new(self.place(), problem, DAMAGED)
    }

    pub(super) fn remaining(&self) -> usize {
        self.rest.len()
    }

    fn advance(&mut self, count: usize) -> &'a [u8] {
        let (taken, rest) = self.rest.split_at(count);
        self.rest = rest;
        self.consumed += count;
        if !self.binary {
            self.line += taken.iter().filter(|&&b| b == b'\n').count();
        }
        taken
    }

    fn skip_blank(&mut self) {
        loop {
            let blank = self.rest.iter().take_while(|b| b.is_ascii_whitespace());
            let count = blank.count();
            self.advance(count);
            if !(self.comments && self.rest.first() == Some(&b'#')) {
                return;
            }
            self.rest_of_line();
        }
    }

    /// The next word, if there is one; it stays where it is.
    pub(super) fn peek(&mut self) -> Option<&'a str> {
        self.skip_blank();
        let length = self.word_length();
        std::str::from_utf8(&self.rest[..length])
            .ok()
            .filter(|w| !w.is_empty())
    }

    fn word_length(&self) -> usize {
        let word = self.rest.iter().take_while(|b| !b.is_ascii_whitespace());
        word.count()
    }

    /// The next word, if the file is not at its end.
    pub(super) fn next(&mut self) -> Result<Option<&'a str>, Defect> {
        self.skip_blank();
        let length = self.word_length();
        if length == 0 {
            return Ok(None);
        }
        let word = std::str::from_utf8(&self.rest[..length]);
        let word = word.map_err(|_| self.defect("it is not text"))?;
        self.advance(length);
        Ok(Some(word))
    }

    /// The next word, which `what` says.
    pub(super) fn word(&mut self, what: &str) -> Result<&'a str, Defect> {
        self.next()?.ok_or_else(|| {
            Defect::new(
                "end of file",
                format!("{what} is missing"),
                "the file is truncated or its counts are wrong: export it again",
            )
        })
    }

    /// A word that is known beforehand.
    pub(super) fn keyword(&mut self, keyword: &str) -> Result<(), Defect> {
        let place = self.clone();
        let word = self.word(keyword)?;
        if word == keyword {
            return Ok(());
        }
        Err(place.defect(format!("{} stands where {keyword} belongs", quoted(word))))
    }

    /// A number written as text.
    pub(super) fn number<T: FromStr>(&mut self, what: &str) -> Result<T, Defect> {
        let word = self.word(what)?;
        word.parse()
            .map_err(|_| self.defect(format!("{} is not {what}", quoted(word))))
    }

    /// What is left of the line, without its end.
    pub(super) fn rest_of_line(&mut self) -> &'a [u8] {
        let end = self.rest.iter().position(|&b| b == b'\n');
        let line = self.advance(end.map_or(self.rest.len(), |e| e + 1));
        line.trim_ascii()
    }

    /// Passes over everything up to the end of the first occurrence of some bytes.
    pub(super) fn skip_past(&mut self, end: &str) -> Result<(), Defect> {
        let at = self
            .rest
            .windows(end.len())
            .position(|w| w == end.as_bytes());
        match at {
            Some(at) => self.advance(at + end.len()),
            None => return Err(self.defect(format!("{end} is missing"))),
        };
        Ok(())
    }

    /// Ends the line before an array that is stored as in memory; text may go on in the same line.
    pub(super) fn begin_array(&mut self) {
        if self.binary {
            self.rest_of_line();
        }
    }

    /// The bytes of `count` numbers of a size.
    pub(super) fn raw(&mut self, count: usize, size: usize) -> Result<&'a [u8], Defect> {
        let wanted = count.checked_mul(size).filter(|&w| w <= self.rest.len());
        let wanted = wanted.ok_or_else(|| {
            self.defect(format!(
                "{count} numbers of {size} bytes should follow, but only {} bytes do",
                self.rest.len()
            ))
        })?;
        Ok(self.advance(wanted))
    }

    /// Whole numbers, as text or of the type that a binary file has them in.
    pub(super) fn integers(&mut self, count: usize, stored: Number) -> Result<Vec<i64>, Defect> {
        if self.binary {
            let bytes = self.raw(count, stored.size())?;
            return stored.integers(bytes, self.big_endian);
        }
        (0..count).map(|_| self.number("a whole number")).collect()
    }

    /// Numbers, as text or of the type that a binary file has them in.
    pub(super) fn reals(&mut self, count: usize, stored: Number) -> Result<Vec<f64>, Defect> {
        if self.binary {
            let bytes = self.raw(count, stored.size())?;
            return Ok(stored.reals(bytes, self.big_endian));
        }
        (0..count).map(|_| self.number("a number")).collect()
    }

    /// A count or another whole number that is not negative.
    pub(super) fn count(&mut self, what: &str, stored: Number) -> Result<usize, Defect> {
        let number = if self.binary {
            self.integers(1, stored)?[0]
        } else {
            self.number(what)?
        };
        usize::try_from(number).map_err(|_| self.defect(format!("{number} is not {what}")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_come_with_their_line() {
        let mut scan = Scanner::with_comments(b"# c\n a 1 # 2\n\n3.5");
        assert_eq!(scan.peek(), Some("a"));
        assert_eq!(scan.word("").unwrap(), "a");
        assert_eq!(scan.place(), "line 2");
        assert_eq!(scan.integers(1, Number::I32).unwrap(), [1]);
        assert_eq!(scan.reals(1, Number::F32).unwrap(), [3.5]);
        assert_eq!(scan.word("the end").unwrap_err().place, "end of file");
        let mut wrong = Scanner::new(b"a\nb");
        wrong.word("").unwrap();
        assert_eq!(wrong.number::<f64>("a number").unwrap_err().place, "line 2");
    }

    #[test]
    fn stored_numbers_keep_sign_and_endianness() {
        assert_eq!(Number::I16.integers(&[0xff, 0xfe], true).unwrap(), [-2]);
        assert_eq!(Number::I16.integers(&[0xfe, 0xff], false).unwrap(), [-2]);
        assert_eq!(Number::U8.integers(&[255], true).unwrap(), [255]);
        assert_eq!(Number::U64.integers(&[255; 8], true).unwrap(), [i64::MAX]);
        assert_eq!(Number::F32.reals(&1.5f32.to_be_bytes(), true), [1.5]);
        assert_eq!(Number::F64.reals(&1.5f64.to_le_bytes(), false), [1.5]);
        assert!(Number::F64.integers(&[0; 8], false).is_err());
    }

    #[test]
    fn claims_beyond_the_file_are_refused() {
        let mut scan = Scanner::new(&[0; 16]);
        scan.binary = true;
        assert!(scan.raw(usize::MAX, 8).is_err());
        assert!(scan.reals(3, Number::F64).is_err());
        assert_eq!(scan.reals(2, Number::F64).unwrap(), [0.0, 0.0]);
    }
}
