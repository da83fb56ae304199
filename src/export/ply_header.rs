//! The PLY container: header, then the vertices as columns of numbers.

use std::path::Path;

use crate::error::{Error, Result};

/// Scalar properties of the vertices.
#[derive(Debug)]
pub(super) struct Table {
    /// Vertices.
    pub rows: usize,
    columns: Vec<(String, Vec<f64>)>,
}

impl Table {
    /// Values of a property.
    pub fn column(&self, name: &str) -> Option<&[f64]> {
        self.columns
            .iter()
            .find(|(n, _)| n == name)
            .map(|(_, v)| v.as_slice())
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// Little endian; `bytes` has at least `size` values.
    fn read(self, bytes: &[u8]) -> f64 {
        let b = |k: usize| bytes.get(k).copied().unwrap_or(0);
        let two = [b(0), b(1)];
        let four = [b(0), b(1), b(2), b(3)];
        match self {
            Self::I8 => f64::from(b(0) as i8),
            Self::U8 => f64::from(b(0)),
            Self::I16 => f64::from(i16::from_le_bytes(two)),
            Self::U16 => f64::from(u16::from_le_bytes(two)),
            Self::I32 => f64::from(i32::from_le_bytes(four)),
            Self::U32 => f64::from(u32::from_le_bytes(four)),
            Self::F32 => f64::from(f32::from_le_bytes(four)),
            Self::F64 => f64::from_le_bytes([b(0), b(1), b(2), b(3), b(4), b(5), b(6), b(7)]),
        }
    }
}

struct Header {
    ascii: bool,
    rows: usize,
    properties: Vec<(String, Scalar)>,
    body: usize,
}

fn wrong(path: &Path, what: impl Into<String>) -> Error {
    Error::input(
        path,
        what,
        "give a PLY file, ascii or binary_little_endian, with the vertices first",
    )
}

fn header(path: &Path, data: &[u8]) -> Result<Header> {
    if !data.starts_with(b"ply") {
        return Err(wrong(path, "is not a PLY file"));
    }
    let mark = b"end_header";
    let end = data.windows(mark.len()).position(|w| w == mark);
    let Some(end) = end else {
        return Err(wrong(path, "has no end of the PLY header"));
    };
    let line_end = data[end..].iter().position(|b| *b == b'\n');
    let body = line_end.map_or(data.len(), |k| end + k + 1);
    let text = String::from_utf8_lossy(&data[..end]);
    let mut out = Header {
        ascii: false,
        rows: 0,
        properties: Vec::new(),
        body,
    };
    let mut elements = 0;
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["format", "ascii", ..] => out.ascii = true,
            ["format", "binary_little_endian", ..] => {}
            ["format", other, ..] => return Err(wrong(path, format!("has the format {other}"))),
            ["element", name, count] => {
                elements += 1;
                if elements == 1 {
                    if *name != "vertex" {
                        return Err(wrong(
                            path,
                            format!(
                                "starts with {name} elements; vertex expected (a compressed PLY?)"
                            ),
                        ));
                    }
                    let count = count.parse();
                    out.rows =
                        count.map_err(|_| wrong(path, "has an unreadable number of vertices"))?;
                }
            }
            ["property", "list", ..] if elements == 1 => {
                return Err(wrong(path, "has list properties in its vertices"));
            }
            ["property", kind, name] if elements == 1 => {
                let kind = Scalar::named(kind)
                    .ok_or_else(|| wrong(path, format!("has the unknown type {kind}")))?;
                out.properties.push(((*name).to_owned(), kind));
            }
            _ => {}
        }
    }
    if elements == 0 {
        return Err(wrong(path, "has no vertices"));
    }
    Ok(out)
}

/// Reads the vertices. The count is checked against the file's length before anything is allocated.
pub(super) fn parse(path: &Path) -> Result<Table> {
    let data = std::fs::read(path).map_err(|e| wrong(path, format!("cannot be read: {e}")))?;
    let h = header(path, &data)?;
    let body = &data[h.body.min(data.len())..];
    let size: usize = h.properties.iter().map(|(_, s)| s.size()).sum();
    let least = if h.ascii {
        2 * h.properties.len()
    } else {
        size
    };
    let short = || wrong(path, format!("is cut short: {} vertices announced", h.rows));
    // The last line of a text file may lack its newline.
    if h.rows.checked_mul(least).is_none_or(|n| n > body.len() + 1) {
        return Err(short());
    }
    let mut columns: Vec<(String, Vec<f64>)> = h
        .properties
        .iter()
        .map(|(n, _)| (n.clone(), Vec::with_capacity(h.rows)))
        .collect();
    if h.ascii {
        let text = String::from_utf8_lossy(body);
        let mut words = text.split_whitespace();
        for row in 0..h.rows {
            for (name, values) in &mut columns {
                let word = words.next().ok_or_else(short)?;
                values.push(
                    word.parse()
                        .map_err(|_| wrong(path, format!("{name} of row {row} is {word:?}")))?,
                );
            }
        }
    } else {
        if body.len() < h.rows * size {
            return Err(short());
        }
        for row in body.chunks_exact(size.max(1)).take(h.rows) {
            let mut at = 0;
            for ((_, values), (_, kind)) in columns.iter_mut().zip(&h.properties) {
                values.push(kind.read(&row[at..]));
                at += kind.size();
            }
        }
    }
    Ok(Table {
        rows: h.rows,
        columns,
    })
}
