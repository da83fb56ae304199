//! Image formats: what a photo is saved as makes no difference to the pixels that are read. The files of
//! `tests/dataset/photos` were written by Pillow 13 from [`colour`] and [`entry`].

use std::fs;
use std::path::{Path, PathBuf};

use glam::DVec3;
use image::{DynamicImage, GrayImage, ImageBuffer, ImageFormat, Luma, Rgb, RgbImage, Rgba};
use tempfile::TempDir;

use super::{colmap_scene, load_every};
use mhsplat::capture::{Alpha, Photo};

const SIZE: [u32; 2] = [16, 12];

/// The picture.
fn colour(x: u32, y: u32) -> [u8; 3] {
    [40 + 10 * x, 30 + 15 * y, 200 - 6 * x - 4 * y].map(|v| v as u8)
}

/// An entry of the palettes; a pixel's is x + y modulo 16.
fn entry(x: u32, y: u32) -> [u8; 3] {
    let i = (x + y) % 16;
    [16 * i, 255 - 16 * i, 7 * i].map(|v| v as u8)
}

/// A scene of one photo, `images/v 00.png` in the model; the photo is removed.
fn scene() -> (TempDir, PathBuf) {
    let dir = colmap_scene(1, DVec3::ZERO, true);
    let file = dir.path().join("images/v 00.png");
    fs::remove_file(&file).unwrap();
    (dir, file)
}

fn read(dir: &Path) -> Photo {
    let data = load_every(dir, 0).unwrap();
    assert!(data.missing.is_empty());
    (*data.train[0].photo.load().unwrap()).clone()
}

/// The photo that is read of an image saved under the model's name.
fn saved(image: impl Into<DynamicImage>) -> Photo {
    let (dir, file) = scene();
    image.into().save(&file).unwrap();
    read(dir.path())
}

/// The photo that is read of a stored file, which keeps its own ending.
fn stored(name: &str) -> Photo {
    let (dir, file) = scene();
    let from = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/dataset/photos")
        .join(name);
    fs::copy(&from, file.with_extension(from.extension().unwrap())).unwrap();
    read(dir.path())
}

/// Largest difference of an opaque photo to a picture, grey levels.
#[track_caller]
fn apart(photo: &Photo, picture: impl Fn(u32, u32) -> [u8; 3]) -> u8 {
    assert_eq!([photo.width, photo.height], [16, 12]);
    assert_eq!(photo.alpha, Alpha::None);
    let plane = (SIZE[0] * SIZE[1]) as usize;
    let off = (0..3 * plane).map(|at| {
        let (c, i) = (at / plane, (at % plane) as u32);
        photo.data[at].abs_diff(picture(i % SIZE[0], i / SIZE[0])[c])
    });
    off.max().unwrap()
}

fn rgb() -> RgbImage {
    RgbImage::from_fn(SIZE[0], SIZE[1], |x, y| Rgb(colour(x, y)))
}

#[test]
fn eight_and_sixteen_bits_are_read_alike() {
    assert_eq!(apart(&saved(rgb()), colour), 0);
    // 257 times the value is the value's own place on the finer scale; what lies between is rounded.
    for off in [0_i32, 120, -120] {
        let wide = |v: u8| (257 * i32::from(v) + off) as u16;
        let pixel = |x, y| Rgb(colour(x, y).map(wide));
        let photo = saved(ImageBuffer::from_fn(SIZE[0], SIZE[1], pixel));
        assert_eq!(apart(&photo, colour), 0, "{off}");
        let pixel = |x, y| {
            let [r, g, b] = colour(x, y).map(wide);
            Rgba([r, g, b, u16::MAX])
        };
        let photo = saved(ImageBuffer::from_fn(SIZE[0], SIZE[1], pixel));
        assert_eq!(apart(&photo, colour), 0, "{off}, opaque alpha");
    }
    // The comparison must be able to fail.
    assert!(apart(&saved(rgb()), entry) > 20);
}

#[test]
fn sixteen_bits_of_alpha_are_read_as_eight() {
    let alpha = |x: u32| (17 * x) as u8;
    let narrow = |x, y| {
        let [r, g, b] = colour(x, y);
        Rgba([r, g, b, alpha(x)])
    };
    let wide = |x, y| Rgba(narrow(x, y).0.map(|v| 257 * u16::from(v)));
    let narrow = saved(ImageBuffer::from_fn(SIZE[0], SIZE[1], narrow));
    let wide = saved(ImageBuffer::from_fn(SIZE[0], SIZE[1], wide));
    assert_eq!(narrow.alpha, Alpha::Transparency);
    assert_eq!(narrow.data[3 * 192 + 5], alpha(5));
    assert_eq!(narrow, wide);
}

#[test]
fn grey_photos_have_three_equal_channels() {
    let grey = |x: u32, y: u32| (13 * x + 5 * y) as u8;
    let wanted = |x, y| [grey(x, y); 3];
    let narrow = GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| Luma([grey(x, y)]));
    assert_eq!(apart(&saved(narrow.clone()), wanted), 0);
    let wide = |x, y| Luma([257 * u16::from(grey(x, y))]);
    let wide = ImageBuffer::<Luma<u16>, Vec<u16>>::from_fn(SIZE[0], SIZE[1], wide);
    assert_eq!(apart(&saved(wide), wanted), 0);
    let (dir, file) = scene();
    narrow
        .save_with_format(file.with_extension("jpg"), ImageFormat::Jpeg)
        .unwrap();
    let off = apart(&read(dir.path()), wanted);
    assert!(off <= 8, "{off}");
}

/// Linear light of a level of sRGB, 0 to 255.
fn linear(level: f32) -> f32 {
    let v = level / 255.0;
    match v <= 0.04045 {
        true => v / 12.92,
        false => ((v + 0.055) / 1.055).powf(2.4),
    }
}

/// The photo that is read of an image saved with this ending.
fn saved_as(ending: &str, image: impl Into<DynamicImage>) -> Photo {
    let (dir, file) = scene();
    image.into().save(file.with_extension(ending)).unwrap();
    read(dir.path())
}

#[test]
fn linear_light_becomes_srgb_at_its_depth() {
    // What lies between two levels of 8 bits is kept until the photo is rounded.
    for off in [0.0, 0.45, -0.45] {
        let pixel = |x, y| Rgb(colour(x, y).map(|v| linear(f32::from(v) + off)));
        let image = ImageBuffer::from_fn(SIZE[0], SIZE[1], pixel);
        assert_eq!(apart(&saved_as("exr", image), colour), 0, "{off}");
    }
    let pixel = |x, y| Rgb(colour(x, y).map(|v| linear(f32::from(v))));
    let image = ImageBuffer::<Rgb<f32>, Vec<f32>>::from_fn(SIZE[0], SIZE[1], pixel);
    let off = apart(&saved_as("hdr", image), colour);
    // Half a step of 1/256 of the brightest of three values, where sRGB is steepest: 12.92 · 255 / 512.
    assert!(off <= 6, "{off}");
    assert_eq!(apart(&saved_as("bmp", rgb()), colour), 0);
    // Levels that were stored as if they were light are noticed.
    let pixel = |x, y| Rgb(colour(x, y).map(|v| f32::from(v) / 255.0));
    let image = ImageBuffer::from_fn(SIZE[0], SIZE[1], pixel);
    assert!(apart(&saved_as("exr", image), colour) > 20);
}

#[test]
fn light_beyond_the_range_is_cut_and_alpha_is_divided_out() {
    let wild = [f32::NAN, f32::INFINITY, 1e30, -2.0];
    let wanted = [0, 255, 255, 0];
    let pixel = |x: u32, _| Rgb([wild[x as usize % 4], 0.0, 1.0]);
    let photo = saved_as("exr", ImageBuffer::from_fn(SIZE[0], SIZE[1], pixel));
    let shown = |x: u32, _: u32| [wanted[x as usize % 4], 0, 255];
    assert_eq!(apart(&photo, shown), 0);
    // An EXR holds colours times alpha; a photo of 8 bits with straight alpha holds them as they are.
    let alpha = |x: u32| 17 * x as u8;
    let straight = ImageBuffer::from_fn(SIZE[0], SIZE[1], |x, y| {
        let [r, g, b] = colour(x, y);
        Rgba([r, g, b, alpha(x)])
    });
    let associated = ImageBuffer::from_fn(SIZE[0], SIZE[1], |x, y| {
        let a = f32::from(alpha(x)) / 255.0;
        let [r, g, b] = colour(x, y).map(|v| a * linear(f32::from(v)));
        Rgba([r, g, b, a])
    });
    let [straight, associated] = [saved(straight), saved_as("exr", associated)];
    assert_eq!(associated.alpha, Alpha::Transparency);
    let apart = straight.data.iter().zip(&associated.data);
    let apart = apart.map(|(a, b)| a.abs_diff(*b)).max();
    assert!(apart <= Some(1), "{apart:?}");
}

#[test]
fn palettes_are_looked_up() {
    for name in ["palette-4bit.png", "palette-8bit.png"] {
        assert_eq!(apart(&stored(name), entry), 0, "{name}");
    }
    let photo = stored("palette-transparent.png");
    assert_eq!(photo.alpha, Alpha::Transparency);
    // Entry 0 is transparent, entry 1 half, the others are opaque.
    assert_eq!(photo.data[3 * 192..3 * 192 + 3], [0, 128, 255]);
    assert_eq!([0, 1, 2].map(|c| photo.data[c * 192 + 2]), entry(2, 0));
    assert_eq!(photo.data[192 + 1], 120, "239 times 128 / 255");
}

#[test]
fn webp_and_jpeg_are_read_within_what_they_lose() {
    assert_eq!(apart(&stored("lossless.webp"), colour), 0);
    for (name, most) in [("lossy.webp", 12), ("progressive.jpg", 6), ("cmyk.jpg", 6)] {
        let off = apart(&stored(name), colour);
        println!("{name}: {off} levels at most");
        assert!(off <= most, "{name}: {off}");
    }
    let (dir, file) = scene();
    rgb()
        .save_with_format(file.with_extension("jpeg"), ImageFormat::Jpeg)
        .unwrap();
    let off = apart(&read(dir.path()), colour);
    assert!(off <= 24, "{off}");
}

#[test]
fn content_counts_and_not_the_ending() {
    let (dir, file) = scene();
    rgb().save_with_format(&file, ImageFormat::WebP).unwrap();
    assert_eq!(apart(&read(dir.path()), colour), 0);
}

/// A JPEG with this EXIF orientation, of which no other tag is set.
fn oriented(jpeg: &[u8], orientation: u8) -> Vec<u8> {
    assert_eq!(jpeg[..2], [0xff, 0xd8]);
    let mut tiff = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
    tiff.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
    let mut out = vec![0xff, 0xd8, 0xff, 0xe1];
    out.extend((tiff.len() as u16 + 2).to_be_bytes());
    out.extend(tiff);
    out.extend(&jpeg[2..]);
    out
}

#[test]
fn exif_orientation_is_ignored() {
    let (dir, file) = scene();
    let file = file.with_extension("jpg");
    rgb().save(&file).unwrap();
    let plain = fs::read(&file).unwrap();
    let upright = read(dir.path());
    for orientation in [3, 6] {
        fs::write(&file, oriented(&plain, orientation)).unwrap();
        // The tag is there to be obeyed.
        let reader = image::ImageReader::open(&file).unwrap();
        let mut decoder = reader.into_decoder().unwrap();
        let tag = image::ImageDecoder::orientation(&mut decoder).unwrap();
        assert_ne!(tag, image::metadata::Orientation::NoTransforms);
        assert_eq!(read(dir.path()), upright);
    }
}
