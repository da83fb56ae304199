//! shrink: photos at a fraction of their size.

use super::*;
use mhsplat::capture::{Alpha, Photo};
use mhsplat::device::{Array, ImageSize, PhotoScale};
use mhsplat::pipeline::stage::shrink::{reduce, shrink, shrink_rows};

/// A photo whose bytes take every value in no pattern.
fn photo(width: u32, height: u32, alpha: Alpha) -> Photo {
    let byte = |i: u32| (i.wrapping_mul(2_654_435_761) >> 24) as u8;
    Photo {
        width,
        height,
        alpha,
        data: (0..width * height * alpha.planes() as u32)
            .map(byte)
            .collect(),
    }
}

fn shrunk(photo: &Photo, scale: PhotoScale) -> Vec<u8> {
    let device = device();
    let defines = Defines {
        alpha: photo.alpha,
        ..Defines::new(device.tuning())
    };
    let kernels = Kernels::new(&device, defines);
    let stage = kernels.build::<f32>("shrink").unwrap();
    let size = ImageSize {
        pixels: [photo.width, photo.height].map(|s| s as usize),
        tile: device.tuning().tile as usize,
    };
    let from = Array::from_slice(&device, "photo", &photo.data).unwrap();
    let shape = (size, photo.alpha.planes());
    let to = reduce(&device, &stage, &from, shape, scale);
    to.unwrap().to_vec().unwrap()
}

#[test]
fn agrees_with_the_reference_to_the_byte() {
    for (size, alpha) in [
        ([64, 48], Alpha::None),
        ([75, 50], Alpha::Transparency),
        ([33, 17], Alpha::None),
    ] {
        for (num, den) in [(1, 2), (1, 4), (1, 8), (3, 4), (3, 8), (9, 16), (9, 64)] {
            let scale = PhotoScale { num, den };
            let photo = photo(size[0], size[1], alpha);
            let want = shrink(&photo, scale);
            assert_eq!(shrunk(&photo, scale), want.data, "{size:?} {scale:?}");
            assert_eq!(want.width as usize, size[0] as usize * num / den);
            // A band of the smaller photo, as ranks take it.
            let rows = 1..want.height as usize - 1;
            let part = shrink_rows(&photo, scale, rows.clone());
            let (width, pixels) = (want.width as usize, (want.width * want.height) as usize);
            let planes = want.data.chunks_exact(pixels);
            let planes = planes.map(|p| &p[rows.start * width..rows.end * width]);
            assert_eq!(part.data, planes.collect::<Vec<_>>().concat());
        }
    }
}

#[test]
fn what_does_not_fill_a_pixel_is_left_out() {
    let photo = Photo {
        width: 3,
        height: 2,
        alpha: Alpha::None,
        data: [[10, 20, 255], [30, 41, 255]].concat().repeat(3),
    };
    assert_eq!(shrunk(&photo, PhotoScale::one_over(2)), [25, 25, 25]); // (10 + 20 + 30 + 41) / 4 = 25.25
}

/// An output pixel counts input pixels by the area that it covers of them: at 3/4 of the size 1, 1/3 and 1/3², of 16/9.
#[test]
fn pixels_count_by_the_area_that_is_covered() {
    let row = |at: u8| [at, 0, 0, 0];
    let photo = Photo {
        width: 4,
        height: 4,
        alpha: Alpha::None,
        data: [row(0), row(144), row(0), row(0)].concat().repeat(3),
    };
    let scale = PhotoScale { num: 3, den: 4 };
    // 144 * 3 * (1, 2, 0) / 16: a third of the second row belongs to the first output row, two thirds to the second.
    let plane = [27, 0, 0, 54, 0, 0, 0, 0, 0];
    assert_eq!(shrunk(&photo, scale), plane.repeat(3));
    // The same through the definition in real numbers, of a photo without a pattern.
    let photo = self::photo(48, 32, Alpha::None);
    let small = shrink(&photo, scale);
    let covered = |to: usize, from: usize| {
        let (start, end) = (to as f64 * 4.0 / 3.0, (to + 1) as f64 * 4.0 / 3.0);
        (end.min(from as f64 + 1.0) - start.max(from as f64)).max(0.0)
    };
    for (x, y) in [(0, 0), (1, 2), (35, 23), (17, 11)] {
        let pixels = (0..32).flat_map(|v| (0..48).map(move |u| (u, v)));
        let mean: f64 = pixels
            .map(|(u, v)| {
                covered(x, u) * covered(y, v) * f64::from(photo.data[v * 48 + u]) * 9.0 / 16.0
            })
            .sum();
        let made = f64::from(small.data[y * 36 + x]);
        assert!((made - mean).abs() <= 0.5 + 1e-9, "{made} {mean}");
    }
}
