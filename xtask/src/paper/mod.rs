//! `cargo xtask paper`: compares the paper's results with our measurements row by row, and gives the command for each.
//!
//! Tests print the rows as `paper: WHAT | PAPER | HERE`.
//! For the rows about recognition, this command trains models itself.
//! Data for plots is printed as `figure: WHICH | …`. A missing row is a failure. docs/SOURCES.md cites the paper.

mod page;
mod plots;
mod recognition;

use std::fs;
use std::process::{ExitCode, Stdio};
use std::time::Instant;

use anyhow::{Context as _, Result, bail, ensure};

use crate::steps;
use crate::test::cargo_for_all;
use crate::{is_full, root};

/// A table or figure of the paper, and the tests that measure the same quantities.
struct Part {
    title: &'static str,
    /// Arguments of `cargo test`.
    test: &'static [&'static str],
    only: &'static str,
    /// The first words of the rows' names. Every row must exist.
    rows: &'static [&'static str],
    /// What a reader must know.
    note: &'static str,
    /// Whether the rows are the same with and without `--quick`.
    at_any_length: bool,
}

const PARTS: &[Part] = &[
    Part {
        title: "Left hand: 400 tilts",
        test: &["--test", "avr_trials"],
        only: "the_papers_400_tilts",
        rows: &[
            "correct tilts, of",
            "tilts mistaken for the opposite",
            "time from the start of a tilt",
            "tilts forward",
            "tilts backward",
            "tilts left",
            "tilts right",
        ],
        note: "The hands are simulated, and the emulated board runs the real image; the paper tested people. A command \
               starts only if a tilt persists (docs/SAFETY.md), which takes some 100 ms. Results by direction are not \
               compared, because we know only the paper's total.",
        at_any_length: false,
    },
    Part {
        title: "Left hand: bends",
        test: &["--test", "avr_trials"],
        only: "bends_count_once",
        rows: &["bends of the index", "bends of the middle", "bends: false counts"],
        note: "",
        at_any_length: false,
    },
    Part {
        title: "Time from a tilt until the wheels react",
        test: &["--test", "avr_street"],
        only: "a_voltage_step",
        rows: &["time from a tilt to 20°", "time from a tilt to 30°", "time from a tilt to 45°"],
        note: "The time starts with the voltage at the board's pin and ends with the first speed of the simulated base.",
        at_any_length: false,
    },
    Part {
        title: "Speed by bends, 10 s",
        test: &["--test", "avr_street"],
        only: "the_papers_speed_modulation",
        rows: &[
            "speed profile, 0.0",
            "speed profile, 1.0",
            "speed profile, 5.2",
            "speed profile, 6.2",
            "speed profile, 9.0",
        ],
        note: "0.478 = 0.9⁷; the paper rounds it to 0.50.",
        at_any_length: true,
    },
    Part {
        title: "Arm: time of each motion from home",
        test: &["--test", "arm_kinematics"],
        only: "single_moves",
        rows: &[
            "ready →",
            "home → pick-up",
            "home → place (",
            "home → place-top",
            "home → place-bottom",
            "home → random",
        ],
        note: "The times are equal by construction: we chose poses that give them, because the paper prints no poses.",
        at_any_length: true,
    },
    Part {
        title: "Right hand: the paper's network on the chip",
        test: &["--test", "nrf_cost"],
        only: "a_network_of_the_papers_shape",
        rows: &[
            "the paper's network on the board: inference",
            "the paper's network on the board: flash",
            "the paper's network on the board: RAM",
            "the paper's features and network",
        ],
        note: "We count executed instructions of the emulated nRF52840; the paper gives a time.",
        at_any_length: false,
    },
    Part {
        title: "Mappings",
        test: &["--test", "arm_kinematics"],
        only: "tilts_bends_and_gestures",
        rows: &[
            "mapping: tilt",
            "mapping: a bend of the index",
            "mapping: a bend of the middle",
            "mapping: gesture",
        ],
        note: "The paper's table II, and the motions that its six gestures start.",
        at_any_length: true,
    },
    Part {
        title: "Both hands at once, as the demo plays them",
        test: &["--test", "demo_session"],
        only: "every_gesture_of_the_demo",
        rows: &[
            "demo: time from gesture up-down until pose home is",
            "demo: time from gesture to-fro until pose pick-up is",
            "demo: time from gesture left-right until pose place is",
            "demo: time from gesture rectangle until pose place-top-right is",
            "demo: time from gesture rectangle-flat until pose place-bottom-right is",
            "demo: time from gesture circle until pose random-top is",
            "demo: time from a gesture's last window",
            "demo: time from the left hand's sample",
        ],
        note: "In the demo, each motion starts at the end of the previous one and passes through home while the base drives, \
               so most motions take twice as long. A gesture's window is 2 s long and is evaluated every 80 ms.",
        at_any_length: true,
    },
];

/// One table, with its matrices and figures.
struct Section {
    title: &'static str,
    /// Name of a row, the paper's result, and our result.
    rows: Vec<[String; 3]>,
    note: String,
    command: String,
    /// Confusion matrices of intended classes and recognised classes.
    matrices: Vec<Matrix>,
    /// The cells of `figure:` lines. The first cell is the name.
    figures: Vec<Vec<String>>,
}

/// Number of recognitions for each pair of an actual and a recognised class.
struct Matrix {
    name: String,
    made: Vec<String>,
    named: Vec<String>,
    counts: Vec<Vec<u64>>,
}

/// What was asked for.
#[derive(Default)]
struct Asked<'a> {
    quick: bool,
    out: Option<&'a str>,
    html: Option<&'a str>,
}

impl<'a> Asked<'a> {
    fn read(args: &[&'a str]) -> Result<Self> {
        let mut asked = Self::default();
        let mut words = args.iter();
        while let Some(&arg) = words.next() {
            match arg {
                "--quick" => asked.quick = true,
                "--out" => asked.out = Some(words.next().context("--out takes a file")?),
                "--html" => asked.html = Some(words.next().context("--html takes a file")?),
                _ => bail!("`cargo xtask paper` takes --quick, --out FILE and --html FILE, not `{arg}`"),
            }
        }
        Ok(asked)
    }
}

/// Measures every row and prints the tables. If requested, it writes them as Markdown and as a page with plots.
///
/// # Errors
/// Fails if an option is unknown, a row is missing, or a command fails.
pub fn run(args: &[&str]) -> Result<ExitCode> {
    let asked = Asked::read(args)?;
    let began = Instant::now();
    let mut sections = Vec::new();
    for part in PARTS {
        sections.push(measured(part, asked.quick)?);
        eprintln!("{:>6} s  {}", began.elapsed().as_secs(), part.title);
    }
    sections.push(recognition::section(asked.quick)?);
    let text = page::markdown(&sections, asked.quick);
    println!("{text}");
    println!("{} s", began.elapsed().as_secs());
    let write =
        |file: &str, text: &str| fs::write(file, text).with_context(|| format!("{file} cannot be written"));
    if let Some(file) = asked.out {
        write(file, &text)?;
    }
    if let Some(file) = asked.html {
        write(file, &page::html(&sections, asked.quick)?)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Checks that docs/PAPER.md contains the current results.
/// The short run compares the rows that do not depend on its length. The long run also compares results of emulated boards.
///
/// # Errors
/// Names each row that differs.
pub fn check() -> Result<()> {
    let page = fs::read_to_string(root().join("docs/PAPER.md"))?;
    // If a short run wrote the page, the page contains the counts of that run.
    let full = is_full() && !page.contains("paper --quick");
    for part in PARTS.iter().filter(|part| part.at_any_length || full) {
        for row in measured(part, !full)?.rows {
            let line = page::row(&row);
            ensure!(
                page.lines().any(|known| known == line),
                "{}: measured now is\n  {line}\n  docs/PAPER.md has another: `cargo xtask paper --out docs/PAPER.md`",
                part.title
            );
        }
    }
    Ok(())
}

/// Measures one part.
fn measured(part: &Part, quick: bool) -> Result<Section> {
    let mut cargo = cargo_for_all("test");
    cargo.args(part.test).args(["--", part.only, "--nocapture"]).stdin(Stdio::null());
    if !quick {
        cargo.env("BIMANUAL_FULL", "1");
    }
    let done = cargo.output()?;
    let said = String::from_utf8_lossy(&done.stdout);
    ensure!(
        done.status.success(),
        "{}: the test fails\n{said}{}",
        part.title,
        String::from_utf8_lossy(&done.stderr)
    );
    let rows = triples(&said);
    for wanted in part.rows {
        ensure!(
            rows.iter().any(|row| row[0].starts_with(wanted)),
            "{}: no row `{wanted}`; it needs the emulators (see `cargo xtask test`)",
            part.title
        );
    }
    let full = if quick { "" } else { "BIMANUAL_FULL=1 " };
    let command = format!(
        "{full}cargo test {} {} (with the features of `cargo xtask test`)",
        part.test.join(" "),
        part.only
    );
    let figures = steps::rows(&said, "figure: ");
    let matrices = directions(&figures).into_iter().collect();
    Ok(Section { title: part.title, rows, note: part.note.to_owned(), command, matrices, figures })
}

/// Returns the rows that a test has printed: name, the paper's result, and our result.
fn triples(said: &str) -> Vec<[String; 3]> {
    steps::rows(said, "paper: ").into_iter().filter_map(|cells| cells.try_into().ok()).collect()
}

/// Returns the matrix of tilt directions and commands, if the test printed a matrix.
fn directions(figures: &[Vec<String>]) -> Option<Matrix> {
    let rows: Vec<&[String]> =
        figures.iter().filter_map(|f| f.strip_prefix(&["tilts".to_owned()][..])).collect();
    let made: Vec<String> = rows.iter().filter_map(|row| row.first().cloned()).collect();
    let named = made.iter().cloned().chain(["none".to_owned()]).collect();
    let counts =
        rows.iter().map(|row| row.iter().skip(1).filter_map(|cell| cell.parse().ok()).collect()).collect();
    (!made.is_empty()).then_some(Matrix { name: "tilts".to_owned(), made, named, counts })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_read_from_what_tests_print_and_nothing_else_is() {
        let said = "running 1 test\npaper: correct tilts, of 40 | 93.5 % of 400 | 100.00 %\n paper: broken | row\nok\n";
        assert_eq!(triples(said), [["correct tilts, of 40", "93.5 % of 400", "100.00 %"].map(str::to_owned)]);
    }

    /// Checks that docs/PAPER.md contains every row that the command prints.
    #[test]
    fn the_page_has_every_row() {
        let page = fs::read_to_string(root().join("docs/PAPER.md")).unwrap();
        for part in PARTS {
            assert!(page.contains(part.title), "{}", part.title);
            for row in part.rows {
                assert!(
                    page.contains(&format!("\n| {row}")),
                    "no row `{row}`: `cargo xtask paper --out docs/PAPER.md`"
                );
            }
        }
        for row in [
            "recipe `paper`, tested on a random 20 %",
            "recipe `paper`, tested on unknown wearers",
            "recipe `aligned`, tested on unknown wearers",
        ] {
            assert!(page.contains(row), "{row}");
        }
    }

    /// Checks that the README's first rows equal those of docs/PAPER.md.
    #[test]
    fn the_readmes_rows_are_the_pages() {
        let page = fs::read_to_string(root().join("docs/PAPER.md")).unwrap();
        let readme = fs::read_to_string(root().join("README.md")).unwrap();
        let first_screen: Vec<&str> = readme.lines().take(40).collect();
        let heading = first_screen.iter().position(|line| line.starts_with("| | paper | here |"));
        let rows = first_screen.iter().skip(heading.expect("a table beside the paper") + 2);
        let rows: Vec<&str> = rows.copied().take_while(|line| line.starts_with('|')).collect();
        assert_eq!(rows.len(), 5);
        for row in rows {
            assert!(page.lines().any(|line| line == row), "docs/PAPER.md has no row {row}");
        }
    }
}
