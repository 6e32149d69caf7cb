//! Tests the page of `models report`: it is self-contained, and its results equal those of the other commands.
//!
//! The recordings are synthetic and the training is short, because the quality of the models does not affect this test.

mod common;

use std::process::Command;

fn models(args: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_models")).args(args).output().expect("the tool starts");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{args:?}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}

const QUICK: [&str; 4] = ["--seeds", "1", "--steps", "20"];

#[test]
fn the_page_needs_nothing_else_and_its_figures_are_those_of_the_other_commands() {
    let data = common::folder();
    let folder = data.path().to_str().unwrap();
    let out = data.path().join("page.html");
    models(
        &[
            &["report", folder, "--examples", "1", "--hours", "0.05", "--out", out.to_str().unwrap()],
            &QUICK[..],
        ]
        .concat(),
    );
    let page = std::fs::read_to_string(&out).unwrap();
    std::fs::remove_file(&out).unwrap();

    for outside in ["http", "//", "src=", "href=", "url(", "@import", "<link", "<script", "<img", "<iframe"] {
        assert!(!page.contains(outside), "the page must not reach outside itself: {outside}");
    }
    for (tag, least) in [("svg", 4), ("table", 26), ("div", 10), ("h2", 8)] {
        let (opened, closed) =
            (page.matches(&format!("<{tag}")).count(), page.matches(&format!("</{tag}>")).count());
        assert_eq!(opened, closed, "{tag}");
        assert!(opened >= least, "{opened} {tag}");
    }
    assert!(page.contains("<h2>Recordings to look at</h2>"));
    // The pictures come first: each person's results, the worst first, and correct events against false events.
    let before_tables = &page[..page.find("<table").unwrap()];
    assert_eq!(before_tables.matches("<svg").count(), 2);
    assert!(before_tables.contains("worst first") && before_tables.contains("strokes/s"), "{before_tables}");
    assert!(before_tables.contains("26 (a board's)"), "the threshold of a board is one of the points");
    let drawn: Vec<f64> = before_tables
        .split("strokes/s")
        .filter_map(|part| part.rsplit_once('>')?.1.split_once(" %, ")?.0.parse().ok())
        .collect();
    assert!(drawn.len() == 3 && drawn.is_sorted(), "{drawn:?}");
    assert!(page.starts_with("<!DOCTYPE html>") && page.ends_with("</html>\n"));
    assert!(!page.contains("NaN"));

    // Compares every row of the table, including the last digit.
    let text = models(&[&["people", folder, "--examples", "1"], &QUICK[..]].concat());
    let mut rows = 0;
    for line in text.lines().filter(|line| line.starts_with("paper ") || line.starts_with("aligned ")) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [recipe, what @ .., float, int8] = words.as_slice() else { panic!("{line}") };
        let row =
            format!("<tr><td>{recipe}</td><td>{}</td><td>{float}</td><td>{int8}</td></tr>", what.join(" "));
        assert!(page.contains(&row), "not on the page: {row}");
        rows += 1;
    }
    assert_eq!(
        rows,
        6 + 12,
        "three people, mean, worst and a random fifth; aligned with 0 and 1 shown as well"
    );

    let text = models(&[&["events", folder, "--hours", "0.05"], &QUICK[..]].concat());
    let mut rows = 0;
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [
            person @ ("a" | "b" | "c" | "all"),
            performed,
            right,
            missed,
            wrong,
            several,
            delay,
            rests,
            events,
            stray,
        ] = words.as_slice()
        else {
            continue;
        };
        let row = format!(
            "<tr><td>{person}</td><td>{performed}</td><td>{right}</td><td>{missed}</td><td>{wrong}</td>\
             <td>{several}</td><td>{delay}</td><td>{rests}</td><td>{events}</td>"
        );
        let start = page.find(&row).unwrap_or_else(|| panic!("not on the page: {row}"));
        let end = page[start..].find("</tr>").unwrap();
        assert!(page[start..start + end].ends_with(&format!("<td>{stray}</td>")), "{stray}");
        rows += 1;
    }
    assert_eq!(rows, 4);
    let simulated = text.lines().find(|line| line.starts_with("simulated wearers")).unwrap();
    let (_, figures) = simulated.split_once(": ").unwrap();
    assert!(page.contains(figures), "{figures}");
}
