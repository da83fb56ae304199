//! COLMAP models: round trips, truncation, refusals.

use std::fs;

use glam::DVec3;

use super::{assert_refused, assert_ring, colmap_scene, load_every, ring, three_points};
use mhsplat::capture::Layout;
use mhsplat::capture::colmap::ColmapModel;

fn model() -> ColmapModel {
    let middle = DVec3::new(0.1, 1.0 / 3.0, -7.0);
    ColmapModel::from_views(&ring(3, middle), three_points(middle))
}

#[test]
fn models_survive_both_formats_bit_for_bit() {
    let dir = tempfile::tempdir().unwrap();
    let model = model();
    model.write(dir.path(), true).unwrap();
    model.write(dir.path(), false).unwrap();
    assert_eq!(ColmapModel::read(dir.path(), true).unwrap(), model);
    assert_eq!(ColmapModel::read(dir.path(), false).unwrap(), model);
    assert_eq!(model.cameras.len(), 1, "equal intrinsics share a camera");
}

#[test]
fn cameras_arrive_where_they_were_put() {
    for (binary, layout) in [(true, Layout::ColmapBin), (false, Layout::ColmapTxt)] {
        let dir = colmap_scene(9, DVec3::ONE, binary);
        let d = load_every(dir.path(), 8).unwrap();
        assert_eq!(d.layout, layout);
        assert_ring(&d, 9, DVec3::ONE, 1e-12);
    }
}

/// Some programs write one line for each image: none of them is lost, nor one whose name looks like numbers.
#[test]
fn images_need_no_lines_of_observations() {
    let dir = colmap_scene(9, DVec3::ZERO, false);
    let file = dir.path().join("sparse/0/images.txt");
    let text = fs::read_to_string(&file).unwrap();
    let images = text
        .lines()
        .filter(|line| !line.is_empty() && !line.starts_with('#'));
    let images: Vec<&str> = images.collect();
    let (seen, cut) = ("\n12.5 7 -1 3.25 4 17\n", "\n12.5 7 -1 3.25\n");
    for between in ["\n", "\n\n", seen, cut, "\n\n# an image\n"] {
        fs::write(&file, images.join(between)).unwrap();
        let data = load_every(dir.path(), 0).unwrap();
        assert_eq!(data.train.len(), 9, "{between:?}");
        assert_eq!(data.remarks, Vec::<String>::new(), "{between:?}");
    }
    // A record that is cut is none of observations.
    let cut = format!("{}\n12 1 0 0 0 0 0 0 1\n", images.join("\n"));
    fs::write(&file, cut).unwrap();
    assert_refused(load_every(dir.path(), 0), &["line 10", "NAME"]);
    let named = [1, 2].map(|id| format!("{id} 1 0 0 0 0 0 0 1 20 31 {id}.jpg\n"));
    fs::write(&file, named.concat()).unwrap();
    let model = ColmapModel::read(&dir.path().join("sparse/0"), false).unwrap();
    assert_eq!(model.images.len(), 2);
}

#[test]
fn every_truncation_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    model().write(dir.path(), true).unwrap();
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let file = dir.path().join(name);
        let whole = fs::read(&file).unwrap();
        for length in 0..whole.len() {
            fs::write(&file, &whole[..length]).unwrap();
            assert_refused(ColmapModel::read(dir.path(), true), &[name]);
        }
        let mut longer = whole.clone();
        longer.push(0);
        fs::write(&file, longer).unwrap();
        assert_refused(ColmapModel::read(dir.path(), true), &[name, "follow after"]);
        fs::write(&file, &whole).unwrap();
        assert!(ColmapModel::read(dir.path(), true).is_ok());
    }
}

#[test]
fn absurd_counts_are_refused_before_allocating() {
    let dir = tempfile::tempdir().unwrap();
    model().write(dir.path(), true).unwrap();
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let file = dir.path().join(name);
        let whole = fs::read(&file).unwrap();
        for count in [4, 1 << 40, u64::MAX] {
            let mut bytes = whole.clone();
            bytes[..8].copy_from_slice(&u64::to_le_bytes(count));
            fs::write(&file, bytes).unwrap();
            assert_refused(ColmapModel::read(dir.path(), true), &[name]);
        }
        fs::write(&file, &whole).unwrap();
    }
    // The count of an image's observations: the last 8 bytes of the file.
    let file = dir.path().join("images.bin");
    let mut bytes = fs::read(&file).unwrap();
    let end = bytes.len();
    bytes[end - 8..].copy_from_slice(&u64::MAX.to_le_bytes());
    fs::write(&file, bytes).unwrap();
    assert_refused(
        ColmapModel::read(dir.path(), true),
        &["images.bin", "image 2 of 3"],
    );
}

#[test]
fn models_that_are_not_read_are_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    model().write(dir.path(), true).unwrap();
    model().write(dir.path(), false).unwrap();
    let (bin, txt) = (
        dir.path().join("cameras.bin"),
        dir.path().join("cameras.txt"),
    );
    let whole = fs::read(&bin).unwrap();
    // The newest model, with the parameters of another.
    let mut bytes = whole.clone();
    bytes[12..16].copy_from_slice(&17_i32.to_le_bytes());
    fs::write(&bin, bytes).unwrap();
    assert_refused(ColmapModel::read(dir.path(), true), &["EQUIRECTANGULAR"]);
    for (params, words) in [
        ("", "0 parameters; 2 expected"),
        ("16 10", "the size of its photos expected, 16 and 8"),
    ] {
        fs::write(&txt, format!("1 EQUIRECTANGULAR 16 8 {params}\n")).unwrap();
        let words = ["cameras.txt", "EQUIRECTANGULAR", words];
        assert_refused(ColmapModel::read(dir.path(), false), &words);
    }
    fs::write(&txt, "1 NEWEST 16 12 20 8 6 0.1\n").unwrap();
    let words = ["NEWEST", "image_undistorter"];
    assert_refused(ColmapModel::read(dir.path(), false), &words);
    let mut bytes = whole.clone();
    bytes[12..16].copy_from_slice(&(-1_i32).to_le_bytes());
    fs::write(&bin, bytes).unwrap();
    assert_refused(ColmapModel::read(dir.path(), true), &["-1"]);
    fs::write(&txt, "1 SIMPLE_PINHOLE 16 12 20 8 6\n").unwrap();
    let read = ColmapModel::read(dir.path(), false).unwrap();
    assert_eq!(read.cameras[0].params, [20.0, 20.0, 8.0, 6.0]);
    fs::write(&txt, "1 PINHOLE 16 12 20 8 6\n").unwrap();
    assert_refused(
        ColmapModel::read(dir.path(), false),
        &["3 parameters", "4 expected"],
    );
}

#[test]
fn non_finite_numbers_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let write_both = |model: &ColmapModel| {
        model.write(dir.path(), true).unwrap();
        model.write(dir.path(), false).unwrap();
    };
    for bad in [f64::NAN, f64::INFINITY] {
        let mut broken = model();
        broken.points[2].position[1] = bad;
        write_both(&broken);
        assert_refused(
            ColmapModel::read(dir.path(), true),
            &["points3D.bin", "point 2"],
        );
        assert_refused(
            ColmapModel::read(dir.path(), false),
            &["points3D.txt", "point 2"],
        );
        broken = model();
        broken.images[1].translation[0] = bad;
        write_both(&broken);
        assert_refused(
            ColmapModel::read(dir.path(), true),
            &["images.bin", "image 1"],
        );
        broken = model();
        broken.images[1].rotation = [0.0; 4];
        write_both(&broken);
        assert_refused(
            ColmapModel::read(dir.path(), false),
            &["images.txt", "image 1"],
        );
        broken = model();
        broken.cameras[0].params[0] = bad;
        write_both(&broken);
        assert_refused(
            ColmapModel::read(dir.path(), true),
            &["cameras.bin", "camera 1"],
        );
    }
}

#[test]
fn inconsistent_models_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let mut broken = model();
    broken.images.clear();
    broken.write(dir.path(), true).unwrap();
    assert_refused(
        ColmapModel::read(dir.path(), true),
        &["no registered image"],
    );
    broken = model();
    broken.images[2].camera_id = 77;
    broken.write(dir.path(), true).unwrap();
    assert_refused(ColmapModel::read(dir.path(), true), &["camera 77"]);
    broken = model();
    broken.images[2].name = broken.images[0].name.clone();
    broken.write(dir.path(), true).unwrap();
    assert_refused(ColmapModel::read(dir.path(), true), &["given twice"]);
    fs::write(
        dir.path().join("images.txt"),
        "1 1 0 0 0 0 zero 0 1 a.png\n\n",
    )
    .unwrap();
    write_txt_cameras(dir.path());
    assert_refused(
        ColmapModel::read(dir.path(), false),
        &["line 1", "TY", "zero"],
    );
    fs::write(dir.path().join("images.txt"), "# x\n1 1 0 0 0 0 0 0 1\n\n").unwrap();
    assert_refused(ColmapModel::read(dir.path(), false), &["line 2", "NAME"]);
}

fn write_txt_cameras(dir: &std::path::Path) {
    fs::write(dir.join("cameras.txt"), "1 PINHOLE 16 12 20 20 8 6\n").unwrap();
}

#[test]
fn image_names_cannot_leave_the_dataset() {
    for name in ["../secret.png", "/etc/passwd", "a/../../b.png", ""] {
        let dir = colmap_scene(2, DVec3::ZERO, true);
        let mut broken = ColmapModel::from_views(&ring(2, DVec3::ZERO), Vec::new());
        broken.images[0].name = name.into();
        broken.write(&dir.path().join("sparse/0"), true).unwrap();
        assert_refused(load_every(dir.path(), 0), &["not below this folder"]);
    }
}

#[test]
fn missing_photos_are_named_and_left_out() {
    let dir = colmap_scene(5, DVec3::ZERO, false);
    fs::remove_file(dir.path().join("images/v 03.png")).unwrap();
    fs::remove_file(dir.path().join("images/v 01.png")).unwrap();
    let d = load_every(dir.path(), 0).unwrap();
    assert_eq!(
        (d.train.len(), d.missing),
        (3, vec!["v 01.png".to_owned(), "v 03.png".into()])
    );
    // The model of the photos as they were before somebody saved them in another format.
    let other = dir.path().join("images/v 03.PNG");
    fs::rename(
        dir.path().join("images/v 02.png"),
        dir.path().join("images/v 02.webp"),
    )
    .unwrap();
    fs::copy(dir.path().join("images/v 00.png"), &other).unwrap();
    let d = load_every(dir.path(), 0).unwrap();
    assert_eq!((d.train.len(), d.missing), (4, vec!["v 01.png".to_owned()]));
    fs::rename(
        dir.path().join("images/v 02.webp"),
        dir.path().join("images/v 02.png"),
    )
    .unwrap();
    fs::remove_file(other).unwrap();
    for k in [0, 2, 4] {
        fs::remove_file(dir.path().join(format!("images/v 0{k}.png"))).unwrap();
    }
    assert_refused(
        load_every(dir.path(), 0),
        &["none", "5 are missing", "v 00.png"],
    );
    fs::remove_dir_all(dir.path().join("images")).unwrap();
    assert_refused(load_every(dir.path(), 0), &["images", "no such folder"]);
}

#[test]
fn corrupt_bytes_never_panic() {
    let dir = colmap_scene(3, DVec3::ZERO, true);
    let sparse = dir.path().join("sparse/0");
    let mut refused = 0;
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let file = sparse.join(name);
        let whole = fs::read(&file).unwrap();
        for at in 0..whole.len() {
            for flip in [0xff, 0x80] {
                let mut bytes = whole.clone();
                bytes[at] ^= flip;
                fs::write(&file, bytes).unwrap();
                refused += u32::from(load_every(dir.path(), 0).is_err());
            }
        }
        fs::write(&file, &whole).unwrap();
    }
    assert!(refused > 100, "{refused} corruptions noticed");
}
