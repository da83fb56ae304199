//! The report page and its charts.

use std::path::Path;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;

use super::samples::*;
use glam::{DMat3, DVec3};
use mhsplat::base::error::Error;
use mhsplat::capture::Camera;
use mhsplat::chart::axis::{Axis, ticks};
use mhsplat::chart::svg::{Banded, Bar, band_chart, bar_chart};
use mhsplat::chart::text::{about, escape, grouped, span};
use mhsplat::config::{Init, Length, Sampler, TrainConfig};
use mhsplat::run::PlanRecord;
use mhsplat::run::report::gallery::{ERROR_FULL_SCALE, colormap, data_uri};
use mhsplat::run::viewer::SceneView;
use mhsplat::run::*;

/// Tag names left open, or the first thing that is wrong: enough of a parser for a page that spells every tag out.
fn check_tags(text: &str) -> Result<(), String> {
    let (mut open, mut rest): (Vec<String>, &str) = (Vec::new(), text);
    while let Some(start) = rest.find('<') {
        let end = rest[start..].find('>').ok_or("a tag without an end")? + start;
        let tag = &rest[start + 1..end];
        rest = &rest[end + 1..];
        if tag.contains('<') || tag.matches('"').count() % 2 == 1 {
            return Err(format!("broken tag <{tag}>"));
        }
        let name: String = tag.chars().take_while(|c| !c.is_whitespace()).collect();
        if tag.starts_with('!') || tag.ends_with('/') {
            continue;
        } else if let Some(name) = name.strip_prefix('/') {
            let last = open.pop();
            if last.as_deref() != Some(name) {
                return Err(format!("</{name}> closes {last:?}"));
            }
        } else {
            if ["style", "script"].contains(&&*name) {
                let end = format!("</{name}>");
                rest = &rest[rest.find(&end).ok_or("style or script never ends")?..];
            }
            open.push(name);
        }
    }
    match open.is_empty() {
        true => Ok(()),
        false => Err(format!("left open: {open:?}")),
    }
}

fn page(
    record: &RunRecord,
    rows: &[MetricsRow],
    density: &[DensityRow],
    views: &[GalleryItem],
) -> String {
    let dir = tempfile::tempdir().unwrap();
    write_report(dir.path(), record, rows, density, views, &[]).unwrap();
    let text = std::fs::read_to_string(dir.path().join("report.html")).unwrap();
    check_tags(&text).unwrap();
    // Nothing but the page itself is left in the folder.
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    text
}

const X: Axis<'static> = Axis::framing("x", "");

fn chart(points: Vec<(f64, f64)>) -> String {
    let text = band_chart("t", &X, &X, &[Banded::line("", points)]);
    check_tags(&text).unwrap();
    assert!(!text.contains("NaN") && !text.contains("inf"), "{text}");
    text
}

#[test]
fn tag_checker_finds_what_is_wrong() {
    assert!(check_tags("<p>a<br/></p>").is_ok());
    for bad in [
        "<p>a",
        "<p><b></p></b>",
        "</p>",
        "<p a=\"1>b</p>",
        "<p",
        "<p <b></b></p>",
    ] {
        assert!(check_tags(bad).is_err(), "{bad}");
    }
}

#[test]
fn the_command_of_a_run_within_a_time_budget_repeats_its_lengths() {
    let mut record = record();
    record.config.lengths = vec![Length::new(20, 6000)];
    let text = page(&record, &rows(), &density(), &[]);
    assert!(text.contains("mhsplat train scenes/plush --config "));
    assert!(!text.contains("--time-budget") && !text.contains("--iterations"));
}

#[test]
fn page_shows_the_run() {
    let views = [view("IMG_0008.jpg", 0.0), view("IMG_0016.jpg", 1.3)];
    let text = page(&record(), &rows(), &density(), &views);
    // For looking at the page: MHSPLAT_KEEP_REPORT names a folder to write it to.
    if let Some(dir) = std::env::var_os("MHSPLAT_KEEP_REPORT") {
        write_report(Path::new(&dir), &record(), &rows(), &density(), &views, &[]).unwrap();
    }
    let shown = [
        "27.31",
        "0.8712",
        "0.0912",
        "412\u{202f}345",
        "23 min 53 s",
        "<dd>45 <small>min</small> 15 <small>s</small></dd>",
        "AMD EPYC",
        "alpha loss",
        "no photo has an alpha channel",
        "IMG_0016.jpg",
        "PSNR against time",
        "SSIM against iterations",
        "Gaussians against time",
        "Acceptance",
        "coarse",
        "fine",
        "splat_grad",
        "IMG_0008.jpg",
        "mhsplat train scenes/plush --background white --init &#39;a b/scene.ply&#39; --iterations 7000 --seed 18446744073709551615 --time-budget 600.0",
    ];
    for text_shown in shown {
        assert!(text.contains(text_shown), "{text_shown}");
    }
    assert_eq!(text.matches("src=\"data:image/png;base64,").count(), 6);
    assert_eq!(text.matches("src=").count(), 6);
    let (before, script) = text.split_once("<script>").unwrap();
    let (script, after) = script.split_once("</script>").unwrap();
    let without = [before, after].concat();
    for reference in ["http://", "https://", "url(", "@import", "<script", "<link"] {
        assert!(!without.contains(reference), "{reference}");
    }
    for reference in ["http://", "https://", "fetch(", "import"] {
        assert!(!script.contains(reference), "{reference}");
    }
    // The page's content policy lets this script run, and no other.
    let hash = BASE64.encode(hmac_sha256::Hash::hash(script.as_bytes()));
    assert!(
        before.contains(&format!("script-src 'sha256-{hash}'\"")),
        "{hash}"
    );
    assert!(text.contains("width=device-width") && text.contains("prefers-color-scheme:dark"));
    let bytes = page(&record(), &rows(), &density(), &[]).len();
    assert!(bytes < 60_000, "{bytes} bytes without images");
}

#[test]
fn training_views_are_shown_the_worst_first() {
    let trained = |name: &str, psnr: f64| GalleryItem {
        training: true,
        psnr,
        ..view(name, 0.5)
    };
    let mut record = record();
    let (views, psnr, ssim) = (8, 31.0, 0.9);
    record.training = Some(TrainingScores { views, psnr, ssim });
    let all = [
        trained("better.jpg", 30.5),
        view("held.jpg", 0.0),
        trained("worse.jpg", 21.25),
    ];
    let text = page(&record, &rows(), &density(), &all);
    let (before, after) = text.split_once("<h2>Training views</h2>").unwrap();
    assert!(after.contains("The worst of 8 that were scored"));
    assert!(before.contains("held.jpg") && !before.contains("worse.jpg"));
    let [worse, better] = ["worse.jpg<span>21.25 dB", "better.jpg<span>30.50 dB"];
    assert!(after.find(worse).unwrap() < after.find(better).unwrap());
    let kinds = |text: &str| ["png", "jpeg"].map(|k| text.matches(&format!("image/{k};")).count());
    assert_eq!((kinds(before), kinds(after)), ([3, 0], [0, 6]));
    // The mean alone where nothing is shown.
    let text = page(&record, &rows(), &density(), &all[1..2]);
    assert!(text.contains("PSNR, training views") && !text.contains("<h2>Training views"));
}

#[cfg(unix)]
#[test]
fn a_run_that_began_with_another_leads_to_its_report() {
    let dir = tempfile::tempdir().unwrap();
    let [first, second] = ["a#1 b", "second"].map(|name| dir.path().join(name));
    std::fs::create_dir_all(second.join("again")).unwrap();
    std::fs::create_dir(&first).unwrap();
    let report = |run: &Path, init: &Path| {
        let mut record = record();
        record.config.init = Init::File(init.to_owned());
        write_report(run, &record, &rows(), &[], &[], &[]).unwrap();
        let text = std::fs::read_to_string(run.join("report.html")).unwrap();
        check_tags(&text).unwrap();
        let (_, said) = text.split_once("Began with the Gaussians of ").unwrap();
        said.split_once("</p>").unwrap().0.to_owned()
    };
    let up = std::env::current_dir().unwrap().components().count() - 1;
    let root = dir.path().canonicalize().unwrap();
    let root = root.strip_prefix("/").unwrap();
    let scene = Path::new(&"../".repeat(up))
        .join(root)
        .join("a#1 b/scene.ply");
    let name = scene.display().to_string();
    assert_eq!(report(&second, &scene), name, "there is no report yet");
    report(&first, Path::new("points.ply"));
    for (run, to) in [
        (&second, "../a%231%20b"),
        (&second.join("again"), "../../a%231%20b"),
    ] {
        let link = format!("<a href=\"{to}/report.html\">{name}</a>");
        assert_eq!(report(run, &scene), link);
    }
    let whole = first.join("scene.ply");
    assert_eq!(report(&second, &whole), whole.display().to_string());
}

#[test]
fn colour_corrected_scores_are_shown_where_there_are_any() {
    let plain = page(&record(), &rows(), &density(), &[]);
    assert!(!plain.contains("colour-corrected"));
    let mut record = record();
    let FinalRecord { mean, per_view } = record.final_scores.as_mut().unwrap();
    (mean.cc_psnr, mean.cc_ssim) = (Some(30.123), Some(0.9134));
    // A view of an earlier version's record may lack them.
    let second = &mut per_view[1].scores;
    (second.cc_psnr, second.cc_ssim) = (Some(31.456), Some(0.9278));
    let text = page(&record, &rows(), &density(), &[]);
    for shown in [
        "<dt>PSNR, colour-corrected</dt><dd>30.12 <small>dB</small></dd>",
        "<dt>SSIM, colour-corrected</dt><dd>0.9134</dd>",
        "<th class=n>PSNR, colour-corrected, dB</th><th class=n>SSIM, colour-corrected</th></tr>",
        "<td class=n>0.0951</td><td class=n>–</td><td class=n>–</td></tr>",
        "<td class=n>0.0873</td><td class=n>31.46</td><td class=n>0.9278</td></tr>",
    ] {
        assert!(text.contains(shown), "{shown}");
    }
}

/// What the figures say of a run with these scores at twenty evaluations.
fn advice(change: impl FnOnce(&mut RunRecord), psnr: impl Fn(f64) -> f64) -> String {
    let mut record = record();
    record.config.max_gaussians = None;
    record.stalled = None;
    record.final_scores = None;
    record.dataset.missing.clear();
    change(&mut record);
    let template = rows()[0];
    let row = |k: u32| MetricsRow {
        iteration: 100 * k,
        psnr: Some(psnr(f64::from(k) / 20.0)),
        ..template
    };
    let rows: Vec<MetricsRow> = (1..=20).map(row).collect();
    let text = page(&record, &rows, &[], &[]);
    let said = text.split_once("<h2>What these figures say</h2>");
    said.map_or_else(String::new, |(_, said)| {
        said.split_once("</ul>").unwrap().0.to_owned()
    })
}

#[test]
fn advice_follows_from_the_figures() {
    let level = |_: f64| 25.0;
    assert_eq!(advice(|_| (), level), "");
    let rising = advice(|_| (), |s| 20.0 + 2.0 * s);
    assert!(
        rising.contains("rose by 0.7 dB from 700 to 1\u{202f}400"),
        "{rising}"
    );
    // Photos were small meanwhile: that is why it rose.
    let small = |record: &mut RunRecord| record.full_size_from = 1200;
    assert_eq!(advice(small, |s| 20.0 + 2.0 * s), "");
    let falling = advice(|_| (), |s| 25.0 - (s - 0.5).max(0.0));
    assert!(falling.contains("0.5 dB higher after"), "{falling}");
    assert!(falling.contains("--iterations"), "{falling}");
    // Rising to the rates' settling alone is no reason for a longer run.
    assert_eq!(advice(|_| (), |s| 25.0 + (s - 0.75).max(0.0)), "");
    let capped = |record: &mut RunRecord| {
        record.gaussians = 5000;
        record.removed = 10;
        record.config.max_gaussians = Some(5010);
    };
    assert!(advice(capped, level).contains("--max-gaussians 5010 was reached"));
    let full = |record: &mut RunRecord| {
        record.final_scores.clone_from(&self::record().final_scores);
        let scores = record.final_scores.as_mut().unwrap();
        scores.mean.psnr = 27.0;
        scores.per_view[0].scores.psnr = 21.0;
        scores.per_view[0].view = "<b>.jpg".to_owned();
    };
    let worst = advice(full, level);
    assert!(
        worst.contains("&lt;b&gt;.jpg is 6.0 dB below the mean"),
        "{worst}"
    );
    let poor = |record: &mut RunRecord| {
        full(record);
        record.final_scores.as_mut().unwrap().mean.psnr = 12.0;
    };
    assert!(advice(poor, level).contains("may not belong together"));
    let told = |psnr: f64, what: &str| {
        let gap = move |record: &mut RunRecord| {
            full(record);
            capped(record);
            let (views, ssim) = (8, 0.95);
            record.training = Some(TrainingScores { views, psnr, ssim });
        };
        advice(gap, level).contains(what)
    };
    let by_heart = |psnr| told(psnr, "photos are too few or too far apart");
    assert!(by_heart(33.5) && !by_heart(32.5));
    // More Gaussians would fit such photos alone.
    assert!(told(32.5, "was reached") && !told(33.5, "was reached"));
    let absent = |record: &mut RunRecord| record.dataset.missing = vec!["a.jpg".to_owned(); 3];
    assert!(advice(absent, level).contains("3 photos that the model names"));
}

/// A level camera at a place, looking along z; y points down.
fn level_camera(name: &str, center: [f64; 3], psnr: Option<f64>) -> SceneView {
    SceneView {
        name: name.to_owned(),
        camera: Camera {
            rotation: DMat3::IDENTITY,
            translation: -DVec3::from(center),
            fx: 100.0,
            fy: 100.0,
            cx: 50.0,
            cy: 50.0,
            width: 100,
            height: 100,
        },
        held_out: psnr.is_some(),
        scores: psnr.map(|v| [v, 0.9]),
        photo: None,
    }
}

/// The page's map, if it has one.
fn map(views: &[SceneView]) -> Option<String> {
    let dir = tempfile::tempdir().unwrap();
    write_report(dir.path(), &record(), &rows(), &[], &[], views).unwrap();
    let text = std::fs::read_to_string(dir.path().join("report.html")).unwrap();
    check_tags(&text).unwrap();
    let (_, map) = text.split_once("<h2>Cameras from above</h2>")?;
    Some(map.split_once("</svg>").unwrap().0.to_owned())
}

#[test]
fn cameras_are_on_a_map() {
    let camera = level_camera;
    let (left, right) = (
        camera("left<", [0.0; 3], Some(21.25)),
        camera("right", [1.0, 0.2, 0.3], Some(30.0)),
    );
    let training = camera("middle", [0.5, 0.0, 0.0], None);
    let text = map(&[left.clone(), right.clone(), training.clone()]).unwrap();
    assert!(text.contains("<title>left&lt;: 21.25 dB</title>"), "{text}");
    assert!(text.contains("<title>middle</title>"), "{text}");
    // Not mirrored: who stands at the left and looks ahead has the other at the right hand.
    let at = |name: &str| -> Vec<f64> {
        let (_, rest) = text.split_once(&format!("<title>{name}")).unwrap();
        let (_, path) = rest.split_once("d=\"M").unwrap();
        let numbers = path.split_once('"').unwrap().0.replace('L', " ");
        numbers.split(' ').map(|v| v.parse().unwrap()).collect()
    };
    let (a, b) = (at("left&lt;"), at("right"));
    let (sight, to) = ([a[2] - a[0], a[3] - a[1]], [b[0] - a[0], b[1] - a[1]]);
    assert!(sight[0] * to[1] - sight[1] * to[0] > 0.0, "{a:?} {b:?}");
    // Panoramas have no map, nor has a run without scores.
    assert!(map(&[left.clone(), left]).is_none());
    assert!(map(&[training.clone(), camera("b", [1.0; 3], None)]).is_none());
    assert!(map(&[]).is_none());
}

#[test]
fn density_control_is_told_in_the_samplers_terms() {
    let told = |sampler| {
        let mut record = record();
        record.config.sampler = sampler;
        page(&record, &rows(), &density(), &[])
    };
    let [mh, mcmc, adc, none] = [Sampler::Mh, Sampler::Mcmc, Sampler::Adc, Sampler::None].map(told);
    for (text, has, has_not) in [
        (&mh, "Mean voxel prior D", "Opacity resets"),
        (&mcmc, "relocated", "Acceptance"),
        (&adc, "Opacity resets so far", "Occupied voxels"),
        (&none, "A fixed set of Gaussians.", "Changes"),
    ] {
        assert!(text.contains(has) && !text.contains(has_not), "{has}");
    }
    assert!(adc.contains("cloned") && !mcmc.contains("cloned"));
    assert!(mcmc.contains("--sampler mcmc") && !mh.contains("--sampler"));
}

#[test]
fn page_of_an_empty_run() {
    let empty = RunRecord::new(
        TrainConfig::default(),
        DatasetRecord::default(),
        DeviceRecord::default(),
        PlanRecord::default(),
    );
    let text = page(&empty, &[], &[], &[]);
    assert!(text.contains("no data") && text.contains("not measured"));
    assert!(!text.contains("NaN"));
    let one = page(&record(), &rows()[..1], &density()[..1], &[]);
    assert!(one.contains("<circle"));
}

#[test]
fn page_escapes_every_string() {
    let evil = "<b a=\"x\">&'\u{7}";
    let mut record = record();
    record.dataset.path = format!("dir/{evil}");
    record.dataset.layout = evil.into();
    record.device = DeviceRecord {
        name: evil.into(),
        vendor: evil.into(),
        platform: evil.into(),
        driver: evil.into(),
        compute_units: None,
        ranks: None,
        cores: None,
        tuning: None,
    };
    (record.version, record.commit) = (evil.into(), evil.into());
    record.plan.kept.push(item(evil, evil));
    record.plan.left_out.push(item(evil, evil));
    record.stages[0].name = evil.into();
    record.config.init = Init::File(evil.into());
    record.final_scores.as_mut().unwrap().per_view[0].view = evil.into();
    let text = page(&record, &rows(), &density(), &[view(evil, 0.0)]);
    assert!(!text.contains("<b a") && !text.contains('\u{7}'));
    let escaped = "&lt;b a=&quot;x&quot;&gt;&amp;&#39;\u{fffd}";
    assert!(
        text.matches(escaped).count() >= 15,
        "{}",
        text.matches(escaped).count()
    );
    assert_eq!(escape(evil), escaped);
}

#[test]
fn page_refuses_images_of_another_size() {
    let dir = tempfile::tempdir().unwrap();
    let mut bad = view("v", 0.0);
    bad.photo.pop();
    let found = write_report(dir.path(), &record(), &[], &[], &[bad], &[]);
    assert!(matches!(found, Err(Error::Numerics { .. })));
    assert!(data_uri("v", &[], 0, 0).is_err());
    assert!(data_uri("v", &[0; 6], 1, 1).is_err());
    assert!(error_map(&[0; 6], &[0; 3]).is_err() && error_map(&[0; 4], &[0; 4]).is_err());
}

#[test]
fn large_images_are_reduced() {
    use base64::Engine;
    let uri = data_uri("v", &vec![90; 1300 * 650 * 3], 1300, 650).unwrap();
    let png = uri.strip_prefix("data:image/png;base64,").unwrap();
    let png = base64::engine::general_purpose::STANDARD
        .decode(png)
        .unwrap();
    let image = image::load_from_memory(&png).unwrap().to_rgb8();
    assert_eq!(image.dimensions(), (640, 320));
    assert_eq!(image.get_pixel(7, 7).0, [90; 3]);
}

#[test]
fn error_map_follows_the_scale() {
    // Per channel 51 of 255 is 0.2, the full scale; 30, 60 and 63 have the same mean.
    assert_eq!(ERROR_FULL_SCALE, 0.2);
    let map = error_map(
        &[0, 0, 0, 30, 60, 63, 9, 9, 9, 255, 0, 255],
        &[51, 51, 51, 0, 0, 0, 9, 9, 9, 0, 255, 0],
    )
    .unwrap();
    let pixels: Vec<_> = map.chunks(3).collect();
    assert_eq!(
        pixels,
        [colormap(1.0), colormap(1.0), colormap(0.0), colormap(1.0)]
    );
    // Lightness rises all along, so that the map reads in grey: luminance of sRGB (IEC 61966-2-1).
    let linear = |v: u8| match f64::from(v) / 255.0 {
        v if v <= 0.04045 => v / 12.92,
        v => ((v + 0.055) / 1.055).powf(2.4),
    };
    let luminance = |t: f64| {
        let [r, g, b] = colormap(t).map(linear);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    for i in 0..50 {
        let t = f64::from(i) / 50.0;
        assert!(luminance(t + 0.02) > luminance(t), "{t}");
    }
    assert_eq!(colormap(f64::NAN), colormap(1.0));
    assert_eq!(colormap(-3.0), colormap(0.0));
}

#[test]
fn ticks_are_round_and_frame_the_data() {
    let t = ticks(13.2, 27.3, 4, true).unwrap();
    assert_eq!((t.low, t.high, t.step), (10.0, 30.0, 5.0));
    assert_eq!(t.at, [10.0, 15.0, 20.0, 25.0, 30.0]);
    assert_eq!(ticks(0.0, 0.0, 4, true).unwrap().high, 1.0);
    for (low, high) in [
        (0.0, 1e-300),
        (1e300, 1.1e300),
        (5.0, 5.0),
        (-3.0, -3.0),
        (1e15, 1e15 + 1.0),
        (-1e-9, 7.3e8),
    ] {
        let t = ticks(low, high, 5, false).unwrap();
        assert!(t.low <= low && t.high >= high && t.low < t.high, "{t:?}");
        assert!((1..=12).contains(&t.at.len()), "{t:?}");
        assert!(t.at.windows(2).all(|w| w[0] < w[1]), "{t:?}");
    }
    assert!(ticks(f64::NAN, f64::NAN, 4, true).is_none());
    assert!(ticks(f64::MIN, f64::MAX, 4, true).is_none());
    assert!(ticks(f64::INFINITY, f64::NEG_INFINITY, 4, true).is_none());
}

#[test]
fn charts_take_any_data() {
    assert!(chart(vec![]).contains("no data"));
    assert!(chart(vec![(f64::NAN, 1.0), (1.0, f64::INFINITY)]).contains("no data"));
    assert_eq!(chart(vec![(3.0, 4.0)]).matches("<circle").count(), 1);
    let gap = chart(vec![(0.0, 1.0), (1.0, f64::NAN), (2.0, 3.0)]);
    assert_eq!(gap.matches("<circle").count(), 2);
    // The two ends of a rising line lie at the lower left and the upper right (SVG's y points down).
    assert!(chart(vec![(0.0, 0.0), (1.0, 1.0)]).contains("points=\"48,188 366,24\""));
    assert!(chart(vec![(-1e300, 1e300), (1e300, -1e300)]).contains("<polyline"));
    let bar = |value| Bar {
        name: "a very long name of a stage".into(),
        value,
        text: "<1>".into(),
    };
    let bars = bar_chart("t", &[bar(1.0), bar(0.0), bar(f64::NAN)]);
    check_tags(&bars).unwrap();
    assert_eq!(bars.matches("<rect").count(), 2);
    assert!(bar_chart("t", &[bar(f64::NAN)]).contains("no data"));
}

#[test]
fn long_series_are_thinned_and_keep_their_peaks() {
    let mut points: Vec<_> = (0..100_000).map(|i| (f64::from(i), 0.0)).collect();
    points[54_321].1 = 8.0;
    let text = chart(points);
    assert!(text.len() < 12_000, "{}", text.len());
    assert!(
        text.contains(",24 "),
        "the peak at the top of the frame is drawn"
    );
}

#[test]
fn numbers_read_well() {
    assert_eq!(grouped(0), "0");
    assert_eq!(grouped(999), "999");
    assert_eq!(grouped(1_234_567), "1\u{202f}234\u{202f}567");
    let spans = [
        (0.0, "0.00 s"),
        (119.4, "119.4 s"),
        (119.96, "2 min 00 s"),
        (185.2, "3 min 05 s"),
        (7199.7, "2 h 00 min"),
        (4e5, "111 h 06 min"),
        (f64::NAN, "–"),
        (-1.0, "–"),
    ];
    for (seconds, text) in spans {
        assert_eq!(span(seconds), text);
    }
    // Estimates, to the digits that they are worth.
    let estimates = [
        (0.2, "0 s"),
        (19.4, "19 s"),
        (42.0, "40 s"),
        (87.4, "85 s"),
        (88.0, "1.5 min"),
        (130.0, "2 min"),
        (569.0, "9.5 min"),
        (840.0, "14 min"),
        (3569.0, "59 min"),
        (3570.0, "1 h 00 min"),
        (6700.0, "1 h 50 min"),
        (f64::INFINITY, "–"),
        (-1.0, "–"),
    ];
    for (seconds, text) in estimates {
        assert_eq!(about(seconds), text, "{seconds}");
    }
}
