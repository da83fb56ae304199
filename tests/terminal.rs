//! Reports as text for a terminal.

use mhsplat::lab::report::{Report, Section};
use mhsplat::lab::table::Table;
use mhsplat::lab::text::text;

fn report() -> Report {
    let row = |cells: [&str; 3]| cells.map(str::to_owned).to_vec();
    let rows = [row(["splat", "1.5", "tiles"]), row(["sort µ", "12.25", ""])];
    let table = Table::new(
        "Stages",
        "Read with care.",
        &["stage", "ms", "limited by"],
        rows,
    );
    let empty = Table::new("Nothing", "", &["a"], []);
    Report {
        title: "Bench".into(),
        subtitle: "one two three four five six seven".into(),
        warnings: vec!["throttled".into()],
        sections: vec![
            Section::Table(table.clone()),
            Section::Table(empty),
            Section::Details {
                summary: "All rows".into(),
                sections: vec![Section::Table(table)],
            },
            Section::Part(Report {
                title: "Second".into(),
                sections: vec![Section::Text("end".into())],
                ..Report::default()
            }),
        ],
        ..Report::default()
    }
}

#[test]
fn tables_are_aligned_and_what_is_folded_away_is_named() {
    let wide = "Bench\none two three four five six\nseven\n! throttled\n\nStages\nRead with care.\n\
                stage      ms  limited by\nsplat     1.5  tiles\nsort µ  12.25\nAll rows: with --markdown\n\nSecond\nend\n";
    assert_eq!(text(&report(), 27), wide);
}

#[test]
fn a_table_that_is_too_wide_has_a_paragraph_per_row() {
    let narrow = text(&report(), 22);
    let rows = "splat\n  ms 1.5,\n  limited by tiles\nsort µ\n  ms 12.25\n";
    assert!(narrow.contains(rows), "{narrow}");
    assert!(
        narrow.lines().all(|line| line.chars().count() <= 22),
        "{narrow}"
    );
}
