//! One fuzz target; the name of the binary says of which reader.
#![no_main]
#![allow(clippy::unwrap_used, clippy::panic, dead_code)]

#[path = "../readers.rs"]
mod readers;

use std::fs;
use std::path::Path;
use std::sync::{Mutex, OnceLock};

use libfuzzer_sys::fuzz_target;
use readers::Reader;

const NAME: &str = env!("CARGO_BIN_NAME");
static READER: OnceLock<Mutex<Reader>> = OnceLock::new();

/// The reader, with its good files laid where the fuzzer looks for inputs.
fn prepare() {
    let reader = readers::reader(NAME);
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(NAME);
    fs::create_dir_all(&corpus).unwrap();
    for (k, seed) in reader.seeds.iter().enumerate() {
        fs::write(corpus.join(format!("good-{k}")), seed).unwrap();
    }
    assert!(READER.set(Mutex::new(reader)).is_ok());
}

fuzz_target!(init: prepare(), |data: &[u8]| {
    let reader = READER.get().unwrap();
    (reader.lock().unwrap().read)(data);
});
