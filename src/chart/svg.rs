//! Line charts, with bands around the lines if there are several samples. Numbers that are not finite are skipped.

use crate::chart::axis::Axis;
use crate::chart::plot::{Plot, empty};

/// Above this many points a series is drawn without marks.
const MARKED: usize = 24;
/// Above this many points a series is thinned to the extremes of each of `MAX_POINTS / 2` columns.
const MAX_POINTS: usize = 480;

/// A line with the range of the samples that it is the median of, and single points.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Banded {
    /// Name in the legend.
    pub name: String,
    /// Points (x, y) in drawing order.
    pub line: Vec<(f64, f64)>,
    /// Ranges (x, low, high), x rising; may be empty.
    pub band: Vec<(f64, f64, f64)>,
    /// Samples, drawn as thin lines that end in a mark; without any, the points of a short line are marked.
    pub samples: Vec<Vec<(f64, f64)>>,
    /// Value in the legend; `None`: the last of the line, or nothing if there are samples without a line.
    pub value: Option<f64>,
}

impl Banded {
    /// A line without band or samples.
    #[must_use]
    pub fn line(name: impl Into<String>, points: Vec<(f64, f64)>) -> Self {
        Self {
            name: name.into(),
            line: points,
            ..Self::default()
        }
    }

    /// The same without points that are not finite.
    fn finite(&self) -> Self {
        let clean = |line: &Vec<(f64, f64)>| -> Vec<(f64, f64)> {
            let good = |p: &&(f64, f64)| p.0.is_finite() && p.1.is_finite();
            line.iter().filter(good).copied().collect()
        };
        let whole = |p: &&(f64, f64, f64)| p.0.is_finite() && p.1.is_finite() && p.2.is_finite();
        Self {
            name: self.name.clone(),
            line: clean(&self.line),
            band: self.band.iter().filter(whole).copied().collect(),
            samples: self.samples.iter().map(clean).collect(),
            value: self.value,
        }
    }

    /// All points of line, samples and band.
    fn points(&self) -> impl Iterator<Item = (f64, f64)> {
        let edges = |b: &(f64, f64, f64)| [(b.0, b.1), (b.0, b.2)];
        let points = self.line.iter().chain(self.samples.iter().flatten());
        points.copied().chain(self.band.iter().flat_map(edges))
    }
}

/// A figure with a line for every series, its band and marks; `no data` if there is no finite point.
#[must_use]
pub fn band_chart(title: &str, x: &Axis<'_>, y: &Axis<'_>, series: &[Banded]) -> String {
    let series: Vec<Banded> = series.iter().map(Banded::finite).collect();
    let points: Vec<_> = series.iter().flat_map(Banded::points).collect();
    let Some(mut plot) = Plot::new(x, y, &points) else {
        return empty("chart", title);
    };
    for (index, series) in series.iter().enumerate() {
        let last = series.value.or(series.line.last().map(|p| p.1));
        // Points alone have no last value.
        let without = ["", "no data"][usize::from(series.samples.is_empty())];
        let last = last.map_or_else(|| without.to_owned(), |v| plot.value(v));
        plot.key(index, &series.name, Some(&last));
        plot.band(index, &series.band);
        for sample in &series.samples {
            plot.line(index, " thin", &thin(sample));
        }
    }
    for (index, series) in series.iter().enumerate() {
        plot.line(index, "", &thin(&series.line));
        let ends = series.samples.iter().filter_map(|s| s.last()).copied();
        let mut marks: Vec<_> = ends.collect();
        if marks.is_empty() && series.line.len() <= MARKED {
            marks.clone_from(&series.line);
        }
        let tips = marks.into_iter().map(|p| (p, plot.tip(p)));
        let tips: Vec<_> = tips.collect();
        plot.marks(index, &tips);
    }
    plot.figure(title)
}

/// The smallest and largest point of each of `MAX_POINTS / 2` runs of points, in order: peaks survive, bytes do not.
fn thin(line: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let n = line.len();
    if n <= MAX_POINTS {
        return line.to_vec();
    }
    let by_y = |a: &usize, b: &usize| line[*a].1.total_cmp(&line[*b].1);
    let length = n.div_ceil(MAX_POINTS / 2);
    let extremes = (0..n).step_by(length).flat_map(|first| {
        let run = first..n.min(first + length);
        [run.clone().min_by(by_y), run.max_by(by_y)]
    });
    let mut kept: Vec<usize> = extremes.flatten().chain([n - 1]).collect();
    kept.sort_unstable();
    kept.dedup();
    kept.into_iter().map(|i| line[i]).collect()
}
