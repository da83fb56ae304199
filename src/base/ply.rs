//! PLY files: the header, and the `vertex` element as a table of scalar columns.
//!
//! Format: Turk, "The PLY polygon file format" (1994). ASCII and binary little endian; lists and big endian are refused.

use std::io::Read;
use std::path::{Path, PathBuf};

use glam::DVec3;

use crate::base::error::{Error, Result};

/// A scalar type of the format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scalar {
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
    /// Both names of every type, and its size in bytes.
    const ALL: [(&str, &str, Self, usize); 8] = [
        ("char", "int8", Self::I8, 1),
        ("uchar", "uint8", Self::U8, 1),
        ("short", "int16", Self::I16, 2),
        ("ushort", "uint16", Self::U16, 2),
        ("int", "int32", Self::I32, 4),
        ("uint", "uint32", Self::U32, 4),
        ("float", "float32", Self::F32, 4),
        ("double", "float64", Self::F64, 8),
    ];

    /// The little-endian value at the start of `bytes`; `None` if they are too few.
    fn read(self, bytes: &[u8]) -> Option<f64> {
        Some(match self {
            Self::I8 => f64::from(i8::from_le_bytes(*bytes.first_chunk()?)),
            Self::U8 => f64::from(*bytes.first()?),
            Self::I16 => f64::from(i16::from_le_bytes(*bytes.first_chunk()?)),
            Self::U16 => f64::from(u16::from_le_bytes(*bytes.first_chunk()?)),
            Self::I32 => f64::from(i32::from_le_bytes(*bytes.first_chunk()?)),
            Self::U32 => f64::from(u32::from_le_bytes(*bytes.first_chunk()?)),
            Self::F32 => f64::from(f32::from_le_bytes(*bytes.first_chunk()?)),
            Self::F64 => f64::from_le_bytes(*bytes.first_chunk()?),
        })
    }
}

/// A column of the table.
#[derive(Debug, Clone)]
struct Property {
    name: String,
    scalar: Scalar,
    /// Bytes from the start of a row.
    offset: usize,
}

/// One `element` of a header.
#[derive(Debug, Default)]
struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
    stride: usize,
    has_list: bool,
}

/// A header, its comments, and the offset of the data.
struct Header {
    ascii: bool,
    elements: Vec<Element>,
    comments: Vec<String>,
    data: usize,
}

/// The `vertex` element of a file.
pub(crate) struct Table {
    path: PathBuf,
    comments: Vec<String>,
    rows: usize,
    properties: Vec<Property>,
    stride: usize,
    body: Body,
}

/// The values of a table.
enum Body {
    /// The file's bytes, and the offset of the first row.
    Binary(Vec<u8>, usize),
    /// Values, row by row.
    Ascii(Vec<f64>),
}

/// An [`Error::Input`] about a damaged file.
fn bad(path: &Path, what: impl Into<String>) -> Error {
    Error::input(path, what, "export the PLY file again")
}

impl Table {
    /// Reads a file's `vertex` element.
    ///
    /// # Errors
    /// A file of another format, big endian, a list among the vertex's properties, a file shorter than its header says.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
        let header = parse_header(path, &bytes)?;
        let Some(at) = header.elements.iter().position(|e| e.name == "vertex") else {
            return Err(bad(path, "no element 'vertex' in the header"));
        };
        let (before, vertex) = (&header.elements[..at], &header.elements[at]);
        if vertex.has_list {
            return Err(bad(
                path,
                "a list among the vertex properties; scalars expected",
            ));
        }
        let names = || vertex.properties.iter().map(|p| p.name.as_str());
        if names().any(|n| n == "packed_position") {
            return Err(Error::input(
                path,
                "a compressed PLY (packed_position); plain 3DGS properties expected",
                "decompress it (SuperSplat: export as uncompressed PLY)",
            ));
        }
        if let Some(twice) = names()
            .enumerate()
            .find(|(i, n)| names().take(*i).any(|m| m == *n))
        {
            return Err(bad(path, format!("property {} is declared twice", twice.1)));
        }
        let (rows, body) = if header.ascii {
            ascii_body(path, &bytes[header.data..], before, vertex)?
        } else {
            let (rows, start) = binary_start(path, bytes.len(), header.data, before, vertex)?;
            (rows, Body::Binary(bytes, start))
        };
        Ok(Self {
            path: path.to_path_buf(),
            comments: header.comments,
            rows,
            properties: vertex.properties.clone(),
            stride: vertex.stride,
            body,
        })
    }

    /// Comments of the header, in the file's order.
    pub(crate) fn comments(&self) -> &[String] {
        &self.comments
    }

    /// True if there is a property of that name.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.properties.iter().any(|p| p.name == name)
    }

    /// Names of the properties, in the file's order.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.properties.iter().map(|p| p.name.as_str())
    }

    /// The values of a property, one per vertex.
    ///
    /// # Errors
    /// A missing property; a value that is not finite.
    pub(crate) fn column(&self, name: &str) -> Result<Vec<f64>> {
        let Some(k) = self.properties.iter().position(|p| p.name == name) else {
            return Err(bad(&self.path, format!("the property {name} is missing")));
        };
        let property = &self.properties[k];
        let value = |row: usize| match &self.body {
            Body::Binary(bytes, start) => bytes
                .get(start + row * self.stride + property.offset..)
                .and_then(|b| property.scalar.read(b)),
            Body::Ascii(values) => values.get(row * self.properties.len() + k).copied(),
        };
        let mut out = Vec::with_capacity(self.rows);
        for row in 0..self.rows {
            match value(row).filter(|v| v.is_finite()) {
                Some(v) => out.push(v),
                None => {
                    let found = value(row).unwrap_or(f64::NAN);
                    let what =
                        format!("{name} of vertex {row} is {found}; a finite number expected");
                    return Err(bad(&self.path, what));
                }
            }
        }
        Ok(out)
    }

    /// A colour channel in 0…255. Floats within [0, 1] are taken as fractions, 16-bit integers as 0…65535.
    fn color(&self, name: &str) -> Result<Vec<u8>> {
        let values = self.column(name)?;
        let scalar = self.properties.iter().find(|p| p.name == name);
        let factor = match scalar.map(|p| p.scalar) {
            Some(Scalar::F32 | Scalar::F64) if values.iter().all(|&v| v <= 1.0) => 255.0,
            Some(Scalar::U16) => 255.0 / 65535.0,
            _ => 1.0,
        };
        let byte = |v: f64| (v * factor).round().clamp(0.0, 255.0) as u8;
        Ok(values.into_iter().map(byte).collect())
    }

    /// Positions and colours, in the file's own frame; grey (128) without `red green blue`.
    ///
    /// # Errors
    /// A missing or non-finite coordinate.
    pub(crate) fn points(&self) -> Result<(Vec<DVec3>, Vec<[u8; 3]>)> {
        let [x, y, z] = [self.column("x")?, self.column("y")?, self.column("z")?];
        let row = |i: usize| DVec3::new(x[i], y[i], z[i]);
        let positions = (0..self.rows).map(row).collect();
        let colors = if ["red", "green", "blue"].iter().all(|c| self.has(c)) {
            let [r, g, b] = [
                self.color("red")?,
                self.color("green")?,
                self.color("blue")?,
            ];
            (0..self.rows).map(|i| [r[i], g[i], b[i]]).collect()
        } else {
            vec![[128; 3]; self.rows]
        };
        Ok((positions, colors))
    }
}

/// Positions and colours of a plain point cloud, in the file's own frame.
///
/// # Errors
/// Those of [`Table::read`] and [`Table::points`].
pub(crate) fn read_points(path: &Path) -> Result<(Vec<DVec3>, Vec<[u8; 3]>)> {
    Table::read(path)?.points()
}

/// Comments in the header of a file, whose data is not read.
///
/// # Errors
/// A file that cannot be read, or is no PLY.
pub(crate) fn read_comments(path: &Path) -> Result<Vec<String>> {
    let mut bytes = Vec::new();
    std::fs::File::open(path)
        .and_then(|file| file.take(HEADER_LIMIT as u64).read_to_end(&mut bytes))
        .map_err(|e| Error::io(path, e))?;
    Ok(parse_header(path, &bytes)?.comments)
}

/// Largest header that is read, bytes.
const HEADER_LIMIT: usize = 1 << 20;

fn parse_header(path: &Path, bytes: &[u8]) -> Result<Header> {
    let mut header = Header {
        ascii: false,
        elements: Vec::new(),
        comments: Vec::new(),
        data: 0,
    };
    let mut format = None;
    for number in 0_usize.. {
        let rest = &bytes[header.data..];
        let end = rest.iter().take(HEADER_LIMIT).position(|&b| b == b'\n');
        let (Some(end), true) = (end, header.data < HEADER_LIMIT) else {
            return Err(bad(path, "no PLY header that ends with 'end_header'"));
        };
        let line = String::from_utf8_lossy(&rest[..end]).into_owned();
        header.data += end + 1;
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["ply"] if number == 0 => {}
            _ if number == 0 => return Err(bad(path, "the first line is not 'ply'")),
            ["format", "ascii", _] => format = Some(true),
            ["format", "binary_little_endian", _] => format = Some(false),
            ["format", other, ..] => {
                let what = format!("the format is {other}; ascii or binary_little_endian expected");
                return Err(bad(path, what));
            }
            ["comment", ..] => {
                let text = line.trim_start().trim_start_matches("comment");
                header.comments.push(text.trim().to_owned());
            }
            ["obj_info", ..] | [] => {}
            ["element", name, count] => header.elements.push(Element {
                name: (*name).to_string(),
                count: count
                    .parse()
                    .map_err(|_| bad(path, format!("element {name} has the count '{count}'")))?,
                ..Element::default()
            }),
            ["property", rest @ ..] => match header.elements.last_mut() {
                Some(element) => add_property(path, element, rest)?,
                None => return Err(bad(path, "a property before any element")),
            },
            ["end_header"] => break,
            _ => return Err(bad(path, format!("header line '{line}' is not understood"))),
        }
    }
    header.ascii = format.ok_or_else(|| bad(path, "the header names no format"))?;
    Ok(header)
}

fn add_property(path: &Path, element: &mut Element, words: &[&str]) -> Result<()> {
    match words {
        ["list", ..] => element.has_list = true,
        [scalar, name] => {
            let found = Scalar::ALL.iter().find(|t| [t.0, t.1].contains(scalar));
            let Some(&(_, _, scalar, size)) = found else {
                let what = format!("property {name} has the unknown type {scalar}");
                return Err(bad(path, what));
            };
            element.properties.push(Property {
                name: (*name).to_string(),
                scalar,
                offset: element.stride,
            });
            element.stride += size;
        }
        _ => return Err(bad(path, format!("property {words:?} is not understood"))),
    }
    Ok(())
}

/// Number of vertices and offset of the first one, after checking that the file is long enough.
fn binary_start(
    path: &Path,
    length: usize,
    data: usize,
    before: &[Element],
    vertex: &Element,
) -> Result<(usize, usize)> {
    if let Some(e) = before.iter().find(|e| e.has_list) {
        let what = format!(
            "element {} holds lists and comes before the vertices",
            e.name
        );
        return Err(bad(path, what));
    }
    let size = |e: &Element| u128::from(e.count) * e.stride as u128;
    let start = data as u128 + before.iter().map(size).sum::<u128>();
    let end = start + size(vertex);
    if end > length as u128 || (vertex.stride == 0 && vertex.count > 0) {
        return Err(bad(
            path,
            format!(
                "the header announces {} vertices of {} bytes, {end} bytes in all; the file has {length}",
                vertex.count, vertex.stride
            ),
        ));
    }
    Ok((vertex.count as usize, start as usize))
}

/// The values of an ASCII file, one vertex a line.
fn ascii_body(
    path: &Path,
    bytes: &[u8],
    before: &[Element],
    vertex: &Element,
) -> Result<(usize, Body)> {
    let columns = vertex.properties.len();
    // A value takes two bytes at least, its separator included.
    let least = u128::from(vertex.count) * columns as u128 * 2;
    if least > bytes.len() as u128 + 1 || (columns == 0 && vertex.count > 0) {
        let what = format!(
            "the header announces {} vertices of {columns} values; {} bytes follow",
            vertex.count,
            bytes.len()
        );
        return Err(bad(path, what));
    }
    let Ok(text) = std::str::from_utf8(bytes) else {
        return Err(bad(path, "an ascii PLY with bytes that are no text"));
    };
    let mut lines = text.lines().filter(|l| !l.trim().is_empty());
    for e in before {
        for _ in 0..e.count {
            if lines.next().is_none() {
                return Err(bad(
                    path,
                    format!("the file ends within element {}", e.name),
                ));
            }
        }
    }
    let rows = vertex.count as usize;
    let mut values = Vec::with_capacity(rows * columns);
    for row in 0..rows {
        let mut words = lines.next().unwrap_or_default().split_whitespace();
        for property in &vertex.properties {
            let word = words.next().unwrap_or_default();
            let value = word.parse::<f64>().map_err(|_| {
                let what = format!(
                    "{} of vertex {row} is '{word}'; a number expected",
                    property.name
                );
                bad(path, what)
            })?;
            values.push(value);
        }
    }
    Ok((rows, Body::Ascii(values)))
}
