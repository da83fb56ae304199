//! The order of the rooms and the absence of circles, read from the `use` lines of `src`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Rooms in the order of the data: a room uses only rooms before it.
const ROOMS: [&str; 14] = [
    "base", "chart", "config", "capture", "scene", "ranks", "device", "density", "pipeline",
    "train", "evaluate", "run", "lab", "cli",
];

/// Path of a module from its file: `src/run/mod.rs` is `run`.
fn module(src: &Path, file: &Path) -> String {
    let path = file.strip_prefix(src).unwrap().with_extension("");
    let mut parts: Vec<_> = path.iter().map(|p| p.to_str().unwrap()).collect();
    if parts.last() == Some(&"mod") {
        parts.pop();
    }
    parts.join("::")
}

fn sources(folder: &Path, out: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// Paths of a use tree, each as its segments.
fn paths(prefix: &[String], tree: &str, out: &mut Vec<Vec<String>>) {
    let tree = tree.split(" as ").next().unwrap_or(tree).trim();
    let segments = |s: &str| -> Vec<String> {
        let parts = s.split("::").map(str::trim);
        parts.filter(|p| !p.is_empty()).map(str::to_owned).collect()
    };
    let Some((head, rest)) = tree.split_once('{') else {
        out.push([prefix, &segments(tree)].concat());
        return;
    };
    let prefix = [prefix, &segments(head)].concat();
    let inner = &rest[..rest.rfind('}').unwrap_or(rest.len())];
    let (mut depth, mut start) = (0, 0);
    for (at, c) in inner.char_indices().chain([(inner.len(), ',')]) {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                if !inner[start..at].trim().is_empty() {
                    paths(&prefix, &inner[start..at], out);
                }
                start = at + 1;
            }
            _ => {}
        }
    }
}

/// Every path that a source names: of its use declarations, and those in its code that begin with `crate` or `super`.
/// Comments and the module of unit tests do not count.
fn named(source: &str) -> Vec<Vec<String>> {
    let code: Vec<&str> = source
        .lines()
        .map(|l| l.split("//").next().unwrap_or(l))
        .collect();
    let code = code.join("\n");
    let code = code.split("#[cfg(test)]\nmod ").next().unwrap_or(&code);
    let mut out = Vec::new();
    for (at, _) in code.match_indices("use ") {
        let line = code[..at].rfind('\n').map_or(0, |n| n + 1);
        let before = code[line..at].trim();
        if before.is_empty() || before.starts_with("pub") {
            paths(&[], code[at + 4..].split(';').next().unwrap(), &mut out);
        }
    }
    for word in ["crate::", "mhsplat::", "super::"] {
        for (at, _) in code.match_indices(word) {
            let end = |c: char| !(c.is_alphanumeric() || c == '_' || c == ':');
            let path = code[at..].split(end).next().unwrap_or_default();
            // Before a bracket it is the head of a use tree, which was read above.
            if !path.ends_with("::") {
                paths(&[], path, &mut out);
            }
        }
    }
    out
}

/// The module that a path from `at` leads to, if it is one of ours.
fn target(at: &str, path: &[String], modules: &BTreeSet<String>) -> Option<String> {
    let mut base: Vec<String> = at.split("::").map(str::to_owned).collect();
    let mut rest = path;
    match rest.first()?.as_str() {
        "crate" | "mhsplat" => {
            base.clear();
            rest = &rest[1..];
        }
        "self" => rest = &rest[1..],
        "super" => {
            while rest.first().is_some_and(|p| p == "super") {
                base.pop();
                rest = &rest[1..];
            }
        }
        // A path that begins with a child of this module.
        first if modules.contains(&format!("{at}::{first}")) => {}
        _ => return None,
    }
    let full = [base, rest.to_vec()].concat();
    let longest = (1..=full.len()).rev().map(|n| full[..n].join("::"));
    longest.into_iter().find(|m| modules.contains(m))
}

/// Modules that each module of `sources` (module, text) names, itself left out.
fn arrows(sources: &[(String, String)]) -> BTreeMap<String, BTreeSet<String>> {
    let modules: BTreeSet<String> = sources.iter().map(|(m, _)| m.clone()).collect();
    let of = |(module, text): &(String, String)| {
        let found = named(text);
        let targets = found.iter().filter_map(|p| target(module, p, &modules));
        (
            module.clone(),
            targets.filter(|t| t != module).collect::<BTreeSet<_>>(),
        )
    };
    sources.iter().map(of).collect()
}

/// Arrows from a room to a later one, and from the product to the laboratory.
fn backward(arrows: &BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    let rank = |module: &str| {
        let room = module.split("::").next().unwrap();
        ROOMS.iter().position(|r| *r == room)
    };
    let all = arrows
        .iter()
        .flat_map(|(from, to)| to.iter().map(move |t| (from, t)));
    all.filter(|(from, to)| rank(from).is_some_and(|f| rank(to).is_none_or(|t| t > f)))
        .map(|(from, to)| format!("{from} -> {to}"))
        .collect()
}

/// Modules that are on a circle of arrows: what is left once modules without arrows are taken away again and again.
fn circles(arrows: &BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    let mut left = arrows.clone();
    loop {
        let before = left.len();
        let kept: BTreeSet<String> = left.keys().cloned().collect();
        left.retain(|_, to| to.iter().any(|t| kept.contains(t)));
        let kept: BTreeSet<String> = left.keys().cloned().collect();
        let named: BTreeSet<String> = left.values().flatten().cloned().collect();
        left.retain(|from, _| named.contains(from) && kept.contains(from));
        if left.len() == before {
            return left.into_keys().collect();
        }
    }
}

fn house() -> Vec<(String, String)> {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&src, &mut files);
    let read = |f: &PathBuf| (module(&src, f), std::fs::read_to_string(f).unwrap());
    files.iter().map(read).collect()
}

#[test]
fn every_folder_is_a_room() {
    for (module, _) in house() {
        let room = module.split("::").next().unwrap();
        assert!(
            ROOMS.contains(&room) || ["lib", "main"].contains(&room),
            "{module} is in no room"
        );
    }
}

#[test]
fn rooms_use_only_rooms_before_them() {
    let arrows = arrows(&house());
    assert!(arrows.len() > 150, "{} modules", arrows.len());
    assert_eq!(backward(&arrows), Vec::<String>::new());
}

#[test]
fn nothing_but_the_command_line_names_the_laboratory() {
    let arrows = arrows(&house());
    let outside = |m: &str| !["lab", "cli", "lib"].contains(&m.split("::").next().unwrap());
    for (from, to) in arrows.iter().filter(|(from, _)| outside(from)) {
        let lab = to.iter().find(|t| *t == "lab" || t.starts_with("lab::"));
        assert!(lab.is_none(), "{from} -> {lab:?}");
    }
}

#[test]
fn there_are_no_circles() {
    assert_eq!(circles(&arrows(&house())), Vec::<String>::new());
}

#[test]
fn wrong_houses_are_found() {
    let made = |files: &[(&str, &str)]| {
        let files: Vec<_> = files
            .iter()
            .map(|(m, t)| (m.to_string(), t.to_string()))
            .collect();
        arrows(&files)
    };
    let backwards = made(&[
        ("base", ""),
        ("scene::knn", "use crate::{base::rng, train::step::Step};"),
        ("train::step", "use crate::base;"),
        ("lab", ""),
        ("train", "fn f() { crate::lab::bench() }"),
    ]);
    assert_eq!(
        backward(&backwards),
        ["scene::knn -> train::step", "train -> lab"]
    );
    let parent_and_child = made(&[
        ("run", "pub mod start;\npub use start::claim;"),
        ("run::start", "use super::Run;"),
        (
            "cli",
            "use mhsplat::run::{self, start as begin};\nuse eval::show;",
        ),
        ("cli::eval", "use crate::cli::{scene, output};"),
        ("cli::scene", ""),
        ("cli::output", ""),
    ]);
    assert_eq!(circles(&parent_and_child), ["run", "run::start"]);
    let straight = made(&[
        ("run", "pub use start::claim; // use crate::cli;"),
        (
            "run::start",
            "#[cfg(test)]\nmod tests {\n    use super::super::Run;\n}",
        ),
    ]);
    assert_eq!(circles(&straight), Vec::<String>::new());
}
