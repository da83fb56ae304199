//! Bounding volume hierarchy over a scene's solids.

use std::cell::Cell;

use glam::DVec3;

use crate::lab::synth::shape::{Entry, Solid};

/// Solids a leaf may hold.
const LEAF: usize = 2;
/// Entries of the walk's stack. Splits may be lopsided down to half this depth and are in the middle below.
const DEPTH: usize = 64;

/// A box and either two children or a range of the solids.
#[derive(Debug, Clone, Copy)]
struct Node {
    low: DVec3,
    high: DVec3,
    /// First solid of a leaf. Unused in an inner node, whose first child is the next node.
    start: usize,
    /// Solids in a leaf, 0 in an inner node.
    count: usize,
    /// Second child of an inner node.
    second: usize,
}

/// The hierarchy: split where the surface area heuristic (Goldsmith & Salmon 1987) says, so that walls do not end up in one box with
/// a book.
#[derive(Debug, Default)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    solids: Vec<Solid>,
}

impl Tree {
    /// Hierarchy over `solids`.
    pub fn new(mut solids: Vec<Solid>) -> Self {
        let mut nodes = Vec::with_capacity(2 * solids.len());
        if !solids.is_empty() {
            split(&mut solids, 0, 0, &mut nodes);
        }
        Self { nodes, solids }
    }

    /// Visits the solids in all boxes that `keep` lets pass, until `visit` returns true.
    fn walk<'a>(
        &'a self,
        keep: impl Fn(DVec3, DVec3) -> bool,
        mut visit: impl FnMut(&'a Solid) -> bool,
    ) {
        let mut stack = [0usize; DEPTH];
        let mut top = usize::from(!self.nodes.is_empty());
        while top > 0 {
            top -= 1;
            let at = stack[top];
            let node = &self.nodes[at];
            if !keep(node.low, node.high) {
                continue;
            }
            if node.count == 0 {
                stack[top] = node.second;
                stack[top + 1] = at + 1;
                top += 2;
            } else if self.solids[node.start..node.start + node.count]
                .iter()
                .any(&mut visit)
            {
                return;
            }
        }
    }

    /// The nearest solid that the ray `o + t·d` (|d| = 1) enters with t < `limit`.
    pub fn nearest(&self, o: DVec3, d: DVec3, limit: f64) -> Option<(&Solid, Entry)> {
        let inverse = d.recip();
        let closest = Cell::new(limit);
        let mut found = None;
        self.walk(
            |low, high| crosses(low, high, o, inverse, closest.get()),
            |solid| {
                if let Some(entry) = solid.enter(o, d, closest.get()) {
                    closest.set(entry.t);
                    found = Some((solid, entry));
                }
                false
            },
        );
        found
    }

    /// Whether a solid for which `casts` holds lies on the ray `o + t·d` before `limit`.
    pub fn blocked(&self, o: DVec3, d: DVec3, limit: f64, casts: impl Fn(&Solid) -> bool) -> bool {
        let inverse = d.recip();
        let mut hit = false;
        self.walk(
            |low, high| crosses(low, high, o, inverse, limit),
            |solid| {
                hit = casts(solid) && solid.enter(o, d, limit).is_some();
                hit
            },
        );
        hit
    }

    /// Distance from `p` to the nearest surface, or `limit` where all are farther away.
    pub fn distance(&self, p: DVec3, limit: f64) -> f64 {
        let closest = Cell::new(limit);
        self.walk(
            |low, high| {
                let gap = (low - p).max(p - high).max(DVec3::ZERO);
                gap.length_squared() < closest.get() * closest.get()
            },
            |solid| {
                let d = solid.shape.distance(solid.local(p));
                closest.set(closest.get().min(d.max(0.0)));
                false
            },
        );
        closest.get()
    }
}

/// Whether a ray crosses a box before `limit`.
fn crosses(low: DVec3, high: DVec3, o: DVec3, inverse: DVec3, limit: f64) -> bool {
    let (a, b) = ((low - o) * inverse, (high - o) * inverse);
    let near = a.min(b).max_element();
    let far = a.max(b).min_element();
    near <= far && far > 0.0 && near < limit
}

/// Appends the nodes over `solids`, the first of which is number `start` of the whole.
fn split(solids: &mut [Solid], start: usize, depth: usize, nodes: &mut Vec<Node>) {
    let (low, high) = solids.iter().fold(EMPTY, grow);
    let at = nodes.len();
    nodes.push(Node {
        low,
        high,
        start,
        count: solids.len(),
        second: 0,
    });
    if solids.len() <= LEAF {
        return;
    }
    let (axis, middle) = cheapest(solids);
    order(solids, axis);
    let middle = if depth < DEPTH / 2 {
        middle
    } else {
        solids.len() / 2
    };
    let (left, right) = solids.split_at_mut(middle);
    split(left, start, depth + 1, nodes);
    let second = nodes.len();
    split(right, start + middle, depth + 1, nodes);
    nodes[at].count = 0;
    nodes[at].second = second;
}

/// The axis and the number of solids left of the split that cost rays least: surface area times number, both sides summed.
fn cheapest(solids: &mut [Solid]) -> (usize, usize) {
    let mut best = (f64::INFINITY, 0, solids.len() / 2);
    for axis in 0..3 {
        order(solids, axis);
        let mut right = EMPTY;
        let mut tail: Vec<f64> = solids
            .iter()
            .rev()
            .map(|s| {
                right = grow(right, s);
                area(right)
            })
            .collect();
        tail.reverse();
        let mut left = EMPTY;
        for (i, pair) in solids.windows(2).enumerate() {
            left = grow(left, &pair[0]);
            let (near, far) = ((i + 1) as f64, (solids.len() - i - 1) as f64);
            let cost = near * area(left) + far * tail[i + 1];
            if cost < best.0 {
                best = (cost, axis, i + 1);
            }
        }
    }
    (best.1, best.2)
}

const EMPTY: (DVec3, DVec3) = (DVec3::INFINITY, DVec3::NEG_INFINITY);

fn grow((low, high): (DVec3, DVec3), solid: &Solid) -> (DVec3, DVec3) {
    let (a, b) = solid.bounds();
    (low.min(a), high.max(b))
}

fn area((low, high): (DVec3, DVec3)) -> f64 {
    let s = high - low;
    s.x * s.y + s.y * s.z + s.z * s.x
}

/// Sorts along an axis; the sort is stable, so equal centres keep their order.
fn order(solids: &mut [Solid], axis: usize) {
    solids.sort_by(|a, b| a.center[axis].total_cmp(&b.center[axis]));
}
