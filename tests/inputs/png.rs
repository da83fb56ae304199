//! PNGs decoded row by row: as photos decoded as a whole are, with all of their 16 bits, and in little memory.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::Path;

use image::{DynamicImage, ImageBuffer};
use serde_json::json;

use crate::cli::{program, stderr};
use crate::dataset::assert_refused;
use mhsplat::base::error::Result;
use mhsplat::capture::{LoadOptions, Photo, load};

/// A dataset of one photo, `photo.png`, with these keys beside its pose.
fn dataset(dir: &Path, keys: serde_json::Value) {
    let mut frame = json!({"file_path": "photo.png", "camera_angle_x": 0.9,
        "transform_matrix": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]});
    for (key, value) in keys.as_object().unwrap() {
        frame[key] = value.clone();
    }
    let file = json!({ "frames": [frame] });
    fs::write(dir.join("transforms.json"), file.to_string()).unwrap();
}

/// The photo of a folder's dataset.
fn read(dir: &Path, max_size: u32) -> Result<Photo> {
    let options = LoadOptions {
        max_size,
        test_every: 0,
        ..LoadOptions::default()
    };
    let data = load(dir, &options)?;
    Ok((*data.train[0].photo.load()?).clone())
}

/// The photo of an image.
fn photo_of(image: &DynamicImage, max_size: u32) -> Photo {
    let dir = tempfile::tempdir().unwrap();
    dataset(dir.path(), json!({}));
    image.save(dir.path().join("photo.png")).unwrap();
    read(dir.path(), max_size).unwrap()
}

/// The area filter of a whole image in `values` of `c` channels, 0 to 255, sums in f32 and in this order: planes before they are rounded.
fn filtered(values: &[f32], c: usize, [w, h]: [usize; 2], [tw, th]: [usize; 2]) -> Vec<f32> {
    let covered = |from: usize, to: usize, t: usize| {
        let (start, end) = (t * from, (t + 1) * from);
        let of = move |s: usize| {
            let overlap = end.min((s + 1) * to) - start.max(s * to);
            (s, (overlap as f64 / from as f64) as f32)
        };
        (start / to..end.div_ceil(to)).map(of)
    };
    let mut planes = vec![0.0; tw * th * c];
    for (i, out) in planes.iter_mut().enumerate() {
        let (k, ty, tx) = (i / (tw * th), i / tw % th, i % tw);
        for (y, down) in covered(h, th, ty) {
            let mut line = 0.0_f32;
            for (x, along) in covered(w, tw, tx) {
                let pixel = &values[(y * w + x) * c..][..c];
                let alpha = pixel.get(3).map_or(1.0, |a| a / 255.0);
                line += along * if k == 3 { pixel[3] } else { pixel[k] * alpha };
            }
            *out += down * line;
        }
    }
    planes
}

fn noise<T: image::Primitive>(n: u32, most: u64) -> Vec<T> {
    let value = |i: u32| ((u64::from(i) * 2_654_435_761) >> 7) % (most + 1);
    (0..n).map(|i| T::from(value(i)).unwrap()).collect()
}

const SIZE: [u32; 2] = [37, 23];

/// Images of every kind of an 8-bit or 16-bit PNG.
fn images() -> Vec<DynamicImage> {
    let [w, h] = SIZE;
    let n = w * h;
    vec![
        DynamicImage::ImageLuma8(ImageBuffer::from_raw(w, h, noise(n, 255)).unwrap()),
        DynamicImage::ImageLumaA8(ImageBuffer::from_raw(w, h, noise(2 * n, 255)).unwrap()),
        DynamicImage::ImageRgb8(ImageBuffer::from_raw(w, h, noise(3 * n, 255)).unwrap()),
        DynamicImage::ImageRgba8(ImageBuffer::from_raw(w, h, noise(4 * n, 255)).unwrap()),
        DynamicImage::ImageLuma16(ImageBuffer::from_raw(w, h, noise(n, 65_535)).unwrap()),
        DynamicImage::ImageLumaA16(ImageBuffer::from_raw(w, h, noise(2 * n, 65_535)).unwrap()),
        DynamicImage::ImageRgb16(ImageBuffer::from_raw(w, h, noise(3 * n, 65_535)).unwrap()),
        DynamicImage::ImageRgba16(ImageBuffer::from_raw(w, h, noise(4 * n, 65_535)).unwrap()),
    ]
}

#[test]
fn rows_give_the_photo_that_the_whole_image_gives() {
    let mut bent = 0;
    for image in images() {
        let color = image.color();
        let c = 3 + usize::from(color.has_alpha());
        let deep = color.bytes_per_pixel() / color.channel_count() == 2;
        let bytes = match c {
            3 => image.to_rgb8().into_raw(),
            _ => image.to_rgba8().into_raw(),
        };
        let values: Vec<f32> = bytes.iter().map(|v| f32::from(*v)).collect();
        for (max_size, to) in [(37, [37, 23]), (36, [36, 22]), (20, [20, 12]), (7, [7, 4])] {
            let photo = photo_of(&image, max_size);
            assert_eq!([photo.width, photo.height], to.map(|s| s as u32));
            let whole = filtered(&values, c, SIZE.map(|s| s as usize), to);
            assert_eq!(photo.data.len(), whole.len());
            for (found, expected) in photo.data.iter().zip(&whole) {
                let expected = expected.round() as u8;
                // Of 8 bits all are the same. Of 16 each value was rounded to half a level before, and so
                // was its alpha.
                let bound = u8::from(deep);
                let off = found.abs_diff(expected);
                assert!(off <= bound, "{color:?} to {max_size}: {found}, {expected}");
                bent += u32::from(off > 0);
            }
        }
    }
    assert!(bent > 0, "no 16-bit value is kept more exactly");
}

#[test]
fn the_mean_of_16_bits_is_that_of_all_bits() {
    let [w, h] = SIZE;
    let raw: Vec<u16> = noise(3 * w * h, 65_535);
    let image = ImageBuffer::from_raw(w, h, raw.clone()).unwrap();
    let values: Vec<f32> = raw.iter().map(|v| f32::from(*v) / 257.0).collect();
    for (max_size, to) in [(20, [20, 12]), (5, [5, 3])] {
        let photo = photo_of(&DynamicImage::ImageRgb16(image.clone()), max_size);
        let exact = filtered(&values, 3, SIZE.map(|s| s as usize), to);
        let rounded: Vec<u8> = exact.iter().map(|v| v.round() as u8).collect();
        assert_eq!(photo.data, rounded);
    }
    // A mean of 0.75 levels, of values that are rounded to 0, 0, 0 and 1.
    let words = [128, 128, 128, 385].iter().flat_map(|v| [*v; 3]);
    let image = ImageBuffer::from_raw(2, 2, words.collect()).unwrap();
    let photo = photo_of(&DynamicImage::ImageRgb16(image), 1);
    assert_eq!(photo.data, [1, 1, 1]);
}

/// A chunk of a PNG.
fn chunk(out: &mut Vec<u8>, name: &[u8; 4], data: &[u8]) {
    out.extend((data.len() as u32).to_be_bytes());
    let start = out.len();
    out.extend(name);
    out.extend(data);
    let sum = crc32fast::hash(&out[start..]);
    out.extend(sum.to_be_bytes());
}

/// A PNG of RGB with 16 bits, and the data that are compressed in it.
fn made([w, h]: [u32; 2], interlaced: bool, data: &[u8]) -> Vec<u8> {
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let sides = [w.to_be_bytes(), h.to_be_bytes()].concat();
    let header = [&sides[..], &[16, 2, 0, 0, u8::from(interlaced)]].concat();
    chunk(&mut out, b"IHDR", &header);
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(data).unwrap();
    chunk(&mut out, b"IDAT", &packed.finish().unwrap());
    chunk(&mut out, b"IEND", &[]);
    out
}

#[test]
fn interlaced_photos_keep_their_bits_as_well() {
    let dir = tempfile::tempdir().unwrap();
    dataset(dir.path(), json!({}));
    let pixel = |v: u16| [v; 3].map(u16::to_be_bytes).concat();
    // Passes 1, 6 and 7 of Adam7, each row behind its filter.
    let mut data = [&[0], &pixel(128)[..], &[0], &pixel(128)[..], &[0]].concat();
    data.extend([pixel(128), pixel(385)].concat());
    fs::write(dir.path().join("photo.png"), made([2, 2], true, &data)).unwrap();
    assert_eq!(read(dir.path(), 1).unwrap().data, [1, 1, 1]);
}

#[test]
fn what_is_too_large_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("photo.png");
    // Headers alone: nothing of these sizes may be allocated.
    let large = [200_000, 200_000];
    fs::write(&file, made(large, false, &[0; 99])).unwrap();
    dataset(dir.path(), json!({"k1": 0.01}));
    let words = ["photo.png", "lens distortion", "MiB", "undistort it first"];
    assert_refused(read(dir.path(), 100), &words);
    dataset(dir.path(), json!({}));
    let words = ["photo.png", "the photo takes", "lower --max-size"];
    assert_refused(read(dir.path(), 1 << 20), &words);
    // Of this size it is decoded until it ends.
    assert_refused(
        read(dir.path(), 100),
        &["photo.png", "not a readable image"],
    );
    fs::write(&file, made(large, true, &[0; 99])).unwrap();
    let words = ["photo.png", "larger than", "not interlaced"];
    assert_refused(read(dir.path(), 100), &words);
    fs::write(&file, made([1 << 30, 1 << 30], false, &[0; 99])).unwrap();
    let words = ["photo.png", "MiB", "scale the photo down"];
    assert_refused(read(dir.path(), 100), &words);
}

/// Writes a photo of 10,000 × 9000 pixels with 16 bits.
#[cfg(target_os = "linux")]
fn write_large(file: &Path) {
    let (width, height) = (10_000, 9_000);
    let file = BufWriter::new(File::create(file).unwrap());
    let mut encoder = png::Encoder::new(file, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Sixteen);
    encoder.set_compression(png::Compression::Fastest);
    let mut writer = encoder.write_header().unwrap();
    let mut rows = writer.stream_writer().unwrap();
    let row = [0x40_u8; 6].repeat(width as usize);
    (0..height).for_each(|_| rows.write_all(&row).unwrap());
    rows.finish().unwrap();
}

/// A photo of 540 MB, in an address space of 480.
#[cfg(target_os = "linux")]
#[test]
fn a_large_photo_takes_little_memory() {
    let dir = tempfile::tempdir().unwrap();
    dataset(dir.path(), json!({}));
    write_large(&dir.path().join("photo.png"));
    let command = program();
    let limited =
        "ulimit -v 480000; exec \"$0\" info \"$1\" --max-size 100 --test-every 0 --threads 1";
    let output = std::process::Command::new("sh")
        .args(["-c", limited])
        .args([command.get_program(), dir.path().as_os_str()])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(said.contains("1 of 100x90"), "{said}");
}
