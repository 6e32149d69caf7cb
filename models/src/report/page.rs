//! The HTML page itself, with embedded style and drawings and without external references.

use std::fmt::Write as _;

use super::svg::{Curve, Percentages, colour, escape, heat, lines};
use super::{Facts, Report};
use crate::evaluate::people::Graded;
use crate::evaluate::study::{Events, Study};

const STYLE: &str = "body{font:15px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#222}\
h1,h2,h3{line-height:1.2}h2{margin-top:2.5rem;border-bottom:1px solid #ccc}\
table{border-collapse:collapse;margin:.6rem 1.2rem .6rem 0}td,th{padding:.15rem .55rem;border:1px solid #ddd;text-align:right}\
td:first-child,th:first-child{text-align:left}caption{text-align:left;font-weight:600}\
.side{display:flex;flex-wrap:wrap;align-items:flex-start}svg{max-width:100%;height:auto;margin:.5rem 1rem .5rem 0}\
svg text{font:11px system-ui,sans-serif;fill:#222}p.note{color:#555}";

/// The whole page.
pub fn html(report: &Report) -> String {
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{0}</title><style>{STYLE}</style></head>\
         <body><h1>{0}</h1>\n<p class=\"note\">Made by <code>models report</code>; every figure is a mean over {1} seeds \
         unless it says otherwise. A person who is held out touches nothing before their recordings are scored.</p>\n",
        escape(&report.title),
        report.seeds
    );
    super::pictures::first(&mut page, report);
    facts(&mut page, &report.facts);
    table(&mut page, report);
    for study in &report.studies {
        confusions(&mut page, study);
    }
    if let Some(study) = report.studies.last() {
        doubts(&mut page, study);
    }
    if let Some(events) = &report.events {
        event_table(&mut page, events);
    }
    page.push_str("<h2>How far confidence can be believed</h2>\n<div class=\"side\">");
    for study in &report.studies {
        calibration(&mut page, study);
    }
    page.push_str("</div>\n");
    learning(&mut page, report);
    features(&mut page, &report.facts);
    page + "</body></html>\n"
}

fn row(page: &mut String, tag: &str, cells: &[String]) {
    page.push_str("<tr>");
    for cell in cells {
        let _ = write!(page, "<{tag}>{}</{tag}>", escape(cell));
    }
    page.push_str("</tr>\n");
}

fn facts(page: &mut String, facts: &Facts) {
    let (count, minutes) = facts.total();
    let _ = write!(
        page,
        "<h2>What the data holds</h2>\n<p>{count} recordings, {minutes:.1} min ({:.2} h), {} people, {} classes, {} axes.</p>\n<table>",
        minutes / 60.0,
        facts.people.len(),
        facts.labels.len(),
        facts.axes
    );
    let mut head = vec!["person".to_owned()];
    head.extend(facts.labels.iter().cloned());
    head.extend(["minutes", "rate, Hz", "largest, m/s²", "values at it"].map(String::from));
    row(page, "th", &head);
    for (name, person) in &facts.people {
        let mut cells = vec![name.clone()];
        cells.extend(facts.labels.iter().map(|label| {
            person.labels.get(label).map_or_else(|| "–".to_owned(), |(count, _)| count.to_string())
        }));
        let minutes = person.labels.values().map(|(_, seconds)| seconds / 60.0).sum::<f64>();
        let (low, high) = person.rates_hz.unwrap_or_default();
        cells.push(format!("{minutes:.1}"));
        cells.push(if high - low < 0.5 { format!("{low:.1}") } else { format!("{low:.1}–{high:.1}") });
        cells.push(format!("{:.2}", person.largest));
        cells.push(format!("{:.3} %", 100.0 * person.at_largest));
        row(page, "td", &cells);
    }
    page.push_str(
        "</table>\n<p class=\"note\">An accelerometer that clips has many values at its largest one; one that does not, next to none.</p>\n",
    );
}

fn table(page: &mut String, report: &Report) {
    page.push_str(
        "<h2>Right recordings, per cent</h2>\n<table><tr><th>recipe</th><th>tested on</th><th>float</th><th>int8</th></tr>\n",
    );
    for study in &report.studies {
        for line in study.rows() {
            let figures = [line.accuracy.float, line.accuracy.int8].map(|value| format!("{value:.2}"));
            row(page, "td", &[&[study.recipe.to_owned(), line.what], &figures[..]].concat());
        }
    }
    page.push_str("</table>\n<h2>Beside the paper</h2>\n<table><tr><th></th><th>paper</th>");
    for study in &report.studies {
        let _ = write!(page, "<th>{}, here</th>", escape(study.recipe));
    }
    page.push_str("</tr>\n");
    let of = |figure: &dyn Fn(&Study) -> String| report.studies.iter().map(figure).collect::<Vec<_>>();
    let line = |page: &mut String, name: &str, paper: &str, ours: Vec<String>| {
        row(page, "td", &[vec![name.to_owned(), paper.to_owned()], ours].concat());
    };
    let split = of(&|study| format!("{:.2}", Graded::mean(&study.random).int8));
    line(page, "same hands in training and test (int8)", "99.9", split);
    let never = of(&|study| {
        let rows = study.rows();
        rows.iter()
            .find(|row| row.what == "never met: mean")
            .map_or_else(String::new, |row| format!("{:.2}", row.accuracy.int8))
    });
    line(page, "people never met, mean (int8)", "not reported", never);
    let network =
        |pick: &dyn Fn(&super::NetworkSize) -> String| report.networks.iter().map(pick).collect::<Vec<_>>();
    line(page, "network", "117-20-10-5-7", network(&|size| size.shape()));
    line(page, "multiplications per inference", "2625", network(&|size| size.products().to_string()));
    line(page, "model in flash, bytes", "17 900", network(&|size| size.blob_bytes.to_string()));
    page.push_str(
        "</table>\n<p class=\"note\">The paper's hands, gestures and sensor positions are other ones than those of this folder; its \
         17.9 kB hold its whole inference. Executed instructions are counted on the emulated board, not here.</p>\n",
    );
}

fn matrix(page: &mut String, caption: &str, graded: &[&Graded], float: bool) {
    let Some(first) = graded.first() else { return };
    let labels = &first.labels;
    let mut sum = vec![vec![0usize; labels.len()]; labels.len()];
    for run in graded {
        let score = if float { &run.scores.float } else { &run.scores.int8 };
        for (sums, counts) in sum.iter_mut().zip(&score.confusion) {
            sums.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
        }
    }
    let _ = write!(
        page,
        "<table><caption>{}, {}</caption><tr><th></th>",
        escape(caption),
        if float { "float" } else { "int8" }
    );
    labels.iter().for_each(|label| {
        let _ = write!(page, "<th>{}</th>", escape(label));
    });
    page.push_str("</tr>");
    for (truth, counts) in sum.iter().enumerate() {
        let total = counts.iter().sum::<usize>().max(1) as f64;
        let _ = write!(page, "<tr><td>{}</td>", escape(&labels[truth]));
        for (given, count) in counts.iter().enumerate() {
            let part = *count as f64 / total * if given == truth { -0.7 } else { 1.0 };
            let _ = write!(page, "<td style=\"background:{}\">{count}</td>", colour(part));
        }
        page.push_str("</tr>");
    }
    page.push_str("</table>\n");
}

fn confusions(page: &mut String, study: &Study) {
    let _ = write!(
        page,
        "<h2>Confusion, recipe {}</h2>\n<p class=\"note\">Rows: true label; columns: given label; recordings of all seeds together.</p>\n",
        escape(study.recipe)
    );
    let both = |page: &mut String, caption: &str, graded: &[&Graded]| {
        page.push_str("<div class=\"side\">");
        matrix(page, caption, graded, true);
        matrix(page, caption, graded, false);
        page.push_str("</div>\n");
    };
    both(page, "random fifth, same people", &study.random.iter().collect::<Vec<_>>());
    for (person, runs) in study.people.iter().zip(&study.strangers) {
        both(page, &format!("{person}, never met"), &runs.iter().collect::<Vec<_>>());
    }
    for (place, count) in study.counts().into_iter().enumerate().filter(|(_, count)| *count > 0) {
        for (person, runs) in study.people.iter().zip(study.shown_at(place)) {
            let graded: Vec<&Graded> = runs.iter().map(|shown| &shown.new).collect();
            both(page, &format!("{person}, {count} shown per class"), &graded);
        }
    }
}

/// Lists recordings whose label may be wrong.
fn doubts(page: &mut String, study: &Study) {
    const MOST: usize = 30;
    let doubts = study.doubts();
    let _ = write!(
        page,
        "<h2>Recordings to look at</h2>\n<p>Taken for something else by most of the models (recipe {}, int8) that have never met the \
         person: {}.</p>\n",
        escape(study.recipe),
        doubts.len()
    );
    if doubts.is_empty() {
        return;
    }
    page.push_str("<table>");
    row(page, "th", &["recording", "taken for", "by so many models", "how surely, 0 to 1"].map(String::from));
    for doubt in doubts.iter().take(MOST) {
        let given: Vec<&str> = doubt.given.keys().map(String::as_str).collect();
        row(
            page,
            "td",
            &[
                doubt.recording.clone(),
                given.join(", "),
                format!("{} of {}", doubt.wrong(), doubt.models),
                format!("{:.2}", doubt.sureness()),
            ],
        );
    }
    page.push_str("</table>\n");
    if doubts.len() > MOST {
        let _ = writeln!(page, "<p>And {} more, less surely.</p>", doubts.len() - MOST);
    }
    page.push_str(
        "<p class=\"note\">One of them alone may have the wrong label, or begin or end with another movement: look at it before you train \
         on it. Many of one person and label: this person does it otherwise than the others, and should be shown to the model.</p>\n",
    );
}

fn event_table(page: &mut String, events: &Events) {
    page.push_str("<h2>Events</h2>\n<p>Recordings of people never met, joined into one each and played through the right hand as a board runs it.</p>\n<table>");
    let head = [
        "person",
        "gestures",
        "exactly one right event, %",
        "missed",
        "wrong",
        "several",
        "median delay, s",
        "recordings of no gesture",
        "false events there",
        "per hour",
        "in the rest between",
    ];
    row(page, "th", &head.map(String::from));
    let together = events.together();
    let all = [("all", &together)];
    for (name, tally) in events.people.iter().map(String::as_str).zip(&events.real).chain(all) {
        let cells = [
            name.to_owned(),
            tally.performed.to_string(),
            format!("{:.2}", tally.right_per_cent()),
            tally.missed.to_string(),
            tally.wrong.to_string(),
            tally.several.to_string(),
            tally.median_delay(),
            tally.rests.to_string(),
            tally.rest_events.to_string(),
            if tally.rest_s > 0.0 { format!("{:.2}", tally.false_per_hour()) } else { "–".to_owned() },
            tally.stray_events.to_string(),
        ];
        row(page, "td", &cells);
    }
    let simulated = &events.simulated;
    let _ = write!(
        page,
        "</table>\n<p>Simulated wearers without a gesture: {} events in {:.1} h, {:.2} per hour.</p>\n",
        simulated.rest_events,
        simulated.rest_s / 3600.0,
        if simulated.rest_s > 0.0 { simulated.false_per_hour() } else { 0.0 }
    );
}

/// Plots the fraction of correct answers against the network's probability for them.
fn calibration(page: &mut String, study: &Study) {
    let curve = |graded: Vec<&Graded>| -> Vec<(f64, f64)> {
        const BINS: usize = 10;
        let mut bins = [(0usize, 0usize, 0.0f64); BINS];
        for answer in graded.iter().flat_map(|run| &run.answers) {
            let belief = f64::from(answer.probability);
            let bin = &mut bins[((belief * BINS as f64) as usize).min(BINS - 1)];
            bin.0 += 1;
            bin.1 += usize::from(answer.right);
            bin.2 += belief;
        }
        let full = bins.iter().filter(|(count, _, _)| *count >= 3);
        full.map(|(count, right, sum)| (sum / *count as f64, *right as f64 / *count as f64)).collect()
    };
    let never: Vec<&Graded> = study.strangers.iter().flatten().collect();
    let ticks: Vec<(f64, String)> = [0.0, 0.25, 0.5, 0.75, 1.0].map(|at| (at, format!("{at}"))).to_vec();
    let _ = write!(page, "<div><h3>{}</h3>", escape(study.recipe));
    page.push_str(&lines(
        ("probability of the label given (int8)", "share that is right"),
        &ticks,
        &ticks,
        true,
        &[
            Curve { name: "people never met", points: curve(never) },
            Curve { name: "random fifth, same people", points: curve(study.random.iter().collect()) },
        ],
    ));
    page.push_str("</div>");
}

fn learning(page: &mut String, report: &Report) {
    if report.learning.is_empty() {
        return;
    }
    page.push_str("<h2>Learning curves</h2>\n<p class=\"note\">People never met, int8, by the share of the others' recordings that the model has learned from; one seed.</p>\n");
    let low = report
        .learning
        .iter()
        .flat_map(|(_, points)| points.iter().map(|point| point.1))
        .fold(100.0, f64::min);
    let axis = Percentages { floor: (low / 10.0).floor() * 10.0 };
    let drawn: Vec<Curve<'_>> = report
        .learning
        .iter()
        .map(|(name, points)| Curve {
            name,
            points: points.iter().map(|(x, y)| (*x, axis.part(*y))).collect(),
        })
        .collect();
    let x_ticks = [0.0, 0.25, 0.5, 0.75, 1.0].map(|x| (x, format!("{:.0} %", 100.0 * x)));
    page.push_str(&lines(
        ("share of the recordings", "right recordings, %"),
        &x_ticks,
        &axis.ticks(),
        false,
        &drawn,
    ));
}

fn features(page: &mut String, facts: &Facts) {
    page.push_str("<h2>Features per class</h2>\n<p class=\"note\">Recipe aligned: mean over the windows of a class, in standard deviations over all windows; blue below, red above the mean of all. Rest the mouse on a cell for its name.</p>\n");
    page.push_str(&heat(&facts.features, &facts.feature_names));
}
