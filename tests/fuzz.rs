//! Untrusted files: whatever is in them, a reader answers or refuses, and does neither panic, hang nor ask for more memory than
//! the file is worth. What fuzzers found worth keeping (`tests/fuzz/corpus`) and a few hundred mutated inputs per reader;
//! MHSPLAT_FUZZ=1000000 for more (with `--test-threads 1`, so that the peak of memory is each reader's own).
//! `tests/fuzz/cargo` lets cargo-fuzz loose on the same readers.

mod mutate;
mod readers;

use std::fs;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use mutate::{Dice, mutated};
use readers::{CLOUDS, COLMAP, EXPORTS, PHOTOS, RUNS, Reader, SETTINGS, reader};

use mhsplat::base::process;

/// Inputs per reader in a plain test run.
const INPUTS: u64 = 400;
/// No input takes longer, on a busy machine either.
const LONGEST: Duration = Duration::from_secs(20);
/// The peak of the process may grow by this over a reader's inputs.
const MOST_MEMORY: u64 = 1 << 30;

fn inputs() -> u64 {
    std::env::var("MHSPLAT_FUZZ").map_or(INPUTS, |n| n.parse().unwrap())
}

/// The stored inputs of a reader, and their names.
fn corpus(name: &str) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/fuzz/corpus")
        .join(name);
    let mut files: Vec<_> = fs::read_dir(&folder)
        .unwrap_or_else(|e| panic!("{}: {e}", folder.display()))
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    assert!(!files.is_empty(), "{} is empty", folder.display());
    let file = |f: &PathBuf| {
        let name = f.file_name().unwrap().to_string_lossy().into_owned();
        (name, fs::read(f).unwrap())
    };
    files.iter().map(file).collect()
}

/// Reads one input and answers whether it was taken, and how long that took; one that makes the reader panic is kept.
fn survives(name: &str, of: &mut Reader, input: &[u8], number: &str) -> (bool, Duration) {
    let began = Instant::now();
    let taken = catch_unwind(AssertUnwindSafe(|| (of.read)(input))).unwrap_or_else(|_| {
        let kept = std::env::temp_dir().join(format!("mhsplat-fuzz-{name}-{number}"));
        fs::write(&kept, input).unwrap();
        panic!(
            "{name}: input {number} makes the reader panic; it is kept as {}",
            kept.display()
        );
    });
    (taken, began.elapsed())
}

/// Feeds a reader.
fn feed(name: &str) {
    let mut of = reader(name);
    let good = of.seeds.clone();
    for seed in &good {
        assert!((of.read)(seed), "{name}: the seeds themselves are good");
    }
    let before = process::peak_rss_bytes();
    let (mut taken, mut slowest) = (0u64, Duration::ZERO);
    let mut pool = Vec::new();
    for (file, stored) in corpus(name) {
        let (_, took) = survives(name, &mut of, &stored, &file);
        slowest = slowest.max(took);
        pool.push(stored);
    }
    // Good files are whole ones, which is what mutation has to start from as often as from what is broken already.
    let stored = pool.len();
    while pool.len() < 2 * stored.max(good.len()) {
        pool.extend_from_slice(&good);
    }
    let count = inputs();
    for k in 0..count {
        let input = mutated(&pool, &mut Dice::new(k));
        let (good, took) = survives(name, &mut of, &input, &k.to_string());
        taken += u64::from(good);
        slowest = slowest.max(took);
    }
    let grown = process::peak_rss_bytes().saturating_sub(before);
    println!(
        "{name}: {stored} stored inputs, {count} mutated, {taken} taken, slowest {slowest:?}, peak grew by {} MiB",
        grown >> 20
    );
    assert!(slowest < LONGEST, "{name}: {slowest:?}");
    // Beside other tests the peak is anybody's.
    let alone = std::env::var_os("MHSPLAT_FUZZ").is_some();
    assert!(!alone || grown < MOST_MEMORY, "{name}: {grown} bytes");
    assert!(
        taken < count,
        "{name}: a reader that takes everything checks nothing"
    );
}

#[test]
fn colmap_models() {
    COLMAP.into_iter().for_each(feed);
}

#[test]
fn transforms_and_photos() {
    PHOTOS.into_iter().for_each(feed);
}

#[test]
fn exports_of_other_programs() {
    EXPORTS.into_iter().for_each(feed);
}

#[test]
fn point_clouds_and_scenes() {
    CLOUDS.into_iter().for_each(feed);
}

#[test]
fn configurations_and_experiments() {
    SETTINGS.into_iter().for_each(feed);
}

#[test]
fn checkpoints_and_run_records() {
    RUNS.into_iter().for_each(feed);
}

/// A reader that no fuzzer is let loose on would be forgotten.
#[test]
fn every_reader_has_a_fuzz_target() {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/cargo/Cargo.toml");
    let manifest: toml::Table = toml::from_str(&fs::read_to_string(manifest).unwrap()).unwrap();
    let bins = manifest["bin"].as_array().unwrap().iter();
    let mut targets: Vec<&str> = bins.map(|b| b["name"].as_str().unwrap()).collect();
    let mut names = [&COLMAP[..], &PHOTOS, &EXPORTS, &CLOUDS, &SETTINGS, &RUNS].concat();
    targets.sort_unstable();
    names.sort_unstable();
    assert_eq!(targets, names);
}

/// What names its version in a checkpoint, up to the number's end.
fn version(bytes: &[u8]) -> Option<Vec<u8>> {
    let key = br#"version\":"#;
    let at = bytes.windows(key.len()).position(|w| w == key)?;
    let end = bytes[at..].iter().position(|b| *b == b',')?;
    Some(bytes[at..at + end].to_vec())
}

/// Readers refuse another version by its number and look no further.
#[test]
fn stored_checkpoints_are_of_this_version() {
    for name in ["checkpoint", "signed_checkpoint"] {
        let this = version(&reader(name).seeds[0]);
        assert!(this.is_some());
        let stored = corpus(name);
        let same = stored.iter().filter(|(_, bytes)| version(bytes) == this);
        assert!(same.count() >= 5, "{name}");
    }
}
