//! Exact nearest neighbours among points: a balanced k-d tree, O(N log N) to build and, for scenes, to query.

use rayon::prelude::*;

/// Points in a leaf; below that, comparing beats descending.
const LEAF: usize = 8;

/// Parts larger than this are built in parallel.
const PARALLEL: usize = 1 << 14;

/// Mean of the squared distances from each point to its `K` nearest others, in the points' units squared (fewer than `K`
/// if there are fewer others; NaN for a single point). Duplicates count as neighbours at distance 0. Positions must be
/// finite and fewer than 2³².
#[must_use]
pub fn mean_squared_distances<const K: usize>(positions: &[[f32; 3]]) -> Vec<f64> {
    let mut points: Vec<(u32, [f32; 3])> = (0..).zip(positions.iter().copied()).collect();
    let root = build(&mut points, 0);
    let tree = Tree {
        points: &points,
        root,
    };
    (0_u32..)
        .zip(positions)
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|(i, p)| {
            let mut nearest = [f64::INFINITY; K];
            tree.search(&tree.root, i, p, &mut nearest);
            let found = nearest.iter().filter(|d| d.is_finite());
            let (sum, count) = found.fold((0.0, 0.0), |(s, n), d| (s + d, n + 1.0));
            sum / count
        })
        .collect()
}

enum Node {
    /// A range of the reordered points.
    Leaf { start: usize, end: usize },
    /// Points of `low` are at most `at` along `axis`, those of `high` at least.
    Split {
        axis: usize,
        at: f32,
        low: Box<Node>,
        high: Box<Node>,
    },
}

struct Tree<'a> {
    /// Index and position, in the order of the leaves.
    points: &'a [(u32, [f32; 3])],
    root: Node,
}

/// Halves by rank along the axis of the largest extent: the depth stays at log₂ N even where all points coincide.
fn build(part: &mut [(u32, [f32; 3])], start: usize) -> Node {
    if part.len() <= LEAF {
        let end = start + part.len();
        return Node::Leaf { start, end };
    }
    let axis = widest_axis(part);
    let middle = part.len() / 2;
    let (_, split, _) = part.select_nth_unstable_by(middle, |a, b| a.1[axis].total_cmp(&b.1[axis]));
    let at = split.1[axis];
    let large = part.len() > PARALLEL;
    let (low, high) = part.split_at_mut(middle);
    let (low, high) = if large {
        rayon::join(|| build(low, start), || build(high, start + middle))
    } else {
        (build(low, start), build(high, start + middle))
    };
    Node::Split {
        axis,
        at,
        low: Box::new(low),
        high: Box::new(high),
    }
}

fn widest_axis(part: &[(u32, [f32; 3])]) -> usize {
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    for (_, p) in part {
        for (k, &v) in p.iter().enumerate() {
            low[k] = low[k].min(v);
            high[k] = high[k].max(v);
        }
    }
    let extent = |k: usize| high[k] - low[k];
    (1..3).fold(0, |best, k| if extent(k) > extent(best) { k } else { best })
}

impl Tree<'_> {
    /// Updates `nearest` (ascending squared distances to `p`) with the points below `node`, point `own` left out.
    fn search<const K: usize>(&self, node: &Node, own: u32, p: &[f32; 3], nearest: &mut [f64; K]) {
        match node {
            Node::Leaf { start, end } => {
                for (i, q) in &self.points[*start..*end] {
                    if *i != own {
                        insert(nearest, squared_distance(p, q));
                    }
                }
            }
            Node::Split {
                axis,
                at,
                low,
                high,
            } => {
                let beyond = f64::from(p[*axis]) - f64::from(*at);
                let (near, far) = if beyond < 0.0 {
                    (low, high)
                } else {
                    (high, low)
                };
                self.search(near, own, p, nearest);
                if nearest.last().is_some_and(|worst| beyond * beyond < *worst) {
                    self.search(far, own, p, nearest);
                }
            }
        }
    }
}

fn squared_distance(p: &[f32; 3], q: &[f32; 3]) -> f64 {
    let along = |k: usize| f64::from(p[k]) - f64::from(q[k]);
    along(0) * along(0) + along(1) * along(1) + along(2) * along(2)
}

/// Keeps the `K` smallest values, ascending.
fn insert<const K: usize>(nearest: &mut [f64; K], d: f64) {
    let place = nearest.iter().take_while(|&&v| v <= d).count();
    if place < K {
        nearest[place..].rotate_right(1);
        nearest[place] = d;
    }
}
