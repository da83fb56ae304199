//! The tables of `data/gpu` are those of the kernels that `.ci/gpu-check` compiles.

use std::collections::BTreeMap;
use std::path::Path;

#[allow(dead_code)] // its main
#[path = "../examples/kernel_sources.rs"]
mod kernel_sources;

/// Differences between a table and the sources: files that either lacks, kernels that a file does not have.
fn differences(table: &str, sources: &BTreeMap<String, String>) -> Vec<String> {
    let mut found = Vec::new();
    let mut listed = BTreeMap::new();
    for row in table.lines().skip(1) {
        let columns: Vec<&str> = row.split(',').collect();
        let [file, kernel] = [columns[0], columns[1]];
        listed.insert(file, kernel);
        match sources.get(file) {
            None => found.push(format!("{file} is no source")),
            Some(text) if !text.contains(&format!("void {kernel}(")) => {
                found.push(format!("{kernel} is no kernel of {file}"));
            }
            Some(_) => (),
        }
    }
    let missing = sources
        .keys()
        .filter(|file| !listed.contains_key(file.as_str()));
    found.extend(missing.map(|file| format!("{file} is missing")));
    found
}

/// Tables of GPUs and their class of sizes.
const TABLES: [(&str, &str); 4] = [
    ("sm_90", "gpu"),
    ("gfx90a", "gpu-wide"),
    ("gfx1100", "gpu-wide"),
    ("dg2", "gpu-wide"),
];

fn table(arch: &str) -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("data/gpu/{arch}.csv"));
    std::fs::read_to_string(file).unwrap()
}

fn sources(class: &str) -> BTreeMap<String, String> {
    let of = kernel_sources::CLASSES
        .into_iter()
        .find(|(name, _)| *name == class);
    kernel_sources::sources(of.unwrap().1)
}

#[test]
fn tables_have_the_kernels_that_are_compiled() {
    for (arch, class) in TABLES {
        let found = differences(&table(arch), &sources(class));
        assert!(
            found.is_empty(),
            "{arch}: {found:?} (.ci/gpu-check {arch} --write)"
        );
    }
}

/// Sources and kernels of a table, but for the sizes that a tuner tries, which classes have of their own.
fn rows(table: &str) -> Vec<String> {
    let of = |row: &str| row.split(',').take(2).collect::<Vec<_>>().join(",");
    let rows = table.lines().skip(1).map(of);
    rows.filter(|row| !row.contains('.')).collect()
}

#[test]
fn tables_of_all_gpus_have_the_same_kernels() {
    let [first, others @ ..] = TABLES.map(|(arch, _)| rows(&table(arch)));
    assert!(first.len() > 100, "{}", first.len());
    for (other, (arch, _)) in others.into_iter().zip(&TABLES[1..]) {
        assert_eq!(other, first, "{arch} and {}", TABLES[0].0);
    }
    let short = table("sm_90").replace("sort,sort_totals", "");
    assert_ne!(rows(&short), first);
}

#[test]
fn what_differs_is_found() {
    let sources = sources("gpu");
    let rows = |rows: &[&str]| format!("source,kernel\n{}", rows.join("\n"));
    let all: Vec<String> = sources
        .iter()
        .map(|(file, text)| {
            let (_, kernel) = text.split_once("__kernel").unwrap();
            let (_, kernel) = kernel.split_once("void ").unwrap();
            format!("{file},{}", kernel.split('(').next().unwrap())
        })
        .collect();
    let all: Vec<&str> = all.iter().map(String::as_str).collect();
    assert_eq!(differences(&rows(&all), &sources), Vec::<String>::new());
    let one = differences(&rows(&all[1..]), &sources);
    assert_eq!(
        one,
        [format!("{} is missing", all[0].split(',').next().unwrap())]
    );
    let mut other = all.clone();
    other.extend(["splat.of-old,splat", "adam,splat"]);
    let found = differences(&rows(&other), &sources);
    assert_eq!(
        found,
        ["splat.of-old is no source", "splat is no kernel of adam"]
    );
}
