//! `mhsplat compare` as a command.

use std::fs;

use super::made::run;
use crate::cli::{done, mhsplat, stderr, stdout, text};

#[test]
fn a_page_tables_and_json() {
    let dir = tempfile::tempdir().unwrap();
    let folders = [0, 1, 2].map(|s| {
        let mh = run(&format!("mh-{s}"), s).write(dir.path());
        let none = run(&format!("none-{s}"), s)
            .sampler_none()
            .slower(1.5)
            .write(dir.path());
        [mh, none]
    });
    let paths: Vec<&str> = folders.iter().flatten().map(|p| text(p)).collect();
    fs::write(folders[1][0].join("report.html"), "").unwrap();
    let page = dir.path().join("page.html");
    let all = [&["compare"], paths.as_slice(), &["-o", text(&page)]].concat();
    let tables = done(&all);
    for word in [
        "| mh | 3 | 1200 |",
        "Time to equal PSNR, CPU seconds",
        "| none | 1.50 (1.50–1.50) | 1.50 (1.50–1.50) |",
    ] {
        assert!(tables.contains(word), "{word}: {tables}");
    }
    let html = fs::read_to_string(&page).unwrap();
    for word in [
        "<svg",
        "class=\"band s1\"",
        "CPU seconds of the process",
        "PSNR against iterations",
        "11 of 11",
        "both 11, only mh 0",
        "Gaussians against wall time",
        "<a href=\"mh-1/report.html\">",
    ] {
        assert!(html.contains(word), "{word}");
    }
    assert!(!html.contains("http://") && html.matches("<script").count() == 1);
    assert_eq!(html.matches("report.html").count(), 1, "others have none");
    // Again, over its own page; but never over anything else.
    done(&all);
    fs::write(&page, "mine").unwrap();
    let refused = mhsplat(&all);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("not a page that mhsplat wrote"));
    assert_eq!(fs::read_to_string(&page).unwrap(), "mine");

    let more = [
        "--json",
        "--threshold",
        "20,24",
        "--clock",
        "train",
        "--reference",
        "none",
    ];
    let json = done(&[&["compare"], paths.as_slice(), &more].concat());
    let v: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(
        (&v["clock"], &v["reference"]),
        (&"train".into(), &"none".into())
    );
    assert_eq!(v["thresholds"], serde_json::json!([20.0, 24.0]));
    assert_eq!(v["groups"][0]["to_psnr"][1]["reach"][0]["clock"], "cpu");
    assert_eq!(
        v["groups"][0]["to_psnr"][1]["reach"][0]["runs"]
            .as_array()
            .unwrap()
            .len(),
        3
    );
    assert!(v["relative"][0]["to_psnr"][0]["spread"]["median"].is_f64());
    assert!(v["groups"][0]["flip"]["median"].is_f64());
    assert_eq!(v["groups"][0]["runs"][0]["iteration"], 1000);
    assert_eq!(v["threshold_rule"], "Thresholds as given.");
    let json = done(&[&["compare", "--json"], paths.as_slice()].concat());
    let v: serde_json::Value = serde_json::from_str(&json).unwrap();
    let own: Vec<f64> = (15..=25).map(f64::from).collect();
    assert_eq!(v["thresholds"], serde_json::json!(own));
}

#[test]
fn refusals_exit_with_2_and_write_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let a = run("a", 0).write(dir.path());
    let b = run("b", 1).with(|r| r.dataset.width = 48).write(dir.path());
    let page = dir.path().join("page.html");
    let args = ["compare", text(&a), text(&b), "-o", text(&page)];
    let refused = mhsplat(&args);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("another resolution") && stdout(&refused).is_empty());
    assert!(!page.exists());
    let allowed = mhsplat(&[&args[..], &["--allow-different"]].concat());
    assert_eq!(allowed.status.code(), Some(0));
    assert!(stderr(&allowed).contains("warning: not comparable"));
    assert!(fs::read_to_string(&page).unwrap().contains("class=warn"));
    for bad in [
        &["compare"][..],
        &["compare", "nowhere"],
        &["compare", text(&a), "--threshold", "nan"],
        &["compare", text(&a), "--threshold", "1e308"],
        &["compare", text(&a), "--threshold=-201"],
    ] {
        assert_eq!(mhsplat(bad).status.code(), Some(2), "{bad:?}");
    }
    // A name for a group; a folder whose own name has the sign is a folder.
    let odd = run("x=y", 0).write(dir.path());
    let named = format!("left={}", text(&a));
    let tables = done(&["compare", &named, text(&odd), "-o", text(&page)]);
    assert!(
        tables.contains("| left | 1 |") && tables.contains("| mh | 1 |"),
        "{tables}"
    );
}
