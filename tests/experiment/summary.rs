//! What an experiment writes: scenes side by side, warnings, problems.

use std::fs;

use serde_json::Value;

use super::{Fake, TWO, drive, experiment};
use crate::compare::made::Made;
use mhsplat::lab::experiment::write;

/// The setting `mh` first, without caps.
fn plain(seeds: &str) -> String {
    format!(
        "seeds = {seeds}\n[train]\niterations = 1000\n[[setting]]\nname = \"mh\"\n\
         [[setting]]\nname = \"none\"\nsampler = \"none\"\n[[scene]]\npath = \"a\"\n[[scene]]\npath = \"b\"\n"
    )
}

struct Written {
    json: Value,
    markdown: String,
    page: String,
}

/// Runs `file` with runs as `change` makes them.
fn written(file: &str, mut fake: Fake) -> Written {
    let dir = tempfile::tempdir().unwrap();
    let e = experiment(dir.path(), file).unwrap();
    drive(&e, &mut fake).unwrap();
    let read = |name: &str| fs::read_to_string(e.output.join(name)).unwrap();
    Written {
        json: serde_json::from_str(&read("summary.json")).unwrap(),
        markdown: read("summary.md"),
        page: read("summary.html"),
    }
}

fn changed(change: fn(&str, Made) -> Made) -> Fake {
    Fake {
        change: Some(change),
        ..Fake::default()
    }
}

/// `none` takes 1.5 times as long in scene a, ends 1 dB lower in b.
fn slower_or_lower(name: &str, run: Made) -> Made {
    match name {
        n if n.starts_with("a/none") => run.slower(1.5),
        n if n.starts_with("b/none") => run.below(1.0),
        _ => run,
    }
}

/// The figures of the first setting against another one in a scene.
fn figures(w: &Written, scene: usize, other: usize) -> &Value {
    &w.json["scenes"][scene]["comparison"]["relative"][other]
}

fn near(v: &Value, wanted: f64) {
    let found = v.as_f64().unwrap_or(f64::NAN);
    assert!((found - wanted).abs() < 1e-6, "{found} instead of {wanted}");
}

#[test]
fn the_overview_holds_every_scene_against_the_first_setting() {
    let w = written(&plain("[0, 1, 2]"), changed(slower_or_lower));
    let o = &w.json["overview"][0];
    assert_eq!(
        (&o["reference"], &o["setting"]),
        (&"mh".into(), &"none".into())
    );
    let [a, b] = [0, 1].map(|k| figures(&w, k, 0));
    for key in ["median", "min", "max"] {
        near(&a["mean"][key], 1.5);
    }
    assert_eq!(a["counts"]["both"], 11);
    assert_eq!(a["no_later"], 11);
    near(&a["psnr"]["median"], 0.0);
    near(&b["psnr"]["median"], 1.0);
    // 25 dB is beyond what `none` reaches in b: counted, without a ratio.
    assert_eq!(
        (&b["counts"]["both"], &b["counts"]["only_reference"]),
        (&10.into(), &1.into())
    );
    assert!(b["to_psnr"][10]["spread"].is_null());
    assert_eq!(b["to_psnr"][10]["reached"], serde_json::json!([3, 0]));
    assert_eq!(b["mean_of"], 10);
    assert_eq!(b["to_psnr"].as_array().unwrap().len(), 11);
    let mean = |figures: &Value| figures["mean"]["median"].as_f64().unwrap();
    near(&o["mean"]["median"], (mean(a) * mean(b)).sqrt());
    // No seed differs from another.
    for key in ["mean", "low", "high"] {
        near(&o["psnr"][key], 0.5);
    }
    assert_eq!(o["psnr"]["samples"], 6);
    near(&o["gaussians"], 1.0);
    assert_eq!(w.json["scenes"][0]["comparison"]["thresholds"][0], 15.0);
    for text in [
        "## All scenes",
        "| none | 6 | +0.50 | +0.50 to +0.50 | 1.00 |",
        "## mh against none",
        "| a | 3 seeds | 1.50 (1.50–1.50) | 1.50 at ",
        " | 11 of 11 | ",
        "| both 11, only mh 0, only none 0, neither 0 |",
        "both 10, only mh 1, only none 0, neither 0",
        "| geometric mean | – | ",
        "2 of 2 scenes",
        "| both 21, only mh 1, only none 0, neither 0 |",
        "### Time over that of mh, CPU seconds",
        "| mh 3, none 0 of 3 |",
    ] {
        assert!(w.markdown.contains(text), "{text}: {}", w.markdown);
    }
    assert!(w.page.contains("mh against none") && w.page.contains("only mh 1"));
}

#[test]
fn the_page_leads_to_the_reports_of_runs() {
    let dir = tempfile::tempdir().unwrap();
    let file = plain("[0, 1]").replace("path = \"b\"", "name = \"b+1\"\npath = \"b\"");
    let e = experiment(dir.path(), &file).unwrap();
    drive(&e, &mut Fake::default()).unwrap();
    let page = || {
        write(&e).unwrap();
        fs::read_to_string(e.output.join("summary.html")).unwrap()
    };
    assert!(!page().contains("report.html"));
    let written = ["a/none/seed-1", "a/mh/seed-0", "b+1/mh/seed-1"];
    for run in written {
        fs::write(e.output.join(run).join("report.html"), "").unwrap();
    }
    let page = page();
    let (_, a) = page
        .split_once("<summary>a: reports of its runs</summary>")
        .unwrap();
    assert!(a.starts_with(
        "<ul><li><a href=\"a/mh/seed-0/report.html\">mh, seed 0</a></li><li><a href=\"a/none/seed-1/report.html\">none, seed 1</a></li></ul>"
    ));
    assert!(page.contains("href=\"b%2B1/mh/seed-1/report.html\""));
    assert_eq!(page.matches("/report.html\"").count(), 3);
    let markdown = fs::read_to_string(e.output.join("summary.md")).unwrap();
    assert!(!markdown.contains("report.html"));
}

#[test]
fn one_seed_is_told_as_one_and_without_a_spread() {
    let w = written(&plain("[0]"), changed(slower_or_lower));
    assert!(
        w.markdown.contains("| a | 1 seed | 1.50 | 1.50 at ")
            && w.markdown.contains("| both 11, only mh 0"),
        "{}",
        w.markdown
    );
    let c = &w.json["scenes"][0]["comparison"]["relative"][0];
    assert_eq!(c["seeds"], serde_json::json!([0]));
    assert_eq!(c["mean"]["samples"], 1);
    assert!(w.json["overview"][0]["psnr"].is_null());
    assert!(
        w.markdown.contains("| none | – | – | – |"),
        "{}",
        w.markdown
    );
}

#[test]
fn losses_are_told_as_such() {
    let w = written(
        &plain("[0, 1]"),
        changed(|name, run| match name.contains("/mh/") {
            true => run.slower(2.0).below(0.2),
            false => run,
        }),
    );
    let row = w
        .markdown
        .lines()
        .find(|l| l.starts_with("| a | 2 seeds"))
        .unwrap();
    assert!(row.contains("| 0 of 10 | −0.20 |"), "{row}");
}

#[test]
fn warnings_of_a_scene_are_beside_its_tables() {
    let w = written(
        &plain("[0]"),
        changed(|name, mut run| {
            if name.starts_with("b/none") {
                run.rows[19].gaussians += 400;
                run = run.with(|r| r.device.name = "elsewhere".into());
            }
            run
        }),
    );
    let part = w.markdown.split("\n## b\n").nth(1).unwrap();
    for text in [
        "\n> not at equal numbers of Gaussians: 1200 (mh) to 1600 (none)",
        "\n> none: device elsewhere",
    ] {
        assert!(
            part.contains(text) && w.markdown.matches(text).count() == 1,
            "{text}: {part}"
        );
    }
    assert!(w.page.contains("<li>not at equal numbers of Gaussians"));
}

#[test]
fn a_scene_that_cannot_be_compared_stops_no_other() {
    let w = written(
        &plain("[0]"),
        changed(|name, run| match name {
            "a/none/seed-0" => run.with(|r| r.dataset.width = 48),
            _ => run,
        }),
    );
    let scenes = &w.json["scenes"];
    assert!(scenes[0]["comparison"].is_null());
    let problem = scenes[0]["problem"].as_str().unwrap();
    assert!(problem.contains("another resolution"), "{problem}");
    assert!(scenes[1]["problem"].is_null() && scenes[1]["comparison"].is_object());
    assert!(
        w.markdown.contains("## a\n\n> not compared: "),
        "{}",
        w.markdown
    );
    assert!(w.markdown.contains("| a | not compared |") && w.markdown.contains("| b | 1 seed |"));
    assert!(w.page.contains("<li>not compared: "));
    let all = &w.json["overview"][0];
    assert!(all["psnr"].is_null() && all["gaussians"].is_null());
}

#[test]
fn a_failed_run_takes_no_seed_from_the_others() {
    let fake = Fake {
        fail: Some("a/none/seed-1"),
        ..Fake::default()
    };
    let three = plain("[0, 1, 2]") + "[[setting]]\nname = \"adc\"\nsampler = \"adc\"\n";
    let w = written(&three, fake);
    let part = w.markdown.split("\n## a\n").nth(1).unwrap();
    for text in [
        "| mh | 3 |",
        "| none | 2 |",
        "| adc | 3 |",
        "> none: seeds 0, 2, but 0, 1, 2 of mh",
    ] {
        assert!(part.contains(text), "{text}: {part}");
    }
    assert_eq!(figures(&w, 0, 0)["seeds"], serde_json::json!([0, 2]));
    assert_eq!(figures(&w, 0, 1)["seeds"], serde_json::json!([0, 1, 2]));
    near(&figures(&w, 0, 0)["mean"]["median"], 1.0);
}

#[test]
fn thresholds_of_a_scene_win_over_the_rule() {
    let file = TWO.replace("path = \"b\"", "path = \"b\"\nthresholds = [20, 22.5]");
    let w = written(&file, Fake::default());
    let of = |k: usize| &w.json["scenes"][k]["comparison"]["thresholds"];
    assert_eq!(of(1), &serde_json::json!([20.0, 22.5]));
    assert_eq!(of(0).as_array().unwrap().len(), 11);
    let part = w.markdown.split("\n## b\n").nth(1).unwrap();
    assert!(part.contains("22.5 dB") && part.contains("Thresholds as given."));
}
