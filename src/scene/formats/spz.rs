//! Niantic's SPZ, versions 2 to 4 read, 3 and 4 written: <https://github.com/nianticlabs/spz>, "File Format".
//!
//! Attributes follow each other, each of all Gaussians: positions (24-bit fixed point), opacities, colours, log-scales, rotations, SH
//! (8 bits each), compressed as one gzip stream or, in version 4, as a Zstandard frame each. Axes are right, up, back.

use std::io::{Read, Write};
use std::path::Path;

use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use ruzstd::decoding::StreamingDecoder;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};

use crate::base::error::{Error, Result};
use crate::base::math::sigmoid;
use crate::capture::Frame;
use crate::scene::formats::scene_file::{
    HalfTurn, Rounding, SceneFile, from_smallest_three, limited_logit, localized, smallest_three,
    unit,
};
use crate::scene::formats::shell::Reach;
use crate::scene::gaussians::{Gaussians, Plane, sh_coefficients};

/// First bytes of what is compressed, and of files of version 4.
pub(super) const MAGIC: [u8; 4] = *b"NGSP";
/// First bytes of a gzip stream.
pub(super) const GZIP: [u8; 2] = [0x1f, 0x8b];
/// Bytes of the header before version 4, and of version 4's.
const HEADERS: [usize; 2] = [16, 32];
/// Bytes of an entry of version 4's table of contents.
const ENTRY: usize = 16;
/// Bit of the header's flags for a scene trained with anti-aliasing.
const ANTI_ALIASED: u8 = 1;
/// Bit of the header's flags for extension records.
const EXTENDED: u8 = 2;
/// Type of the record that names axes other than the usual ones.
const AXES: u32 = 0xADBE_0003;

/// Steps of a colour per unit of its SH coefficient: 8 bits for −3.3 to 3.3.
const COLOR_STEPS: f64 = 0.15 * 255.0;
/// Steps of a log-scale per unit, and its value at byte 0.
const SCALE: [f64; 2] = [16.0, -10.0];
/// Steps of a rotation's smaller component between 0 and √½.
const ROTATION_STEPS: f64 = 511.0;
/// Steps between the values that SH coefficients of degree 1 and of higher degrees are rounded to, of 256 within −1 to 1. The format's
/// own library takes 8 and 16, which cost 1 dB more and save a sixth of the bytes (docs/results/formats.md).
const SH_BUCKETS: [i32; 2] = [4, 8];
/// Most bits behind the binary point of a position.
const MOST_FRACTION: u32 = 20;
/// Largest value of a 24-bit position.
const LARGEST: f64 = 8_388_607.0;

/// Bits behind the binary point below which a remark tells of rounded positions.
const FINE: u32 = 12;

/// Largest radius of a shell about a scene: its Gaussians then have scales within the format's range.
const LARGEST_SHELL: f64 = 5000.0;

/// Bytes of history that a Zstandard frame may ask for however little it holds.
const SMALL_WINDOW: u64 = 8 << 20;

/// The content of a header.
#[derive(Clone, Copy)]
struct Header {
    version: u32,
    count: usize,
    sh_degree: u32,
    fraction: u8,
    flags: u8,
}

/// An error about a damaged file.
fn bad(path: &Path, what: impl Into<String>) -> Error {
    Error::input(path, what, "export the SPZ file again")
}

fn number<const K: usize>(bytes: &[u8], at: usize) -> [u8; K] {
    let found = bytes.get(at..).and_then(|b| b.first_chunk());
    found.copied().unwrap_or([0; K])
}

impl Header {
    /// Reads a header of at least 16 bytes.
    fn read(path: &Path, bytes: &[u8]) -> Result<Self> {
        if bytes.len() < HEADERS[0] || !bytes.starts_with(&MAGIC) {
            return Err(bad(path, "no SPZ header"));
        }
        let version = u32::from_le_bytes(number(bytes, 4));
        if !(2..=4).contains(&version) {
            let what = format!("SPZ of version {version}; 2, 3 or 4 expected");
            return Err(Error::input(path, what, "convert it with its own program"));
        }
        let header = Self {
            version,
            count: u32::from_le_bytes(number(bytes, 8)) as usize,
            sh_degree: u32::from(bytes[12]),
            fraction: bytes[13],
            flags: bytes[14],
        };
        if header.sh_degree > 4 || header.fraction > 23 {
            let (degree, bits) = (header.sh_degree, header.fraction);
            let what =
                format!("SH degree {degree} and {bits} fractional bits; at most 4 and 23 expected");
            return Err(bad(path, what));
        }
        Ok(header)
    }

    /// Bytes of the SH coefficients above the constant one.
    fn sh_bytes(&self) -> usize {
        3 * (sh_coefficients(self.sh_degree) - 1)
    }

    /// Bytes per Gaussian of positions, opacities, colours, scales, rotations and SH.
    fn strides(&self) -> [usize; 6] {
        let rotation = if self.version == 2 { 3 } else { 4 };
        [9, 1, 3, 3, rotation, self.sh_bytes()]
    }

    /// The bytes of a file with these attributes.
    fn pack(&self, path: &Path, attributes: &[Vec<u8>; 6]) -> Result<Vec<u8>> {
        let full: Vec<&Vec<u8>> = attributes.iter().filter(|a| !a.is_empty()).collect();
        let count = u32::try_from(self.count);
        let count = count.map_err(|_| Error::numerics("SPZ", "too many Gaussians"))?;
        let streams = if self.version == 4 { full.len() } else { 0 };
        let [degree, streams] = [self.sh_degree as u8, streams as u8];
        let mut bytes = MAGIC.to_vec();
        bytes.extend(self.version.to_le_bytes());
        bytes.extend(count.to_le_bytes());
        bytes.extend([degree, self.fraction, self.flags, streams]);
        if self.version == 4 {
            // The table of contents follows the header at once.
            bytes.extend((HEADERS[1] as u32).to_le_bytes());
            bytes.resize(HEADERS[1], 0);
            let pack = |whole: &&Vec<u8>| compress_to_vec(&whole[..], CompressionLevel::Fastest);
            let frames: Vec<Vec<u8>> = full.iter().map(pack).collect();
            for (frame, whole) in frames.iter().zip(&full) {
                bytes.extend((frame.len() as u64).to_le_bytes());
                bytes.extend((whole.len() as u64).to_le_bytes());
            }
            bytes.extend(frames.into_iter().flatten());
            return Ok(bytes);
        }
        let failed = |e| Error::io(path, e);
        let mut packed = GzEncoder::new(Vec::new(), Compression::best());
        packed.write_all(&bytes).map_err(failed)?;
        for attribute in full {
            packed.write_all(attribute).map_err(failed)?;
        }
        packed.finish().map_err(failed)
    }

    /// Bytes of all attributes, if the compressed ones may hold so many.
    fn size(&self, path: &Path, compressed: usize) -> Result<usize> {
        let size = self.strides().iter().sum::<usize>() as u64 * self.count as u64;
        // Real scenes shrink to a half; whatever shrinks to a hundredth is made to fill the memory.
        let most = (100 * compressed as u64).max(1 << 26);
        if size > most {
            let n = self.count;
            let what = format!("the header announces {n} Gaussians; {compressed} bytes hold fewer");
            return Err(bad(path, what));
        }
        Ok(size as usize)
    }
}

/// True if a file's first bytes are those of a scene trained with anti-aliasing.
pub(super) fn is_anti_aliased(start: &[u8]) -> bool {
    let mut header = [0; HEADERS[0]];
    let found = match start.starts_with(&GZIP) {
        true => GzDecoder::new(start).read_exact(&mut header).is_ok(),
        false => (&mut &*start).read_exact(&mut header).is_ok(),
    };
    found && header.starts_with(&MAGIC) && header[14] & ANTI_ALIASED != 0
}

/// Reads a file: gzip, plain or version 4, by its first bytes.
///
/// # Errors
/// [`Error::Input`] for a damaged or truncated file, another version, axes that are not supported.
pub(super) fn read(path: &Path, bytes: &[u8], frame: &Frame) -> Result<SceneFile> {
    let (header, attributes) = if bytes.starts_with(&GZIP) {
        let mut stream = GzDecoder::new(bytes);
        let mut start = [0; HEADERS[0]];
        let cut = |e: std::io::Error| bad(path, format!("damaged or cut off ({e})"));
        stream.read_exact(&mut start).map_err(cut)?;
        let header = Header::read(path, &start)?;
        let size = header.size(path, bytes.len())?;
        let mut attributes = Vec::new();
        let mut all = stream.by_ref().take(size as u64);
        all.read_to_end(&mut attributes).map_err(cut)?;
        // The checksum comes at the end of the stream.
        stream.read(&mut [0]).map_err(cut)?;
        (header, attributes)
    } else {
        let header = Header::read(path, bytes)?;
        let attributes = match header.version {
            4 => streams(path, &header, bytes)?,
            _ => bytes[HEADERS[0]..].to_vec(),
        };
        (header, attributes)
    };
    let size = header.size(path, bytes.len())?;
    if attributes.len() < size {
        let (n, found) = (header.count, attributes.len());
        let what = format!("the header announces {n} Gaussians, {size} bytes; {found} follow");
        return Err(bad(path, what));
    }
    let splats = decode(path, &header, &attributes, frame)?;
    let left_out = "spherical harmonics of degree 4 are left out; degree 3 is the highest here";
    Ok(SceneFile {
        anti_aliased: header.flags & ANTI_ALIASED != 0,
        remarks: (header.sh_degree > 3)
            .then(|| left_out.to_owned())
            .into_iter()
            .collect(),
        ..SceneFile::new(splats)
    })
}

/// The attributes of a file of version 4, one after the other.
fn streams(path: &Path, header: &Header, bytes: &[u8]) -> Result<Vec<u8>> {
    let short = || bad(path, "ends within its table of contents");
    if bytes.len() < HEADERS[1] {
        return Err(short());
    }
    let table = u32::from_le_bytes(number(bytes, 16)) as usize;
    let sizes: Vec<usize> = header.strides().iter().map(|s| s * header.count).collect();
    let wanted: Vec<usize> = sizes.into_iter().filter(|size| *size > 0).collect();
    // Attributes without bytes have no stream; some writers give them an empty one.
    let count = usize::from(bytes[15]);
    let records = bytes.get(HEADERS[1]..table).ok_or_else(short)?;
    if header.flags & EXTENDED != 0 {
        check_axes(path, records)?;
    }
    let mut at = table + ENTRY * count;
    let entries = bytes.get(table..at).ok_or_else(short)?;
    header.size(path, bytes.len())?;
    let mut attributes = Vec::new();
    let mut left = wanted.iter();
    for entry in entries.chunks_exact(ENTRY) {
        let [packed, whole] = [0, 8].map(|k| u64::from_le_bytes(number(entry, k)));
        let end = usize::try_from(packed).ok().and_then(|n| at.checked_add(n));
        let frame = end.and_then(|end| bytes.get(at..end));
        let Some(frame) = frame else {
            return Err(bad(path, "ends within a stream"));
        };
        at += frame.len();
        if whole == 0 {
            continue;
        }
        let size = left.next().copied().unwrap_or(0);
        if size as u64 != whole {
            let what = format!("a stream of {whole} bytes in the place of one of {size}");
            return Err(bad(path, what));
        }
        let broken = |e: String| bad(path, format!("a damaged stream ({e})"));
        let start = attributes.len();
        let window = whole.max(SMALL_WINDOW);
        let decoder = StreamingDecoder::new_with_max_window_size(frame, window);
        let decoder = decoder.map_err(|e| broken(e.to_string()))?;
        let read = decoder.take(whole).read_to_end(&mut attributes);
        read.map_err(|e| broken(e.to_string()))?;
        if attributes.len() - start != size {
            return Err(broken(format!(
                "{} bytes of {size}",
                attributes.len() - start
            )));
        }
    }
    Ok(attributes)
}

/// Refuses extension records that name other axes than the usual ones.
fn check_axes(path: &Path, mut records: &[u8]) -> Result<()> {
    while records.len() >= 8 {
        let kind = u32::from_le_bytes(number(records, 0));
        let length = u32::from_le_bytes(number(records, 4)) as usize;
        if kind == AXES {
            let what = "stored in axes of its own (SPZ_ADOBE_coordinate_system)";
            return Err(Error::input(path, what, "convert it with its own program"));
        }
        records = records
            .get(8_usize.saturating_add(length)..)
            .unwrap_or_default();
    }
    Ok(())
}

fn decode(path: &Path, header: &Header, bytes: &[u8], frame: &Frame) -> Result<Gaussians> {
    let (n, degree) = (header.count, header.sh_degree.min(3));
    let mut parts: [&[u8]; 6] = [&[]; 6];
    let mut at = 0;
    for (part, stride) in parts.iter_mut().zip(header.strides()) {
        *part = &bytes[at..at + stride * n];
        at += stride * n;
    }
    let [positions, opacities, colors, scales, rotations, sh] = parts;
    let mut planes: Vec<Vec<f32>> = vec![Vec::new(); Plane::count(degree)];
    let column = |bytes: &[u8], k: usize, stride: usize, value: &dyn Fn(u8) -> f64| -> Vec<f32> {
        let of = bytes.iter().skip(k).step_by(stride.max(1));
        of.map(|b| value(*b) as f32).collect()
    };
    for k in 0..3 {
        let value = |p: &[u8]| {
            let [low, middle, high]: [u8; 3] = number(p, 3 * k);
            let fixed = i32::from_le_bytes([0, low, middle, high]) >> 8;
            (f64::from(fixed) / f64::from(1_u32 << header.fraction)) as f32
        };
        planes[Plane::POSITION + k] = positions.chunks_exact(9).map(value).collect();
        let log_scale = |b: u8| f64::from(b) / SCALE[0] + SCALE[1];
        planes[Plane::LOG_SCALE + k] = column(scales, k, 3, &log_scale);
        let color = |b: u8| (f64::from(b) - 127.5) / COLOR_STEPS;
        planes[Plane::SH + k] = column(colors, k, 3, &color);
    }
    let opacity = |b: u8| f64::from(limited_logit(f64::from(b) / 255.0));
    planes[Plane::OPACITY] = column(opacities, 0, 1, &opacity);
    for q in rotations.chunks_exact(header.strides()[4]).map(rotation) {
        for (k, v) in q.into_iter().enumerate() {
            planes[Plane::ROTATION + k].push(v as f32);
        }
    }
    let stride = header.sh_bytes();
    for k in 0..3 * (sh_coefficients(degree) - 1) {
        let coefficient = |b: u8| (f64::from(b) - 128.0) / 128.0;
        planes[Plane::SH + 3 + k] = column(sh, k, stride, &coefficient);
    }
    let mut splats = Gaussians::new(degree, planes)?;
    HalfTurn::X.turn(&mut splats);
    let planes = splats.planes().to_vec();
    localized(path, degree, planes, frame)
}

/// The quaternion w, x, y, z of a rotation of 3 bytes (x, y, z; w is positive) or of 4 (the three smaller of x, y, z, w).
fn rotation(bytes: &[u8]) -> [f64; 4] {
    if let &[x, y, z] = bytes {
        let [x, y, z] = [x, y, z].map(|b| f64::from(b) / 127.5 - 1.0);
        let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
        return [w, x, y, z];
    }
    let word = u32::from_le_bytes(number(bytes, 0));
    let component = |k: u32| {
        let part = word >> (10 * k);
        let size = f64::from(part & 511) / ROTATION_STEPS * 0.5_f64.sqrt();
        if part >> 9 & 1 == 1 { -size } else { size }
    };
    let [x, y, z, w] = from_smallest_three(
        (word >> 30) as usize,
        [component(2), component(1), component(0)],
    );
    [w, x, y, z]
}

/// A rotation in 4 bytes.
fn packed_rotation(q: [f64; 4]) -> u32 {
    let [w, x, y, z] = q;
    let (largest, others) = smallest_three([x, y, z, w]);
    others.into_iter().fold(largest as u32, |word, v| {
        let size = (v.abs() / 0.5_f64.sqrt() * ROTATION_STEPS)
            .round()
            .min(ROTATION_STEPS);
        word << 10 | u32::from(v < 0.0) << 9 | size as u32
    })
}

/// Way in which the attributes are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Packing {
    /// Version 3: one gzip stream.
    Gzip,
    /// Version 4: a Zstandard frame for each attribute.
    Zstandard,
}

/// The bytes of a file, and remarks on what the format cannot hold. The scene is in the dataset's frame.
///
/// # Errors
/// [`Error::Input`] for a position that 24 bits do not reach.
pub(super) fn encode(
    path: &Path,
    scene: &SceneFile,
    packing: Packing,
) -> Result<(Vec<u8>, Vec<String>)> {
    let mut splats = scene.splats.clone();
    HalfTurn::X.turn(&mut splats);
    let n = splats.len();
    let fraction = fraction(path, &splats)?;
    let mut attributes: [Vec<u8>; 6] = Default::default();
    let [
        positions,
        opacity_bytes,
        color_bytes,
        scale_bytes,
        rotations,
        sh,
    ] = &mut attributes;
    for i in 0..n {
        for v in splats.gather::<3>(Plane::POSITION, i) {
            let fixed = (f64::from(v) * f64::from(1_u32 << fraction)).round() as i32;
            positions.extend(&fixed.to_le_bytes()[..3]);
        }
    }
    let [mut opacities, mut colors, mut scales] = [(); 3].map(|()| Rounding::default());
    let opacity = |l: &f32| opacities.byte(255.0 * sigmoid(f64::from(*l)));
    opacity_bytes.extend(splats.planes()[Plane::OPACITY].iter().map(opacity));
    for i in 0..n {
        let color = splats.gather::<3>(Plane::SH, i).map(f64::from);
        color_bytes.extend(color.map(|v| colors.byte(v * COLOR_STEPS + 127.5)));
    }
    for i in 0..n {
        let scale = splats.gather::<3>(Plane::LOG_SCALE, i).map(f64::from);
        scale_bytes.extend(scale.map(|v| scales.byte((v - SCALE[1]) * SCALE[0])));
    }
    for i in 0..n {
        let q = unit(splats.gather(Plane::ROTATION, i));
        rotations.extend(packed_rotation(q).to_le_bytes());
    }
    let mut bands = Rounding::default();
    for i in 0..n {
        for (k, plane) in splats.planes()[Plane::SH + 3..].iter().enumerate() {
            let bucket = SH_BUCKETS[usize::from(k >= 9)];
            let step = f64::from(bucket);
            let value = f64::from(plane[i]) * 128.0 + 128.0;
            let rounded = ((value / step).round() * step).min(255.0);
            sh.push(bands.byte(if value > 256.0 { value } else { rounded }));
        }
    }
    let remarks = [
        scales.remark("scales", "e^-10 to e^5.9 of the file's unit of length"),
        colors.remark("colours", "0.5 ± 0.94"),
        bands.remark("view-dependent coefficients", "-1 to 1"),
        (fraction < FINE).then(|| format!("positions are rounded to 1/{}", 1_u32 << fraction)),
    ];
    let header = Header {
        version: match packing {
            Packing::Gzip => 3,
            Packing::Zstandard => 4,
        },
        count: n,
        sh_degree: splats.sh_degree(),
        fraction: fraction as u8,
        flags: if scene.anti_aliased { ANTI_ALIASED } else { 0 },
    };
    let bytes = header.pack(path, &attributes)?;
    Ok((bytes, remarks.into_iter().flatten().collect()))
}

/// The largest shell whose Gaussians have scales within the format's range, and that costs the positions of Gaussians in the file's frame no bit of the
/// first [`FINE`] behind the point.
///
/// # Errors
/// [`Error::Input`] for a position that 24 bits do not reach.
pub(super) fn reach(path: &Path, splats: &Gaussians) -> Result<Reach> {
    let bits = fraction(path, splats)?.min(FINE);
    Ok(Reach {
        coordinate: LARGEST / f64::from(1_u32 << bits),
        radius: LARGEST_SHELL,
    })
}

/// The most bits behind the binary point with which every position fits into 24.
fn fraction(path: &Path, splats: &Gaussians) -> Result<u32> {
    let positions = &splats.planes()[Plane::POSITION..Plane::LOG_SCALE];
    let sizes = positions.iter().flatten().map(|v| f64::from(v.abs()));
    let farthest = sizes.fold(0.0, f64::max);
    let fits = |bits: &u32| farthest * f64::from(1_u32 << bits) <= LARGEST;
    (0..=MOST_FRACTION).rev().find(fits).ok_or_else(|| {
        let what =
            format!("a Gaussian lies {farthest:.0} from the origin; SPZ reaches to {LARGEST:.0}");
        Error::input(
            path,
            what,
            "leave it out with --crop, or choose another format",
        )
    })
}
