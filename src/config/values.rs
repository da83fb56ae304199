//! Options with a spelling of their own.

use serde::{Deserialize, Serialize};

use crate::base::error::{Error, Result};

/// Where the first Gaussians come from; written `points`, `random` or the path of a PLY file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum Init {
    /// One Gaussian per sparse point; random where the dataset has none.
    #[default]
    Points,
    /// Random points in the cameras' bounding box.
    Random,
    /// A PLY file in the dataset's own frame: Gaussians (3DGS properties), or a plain point cloud.
    File(std::path::PathBuf),
}

impl std::str::FromStr for Init {
    type Err = Error;
    fn from_str(s: &str) -> Result<Self> {
        match s {
            "points" => Ok(Self::Points),
            "random" => Ok(Self::Random),
            path if path.to_lowercase().ends_with(".ply") => Ok(Self::File(path.into())),
            other => Err(Error::config(
                "--init",
                format!("{other:?}; points, random or a .ply file expected"),
            )),
        }
    }
}

impl TryFrom<String> for Init {
    type Error = Error;
    fn try_from(s: String) -> Result<Self> {
        s.parse()
    }
}

impl From<Init> for String {
    fn from(v: Init) -> Self {
        match v {
            Init::Points => "points".into(),
            Init::Random => "random".into(),
            Init::File(path) => path.to_string_lossy().into_owned(),
        }
    }
}

/// Whether every training photo has an affine colour transform of its own (\[3DGS\], later versions).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, Default)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum ExposureChoice {
    /// If photos differ in brightness by more than what they show; see [`crate::train::brightness`].
    #[default]
    Auto,
    /// Yes.
    On,
    /// No.
    Off,
}

/// What lies behind the scene; written `auto`, `black`, `white`, `random` or `R,G,B`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, Default)]
#[serde(try_from = "String", into = "String")]
#[non_exhaustive]
pub enum Background {
    /// As [`Background::Random`] where photos are transparent, as [`Background::Black`] where they are not. Over one colour a
    /// scene keeps fog of that colour, which no training view shows and other views do. Black when evaluating.
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
    /// Whether every iteration has a colour of its own, over photos that are transparent or not.
    #[must_use]
    pub fn changes(self, transparent: bool) -> bool {
        self == Self::Random || (self == Self::Auto && transparent)
    }
}

impl std::str::FromStr for Background {
    type Err = Error;
    fn from_str(s: &str) -> Result<Self> {
        let wrong = || {
            Error::config(
                "--background",
                format!("{s:?}; auto, black, white, random or R,G,B in 0 to 1 expected"),
            )
        };
        match s {
            "auto" => Ok(Self::Auto),
            "black" => Ok(Self::Black),
            "white" => Ok(Self::White),
            "random" => Ok(Self::Random),
            _ => {
                let parts: Vec<f32> = s
                    .split(',')
                    .map(|v| v.trim().parse().map_err(|_| wrong()))
                    .collect::<Result<_>>()?;
                let rgb: [f32; 3] = parts.try_into().map_err(|_| wrong())?;
                if rgb.iter().all(|v| (0.0..=1.0).contains(v)) {
                    Ok(Self::Color(rgb))
                } else {
                    Err(wrong())
                }
            }
        }
    }
}

impl TryFrom<String> for Background {
    type Error = Error;
    fn try_from(s: String) -> Result<Self> {
        s.parse()
    }
}

impl From<Background> for String {
    fn from(v: Background) -> Self {
        match v {
            Background::Auto => "auto".into(),
            Background::Black => "black".into(),
            Background::White => "white".into(),
            Background::Random => "random".into(),
            Background::Color([r, g, b]) => format!("{r},{g},{b}"),
        }
    }
}

/// Seconds from `90`, `90s`, `10m`, `1.5h` or `1h30m`.
///
/// # Errors
/// Anything else, or a time that is not positive.
pub fn parse_duration(s: &str) -> Result<f64> {
    let wrong = || {
        Error::config(
            "--time-budget",
            format!("{s:?}; a time like 90s, 10m or 1h30m expected"),
        )
    };
    let mut total = 0.0;
    let mut number = String::new();
    for c in s.trim().chars() {
        let unit = match c {
            '0'..='9' | '.' => {
                number.push(c);
                continue;
            }
            's' => 1.0,
            'm' => 60.0,
            'h' => 3600.0,
            _ => return Err(wrong()),
        };
        total += unit * number.parse::<f64>().map_err(|_| wrong())?;
        number.clear();
    }
    if !number.is_empty() {
        total += number.parse::<f64>().map_err(|_| wrong())?;
    }
    if total > 0.0 { Ok(total) } else { Err(wrong()) }
}

/// Bytes from `4294967296`, `512M`, `4G` or `1.5GiB`: K, M, G and T are powers of 1024, and a B or iB after them is allowed.
///
/// # Errors
/// Anything else, or less than one byte.
pub fn parse_bytes(s: &str) -> Result<u64> {
    let wrong = || {
        Error::config(
            "--image-budget",
            format!("{s:?}; a positive number of bytes like 800000000, 512M or 4G expected"),
        )
    };
    let text = s.trim().to_ascii_uppercase();
    let text = text.strip_suffix('B').unwrap_or(&text);
    let text = text.strip_suffix('I').unwrap_or(text);
    let power = text.chars().last().and_then(|unit| "KMGT".find(unit));
    let (number, scale) = match power {
        Some(power) => (&text[..text.len() - 1], 1024_u64 << (10 * power)),
        None => (text, 1),
    };
    let bytes = number.parse::<f64>().map_err(|_| wrong())? * scale as f64;
    if bytes.is_finite() && bytes >= 1.0 {
        Ok(bytes as u64)
    } else {
        Err(wrong())
    }
}

/// `image-budget` as a number of bytes or as [`parse_bytes`] reads it.
pub(super) fn bytes_or_number<'de, D: serde::Deserializer<'de>>(
    d: D,
) -> std::result::Result<Option<u64>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Either {
        Number(u64),
        Text(String),
    }
    Ok(match Option::<Either>::deserialize(d)? {
        None => None,
        Some(Either::Number(v)) => Some(v),
        Some(Either::Text(s)) => Some(parse_bytes(&s).map_err(serde::de::Error::custom)?),
    })
}

/// `time-budget` as a number of seconds or as [`parse_duration`] reads it.
pub(super) fn duration_or_number<'de, D: serde::Deserializer<'de>>(
    d: D,
) -> std::result::Result<Option<f64>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Either {
        Number(f64),
        Text(String),
    }
    Ok(match Option::<Either>::deserialize(d)? {
        None => None,
        Some(Either::Number(v)) => Some(v),
        Some(Either::Text(s)) => Some(parse_duration(&s).map_err(serde::de::Error::custom)?),
    })
}
