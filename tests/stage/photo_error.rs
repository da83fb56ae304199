//! photo_error: errors of pixels.

use super::*;
use mhsplat::capture::{Alpha, photo};
use mhsplat::device::{Array, CameraArg};
use mhsplat::pipeline::photo_array::PhotoArray;
use mhsplat::pipeline::stage::exposure::{IDENTITY, exposed};
use mhsplat::pipeline::stage::loss::ImagePair;
use mhsplat::pipeline::stage::photo_error::PhotoErrors;

#[test]
fn agrees_with_the_reference() {
    agrees("photo_error");
}

#[test]
fn wrong_errors_are_rejected() {
    rejects("photo_error", "errors", |errors| errors[7] += 1e-3);
    let masked = cases::mild("masked", 60, [40, 30], 1, 26).with_mask();
    rejects_in("photo_error", "errors", &masked, |errors| errors[7] += 1e-3);
}

/// The formula in f32, as the host has it for the few pixels that it asks for.
fn formula(case: &Case, image: &[f32], e: Option<&[f32]>) -> Vec<f32> {
    let (p, n) = (&case.photo, image.len() / 3);
    let colors = photo::colors(p.alpha, &p.data, case.background);
    let error = |i: usize| {
        let mut seen = [0, 1, 2].map(|c| image[c * n + i]);
        if let Some(e) = e {
            seen = exposed(e, seen);
        }
        let apart = |c: usize| (seen[c] - colors[c][i]).abs();
        let sum = apart(0) + apart(1) + apart(2);
        match p.alpha {
            Alpha::None => sum / 3.0,
            _ => sum * (f32::from(p.data[3 * n + i]) / 255.0) / 3.0,
        }
    };
    (0..n).map(error).collect()
}

/// Births are drawn by the last bits of the errors: on CPUs they are those of the formula in either style.
#[test]
fn errors_are_those_of_the_formula_to_the_bit() {
    let device = device();
    let mild = |alpha: fn(Case) -> Case| alpha(cases::mild("bits", 1, [75, 33], 0, 5));
    for case in [mild(|c| c), mild(Case::with_alpha), mild(Case::with_mask)] {
        let size = CameraArg::<f32>::new(&case.camera, device.tuning().tile).image();
        let ([w, h], [stride, rows]) = (size.pixels, size.padded());
        let color = |c: usize, x: usize, y: usize| ((c * 31 + x * 7 + y * 13) % 97) as f32 / 71.0;
        let mut padded = vec![0.5; 4 * stride * rows];
        let mut flat = vec![0.0; 3 * w * h];
        for (c, y, x) in
            (0..3).flat_map(|c| (0..h).flat_map(move |y| (0..w).map(move |x| (c, y, x))))
        {
            padded[(c * rows + y) * stride + x] = color(c, x, y);
            flat[(c * h + y) * w + x] = color(c, x, y);
        }
        let mut bent = IDENTITY.map(|v| v as f32);
        [bent[1], bent[3], bent[4], bent[10]] = [0.07, -0.013, 0.21, 0.83];
        let transforms = [IDENTITY.map(|v| v as f32), bent].concat();
        let transforms = Array::from_slice(&device, "exposures", &transforms).unwrap();
        let photo = PhotoArray::upload(&device, &case.photo).unwrap();
        let own = Tuning::for_device(device.info());
        let group = Tuning {
            chunks: 64,
            ..Tuning::GPU
        };
        for (tuning, transform) in [own, group]
            .into_iter()
            .flat_map(|t| [(t, None), (t, Some(1))])
        {
            let defines = Defines {
                alpha: case.photo.alpha,
                ..Defines::new(tuning)
            };
            let stage = PhotoErrors::<f32>::new(&Kernels::new(&device, defines)).unwrap();
            let image = Array::from_slice(&device, "image", &padded).unwrap();
            let pair = ImagePair {
                image: &image,
                photo: &photo,
                background: case.background,
                size,
                band: 0..size.tiles()[1],
                blank: None,
            };
            stage
                .write(&pair, transform.map(|view| (&transforms, view)))
                .unwrap();
            let got = image.to_vec().unwrap();
            let errors = &got[PhotoErrors::<f32>::PLANE * stride * rows..];
            let got = (0..w * h).map(|i| errors[i / w * stride + i % w]);
            let want = formula(&case, &flat, transform.map(|_| bent.as_slice()));
            let differ = got
                .zip(&want)
                .filter(|(a, b)| a.to_bits() != b.to_bits())
                .count();
            assert_eq!(differ, 0, "{:?} {transform:?} {tuning:?}", case.photo.alpha);
            assert!(want.iter().any(|e| *e > 0.01));
            // Transmittance stays.
            assert!(errors[stride * rows..].iter().all(|t| *t == 0.5));
        }
    }
}
