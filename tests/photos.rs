//! Photos within a budget: decoded on demand and ahead, the least recently used gives way, and no result changes.

use std::fs;
use std::ops::Range;
use std::path::Path;
use std::sync::mpsc::channel;
use std::thread::spawn;
use std::time::{Duration, Instant};

use glam::DVec3;
use tempfile::TempDir;

use crate::dataset::colmap_scene;
use crate::determinism::room_within;
use mhsplat::Plan;
use mhsplat::base::error::{Error, Result};
use mhsplat::capture::source::parse_available;
use mhsplat::capture::{Alpha, Dataset, LoadOptions, PhotoSource, load};
use mhsplat::config::parse_bytes;
use mhsplat::device::tuning::Tuning;
use mhsplat::device::{Array, Defines, Device, ImageSize, Kernels, PhotoScale};
use mhsplat::evaluate::{Evaluator, ViewScore};
use mhsplat::pipeline::buffers::ViewSet;
use mhsplat::pipeline::photo_array::PhotoArray;
use mhsplat::pipeline::photos::{PhotoStats, Photos, Wanted};
use mhsplat::pipeline::stage::loss::ImagePair;
use mhsplat::pipeline::stage::metrics::score;
use mhsplat::pipeline::stage::shrink::shrink;
use mhsplat::run::initial_gaussians;
use mhsplat::scene::Gaussians;
use mhsplat::train::Begun;
use mhsplat::train::schedule::Schedule;
use mhsplat::{TrainConfig, Trainer};

/// Bytes of a photo of [`colmap_scene`].
const SMALL: u64 = 16 * 12 * 3;
/// Bytes of a photo of the bundled room at 64 pixels.
const ROOM: u64 = 64 * 48 * 3;

fn within(path: &Path, budget: u64) -> Result<Dataset> {
    let options = LoadOptions {
        test_every: 0,
        image_budget: Some(budget),
        ..LoadOptions::default()
    };
    load(path, &options)
}

/// Photos of a dataset's training views, in their order.
fn added(data: &Dataset) -> Photos {
    // Photos are cut at rows of tiles.
    let device = Device::open(None).unwrap();
    let tuning = Tuning {
        tile: 16,
        ..device.tuning()
    };
    let photos = Photos::new(&device.with_tuning(tuning), data.image_budget);
    for (i, view) in data.train.iter().enumerate() {
        assert_eq!(photos.add(view.photo.clone()).unwrap(), i);
    }
    photos
}

/// A photo at its full size.
const fn whole(photo: usize) -> Wanted {
    smaller(photo, 1)
}

const fn smaller(photo: usize, divisor: usize) -> Wanted {
    Wanted {
        photo,
        scale: PhotoScale::one_over(divisor),
        rows: None,
    }
}

/// Waits until so many files have been decoded, and a little longer for those that should not be.
fn wait_for(photos: &Photos, decoded: u64) {
    let start = Instant::now();
    while photos.stats().decoded < decoded {
        assert!(start.elapsed() < Duration::from_secs(60), "{decoded}");
        std::thread::sleep(Duration::from_millis(2));
    }
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(photos.stats().decoded, decoded);
}

#[test]
fn the_least_recently_used_photo_gives_way() {
    let dir = colmap_scene(6, DVec3::ZERO, true);
    let data = within(dir.path(), 3 * SMALL).unwrap();
    assert!(data.photos_on_demand());
    let photos = added(&data);
    let mut decoded = 0;
    for (photo, is_there) in [
        (0, false),
        (1, false),
        (2, false),
        (0, true),
        (3, false), // in the place of 1
        (2, true),
        (0, true),
        (1, false), // in the place of 3
        (2, true),
        (3, false), // in the place of 0
        (1, true),
        (0, false),
    ] {
        let array = photos.get(whole(photo), []).unwrap();
        let expected = data.train[photo].photo.load().unwrap();
        assert_eq!(array.to_vec().unwrap(), expected.data);
        decoded += u64::from(!is_there);
        assert_eq!(photos.stats().decoded, decoded, "photo {photo}");
    }
    let stats = photos.stats();
    assert_eq!((stats.hits, stats.misses), (5, 7));
    assert_eq!(stats.peak_bytes, 3 * SMALL);
    assert_eq!(
        (stats.total_bytes, stats.budget_bytes),
        (6 * SMALL, 3 * SMALL)
    );
    assert!(stats.seconds_waited > 0.0);
}

#[test]
fn photos_are_decoded_ahead_as_far_as_the_budget_goes() {
    let dir = colmap_scene(9, DVec3::ZERO, true);
    let photos = added(&within(dir.path(), 5 * SMALL).unwrap());
    photos.get(whole(0), (1..9).map(whole)).unwrap();
    wait_for(&photos, 5);
    for photo in 1..5 {
        photos.get(whole(photo), (photo + 1..5).map(whole)).unwrap();
    }
    assert_eq!((photos.stats().hits, photos.stats().misses), (4, 1));
    photos.get(whole(5), [6, 5, 6, 7].map(whole)).unwrap();
    wait_for(&photos, 8);
    assert_eq!(photos.stats().peak_bytes, 5 * SMALL);
}

#[test]
fn photos_that_fit_are_uploaded_once() {
    let dir = colmap_scene(4, DVec3::ZERO, true);
    let data = within(dir.path(), 4 * SMALL).unwrap();
    assert!(!data.photos_on_demand());
    let photos = added(&data);
    for photo in [3, 0, 3, 1] {
        photos.get(whole(photo), [whole(2)]).unwrap();
    }
    let stats = photos.stats();
    assert_eq!((stats.hits, stats.misses, stats.decoded), (4, 0, 0));
    assert_eq!(stats.peak_bytes, 4 * SMALL);
}

/// Bytes of a photo of [`colmap_scene`] at half its size.
const HALF: u64 = SMALL / 4;

/// Photos at half their size, then at their full size, of a dataset read within a budget; each is asked for `rounds` times in turn and
/// compared with its definition.
fn halved(budget: u64, rounds: usize) -> (PhotoStats, PhotoStats) {
    let dir = colmap_scene(6, DVec3::ZERO, true);
    let data = within(dir.path(), budget).unwrap();
    let photos = added(&data);
    let mut stats = Vec::new();
    for divisor in [2, 1] {
        for photo in (0..6).cycle().take(6 * rounds) {
            let found = photos.get(smaller(photo, divisor), []).unwrap();
            let expected = data.train[photo].photo.load().unwrap();
            let expected = shrink(&expected, PhotoScale::one_over(divisor));
            assert_eq!(found.to_vec().unwrap(), expected.data, "photo {photo}");
        }
        stats.push(photos.stats());
    }
    (stats[0], stats[1])
}

#[test]
fn small_photos_are_decoded_once_where_whole_ones_would_not_fit() {
    // All six at half the size, and the whole of one while it is decoded.
    let (small, whole) = halved(6 * HALF + SMALL, 4);
    assert_eq!((small.decoded, small.hits, small.misses), (6, 18, 6));
    assert!(small.peak_bytes <= 6 * HALF + SMALL, "{small:?}");
    // Two at full size: each is decoded anew in its turn.
    assert_eq!(whole.decoded, 6 + 24);
}

#[test]
fn small_photos_beside_whole_ones_keep_to_the_budget() {
    for (room, kept) in [(0, 0), (HALF, 1), (6 * HALF, 6)] {
        let (small, whole) = halved(6 * SMALL + room, 2);
        assert_eq!(small.peak_bytes, 6 * SMALL + kept * HALF);
        assert_eq!((whole.decoded, whole.hits, whole.misses), (0, 24, 0));
    }
}

#[test]
fn small_photos_ahead_leave_room_for_the_whole_of_one() {
    let dir = colmap_scene(9, DVec3::ZERO, true);
    let photos = added(&within(dir.path(), SMALL + 3 * HALF).unwrap());
    let half = |photo| smaller(photo, 2);
    photos.get(half(0), (1..9).map(half)).unwrap();
    wait_for(&photos, 4);
    for photo in 1..9 {
        let next = (photo + 1..9).map(half);
        photos.get(half(photo), next).unwrap();
    }
    assert!(photos.stats().peak_bytes <= SMALL + 3 * HALF);
}

#[test]
fn a_run_that_began_at_full_size_says_why_it_stays_there() {
    let begun = Begun {
        anti_aliasing: Some(false),
        detail: Some(Vec::new()),
        ..Begun::default()
    };
    for (size, reason) in [(256, "as in the checkpoint"), (64, "too small")] {
        let data = room_within(size, None);
        let detail = Plan::begun(&data, &TrainConfig::default(), &begun)
            .unwrap()
            .detail;
        assert!(detail.value.is_empty());
        assert!(detail.why.to_string().contains(reason), "{}", detail.why);
    }
}

#[test]
fn a_photo_ahead_that_is_there_in_another_size_gives_way() {
    let dir = colmap_scene(3, DVec3::ZERO, true);
    for budget in [SMALL + HALF, SMALL + 3 * HALF, 2 * SMALL + 3 * HALF] {
        let photos = added(&within(dir.path(), budget).unwrap());
        for first in [1, 2] {
            // Those ahead come last, and stay as far as the budget goes.
            for photo in [0, 2, 1] {
                photos.get(smaller(photo, first), []).unwrap();
            }
            // Waited for in vain, once.
            let next = [1, 2].map(|photo| smaller(photo, 3 - first));
            photos.get(smaller(0, 3 - first), next).unwrap();
            assert!(photos.stats().peak_bytes <= budget);
        }
    }
}

/// Bytes of a photo of the bundled room at its full size, 256 by 192 pixels, and of a row of it.
const LARGE: u64 = 192 * LINE;
const LINE: u64 = 256 * 3;

/// Some rows of a photo at 1/`divisor` of its size.
fn part(photo: usize, divisor: usize, rows: Range<usize>) -> Wanted {
    Wanted {
        rows: Some(rows),
        ..smaller(photo, divisor)
    }
}

#[test]
fn a_part_of_a_photo_is_kept_where_no_more_is_wanted() {
    let data = room_within(256, Some(2 * LARGE));
    let photos = added(&data);
    let get = |wanted: Wanted, kept: Range<usize>, decoded: u64| {
        let photo = data.train[wanted.photo].photo.load().unwrap();
        let photo = shrink(&photo, wanted.scale);
        let (width, pixels) = (photo.width as usize, (photo.width * photo.height) as usize);
        let planes = photo.data.chunks_exact(pixels);
        let rows = planes.map(|plane| &plane[kept.start * width..kept.end * width]);
        let found = photos.get(wanted.clone(), []).unwrap();
        assert_eq!(*found.rows(), kept, "{wanted:?}");
        assert_eq!(found.to_vec().unwrap(), rows.collect::<Vec<_>>().concat());
        assert_eq!(photos.stats().decoded, decoded, "{wanted:?}");
    };
    // A row of tiles is kept on either side.
    get(part(0, 1, 0..64), 0..80, 1);
    get(part(0, 1, 16..80), 0..80, 1);
    get(part(0, 1, 16..81), 0..97, 2);
    get(part(0, 1, 144..192), 128..192, 3);
    get(part(0, 1, 192..192), 128..192, 3);
    // The whole serves any part, and gives way to it.
    get(whole(0), 0..192, 4);
    get(part(0, 1, 64..80), 48..96, 4);
    get(whole(0), 0..192, 5);
    get(part(0, 1, 16..176), 0..192, 5);
    // Rows are those of the smaller photo.
    get(part(1, 2, 0..16), 0..32, 6);
    get(part(1, 2, 80..96), 64..96, 7);
    get(part(1, 1, 80..96), 64..112, 8);
    get(part(1, 4, 0..16), 0..32, 9);
    assert!(photos.stats().peak_bytes <= 2 * LARGE);
}

#[test]
fn parts_of_more_photos_are_within_a_budget_than_whole_ones() {
    let data = room_within(256, Some(4 * LARGE));
    let photos = added(&data);
    // Six of twelve rows of tiles are kept: of six photos, beside the whole of one.
    let own = |photo| part(photo, 1, 0..80);
    for photo in (0..6).chain(0..6) {
        photos.get(own(photo), []).unwrap();
    }
    let stats = photos.stats();
    assert_eq!((stats.decoded, stats.hits, stats.misses), (6, 6, 6));
    assert_eq!(stats.peak_bytes, 5 * 96 * LINE + LARGE);
    // Whole ones that are looked at give way, those ahead, too.
    for photo in 1..4 {
        photos.get(whole(photo), []).unwrap();
    }
    for photo in [0, 4, 5, 3, 2, 1, 6, 7] {
        let next = (0..8).map(|k| own((photo + k) % 8));
        let found = photos.get(own(photo), next).unwrap();
        assert_eq!(*found.rows(), 0..96);
    }
    assert!(photos.stats().peak_bytes <= 4 * LARGE);
}

/// Whole photos on their way when parts of them are wanted, in another order: they take what they take, and nobody waits for ever.
#[test]
fn photos_that_come_whole_leave_room_for_the_one_in_use() {
    let data = room_within(256, Some(3 * LARGE));
    for _ in 0..10 {
        let photos = added(&data);
        let (done, wait) = channel();
        let work = move || {
            photos.get(whole(0), [whole(1), whole(2)]).unwrap();
            let own = |photo| part(photo, 1, 0..80);
            let found = photos.get(own(5), [own(0), own(1), own(2)]).unwrap();
            done.send(found.rows().clone()).unwrap();
        };
        let thread = spawn(work);
        let rows = wait.recv_timeout(Duration::from_secs(30));
        assert_eq!(rows.expect("waits for ever"), 0..96);
        thread.join().unwrap();
    }
}

/// One photo with transparent pixels, one with an alpha channel and none.
pub fn with_alpha(dir: &Path, transparent: bool) {
    let mut image = image::RgbaImage::from_pixel(16, 12, image::Rgba([200, 100, 50, 255]));
    image.save(dir.join("images/v 01.png")).unwrap();
    if transparent {
        image.put_pixel(5, 5, image::Rgba([200, 100, 50, 128]));
        image.save(dir.join("images/v 02.png")).unwrap();
    }
}

/// Five photos and what their alpha means: without an alpha channel, with one that is opaque, with transparent pixels.
pub fn painted() -> [(TempDir, Alpha); 3] {
    [
        (None, Alpha::None),
        (Some(false), Alpha::None),
        (Some(true), Alpha::Transparency),
    ]
    .map(|(transparent, alpha)| {
        let dir = colmap_scene(5, DVec3::ZERO, true);
        if let Some(transparent) = transparent {
            with_alpha(dir.path(), transparent);
        }
        (dir, alpha)
    })
}

#[test]
fn photos_on_demand_are_those_in_memory() {
    for (dir, alpha) in painted() {
        let eager = within(dir.path(), u64::MAX).unwrap();
        let lazy = within(dir.path(), 2 * SMALL).unwrap();
        assert_eq!(eager.fingerprint(), lazy.fingerprint());
        assert_eq!(eager.alpha(), alpha);
        assert_eq!(lazy.alpha(), alpha);
        assert_eq!(eager.photo_bytes(), lazy.photo_bytes());
        for (a, b) in eager.train.iter().zip(&lazy.train) {
            assert!(matches!(a.photo, PhotoSource::Memory(_)));
            assert!(matches!(b.photo, PhotoSource::File(_)));
            let photo = a.photo.load().unwrap();
            assert_eq!(photo, b.photo.load().unwrap());
            assert_eq!((photo.alpha, b.photo.alpha()), (alpha, alpha));
            assert_eq!(
                (photo.width, photo.height),
                (b.camera.width, b.camera.height)
            );
        }
    }
}

#[test]
fn a_run_that_goes_on_measures_no_photo_again() {
    let dir = colmap_scene(5, DVec3::ZERO, true);
    let lazy = within(dir.path(), 2 * SMALL).unwrap();
    let mut config = TrainConfig::default();
    let plan = Plan::new(&lazy, &config).unwrap();
    fs::remove_dir_all(dir.path().join("images")).unwrap();
    assert!(Plan::new(&lazy, &config).is_err());
    let begun = |detail: &[f32]| Begun {
        anti_aliasing: Some(plan.anti_aliasing.value),
        detail: Some(detail.to_vec()),
        clearance: Some(plan.clearance.value.clone()),
        background: Some(plan.background.value),
    };
    let same = Plan::begun(&lazy, &config, &begun(&plan.detail.value)).unwrap();
    assert_eq!(same, plan);
    let other = Plan::begun(&lazy, &config, &begun(&[0.5])).unwrap();
    assert_eq!(other.detail.value, [0.5]);
    // It goes on as it began, whatever the configuration says now.
    config.work.resolution_levels = 0;
    let kept = Plan::begun(&lazy, &config, &begun(&[0.5])).unwrap();
    assert_eq!(kept.detail.value, [0.5]);
}

#[test]
fn broken_files_are_found_at_the_start_on_demand_too() {
    let dir = colmap_scene(4, DVec3::ZERO, true);
    let file = dir.path().join("images/v 02.png");
    let whole = fs::read(&file).unwrap();
    // The header of the first is in order.
    for bytes in [&whole[..whole.len() / 2], b"not a photo"] {
        fs::write(&file, bytes).unwrap();
        let refused = within(dir.path(), SMALL);
        crate::dataset::assert_refused(refused, &["v 02.png", "not a readable image"]);
    }
}

#[test]
fn a_budget_below_one_photo_is_refused() {
    let dir = colmap_scene(3, DVec3::ZERO, true);
    assert!(within(dir.path(), SMALL).is_ok());
    let Err(Error::Config { option, what }) = within(dir.path(), SMALL - 1) else {
        panic!("a budget of less than one photo is accepted");
    };
    assert_eq!(option, "--image-budget");
    assert!(
        what.contains("575") && what.contains("576") && what.contains(".png"),
        "{what}"
    );
}

/// Parameters, scores of the held-out views and use of the budget after 60 iterations.
fn trained(budget: u64) -> (Gaussians, Vec<ViewScore>, PhotoStats) {
    let data = room_within(64, Some(budget));
    let config = TrainConfig {
        iterations: 60,
        max_size: 64,
        seed: 5,
        ..TrainConfig::default()
    };
    let device = Device::open(None).unwrap();
    let plan = Plan::new(&data, &config).unwrap();
    let splats = initial_gaussians(&data, &plan).unwrap();
    let photos = Photos::new(&device, data.image_budget);
    let train = ViewSet::new(&photos, data.train).unwrap();
    let test = ViewSet::new(&photos, data.test).unwrap();
    let mut trainer = Trainer::with_views(train, &plan, &splats).unwrap();
    let defines = Defines::new(Tuning::for_device(device.info()));
    let evaluator = Evaluator::new(&device, defines, test).unwrap();
    let mut scores = Vec::new();
    for until in [30, 60] {
        trainer.advance_to(until).unwrap();
        let scene = &mut trainer;
        let all = evaluator.score_all(scene, [0.0; 3], false);
        scores.extend(all.unwrap());
    }
    assert!(trainer.stats().accepted > 0, "density control took no part");
    let splats = trainer.state().unwrap().splats;
    (splats, scores, trainer.photo_stats())
}

#[test]
fn a_small_budget_changes_no_bit() {
    let (whole, scores, stats) = trained(u64::MAX);
    assert_eq!((stats.misses, stats.peak_bytes), (0, 40 * ROOM));
    for photos in [1, 3, 12] {
        let (parts, same, stats) = trained(photos * ROOM);
        assert!(whole == parts, "{photos} photos at one time");
        assert_eq!(scores, same);
        assert!(
            stats.peak_bytes <= photos * ROOM && stats.decoded >= 60,
            "{stats:?}"
        );
        assert_eq!(stats.total_bytes, 40 * ROOM);
    }
}

#[test]
fn a_photo_that_goes_missing_is_named() {
    type Spoil = fn(&Path);
    let spoils: [(Spoil, &str); 3] = [
        (|file| fs::remove_file(file).unwrap(), "check that the path"),
        (
            |file| fs::write(file, "no photo").unwrap(),
            "not a readable image",
        ),
        (
            |file| image::RgbImage::new(32, 24).save(file).unwrap(),
            "32×24 pixels in 3 channels; 16×12 in 3",
        ),
    ];
    for (spoil, word) in spoils {
        let dir = colmap_scene(6, DVec3::ZERO, true);
        let data = within(dir.path(), 2 * SMALL).unwrap();
        let config = TrainConfig {
            iterations: 100,
            ..TrainConfig::default()
        };
        let device = Device::open(None).unwrap();
        let splats = initial_gaussians(&data, &Plan::new(&data, &config).unwrap()).unwrap();
        let mut trainer =
            Trainer::new(&device, &data, &Plan::new(&data, &config).unwrap(), &splats).unwrap();
        trainer.advance_to(8).unwrap();
        spoil(&dir.path().join("images/v 04.png"));
        let error = (0..50).find_map(|_| trainer.advance().err()).unwrap();
        let text = error.to_string();
        assert!(text.contains("v 04.png") && text.contains(word), "{text}");
    }
}

/// Squared errors of the rows of an image against a photo whose handle is gone before the kernels have run.
fn rows_against(device: &Device, photo: Array<u8>, side: usize, drop_early: bool) -> Vec<f32> {
    let kernels = Kernels::new(device, Defines::new(Tuning::for_device(device.info())));
    let stage = kernels.build::<f32>("metrics").unwrap();
    let image = Array::zeros(device, "image", 4 * side * side).unwrap();
    let rows = Array::zeros(device, "rows", 2 * side).unwrap();
    let size = ImageSize {
        pixels: [side, side],
        tile: device.tuning().tile as usize,
    };
    let photo = PhotoArray::whole(photo, size);
    let pair = ImagePair {
        image: &image,
        photo: &photo,
        background: [0.0; 3],
        size,
        band: 0..size.tiles()[1],
        blank: None,
    };
    for _ in 0..20 {
        score(&stage, &pair, &rows).unwrap();
    }
    device.flush().unwrap();
    if drop_early {
        drop(photo);
        let others =
            (0..8).map(|_| Array::from_slice(device, "photo", &vec![255; 3 * side * side]));
        assert!(others.into_iter().all(|a| a.is_ok()));
    }
    rows.read(0, side).unwrap()
}

#[test]
fn kernels_under_way_keep_the_photo_that_gave_way() {
    let device = Device::open(None).unwrap();
    let side = 1024;
    let data: Vec<u8> = (0..3 * side * side).map(|i| (i * 31 % 251) as u8).collect();
    let photo = || Array::from_slice(&device, "photo", &data).unwrap();
    let kept = rows_against(&device, photo(), side, false);
    assert!(kept.iter().all(|v| *v > 0.0));
    assert_eq!(kept, rows_against(&device, photo(), side, true));
}

#[test]
fn the_views_ahead_are_those_of_the_schedule() {
    let schedule = Schedule::new(&TrainConfig::default());
    for views in [1, 2, 5, 40] {
        let ahead = schedule.upcoming(33, 20, views);
        let one_by_one: Vec<usize> = (33..53)
            .flat_map(|i| schedule.upcoming(i, 1, views))
            .collect();
        assert_eq!(ahead, one_by_one);
    }
}

#[test]
fn budgets_are_read() {
    for (text, bytes) in [
        ("1", 1),
        (" 800000000 ", 800_000_000),
        ("512M", 512 << 20),
        ("4g", 4 << 30),
        ("1.5GiB", 3 << 29),
        ("2KB", 2048),
        ("1T", 1 << 40),
    ] {
        assert_eq!(parse_bytes(text).unwrap(), bytes, "{text}");
    }
    for text in [
        "", "0", "0.2", "-1", "M", "4GG", "much", "nan", "inf", "1e999",
    ] {
        let expected = parse_bytes(text).unwrap_err();
        assert!(expected.contains("512M or 4G expected"), "{text}");
    }
    let read = |text: &str| toml::from_str::<TrainConfig>(text).map(|c| c.image_budget);
    assert_eq!(read("image-budget = \"2G\"").unwrap(), Some(2 << 30));
    assert_eq!(read("image-budget = 1000").unwrap(), Some(1000));
    assert_eq!(read("").unwrap(), None);
    assert!(read("image-budget = \"much\"").is_err());
    assert!(read("image-budget = -1").is_err());
    let meminfo = "MemTotal:  24683896 kB\nMemFree: 1 kB\nMemAvailable:    1024 kB\n";
    assert_eq!(parse_available(meminfo), Some(1 << 20));
    assert_eq!(parse_available("MemTotal:  24683896 kB\n"), None);
}
