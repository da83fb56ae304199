//! Places of texts beside the marks of a chart: none over another text, a mark, a line or the frame.

/// A point in pixels of the view box.
type Point = (f64, f64);

/// A rectangle: left, top, right, bottom.
type Rectangle = [f64; 4];

/// Width of a character of 12-unit text, and its extent above and below the baseline.
const CHARACTER: f64 = 6.6;
const ABOVE: f64 = 9.0;
const BELOW: f64 = 3.0;

/// Half the side of what a mark takes.
const MARK: f64 = 4.0;

/// Distance of the points of a line that are looked at.
const STEP: f64 = 2.0;

/// Places of a text relative to its mark, the preferred one first: offset of the baseline, and the text's anchor.
const PLACES: [(Point, &str); 8] = [
    ((7.0, 4.0), "start"),
    ((5.0, -6.0), "start"),
    ((5.0, 15.0), "start"),
    ((0.0, -7.0), "middle"),
    ((0.0, 16.0), "middle"),
    ((-7.0, 4.0), "end"),
    ((-5.0, -6.0), "end"),
    ((-5.0, 15.0), "end"),
];

/// Texts, marks and lines drawn so far within a frame.
pub(super) struct Labels {
    frame: Rectangle,
    taken: Vec<Rectangle>,
    lines: Vec<Point>,
}

impl Labels {
    /// An empty frame.
    pub(super) fn new(frame: Rectangle) -> Self {
        Self {
            frame,
            taken: Vec::new(),
            lines: Vec::new(),
        }
    }

    /// Keeps texts off a mark.
    pub(super) fn mark(&mut self, (x, y): Point) {
        self.taken.push([x - MARK, y - MARK, x + MARK, y + MARK]);
    }

    /// Keeps texts off a line through these points.
    pub(super) fn line(&mut self, points: &[Point]) {
        for pair in points.windows(2) {
            let ((x, y), (to_x, to_y)) = (pair[0], pair[1]);
            let steps = ((to_x - x).hypot(to_y - y) / STEP).ceil().max(1.0);
            let at = |k: u32| {
                let share = f64::from(k) / steps;
                (x + share * (to_x - x), y + share * (to_y - y))
            };
            self.lines.extend((0..=steps as u32).map(at));
        }
    }

    /// Baseline and anchor of a text beside a mark; `None` if there is no room for it.
    pub(super) fn place(&mut self, (x, y): Point, text: &str) -> Option<(Point, &'static str)> {
        let width = CHARACTER * text.chars().count() as f64;
        let place = |((dx, dy), anchor): (Point, &'static str)| {
            let (x, y) = (x + dx, y + dy);
            let left = match anchor {
                "start" => x,
                "middle" => x - 0.5 * width,
                _ => x - width,
            };
            let covers = [left, y - ABOVE, left + width, y + BELOW];
            (((x, y), anchor), covers)
        };
        let (found, covers) = PLACES.map(place).into_iter().find(|p| self.free(&p.1))?;
        self.taken.push(covers);
        Some(found)
    }

    fn free(&self, [left, top, right, bottom]: &Rectangle) -> bool {
        let [frame_left, frame_top, frame_right, frame_bottom] = self.frame;
        let inside = *left >= frame_left
            && *right <= frame_right
            && *top >= frame_top
            && *bottom <= frame_bottom;
        let apart =
            |o: &Rectangle| o[0] >= *right || o[2] <= *left || o[1] >= *bottom || o[3] <= *top;
        let off = |(x, y): &Point| x < left || x > right || y < top || y > bottom;
        inside && self.taken.iter().all(apart) && self.lines.iter().all(off)
    }
}

#[cfg(test)]
mod tests {
    use super::Labels;

    const FRAME: [f64; 4] = [0.0, 0.0, 200.0, 100.0];

    #[test]
    fn texts_evade_texts_marks_lines_and_the_frame() {
        let mut labels = Labels::new(FRAME);
        for at in [(50.0, 50.0), (65.0, 52.0), (195.0, 3.0)] {
            labels.mark(at);
        }
        let ((x, y), anchor) = labels.place((50.0, 50.0), "12.3").unwrap();
        assert!(
            x > 50.0 && y < 50.0 && anchor == "start",
            "the mark beside it is kept clear"
        );
        let ((x, _), anchor) = labels.place((195.0, 3.0), "0.45").unwrap();
        assert!(x < 195.0 && anchor == "end", "the frame ends at the right");
        let mut lines = Labels::new(FRAME);
        assert_eq!(lines.place((50.0, 50.0), "12.3").unwrap().0, (57.0, 54.0));
        let mut lines = Labels::new(FRAME);
        lines.line(&[(0.0, 50.0), (200.0, 50.0)]);
        let ((_, y), _) = lines.place((50.0, 50.0), "12.3").unwrap();
        assert!(!(47.0..59.0).contains(&y), "{y}");
    }

    #[test]
    fn without_room_there_is_no_text() {
        let mut labels = Labels::new([0.0, 0.0, 40.0, 20.0]);
        assert!(labels.place((20.0, 10.0), "far too long a text").is_none());
        let same = (0..9).map(|_| labels.place((20.0, 10.0), "1"));
        let shown = same.flatten().count();
        assert!((1..9).contains(&shown), "{shown}");
    }
}
