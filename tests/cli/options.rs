//! One struct for the flags of `train` and the keys of its configuration files; `--help`.

use std::fs;

use serde_json::{Value, json};

use super::{done, mhsplat, program, room, stderr, stdout, text};
use mhsplat::TrainConfig;

/// Lines of a help text below a heading.
fn section(help: &str, heading: &str) -> Vec<String> {
    let after = help
        .split_once(&format!("{heading}:\n"))
        .unwrap_or_else(|| panic!("{heading:?} is not in {help}"))
        .1;
    let lines = after.lines().take_while(|l| l.starts_with("  "));
    lines.map(|l| l.trim().to_owned()).collect()
}

#[test]
fn help_groups_the_commands() {
    for flag in ["--help", "-h"] {
        let help = done(&[flag]);
        let groups = [
            (
                "Make a scene",
                &[
                    "train", "render", "view", "eval", "convert", "split", "merge",
                ][..],
            ),
            (
                "Measure",
                &["bench", "verify", "compare", "experiment", "surrogate"],
            ),
            (
                "Tools",
                &["info", "doctor", "devices", "synth", "completions", "man"],
            ),
        ];
        for (heading, names) in groups {
            let lines = section(&help, heading);
            let found: Vec<&str> = lines.iter().filter_map(|l| l.split(' ').next()).collect();
            assert_eq!(found, names, "{help}");
            for line in lines {
                let (name, about) = line.split_once(' ').unwrap();
                let own = done(&[name, "-h"]);
                assert_eq!(own.lines().next(), Some(about.trim()), "{name}");
            }
        }
        assert!(help.contains("Usage: ") && !section(&help, "Options").is_empty());
    }
}

/// Names of all commands.
fn commands() -> Vec<String> {
    let help = done(&["--help"]);
    let groups = ["Make a scene", "Measure", "Tools"];
    let lines = groups.iter().flat_map(|heading| section(&help, heading));
    lines
        .filter_map(|line| Some(line.split(' ').next()?.to_owned()))
        .collect()
}

/// Every command has an example, and scripts and pages of shells know every command.
#[test]
fn shells_are_told_of_every_command() {
    let dir = tempfile::tempdir().unwrap();
    let pages = dir.path().join("pages");
    assert!(done(&["man", text(&pages)]).contains("pages in"));
    let again = mhsplat(&["man", text(&pages)]);
    assert_eq!(again.status.code(), Some(2), "nothing is overwritten");
    let scripts = ["bash", "zsh", "fish", "powershell", "elvish"];
    let scripts = scripts.map(|shell| done(&["completions", shell]));
    let names = commands();
    for name in &names {
        let example = format!("Example: mhsplat {name}");
        let own = done(&[name, "--help"]);
        assert!(own.contains(&example), "{name}: {own}");
        let page = fs::read_to_string(pages.join(format!("mhsplat-{name}.1"))).unwrap();
        assert!(
            page.contains(".SH OPTIONS") || page.contains(".SH NAME"),
            "{page}"
        );
        assert!(scripts.iter().all(|script| script.contains(name)), "{name}");
        // Help fits a terminal of 80 columns.
        let narrow = program()
            .args([name, "-h"])
            .env("COLUMNS", "80")
            .output()
            .unwrap();
        let narrow = stdout(&narrow);
        let long = narrow
            .lines()
            .find(|l| l.chars().count() > 80 && !l.contains("Usage"));
        assert!(long.is_none(), "{name}: {long:?}");
    }
    assert!(names.len() > 10);
    assert!(scripts[0].contains("--max-size"));
}

/// `--device` is offered where a device is used, and nowhere else.
#[test]
fn devices_are_offered_where_they_are_used() {
    let uses = [
        "bench",
        "eval",
        "experiment",
        "info",
        "render",
        "surrogate",
        "train",
        "verify",
        "view",
    ];
    let offers = |name: &String| done(&[name, "--help"]).contains("--device");
    let mut offered: Vec<String> = commands().into_iter().filter(offers).collect();
    offered.sort_unstable();
    assert_eq!(offered, uses);
    let refused = mhsplat(&["synth", "room", "nowhere", "--device", "0"]);
    assert_eq!(refused.status.code(), Some(2));
}

/// The lines of an option in the short help, as one.
fn entry(help: &str, option: &str) -> String {
    let begins = |l: &&str| l.trim_start().starts_with('-');
    let named = |l: &&str| begins(l) && l.split([' ', ',']).any(|word| word == option);
    let mut lines = help.lines().skip_while(|l| !named(l));
    let first = lines
        .next()
        .unwrap_or_else(|| panic!("{option} is not in {help}"));
    let rest = lines.take_while(|l| !begins(l) && !l.is_empty());
    let words = std::iter::once(first)
        .chain(rest)
        .flat_map(str::split_whitespace);
    words.collect::<Vec<_>>().join(" ")
}

#[test]
fn help_shows_every_option_and_its_default() {
    let long = done(&["train", "--help"]);
    assert!(!long.contains(['`', '\\']), "{long}");
    let help = done(&["train", "-h"]);
    let config = serde_json::to_value(TrainConfig::default()).unwrap();
    for (key, value) in config.as_object().unwrap() {
        let shown = match value {
            Value::Object(_) => continue,
            Value::Null | Value::Bool(_) => None,
            Value::String(word) => Some(word.clone()),
            other => Some(other.to_string()),
        };
        let entry = entry(&help, &format!("--{key}"));
        // Without a budget its default is that of the preset.
        if let Some(default) = shown.filter(|_| key != "iterations") {
            assert!(entry.contains(&format!("[default: {default}]")), "{entry}");
        }
    }
    let preset = entry(&help, "--preset");
    assert!(preset.contains("[default: standard]"), "{preset}");
    let surrogate = entry(&help, "--surrogate");
    assert!(surrogate.contains("[default: importance]"), "{surrogate}");
}

#[test]
fn flags_win_over_a_file_and_a_file_over_the_defaults() {
    let dir = tempfile::tempdir().unwrap();
    let (file, run) = (dir.path().join("config.toml"), dir.path().join("run"));
    fs::write(
        &file,
        "iterations = 1\nmax-size = 32\nseed = 5\nsampler = \"adc\"\nsh-degree = 1\nalpha-is-mask = true\n\
         time-budget = \"1h\"\nbackground = \"white\"\n[mh]\nsurrogate = \"probe\"\nprobe-views = 2\n[loss]\nlambda-ssim = 0.5\n",
    )
    .unwrap();
    let room = room();
    let config = ["--config", text(&file), "--json"];
    // Two of the flags are the defaults, typed.
    let flags = [
        "--seed",
        "7",
        "--sampler",
        "mh",
        "--surrogate",
        "importance",
    ];
    let args = [&["train", &room, "-o", text(&run)], &config[..], &flags].concat();
    let record: Value = serde_json::from_str(&done(&args)).unwrap();
    let mut expected = TrainConfig {
        iterations: 1,
        max_size: 32,
        seed: 7,
        sh_degree: 1,
        alpha_is_mask: true,
        time_budget: Some(3600.0),
        background: "white".parse().unwrap(),
        ..TrainConfig::default()
    };
    expected.mh.probe_views = 2;
    expected.loss.lambda_ssim = 0.5;
    let found: TrainConfig = serde_json::from_value(record["config"].clone()).unwrap();
    assert_eq!(found, expected);
}

#[test]
fn only_run_control_may_change_with_resume() {
    let dir = tempfile::tempdir().unwrap();
    let (room, folder) = (room(), text(dir.path()).to_owned());
    let resume = |flags: &[&str]| {
        let args = [&["train", &room, "--resume", &folder], flags].concat();
        let output = mhsplat(&args);
        assert_eq!(output.status.code(), Some(2));
        stderr(&output)
    };
    for flags in [
        ["--output", "run"],
        ["--config", "file.toml"],
        ["--sampler", "mh"],
        ["--surrogate", "probe"],
        ["--max-size", "64"],
        ["--max-gaussians", "9"],
        ["--clearance", "0.4"],
        ["--batch", "2"],
        ["--sh-degree", "3"],
        ["--seed", "0"],
        ["--test-every", "8"],
        ["--init", "points"],
        ["--background", "auto"],
        ["--anti-aliasing", "auto"],
        ["--exposure", "auto"],
    ] {
        let said = resume(&flags);
        assert!(
            said.contains("cannot be used with") && said.contains(flags[0]),
            "{said}"
        );
    }
    let said = resume(&["--seed", "0", "--alpha-is-mask"]);
    assert!(
        said.contains("--seed") && said.contains("--alpha-is-mask") && !said.contains("--init"),
        "{said}"
    );
    for flags in [
        ["--time-budget", "1m"],
        ["--iterations", "900"],
        ["--patience", "3"],
        ["--image-budget", "1M"],
        ["--eval-every", "5"],
        ["--export-every", "5"],
        ["--export", "spz,splat"],
        ["--checkpoint-every", "5"],
        ["--require-psnr", "20"],
    ] {
        // Accepted: what is wrong is that the folder holds no run.
        let said = resume(&flags);
        assert!(said.contains("checkpoint"), "{said}");
    }
}

/// A refused value names its option and what is expected, on the command line and in a file.
#[test]
fn refused_values_name_their_option() {
    let dir = tempfile::tempdir().unwrap();
    let (toml, json) = (dir.path().join("c.toml"), dir.path().join("c.json"));
    for (option, value, expected) in [
        (
            "init",
            "elsewhere",
            "points, random or a .ply, .spz, .splat, .glb or .sog file",
        ),
        ("background", "0,0,2", "R,G,B in 0 to 1"),
        ("time-budget", "soon", "90s, 10m or 1h30m"),
        ("image-budget", "much", "512M or 4G"),
        ("sampler", "best", "mcmc"),
        ("exposure", "maybe", "auto"),
    ] {
        let flag = format!("--{option}");
        fs::write(&toml, format!("{option} = {value:?}")).unwrap();
        fs::write(&json, json!({ "config": { option: value } }).to_string()).unwrap();
        for args in [
            [&flag, value],
            ["--config", text(&toml)],
            ["--config", text(&json)],
        ] {
            let args = [&["train", "nowhere", "-o", text(dir.path())], &args[..]].concat();
            let output = mhsplat(&args);
            assert_eq!(output.status.code(), Some(2));
            let said = stderr(&output);
            for word in [option, value, expected] {
                assert!(said.contains(word), "{args:?}: {said}");
            }
        }
    }
    // Lists would be taken by the order of their values.
    for (file, content, expected) in [
        (&json, "[]", "a table of options expected"),
        (
            &json,
            r#"{ "config": ["mcmc", 20] }"#,
            "a table of options expected",
        ),
        (
            &json,
            r#"{ "optimizer": [0.5] }"#,
            "optimizer: a table expected",
        ),
        (&toml, "optimizer = [0.5]", "optimizer: a table expected"),
        (&toml, "lengths = [[10, 100]]", "lengths: tables expected"),
        (&toml, "[optimizer]\nepsilon = inf", "a finite epsilon > 0"),
        (
            &json,
            r#"{ "optimizer": { "beta2": 1.5 } }"#,
            "beta1 and beta2",
        ),
        (&toml, "[mh]\nturnover = -1.0", "mh.turnover"),
    ] {
        fs::write(file, content).unwrap();
        let args = ["train", "nowhere", "-o", "run", "--config", text(file)];
        let output = mhsplat(&args);
        let said = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{content}: {said}");
        assert!(said.contains(expected), "{content}: {said}");
        assert!(said.contains(text(file)), "{content}: {said}");
    }
    fs::write(&toml, "[mh]\nbirth = \"twin\"").unwrap();
    fs::write(&json, r#"{ "mh": { "birth": "twin" } }"#).unwrap();
    for file in [&toml, &json] {
        let output = mhsplat(&["train", "nowhere", "-o", "run", "--config", text(file)]);
        let said = stderr(&output);
        assert!(
            said.contains("mh.birth: ") && said.contains("faint"),
            "{said}"
        );
    }
}

/// A flag wins over what a file has, and is what is named where it is wrong.
#[test]
fn a_wrong_value_is_told_by_the_flag_or_the_file_that_has_it() {
    let dir = tempfile::tempdir().unwrap();
    let toml = dir.path().join("c.toml");
    let says = |content: &str, flags: [&str; 2], expected: &str, names_file: bool| {
        fs::write(&toml, content).unwrap();
        let args = ["train", "nowhere", "-o", "run", "--config", text(&toml)];
        let said = stderr(&mhsplat(&[&args[..], &flags].concat()));
        assert!(said.contains(expected), "{flags:?}: {said}");
        assert_eq!(said.contains(text(&toml)), names_file, "{said}");
    };
    let wrong = "sh-degree = 9";
    says(wrong, ["--sh-degree", "1"], "nowhere", false);
    says(wrong, ["--sh-degree", "5"], "--sh-degree: 5", false);
    says(wrong, ["--sh-degree", "9"], "--sh-degree: 9", false);
    // Nor does a value that a flag replaces hide the next one.
    let two = "sh-degree = 9\n[mh]\nturnover = -1.0";
    says(two, ["--sh-degree", "1"], "mh.turnover", true);
    // The file has no part in what is wrong only with a flag.
    says("patience = 3", ["--eval-every", "0"], "--patience", false);
}
