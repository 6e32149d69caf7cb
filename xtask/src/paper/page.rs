//! The tables as Markdown, and as one page of HTML with plots that refers to nothing outside itself.

use std::fmt::Write as _;

use anyhow::Result;

use super::{Section, plots};

/// What the paper says without a figure, and where to look here.
const CLAIMS: [[&str; 2]; 5] = [
    [
        "few false positives at idle",
        "events per hour of daily movement by real people: `models daily events` (models/README.md)",
    ],
    [
        "low power",
        "share of the time awake, and charge per hour without the radio: `nrf_cost` (firmware-nano33/README.md)",
    ],
    ["several users", "people never met, and after three gestures shown: `models people` (models/README.md)"],
    ["both hands at once", "`cargo run --release -- demo`: the base drives while the arm moves"],
    [
        "latency from gesture to motion",
        "both boards' images before ROS 2: `cargo xtask test --only \"ROS 2\"` prints it in parts",
    ],
];
const CLAIMS_TITLE: &str = "What the paper claims without a figure";

fn command(quick: bool) -> &'static str {
    if quick { "cargo xtask paper --quick" } else { "cargo xtask paper" }
}

/// All of it for docs/PAPER.md.
pub fn markdown(sections: &[Section], quick: bool) -> String {
    let mut text = format!(
        "# The paper beside this project\nMade by `{}`. \"Not stated\": the paper gives no such figure. The paper: \
         [SOURCES.md](SOURCES.md).\n",
        command(quick)
    );
    for section in sections {
        let _ = write!(text, "\n## {}\n| | paper | here |\n|---|---|---|\n", section.title);
        for cells in &section.rows {
            let _ = writeln!(text, "{}", row(cells));
        }
        if !section.note.is_empty() {
            let _ = writeln!(text, "\n{}", section.note);
        }
        for matrix in &section.matrices {
            let _ = write!(text, "\n| {}: made ↓, named → |", matrix.name);
            matrix.named.iter().for_each(|name| text += &format!(" {name} |"));
            let _ = writeln!(text, "\n|---{}|", "|---".repeat(matrix.named.len()));
            for (made, counts) in matrix.made.iter().zip(&matrix.counts) {
                let cells: Vec<String> = counts.iter().map(u64::to_string).collect();
                let _ = writeln!(text, "| {made} | {} |", cells.join(" | "));
            }
        }
        let _ = writeln!(text, "\n`{}`", section.command);
    }
    let _ = write!(text, "\n## {CLAIMS_TITLE}\n| | here |\n|---|---|\n");
    for [claim, here] in CLAIMS {
        let _ = writeln!(text, "| {claim} | {here} |");
    }
    text
}

/// A row of docs/PAPER.md.
pub fn row([what, paper, here]: &[String; 3]) -> String {
    format!("| {what} | {paper} | {here} |")
}

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#222}\
h2{margin-top:2.5rem;border-bottom:1px solid #ccc}table{border-collapse:collapse}\
td,th{padding:.15rem .6rem;border:1px solid #ddd;text-align:left}p.how{color:#555}\
.plots{display:flex;flex-wrap:wrap}svg{max-width:100%;height:auto;margin:.5rem 1rem .5rem 0}";

/// All of it as one page.
///
/// # Errors
/// A figure that cannot be drawn.
pub fn html(sections: &[Section], quick: bool) -> Result<String> {
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>The paper beside this project</title>\
         <style>{STYLE}</style></head><body><h1>The paper beside this project</h1>\n<p>Made by <code>{}</code>. “Not \
         stated”: the paper gives no such figure. The paper: docs/SOURCES.md.</p>\n",
        command(quick)
    );
    for section in sections {
        let _ = writeln!(
            page,
            "<h2>{}</h2>\n<table><tr><th></th><th>paper</th><th>here</th></tr>",
            inline(section.title)
        );
        for cells in &section.rows {
            let cells: String = cells.iter().map(|cell| format!("<td>{}</td>", inline(cell))).collect();
            let _ = writeln!(page, "<tr>{cells}</tr>");
        }
        let _ = writeln!(page, "</table>\n<div class=\"plots\">{}</div>", drawings(section)?);
        let _ = writeln!(
            page,
            "<p>{}</p>\n<p class=\"how\"><code>{}</code></p>",
            inline(&section.note),
            escape(&section.command)
        );
    }
    let _ = writeln!(page, "<h2>{CLAIMS_TITLE}</h2>\n<table>");
    for [claim, here] in CLAIMS {
        let _ = writeln!(page, "<tr><td>{claim}</td><td>{}</td></tr>", inline(here));
    }
    Ok(page + "</table></body></html>\n")
}

/// All plots of a section.
fn drawings(section: &Section) -> Result<String> {
    let mut drawn = String::new();
    for matrix in &section.matrices {
        drawn += &plots::heat(matrix)?;
    }
    drawn += &plots::speed(&numbers(section, "speed"))?;
    let paths = plots::paths(&numbers(section, "path"));
    drawn += &paths?;
    Ok(drawn)
}

/// The cells of the figures of one name, each with what stands before its numbers (a name, or nothing) and the numbers.
fn numbers(section: &Section, name: &str) -> Vec<(String, Vec<f64>)> {
    let of_it = section.figures.iter().filter(|cells| cells.first().is_some_and(|first| first == name));
    let parts = of_it.map(|cells| {
        let numbers = cells[1..].iter().filter_map(|cell| cell.parse().ok()).collect();
        let text = cells[1..].iter().find(|cell| cell.parse::<f64>().is_err());
        (text.cloned().unwrap_or_default(), numbers)
    });
    parts.collect()
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// Escaped, with what stands between backticks as code and links as their text.
fn inline(text: &str) -> String {
    let mut out = String::new();
    for (place, part) in escape(text).split('`').enumerate() {
        let part = without_links(part);
        out += &if place % 2 == 1 { format!("<code>{part}</code>") } else { part };
    }
    out
}

/// `[text](link)` becomes the text: a page that is passed on has no documents beside it.
fn without_links(text: &str) -> String {
    let Some((before, rest)) = text.split_once('[') else { return text.to_owned() };
    match rest.split_once("](").and_then(|(name, rest)| Some((name, rest.split_once(')')?.1))) {
        Some((name, after)) => format!("{before}{name}{}", without_links(after)),
        None => text.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Matrix;
    use super::*;

    fn section() -> Section {
        let words = |text: &str| text.split(' ').map(str::to_owned).collect::<Vec<_>>();
        Section {
            title: "Tilts & more",
            rows: vec![["`tilts`: right", "93.5 %", "100 %"].map(str::to_owned)],
            note: "See [models/README.md](../models/README.md).".to_owned(),
            command: "cargo test <x>".to_owned(),
            matrices: vec![Matrix {
                name: "tilts".to_owned(),
                made: words("forward backward"),
                named: words("forward backward none"),
                counts: vec![vec![9, 0, 1], vec![0, 10, 0]],
            }],
            figures: [
                "speed 0.00 0.5 0.0",
                "speed 0.05 0.5 0.5",
                "path pick-up 0.1 0.2 0.3",
                "path pick-up 0.2 0.2 0.4",
            ]
            .map(words)
            .into(),
        }
    }

    #[test]
    fn the_page_of_plots_has_each_table_and_plot_and_asks_for_nothing_outside() {
        let page = html(&[section()], true).unwrap();
        // A heat map, the speed profile, and the paths from the side and from above.
        assert_eq!(page.matches("<svg").count(), 4, "{page}");
        for part in
            ["Tilts &amp; more", "<code>tilts</code>: right", "93.5 %", "pick-up", "cargo test &lt;x&gt;"]
        {
            assert!(page.contains(part), "{part}");
        }
        assert!(!page.contains("src=") && !page.contains("href="), "{page}");
        assert!(page.contains("See models/README.md."));
    }

    #[test]
    fn a_section_is_a_table_a_matrix_and_the_command_that_measures_it() {
        let text = markdown(&[section()], false);
        for line in [
            "Made by `cargo xtask paper`.",
            "| `tilts`: right | 93.5 % | 100 % |",
            "| tilts: made ↓, named → | forward | backward | none |",
            "| forward | 9 | 0 | 1 |",
            "`cargo test <x>`",
        ] {
            assert!(text.contains(line), "{line}\n{text}");
        }
    }
}
