//! Arrays in VTK's XML files: a header of counts, then the bytes, perhaps in base64, perhaps in blocks compressed by zlib.

use super::scan::Number;
use crate::error::Defect;
use crate::files::quoted;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use roxmltree::Node;
use std::io::{self, Read, Write};

/// How a file stores its arrays.
#[derive(Debug, Clone, Copy)]
pub(super) struct Encoding {
    pub(super) big_endian: bool,
    header: Number,
    compressed: bool,
}

impl Encoding {
    pub(super) fn of(root: &Node<'_, '_>) -> Result<Self, Defect> {
        let refuse = |problem: String, remedy: &str| Err(Defect::new("VTKFile", problem, remedy));
        let compressed = match root.attribute("compressor") {
            None | Some("") => false,
            Some("vtkZLibDataCompressor") => true,
            Some(other) => {
                let problem = format!(
                    "it is compressed by {}, which is not supported",
                    quoted(other)
                );
                return refuse(problem, "write it with zlib or without compression");
            }
        };
        let header = match root.attribute("header_type") {
            None | Some("UInt32") => Number::U32,
            Some("UInt64") => Number::U64,
            Some(other) => {
                return refuse(
                    format!("{} is no type of headers", quoted(other)),
                    "export the file again",
                );
            }
        };
        Ok(Self {
            big_endian: root.attribute("byte_order") == Some("BigEndian"),
            header,
            compressed,
        })
    }
}

/// The bytes of an array from where its header stands. Appended data goes on after it.
pub(super) fn decode(data: &[u8], base64: bool, encoding: Encoding) -> Result<Vec<u8>, String> {
    let decoded;
    let bytes = if base64 {
        decoded = decode_base64(data)?;
        &decoded
    } else {
        data
    };
    if bytes.is_empty() {
        return Ok(Vec::new());
    }
    let mut header = Header { bytes, encoding };
    if !encoding.compressed {
        let size = header.next()?;
        return header.take(size).map(<[u8]>::to_vec);
    }
    let (blocks, block_size, last_size) = (header.next()?, header.next()?, header.next()?);
    let sizes = header.take(blocks.saturating_mul(encoding.header.size()))?;
    let sizes = encoding
        .header
        .integers(sizes, encoding.big_endian)
        .map_err(|defect| defect.problem)?;
    let mut content = Vec::new();
    for (b, &compressed_size) in sizes.iter().enumerate() {
        let block = header.take(usize::try_from(compressed_size).unwrap_or(usize::MAX))?;
        let wanted = if b + 1 == blocks && last_size > 0 {
            last_size
        } else {
            block_size
        };
        let before = content.len();
        let inflated = ZlibDecoder::new(block)
            .take(wanted as u64)
            .read_to_end(&mut content);
        inflated.map_err(|e| format!("block {b} cannot be decompressed ({e})"))?;
        if content.len() - before != wanted {
            return Err(format!(
                "block {b} should hold {wanted} bytes, but has {}",
                content.len() - before
            ));
        }
    }
    Ok(content)
}

/// Header and data while they are taken apart.
struct Header<'a> {
    bytes: &'a [u8],
    encoding: Encoding,
}

impl<'a> Header<'a> {
    fn next(&mut self) -> Result<usize, String> {
        let Encoding {
            header, big_endian, ..
        } = self.encoding;
        let number = self.take(header.size())?;
        let number = header
            .integers(number, big_endian)
            .map_err(|defect| defect.problem)?[0];
        Ok(usize::try_from(number).unwrap_or(usize::MAX))
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let parts = self.bytes.split_at_checked(count);
        let (taken, rest) = parts.ok_or_else(|| {
            format!(
                "{count} bytes should follow, but only {} do",
                self.bytes.len()
            )
        })?;
        self.bytes = rest;
        Ok(taken)
    }
}

/// Base64 as far as it goes. Header and data may be encoded one after the other, each with its padding.
fn decode_base64(data: &[u8]) -> Result<Vec<u8>, String> {
    let is_base64 =
        |b: &u8| b.is_ascii_alphanumeric() || b"+/=".contains(b) || b.is_ascii_whitespace();
    let end = data
        .iter()
        .position(|b| !is_base64(b))
        .unwrap_or(data.len());
    let letters: Vec<u8> = data[..end]
        .iter()
        .copied()
        .filter(|b| !b.is_ascii_whitespace())
        .collect();
    let mut content = Vec::new();
    let mut rest = letters.as_slice();
    while !rest.is_empty() {
        let padding = rest.iter().position(|&b| b == b'=').unwrap_or(rest.len());
        let (part, others) = rest.split_at((padding + 1).next_multiple_of(4).min(rest.len()));
        let decoded = STANDARD.decode_vec(part, &mut content);
        decoded.map_err(|e| format!("it is not base64 ({e})"))?;
        rest = others;
    }
    Ok(content)
}

/// The bytes that a block holds before it is compressed.
const BLOCK: usize = 1 << 20;

/// Writes an array in base64, compressed by zlib, with a header of 64-bit numbers, little endian.
pub(super) fn write(out: &mut dyn Write, bytes: &[u8]) -> io::Result<()> {
    let blocks: Vec<Vec<u8>> = bytes
        .chunks(BLOCK)
        .map(|block| {
            let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
            encoder.write_all(block)?;
            encoder.finish()
        })
        .collect::<io::Result<_>>()?;
    let header = [blocks.len(), BLOCK, bytes.len() % BLOCK];
    let sizes = header.into_iter().chain(blocks.iter().map(Vec::len));
    let header: Vec<u8> = sizes.flat_map(|size| (size as u64).to_le_bytes()).collect();
    out.write_all(STANDARD.encode(header).as_bytes())?;
    out.write_all(STANDARD.encode(blocks.concat()).as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    const COMPRESSED: Encoding = Encoding {
        big_endian: false,
        header: Number::U64,
        compressed: true,
    };

    #[test]
    fn arrays_of_any_number_of_blocks_come_back() {
        for size in [0, 1, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK] {
            let bytes: Vec<u8> = (0..size).map(|k| ((k * k) >> 7) as u8).collect();
            let mut text = Vec::new();
            write(&mut text, &bytes).unwrap();
            text.extend(b"\n</DataArray>");
            assert!(decode(&text, true, COMPRESSED).unwrap() == bytes, "{size}");
        }
    }

    #[test]
    fn header_and_data_may_be_encoded_apart_or_together() {
        let plain = Encoding {
            compressed: false,
            header: Number::U32,
            ..COMPRESSED
        };
        let (header, data) = (4u32.to_le_bytes(), *b"abcd");
        let apart = STANDARD.encode(header) + &STANDARD.encode(data);
        let together = STANDARD.encode([header, data].concat());
        for text in [apart, together] {
            assert_eq!(decode(text.as_bytes(), true, plain).unwrap(), b"abcd");
        }
        assert_eq!(
            decode(&[header, data].concat(), false, plain).unwrap(),
            b"abcd"
        );
    }

    #[test]
    fn padding_in_the_wrong_place_is_refused() {
        for text in ["=", "====", "YQ=Y", "YQ==="] {
            assert!(decode_base64(text.as_bytes()).is_err(), "{text}");
        }
    }

    #[test]
    fn headers_that_lie_are_refused() {
        let huge = [u64::MAX, 1, 1].map(u64::to_le_bytes).concat();
        assert!(decode(&huge, false, COMPRESSED).is_err());
        let short = [1u64, 10, 10, 3].map(u64::to_le_bytes).concat();
        assert!(decode(&short, false, COMPRESSED).is_err());
    }
}
