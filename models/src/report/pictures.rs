//! Pictures at the top of the page. One shows the results and the tempo of each person, the worst person first.
//! Another shows how many false events each setting causes if it detects more gestures.

use std::fmt::Write as _;

use shared_dsp::right::movement::MovementConfig;

use super::svg::{Bar, Curve, Percentages, bars, escape, lines};
use super::{Facts, Report};
use crate::evaluate::events::Tally;
use crate::evaluate::people::Graded;
use crate::evaluate::study::{Events, Study};

/// Opens the page.
pub fn first(page: &mut String, report: &Report) {
    page.push_str("<div class=\"side\">");
    if let Some(study) = report.studies.last() {
        people(page, study, &report.facts);
    }
    if let Some(events) = &report.events {
        trade(page, events, report.facts.axes);
    }
    page.push_str("</div>\n");
}

/// Draws a bar for each held-out person.
fn people(page: &mut String, study: &Study, facts: &Facts) {
    let mut each: Vec<(&String, f64)> = study
        .people
        .iter()
        .zip(&study.strangers)
        .map(|(name, runs)| (name, Graded::mean(runs).int8))
        .collect();
    each.sort_by(|a, b| a.1.total_cmp(&b.1));
    let floor = each.first().map_or(0.0, |(_, worst)| ((worst - 5.0) / 10.0).floor() * 10.0).max(0.0);
    let axis = Percentages { floor };
    let drawn: Vec<Bar> = each
        .into_iter()
        .map(|(name, per_cent)| {
            let tempo = facts.people.iter().find(|(known, _)| known == name);
            let tempo = match tempo.and_then(|(_, person)| person.strokes_hz) {
                Some([slow, usual, fast]) => format!("{usual:.1} strokes/s ({slow:.1}–{fast:.1})"),
                None => "no tempo".to_owned(),
            };
            let part = axis.part(per_cent);
            Bar { name: name.clone(), part, text: format!("{per_cent:.1} %, {tempo}") }
        })
        .collect();
    let _ = write!(
        page,
        "<div><h2>People never met, worst first</h2>\n<p class=\"note\">Right recordings, int8, recipe {}; a bar begins at {floor:.0} %. \
         Beside it the tempo of the person's gestures: the middle one, and a tenth slower and faster.</p>\n{}</div>\n",
        escape(study.recipe),
        bars(&drawn)
    );
}

/// Plots correct events for gestures against false events without a gesture, for each threshold that was tested.
fn trade(page: &mut String, events: &Events, axes: usize) {
    let boards = MovementConfig::for_axes(axes).max_rest;
    let together = events.together();
    let mut tried: Vec<(u8, &Tally, &Tally)> =
        events.trade.iter().map(|(max_rest, real, simulated)| (*max_rest, real, simulated)).collect();
    tried.push((boards, &together, &events.simulated));
    tried.sort_by_key(|(max_rest, _, _)| *max_rest);
    tried.dedup_by_key(|(max_rest, _, _)| *max_rest);
    let low = tried.iter().map(|(_, real, _)| real.right_per_cent()).fold(100.0, f64::min);
    let axis = Percentages { floor: ((low - 1.0) / 10.0).floor().max(0.0) * 10.0 };
    // False events in real people's recordings without a gesture, and in the hours of simulated wearers.
    let real = |tally: &Tally| 100.0 * tally.rest_events as f64 / tally.rests.max(1) as f64;
    let simulated = |tally: &Tally| if tally.rest_s > 0.0 { tally.false_per_hour() } else { 0.0 };
    let most = tried.iter().flat_map(|(_, r, s)| [real(r), simulated(s)]).fold(1.0, f64::max);
    let curve = |name, x: &dyn Fn(&(u8, &Tally, &Tally)) -> f64| Curve {
        name,
        points: tried.iter().map(|point| (x(point) / most, axis.part(point.1.right_per_cent()))).collect(),
    };
    let x_ticks: Vec<(f64, String)> =
        (0..=4).map(|n| f64::from(n) / 4.0).map(|at| (at, format!("{:.1}", at * most))).collect();
    let thresholds: Vec<String> = tried
        .iter()
        .map(|(max_rest, tally, _)| {
            let mark = if *max_rest == boards { " (a board's)" } else { "" };
            format!("{max_rest}{mark}: {:.1} %", tally.right_per_cent())
        })
        .collect();
    let _ = write!(
        page,
        "<div><h2>Events against false events</h2>\n<p class=\"note\">Each point is a threshold: how probable rest may be, of 256, when an \
         event is made; from left to right {}.</p>\n{}</div>\n",
        thresholds.join(", "),
        lines(
            ("false events", "gestures with exactly one right event, %"),
            &x_ticks,
            &axis.ticks(),
            false,
            &[
                curve("in 100 recordings of no gesture", &|(_, tally, _)| real(tally)),
                curve("in an hour of simulated wearers", &|(_, _, tally)| simulated(tally)),
            ],
        )
    );
}
