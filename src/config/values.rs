//! Options with a spelling of their own. Parsers return what they expect as their error; who calls them names the option, as
//! [`deserialize`] does.

use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use serde::de::{DeserializeOwned, Error as _};
use serde::{Deserialize, Deserializer, Serialize};

/// Endings of scene files.
const SCENES: [&str; 5] = [".ply", ".spz", ".splat", ".glb", ".sog"];

/// Source of the first Gaussians; written `points`, `random` or the path of a scene file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum Init {
    /// One Gaussian per sparse point; if the dataset has none, per place at which its photos agree, else random.
    #[default]
    Points,
    /// Random points in the cameras' bounding box.
    Random,
    /// A file in the dataset's own frame: Gaussians, or a plain point cloud.
    File(PathBuf),
}

impl FromStr for Init {
    type Err = &'static str;
    fn from_str(s: &str) -> Result<Self, Self::Err> {
        match s {
            "points" => Ok(Self::Points),
            "random" => Ok(Self::Random),
            path if SCENES.iter().any(|end| path.to_lowercase().ends_with(end)) => {
                Ok(Self::File(path.into()))
            }
            _ => Err("points, random or a .ply, .spz, .splat, .glb or .sog file expected"),
        }
    }
}

impl fmt::Display for Init {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Points => f.write_str("points"),
            Self::Random => f.write_str("random"),
            Self::File(path) => f.write_str(&path.to_string_lossy()),
        }
    }
}

impl TryFrom<String> for Init {
    type Error = String;
    fn try_from(s: String) -> Result<Self, String> {
        s.parse().map_err(|what| format!("{s:?}; {what}"))
    }
}

impl From<Init> for String {
    fn from(v: Init) -> Self {
        v.to_string()
    }
}

/// Colour behind the scene; written `auto`, `black`, `white`, `random` or `R,G,B`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Default)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum Background {
    /// [`Background::Random`] if photos are transparent: over one colour a scene keeps fog of that colour, which no training view shows and other
    /// views do. The mean colour of photos that are neither transparent nor masked, which the sky is nearer to than to black. Else
    /// [`Background::Black`].
    #[default]
    Auto,
    /// (0, 0, 0).
    Black,
    /// (1, 1, 1).
    White,
    /// A new colour each iteration; black when evaluating.
    Random,
    /// RGB in [0, 1].
    Color([f32; 3]),
}

impl Background {
    /// True if every iteration has a colour of its own, over photos that are transparent or not.
    #[must_use]
    pub fn changes(self, transparent: bool) -> bool {
        self == Self::Random || (self == Self::Auto && transparent)
    }

    /// The colour where no photo decides: the one that is named, or black.
    #[must_use]
    pub fn named(self) -> [f32; 3] {
        match self {
            Self::White => [1.0; 3],
            Self::Color(color) => color,
            Self::Auto | Self::Black | Self::Random => [0.0; 3],
        }
    }
}

impl FromStr for Background {
    type Err = &'static str;
    fn from_str(s: &str) -> Result<Self, Self::Err> {
        let wrong = "auto, black, white, random or R,G,B in 0 to 1 expected";
        match s {
            "auto" => Ok(Self::Auto),
            "black" => Ok(Self::Black),
            "white" => Ok(Self::White),
            "random" => Ok(Self::Random),
            _ => {
                let parts = s.split(',').map(|v| v.trim().parse());
                let parts: Vec<f32> = parts.collect::<Result<_, _>>().map_err(|_| wrong)?;
                let rgb: [f32; 3] = parts.try_into().map_err(|_| wrong)?;
                if rgb.iter().all(|v| (0.0..=1.0).contains(v)) {
                    Ok(Self::Color(rgb))
                } else {
                    Err(wrong)
                }
            }
        }
    }
}

impl fmt::Display for Background {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Black => f.write_str("black"),
            Self::White => f.write_str("white"),
            Self::Random => f.write_str("random"),
            Self::Color([r, g, b]) => write!(f, "{r},{g},{b}"),
        }
    }
}

impl TryFrom<String> for Background {
    type Error = String;
    fn try_from(s: String) -> Result<Self, String> {
        s.parse().map_err(|what| format!("{s:?}; {what}"))
    }
}

impl From<Background> for String {
    fn from(v: Background) -> Self {
        v.to_string()
    }
}

/// Seconds from `90`, `90s`, `10m`, `1.5h` or `1h30m`.
///
/// # Errors
/// Anything else, or a time that is not positive: what is expected.
pub fn parse_duration(s: &str) -> Result<f64, &'static str> {
    let wrong = "a time like 90s, 10m or 1h30m expected";
    let mut total = 0.0;
    for part in s.trim().split_inclusive(['s', 'm', 'h']) {
        let number = part.trim_end_matches(['s', 'm', 'h']);
        let unit = match &part[number.len()..] {
            "m" => 60.0,
            "h" => 3600.0,
            _ => 1.0,
        };
        // Other spellings that f64 reads ("1e3", "inf") are no times.
        let plain = number.chars().all(|c| c.is_ascii_digit() || c == '.');
        let number = number.parse::<f64>().ok().filter(|_| plain);
        total += unit * number.ok_or(wrong)?;
    }
    if total > 0.0 { Ok(total) } else { Err(wrong) }
}

/// Bytes from `4294967296`, `512M`, `4G` or `1.5GiB`: K, M, G and T are powers of 1024, and a B or iB after them is allowed.
///
/// # Errors
/// Anything else, or less than one byte: what is expected.
pub fn parse_bytes(s: &str) -> Result<u64, &'static str> {
    let wrong = "a positive number of bytes like 800000000, 512M or 4G expected";
    let text = s.trim().to_ascii_uppercase();
    let text = text.strip_suffix('B').unwrap_or(&text);
    let text = text.strip_suffix('I').unwrap_or(text);
    let power = text.chars().last().and_then(|unit| "KMGT".find(unit));
    let (number, scale) = match power {
        Some(power) => (&text[..text.len() - 1], 1024_u64 << (10 * power)),
        None => (text, 1),
    };
    let bytes = number.parse::<f64>().map_err(|_| wrong)? * scale as f64;
    if bytes.is_finite() && bytes >= 1.0 {
        Ok(bytes as u64)
    } else {
        Err(wrong)
    }
}

/// A value that files may give as a number or as a text.
#[derive(Serialize, Deserialize)]
#[serde(untagged)]
pub enum NumberOrText<T> {
    /// A number.
    Number(T),
    /// A text.
    Text(String),
}

/// An optional number, or a text that `parse` reads.
fn number_or_text<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
    deserializer: D,
    parse: impl Fn(&str) -> Result<T, &'static str>,
) -> Result<Option<T>, D::Error> {
    let read = |value| match value {
        NumberOrText::Number(number) => Ok(number),
        NumberOrText::Text(text) => {
            parse(&text).map_err(|what| D::Error::custom(format!("{text:?}; {what}")))
        }
    };
    Option::deserialize(deserializer)?.map(read).transpose()
}

/// `image-budget` as a number of bytes or in the form of [`parse_bytes`].
pub(super) fn image_budget<'de, D: Deserializer<'de>>(d: D) -> Result<Option<u64>, D::Error> {
    number_or_text(d, parse_bytes)
}

/// `time-budget` as a number of seconds or in the form of [`parse_duration`].
pub(super) fn time_budget<'de, D: Deserializer<'de>>(d: D) -> Result<Option<f64>, D::Error> {
    number_or_text(d, parse_duration)
}

/// A value of a file.
///
/// # Errors
/// A value that is refused, with its key: `mh.birth: unknown variant …`.
pub fn deserialize<'de, T: Deserialize<'de>>(from: impl Deserializer<'de>) -> Result<T, String> {
    serde_path_to_error::deserialize(from).map_err(|e| e.to_string())
}

/// The value of a JSON document.
///
/// # Errors
/// Those of [`deserialize`], or text after the value.
pub fn from_json<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let mut from = serde_json::Deserializer::from_str(text);
    let value = deserialize(&mut from)?;
    from.end().map_err(|e| e.to_string())?;
    Ok(value)
}
