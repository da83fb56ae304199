//! PLY files: the header, and an element of it, mostly `vertex`, as a table of scalar columns.
//!
//! Format: Turk, "The PLY polygon file format" (1994). ASCII and binary little endian; lists and big endian are refused.

use std::cell::Cell;
use std::collections::HashSet;
use std::fs::File;
use std::io::{self, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use glam::DVec3;

use crate::base::error::{Error, Result};
use crate::base::files;

/// A scalar type of the format: its two names, its size in bytes, and the little-endian value at the start of some bytes.
type Scalar = ([&'static str; 2], usize, fn(&[u8]) -> Option<f64>);

const SCALARS: [Scalar; 8] = [
    (["char", "int8"], 1, |b| first(b, i8::from_le_bytes)),
    (["uchar", "uint8"], 1, |b| first(b, u8::from_le_bytes)),
    (["short", "int16"], 2, |b| first(b, i16::from_le_bytes)),
    (["ushort", "uint16"], 2, |b| first(b, u16::from_le_bytes)),
    (["int", "int32"], 4, |b| first(b, i32::from_le_bytes)),
    (["uint", "uint32"], 4, |b| first(b, u32::from_le_bytes)),
    (["float", "float32"], 4, |b| first(b, f32::from_le_bytes)),
    DOUBLE,
];
const DOUBLE: Scalar = (["double", "float64"], 8, |b| first(b, f64::from_le_bytes));

/// The value at the start of `bytes`; `None` if they are too few.
fn first<T: Into<f64>, const K: usize>(bytes: &[u8], from: fn([u8; K]) -> T) -> Option<f64> {
    Some(from(*bytes.first_chunk()?).into())
}

/// A column of the table.
#[derive(Debug, Clone)]
struct Property {
    name: String,
    scalar: Scalar,
    /// Type of the values in memory: `scalar` of a binary file, [`DOUBLE`] of an ASCII one.
    stored: Scalar,
    /// Bytes from the start of a row.
    offset: usize,
}

/// One `element` of a header.
#[derive(Debug, Clone, Default)]
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

/// A file whose header was read.
pub(crate) struct Content {
    path: PathBuf,
    header: Header,
    bytes: Rc<Vec<u8>>,
}

/// An element of a file.
pub(crate) struct Table {
    path: PathBuf,
    /// Comments of the header, in the file's order.
    pub(crate) comments: Vec<String>,
    element: Element,
    bytes: Rc<Vec<u8>>,
    /// Offset of the first row in `bytes`.
    start: usize,
}

/// A kind of PLY with its properties, and the remedy for a file that lacks one of them.
pub(crate) type Kind = [&'static str; 2];

/// A plain point cloud.
const CLOUD: Kind = [
    "a point cloud (x y z, maybe red green blue)",
    "export the points with these properties, or give a scene PLY of 3DGS",
];

/// An [`Error::Input`] about a damaged file.
fn bad(path: &Path, what: impl Into<String>) -> Error {
    Error::input(path, what, "export the PLY file again")
}

impl Content {
    /// The header of a file's bytes.
    ///
    /// # Errors
    /// A file of another format, big endian.
    pub(crate) fn new(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        Ok(Self {
            path: path.to_path_buf(),
            header: parse_header(path, &bytes)?,
            bytes: Rc::new(bytes),
        })
    }

    /// True if the header names the element.
    pub(crate) fn has(&self, element: &str) -> bool {
        self.header.elements.iter().any(|e| e.name == element)
    }

    /// The rows of an element.
    ///
    /// # Errors
    /// No element of that name, a list among its properties, a file shorter than its header says.
    pub(crate) fn table(&self, element: &str) -> Result<Table> {
        let (path, elements) = (&self.path, &self.header.elements);
        let Some(at) = elements.iter().position(|e| e.name == element) else {
            return Err(bad(path, format!("no element '{element}' in the header")));
        };
        let (before, mut element) = (&elements[..at], elements[at].clone());
        if element.has_list {
            let name = &element.name;
            let what = format!("a list among the {name} properties; scalars expected");
            return Err(bad(path, what));
        }
        let mut seen = HashSet::new();
        for Property { name, .. } in &element.properties {
            if !seen.insert(name) {
                return Err(bad(path, format!("property {name} is declared twice")));
            }
        }
        let data = self.header.data;
        let (bytes, start) = if self.header.ascii {
            let values = ascii_values(path, &self.bytes[data..], before, &element)?;
            element.stride = 8 * element.properties.len();
            for (k, property) in element.properties.iter_mut().enumerate() {
                (property.stored, property.offset) = (DOUBLE, 8 * k);
            }
            (Rc::new(values), 0)
        } else {
            let start = binary_start(path, self.bytes.len(), data, before, &element)?;
            (self.bytes.clone(), start)
        };
        Ok(Table {
            path: path.clone(),
            comments: self.header.comments.clone(),
            element,
            bytes,
            start,
        })
    }
}

impl Table {
    /// Reads a file's `vertex` element.
    ///
    /// # Errors
    /// Those of [`Content::new`] and [`Content::table`]; a file that cannot be read.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        Content::new(path, files::read(path)?)?.table("vertex")
    }

    /// Number of rows.
    pub(crate) fn len(&self) -> usize {
        self.element.count as usize
    }

    /// True if there is a property of that name.
    pub(crate) fn has(&self, name: &str) -> bool {
        self.names().any(|n| n == name)
    }

    /// Names of the properties, in the file's order.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.element.properties.iter().map(|p| p.name.as_str())
    }

    /// The values of a property that every file of a kind has, one per vertex.
    ///
    /// # Errors
    /// A missing property; a value that is not finite.
    pub(crate) fn column(&self, name: &str, kind: Kind) -> Result<Vec<f64>> {
        Ok(self.typed_column(name, kind, |v| v)?.1)
    }

    /// [`Table::column`] with `limit` in the place of what is beyond single precision, and how often that was.
    ///
    /// # Errors
    /// A missing property; a NaN.
    pub(crate) fn limited_column(
        &self,
        name: &str,
        kind: Kind,
        limit: f64,
    ) -> Result<(Vec<f64>, usize)> {
        let limited = Cell::new(0);
        let change = |v: f64| {
            if v.is_nan() || v.abs() <= f64::from(f32::MAX) {
                return v;
            }
            limited.set(limited.get() + 1);
            limit.copysign(v)
        };
        let values = self.typed_column(name, kind, change)?.1;
        Ok((values, limited.get()))
    }

    /// The first name of a property's type, and its values, changed before it is asked if they are finite.
    fn typed_column(
        &self,
        name: &str,
        [expected, fix]: Kind,
        change: impl Fn(f64) -> f64,
    ) -> Result<(&'static str, Vec<f64>)> {
        let Element {
            properties, stride, ..
        } = &self.element;
        let Some(property) = properties.iter().find(|p| p.name == name) else {
            let what = format!("the property {name} is missing; {expected} expected");
            return Err(Error::input(&self.path, what, fix));
        };
        let value = |row: usize| {
            let bytes = self
                .bytes
                .get(self.start + row * stride + property.offset..);
            let found = bytes.and_then(|b| property.stored.2(b));
            let found = change(found.unwrap_or(f64::NAN));
            found.is_finite().then_some(found).ok_or_else(|| {
                let kind = &self.element.name;
                let what = format!("{name} of {kind} {row} is {found}; a finite number expected");
                bad(&self.path, what)
            })
        };
        let values: Result<Vec<f64>> = (0..self.len()).map(value).collect();
        Ok((property.scalar.0[0], values?))
    }

    /// A colour channel in 0…255. Floats within [0, 1] are taken as fractions, 16-bit integers as 0…65535.
    fn color(&self, name: &str) -> Result<Vec<u8>> {
        let (scalar, values) = self.typed_column(name, CLOUD, |v| v)?;
        let factor = match scalar {
            "float" | "double" if values.iter().all(|&v| v <= 1.0) => 255.0,
            "ushort" => 255.0 / 65535.0,
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
        let [x, y, z] = ["x", "y", "z"].map(|name| self.column(name, CLOUD));
        let (x, y, z) = (x?, y?, z?);
        let rows = 0..x.len();
        let positions = rows.clone().map(|i| DVec3::new(x[i], y[i], z[i]));
        let colors = if ["red", "green", "blue"].iter().all(|c| self.has(c)) {
            let [r, g, b] = ["red", "green", "blue"].map(|c| self.color(c));
            let (r, g, b) = (r?, g?, b?);
            rows.map(|i| [r[i], g[i], b[i]]).collect()
        } else {
            vec![[128; 3]; x.len()]
        };
        Ok((positions.collect(), colors))
    }
}

/// Comments in the header of a file, whose data is not read.
///
/// # Errors
/// A file that cannot be read, or is no PLY.
pub(crate) fn read_comments(path: &Path) -> Result<Vec<String>> {
    Ok(read_header(path)?.comments)
}

/// True for a file of Gaussians, by its header.
pub(crate) fn is_scene(path: &Path) -> bool {
    let elements = read_header(path).map(|header| header.elements);
    elements.unwrap_or_default().iter().any(|element| {
        let mut names = element.properties.iter().map(|p| p.name.as_str());
        names.any(|name| matches!(name, "f_dc_0" | "packed_position"))
    })
}

fn read_header(path: &Path) -> Result<Header> {
    let mut bytes = Vec::new();
    files::check_regular(path)?;
    std::fs::File::open(path)
        .and_then(|file| file.take(HEADER_LIMIT as u64).read_to_end(&mut bytes))
        .map_err(|e| Error::io(path, e))?;
    parse_header(path, &bytes)
}

/// Writes a binary file of `count` vertices atomically: `header` is a comment line or empty, `properties` are types and names,
/// and `rows` writes the values.
///
/// # Errors
/// [`Error::Io`].
pub(crate) fn write<'a>(
    path: &Path,
    header: &str,
    count: usize,
    properties: impl Iterator<Item = (&'a str, &'a str)>,
    rows: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    let lines: String = properties
        .map(|(scalar, name)| format!("property {scalar} {name}\n"))
        .collect();
    files::write(path, |out| {
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\n{header}element vertex {count}\n{lines}end_header\n"
        )?;
        rows(out)
    })
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
            let Some(scalar) = SCALARS.into_iter().find(|s| s.0.contains(scalar)) else {
                let what = format!("property {name} has the unknown type {scalar}");
                return Err(bad(path, what));
            };
            element.properties.push(Property {
                name: (*name).to_string(),
                scalar,
                stored: scalar,
                offset: element.stride,
            });
            element.stride += scalar.1;
        }
        _ => return Err(bad(path, format!("property {words:?} is not understood"))),
    }
    Ok(())
}

/// Offset of the first row, after checking that the file is long enough.
fn binary_start(
    path: &Path,
    length: usize,
    data: usize,
    before: &[Element],
    element: &Element,
) -> Result<usize> {
    if let Some(Element { name, .. }) = before.iter().find(|e| e.has_list) {
        let what = format!("element {name} holds lists and comes before what is needed");
        return Err(bad(path, what));
    }
    let size = |e: &Element| u128::from(e.count) * e.stride as u128;
    let start = data as u128 + before.iter().map(size).sum::<u128>();
    let end = start + size(element);
    if end > length as u128 || (element.stride == 0 && element.count > 0) {
        let (kind, count, stride) = (&element.name, element.count, element.stride);
        let what = format!(
            "the header announces {count} rows of {kind} of {stride} bytes, {end} bytes in all; the file has {length}"
        );
        return Err(bad(path, what));
    }
    Ok(start as usize)
}

/// The values of an ASCII file, one row a line, as doubles.
fn ascii_values(
    path: &Path,
    bytes: &[u8],
    before: &[Element],
    element: &Element,
) -> Result<Vec<u8>> {
    let (columns, count, length) = (element.properties.len(), element.count, bytes.len());
    let kind = &element.name;
    // A value takes two bytes at least, its separator included.
    let least = u128::from(count) * columns as u128 * 2;
    if least > length as u128 + 1 || (columns == 0 && count > 0) {
        let what = format!(
            "the header announces {count} rows of {kind} of {columns} values; {length} bytes follow"
        );
        return Err(bad(path, what));
    }
    let text = std::str::from_utf8(bytes)
        .map_err(|_| bad(path, "an ascii PLY with bytes that are no text"))?;
    let mut lines = text.lines().filter(|l| !l.trim().is_empty());
    for Element { name, count, .. } in before {
        for _ in 0..*count {
            if lines.next().is_none() {
                return Err(bad(path, format!("the file ends within element {name}")));
            }
        }
    }
    let mut values = Vec::with_capacity(8 * count as usize * columns);
    for row in 0..count {
        let mut words = lines.next().unwrap_or_default().split_whitespace();
        for Property { name, .. } in &element.properties {
            let word = words.next().unwrap_or_default();
            let value: f64 = word.parse().map_err(|_| {
                let what = format!("{name} of {kind} {row} is '{word}'; a number expected");
                bad(path, what)
            })?;
            values.extend(value.to_le_bytes());
        }
    }
    Ok(values)
}
