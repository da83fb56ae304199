//! shrink: photos at a fraction of their size.

use super::*;
use mhsplat::capture::{Alpha, Photo};
use mhsplat::device::{Array, ImageSize};
use mhsplat::pipeline::stage::shrink::{reduce, shrink};

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

fn shrunk(photo: &Photo, factor: u32) -> Vec<u8> {
    let device = device();
    let defines = Defines {
        alpha: photo.alpha,
        ..Defines::new(device.tuning())
    };
    let kernels = Kernels::new(&device, defines);
    let stage = kernels.build::<f32>("shrink").unwrap();
    let size = ImageSize([photo.width, photo.height].map(|s| s as usize));
    let from = Array::from_slice(&device, "photo", &photo.data).unwrap();
    let shape = (size, photo.alpha.planes());
    let to = reduce(&device, &stage, &from, shape, factor as usize);
    to.unwrap().to_vec().unwrap()
}

#[test]
fn agrees_with_the_reference_to_the_byte() {
    for (size, alpha) in [
        ([64, 48], Alpha::None),
        ([75, 50], Alpha::Transparency),
        ([33, 17], Alpha::None),
    ] {
        for factor in [2, 4, 8] {
            let photo = photo(size[0], size[1], alpha);
            let want = shrink(&photo, factor);
            assert_eq!(shrunk(&photo, factor), want.data, "{size:?} / {factor}");
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
    assert_eq!(shrunk(&photo, 2), [25, 25, 25]); // (10 + 20 + 30 + 41) / 4 = 25.25
}
