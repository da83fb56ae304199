//! `mhsplat bench`.

use std::path::PathBuf;

use crate::cli::common::{Common, DeviceOption, Outcome};
use crate::cli::lab::Form;
use crate::cli::output;
use mhsplat::base::error::{Error, Result};
use mhsplat::device::Device;
use mhsplat::lab::bench;
use mhsplat::lab::bench::{Options, Outcome as Measured};
use mhsplat::lab::folder::{check_folder, write_files};

/// Cases of several ranks: Gaussians, pixels.
const SCALED: [(usize, u32); 2] = [(100_000, 800), (500_000, 800)];

/// Arguments.
#[derive(clap::Args)]
pub struct BenchArgs {
    /// 10k, 100k, 500k and 1M Gaussians at 400, 800 and 1600 pixels each.
    #[arg(long)]
    full: bool,
    /// Measure a trained scene, too, seen from a circle around it.
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Folder for bench.json, bench.csv, bench.md and bench.html; must be empty or not exist.
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Measure how one scene of 100k and 500k Gaussians trains on 1, 2 and 4 ranks of the device, and model more of them over networks.
    #[arg(long, conflicts_with_all = ["full", "scene"])]
    scaling: bool,
    /// N@PX, one or more, in a hurry: shows that everything works, measures nothing.
    #[arg(long, hide = true, value_parser = brief_case, value_delimiter = ',', conflicts_with = "full")]
    brief: Vec<(usize, u32)>,
    #[command(flatten)]
    device: DeviceOption,
    #[command(flatten)]
    form: Form,
}

fn brief_case(text: &str) -> std::result::Result<(usize, u32), String> {
    let numbers = text.split_once('@');
    numbers
        .and_then(|(n, px)| Some((n.parse().ok()?, px.parse().ok()?)))
        .filter(|(n, px): &(usize, u32)| *n > 0 && (1..=4096).contains(px))
        .ok_or_else(|| "N@PX expected".into())
}

/// Measures one device, or all of them with --device all.
pub fn run(args: &BenchArgs, common: &Common) -> Result<Outcome> {
    if let Some(dir) = &args.output {
        check_folder(dir)?;
    }
    let options = Options {
        scene: args.scene.clone(),
        ..match (args.brief.as_slice(), args.full) {
            ([], true) => Options::full(),
            ([], false) => Options::default(),
            (cases, _) => Options::brief(cases.to_vec()),
        }
    };
    let mut note = |text: &str| output::note(text);
    if args.scaling {
        return scaling(args, &options, &mut note, common);
    }
    let outcomes = match args.device.selector().as_deref() {
        Some("all") => {
            let all = Device::list()?.into_iter();
            let devices: Vec<_> = all.map(|d| (d.name, Some(d.index.to_string()))).collect();
            bench::run_all(
                &devices,
                |selector| args.device.open_tuned(selector),
                &options,
                &mut note,
            )
        }
        one => {
            let record = bench::run(&args.device.open_tuned(one)?, &options, &mut note)?;
            vec![Measured::Done(Box::new(record))]
        }
    };
    if let Some(dir) = &args.output {
        bench::write_folder(dir, &outcomes)?;
    }
    if common.json {
        output::line(&bench::json(&outcomes)?);
    } else {
        args.form.print(&bench::report(&outcomes));
    }
    let failed = |o: &Measured| matches!(o, Measured::Failed { .. });
    if outcomes.iter().all(failed) {
        return Err(Error::device(
            "bench",
            "no device could be measured",
            "see why above, and `mhsplat devices`",
        ));
    }
    Ok(Outcome::Done)
}

/// Measures several ranks of one device.
fn scaling(
    args: &BenchArgs,
    options: &Options,
    note: &mut dyn FnMut(&str),
    common: &Common,
) -> Result<Outcome> {
    let options = match args.brief.as_slice() {
        [] => Options {
            cases: SCALED.to_vec(),
            samples: 15,
            ..options.clone()
        },
        _ => options.clone(),
    };
    let open = |list: &str| args.device.open_list(list);
    let selector = args.device.selector().unwrap_or_else(|| "cpu".to_owned());
    let all = bench::scaling::measure(&open, &selector, &options, note)?;
    let report = bench::scaling::report(&all);
    if let Some(dir) = &args.output {
        let json = serde_json::to_string_pretty(&all);
        let json = json.map_err(|e| Error::numerics("bench", e.to_string()))?;
        let files = [
            ("bench.json", json + "\n"),
            ("bench.md", report.to_markdown()),
            ("bench.html", report.to_html()),
        ];
        write_files(dir, &files)?;
    }
    match common.json {
        true => output::json(&all)?,
        false => args.form.print(&report),
    }
    Ok(Outcome::Done)
}
