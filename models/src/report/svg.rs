//! Draws small SVG pictures for a self-contained page.

use std::fmt::Write as _;

/// Escapes HTML's special characters in a text.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A line with a name through points (x, y), whose coordinates are in 0..=1.
pub struct Curve<'a> {
    /// What it is.
    pub name: &'a str,
    /// Its points.
    pub points: Vec<(f64, f64)>,
}

const COLOURS: [&str; 6] = ["#1f5fa8", "#c8501e", "#2e8b57", "#7b4fa3", "#8a6d1b", "#555"];
const WIDTH: f64 = 360.0;
const HEIGHT: f64 = 260.0;
const LEFT: f64 = 46.0;
const TOP: f64 = 12.0;
const PLOT: (f64, f64) = (300.0, 200.0);

/// An axis of percentages from a floor to 100.
pub struct Percentages {
    /// The percentage at the axis's start.
    pub floor: f64,
}

impl Percentages {
    /// Returns the position of a percentage on the axis: 0 at the floor, 1 at 100 %.
    pub fn part(&self, per_cent: f64) -> f64 {
        (per_cent - self.floor) / (100.0 - self.floor).max(1e-9)
    }

    /// Returns five ticks, the first at the floor.
    pub fn ticks(&self) -> Vec<(f64, String)> {
        (0..=4)
            .map(|n| self.floor + (100.0 - self.floor) * f64::from(n) / 4.0)
            .map(|y| (self.part(y), format!("{y:.0}")))
            .collect()
    }
}

/// Draws a line chart. `x_ticks` and `y_ticks` contain positions in 0..=1 and their texts.
/// `diagonal` adds the line y = x.
pub fn lines(
    (x_name, y_name): (&str, &str),
    x_ticks: &[(f64, String)],
    y_ticks: &[(f64, String)],
    diagonal: bool,
    lines: &[Curve<'_>],
) -> String {
    let x = |part: f64| LEFT + part.clamp(0.0, 1.0) * PLOT.0;
    let y = |part: f64| TOP + (1.0 - part.clamp(0.0, 1.0)) * PLOT.1;
    let height = HEIGHT + 16.0 * lines.len() as f64;
    let mut svg = format!("<svg viewBox=\"0 0 {WIDTH} {height}\" width=\"{WIDTH}\" role=\"img\">");
    let _ = write!(
        svg,
        "<rect x=\"{LEFT}\" y=\"{TOP}\" width=\"{}\" height=\"{}\" fill=\"none\" stroke=\"#999\"/>",
        PLOT.0, PLOT.1
    );
    for (at, text) in x_ticks {
        let (at, text) = (x(*at), escape(text));
        let _ = write!(
            svg,
            "<text x=\"{at:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{text}</text>",
            y(0.0) + 14.0
        );
    }
    for (at, text) in y_ticks {
        let (at, text) = (y(*at), escape(text));
        let _ = write!(
            svg,
            "<line x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{at:.1}\" y2=\"{at:.1}\" stroke=\"#ddd\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{text}</text>",
            x(1.0),
            LEFT - 4.0,
            at + 4.0
        );
    }
    if diagonal {
        let _ = write!(
            svg,
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"#999\" stroke-dasharray=\"4 3\"/>",
            x(0.0),
            y(0.0),
            x(1.0),
            y(1.0)
        );
    }
    for (line, colour) in lines.iter().zip(COLOURS.iter().cycle()) {
        let points: Vec<String> =
            line.points.iter().map(|(px, py)| format!("{:.1},{:.1}", x(*px), y(*py))).collect();
        let _ = write!(
            svg,
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>",
            points.join(" ")
        );
        for point in &points {
            let (px, py) = point.split_once(',').unwrap_or(("0", "0"));
            let _ = write!(svg, "<circle cx=\"{px}\" cy=\"{py}\" r=\"3\" fill=\"{colour}\"/>");
        }
    }
    let _ = write!(
        svg,
        "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>",
        x(0.5),
        y(0.0) + 32.0,
        escape(x_name)
    );
    let _ = write!(
        svg,
        "<text transform=\"translate(11 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        y(0.5),
        escape(y_name)
    );
    for (index, (line, colour)) in lines.iter().zip(COLOURS.iter().cycle()).enumerate() {
        let at = HEIGHT + 16.0 * index as f64;
        let _ = write!(
            svg,
            "<rect x=\"{LEFT}\" y=\"{:.1}\" width=\"12\" height=\"4\" fill=\"{colour}\"/>\
             <text x=\"{:.1}\" y=\"{at:.1}\">{}</text>",
            at - 6.0,
            LEFT + 18.0,
            escape(line.name)
        );
    }
    svg + "</svg>"
}

/// Draws a bar with its name in front and a text behind.
pub struct Bar {
    /// Whose it is.
    pub name: String,
    /// Its length, 0 to 1.
    pub part: f64,
    /// What it says.
    pub text: String,
}

/// Draws bars below each other.
pub fn bars(bars: &[Bar]) -> String {
    const ROW: f64 = 20.0;
    const NAMES: f64 = 90.0;
    const LONGEST: f64 = 180.0;
    let (width, height) = (NAMES + LONGEST + 210.0, ROW * bars.len() as f64);
    let mut svg = format!("<svg viewBox=\"0 0 {width} {height}\" width=\"{width}\" role=\"img\">");
    for (index, bar) in bars.iter().enumerate() {
        let (y, length) = (ROW * index as f64, LONGEST * bar.part.clamp(0.0, 1.0));
        let _ = write!(
            svg,
            "<text x=\"0\" y=\"{0:.1}\">{1}</text><rect x=\"{NAMES}\" y=\"{2:.1}\" width=\"{LONGEST}\" height=\"12\" \
             fill=\"#eee\"/><rect x=\"{NAMES}\" y=\"{2:.1}\" width=\"{length:.1}\" height=\"12\" fill=\"{3}\"/>\
             <text x=\"{4:.1}\" y=\"{0:.1}\">{5}</text>",
            y + 14.0,
            escape(&bar.name),
            y + 4.0,
            COLOURS[0],
            NAMES + LONGEST + 8.0,
            escape(&bar.text)
        );
    }
    svg + "</svg>"
}

/// Draws a map of values in −1..=1 with a row for each name. The name of a column appears under the mouse.
pub fn heat(rows: &[(String, Vec<f64>)], columns: &[String]) -> String {
    const CELL: (f64, f64) = (9.0, 18.0);
    const NAMES: f64 = 110.0;
    let width = NAMES + CELL.0 * columns.len() as f64;
    let height = CELL.1 * rows.len() as f64;
    let mut svg = format!("<svg viewBox=\"0 0 {width} {height}\" width=\"{width}\" role=\"img\">");
    for (index, (name, values)) in rows.iter().enumerate() {
        let y = CELL.1 * index as f64;
        let _ = write!(svg, "<text x=\"0\" y=\"{:.1}\">{}</text>", y + 13.0, escape(name));
        for (place, (value, column)) in values.iter().zip(columns).enumerate() {
            let _ = write!(
                svg,
                "<rect x=\"{:.1}\" y=\"{y:.1}\" width=\"{}\" height=\"{}\" fill=\"{}\"><title>{}: {} {value:+.2}</title></rect>",
                NAMES + CELL.0 * place as f64,
                CELL.0,
                CELL.1,
                colour(*value),
                escape(name),
                escape(column)
            );
        }
    }
    svg + "</svg>"
}

/// Returns a colour: blue below zero, white at zero, red above.
pub fn colour(value: f64) -> String {
    let part = value.clamp(-1.0, 1.0);
    let fade = |end: f64| (255.0 + (end - 255.0) * part.abs()).round() as u8;
    let [r, g, b] = if part < 0.0 {
        [fade(40.0), fade(90.0), fade(180.0)]
    } else {
        [fade(200.0), fade(60.0), fade(30.0)]
    };
    format!("#{r:02x}{g:02x}{b:02x}")
}
