//! Draws SVG plots with the crate `plotters`.

use std::collections::BTreeMap;

use anyhow::{Result, anyhow};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::Matrix;

const COLOURS: [RGBColor; 6] = [
    RGBColor(31, 95, 168),
    RGBColor(200, 80, 30),
    RGBColor(46, 139, 87),
    RGBColor(123, 79, 163),
    RGBColor(138, 109, 27),
    RGBColor(85, 85, 85),
];
const FONT: (&str, u32) = ("sans-serif", 12);

/// Draws into a picture that has this size.
fn drawn<F>(size: (u32, u32), draw: F) -> Result<String>
where
    F: FnOnce(&DrawingArea<SVGBackend<'_>, plotters::coord::Shift>) -> Result<(), Box<dyn std::error::Error>>,
{
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        draw(&area)
            .and_then(|()| Ok(area.present()?))
            .map_err(|error| anyhow!("a plot cannot be drawn: {error}"))?;
    }
    Ok(svg)
}

/// Draws a confusion matrix in which a darker cell is a larger fraction of its row.
pub fn heat(matrix: &Matrix) -> Result<String> {
    const CELL: i32 = 46;
    const LEFT: i32 = 120;
    const TOP: i32 = 44;
    let (rows, columns) = (matrix.made.len() as i32, matrix.named.len() as i32);
    let size = ((LEFT + CELL * columns + 8) as u32, (TOP + CELL * rows + 8) as u32);
    drawn(size, |area| {
        let style = FONT.into_font().color(&BLACK);
        area.draw(&Text::new(format!("{}: actual ↓, recognised →", matrix.name), (4, 4), style.clone()))?;
        let centred = style.clone().pos(Pos::new(HPos::Center, VPos::Center));
        for (column, name) in (0..).zip(&matrix.named) {
            // Adjacent names have different heights, because names are wider than cells.
            let at = (LEFT + CELL * column + CELL / 2, if column % 2 == 0 { TOP - 8 } else { TOP - 20 });
            area.draw(&Text::new(name.clone(), at, centred.clone()))?;
        }
        for (row, (name, counts)) in (0..).zip(matrix.made.iter().zip(&matrix.counts)) {
            let top = TOP + CELL * row;
            let right = style.clone().pos(Pos::new(HPos::Right, VPos::Center));
            area.draw(&Text::new(name.clone(), (LEFT - 6, top + CELL / 2), right))?;
            let sum = counts.iter().sum::<u64>().max(1);
            for (column, &count) in (0..).zip(counts) {
                let share = count as f64 / sum as f64;
                let corner = (LEFT + CELL * column, top);
                let cell = [corner, (corner.0 + CELL, corner.1 + CELL)];
                area.draw(&Rectangle::new(cell, COLOURS[0].mix(share).filled()))?;
                area.draw(&Rectangle::new(cell, RGBColor(200, 200, 200)))?;
                let ink = if share > 0.5 { &WHITE } else { &BLACK };
                let middle = (corner.0 + CELL / 2, top + CELL / 2);
                let text = FONT.into_font().color(ink).pos(Pos::new(HPos::Center, VPos::Center));
                area.draw(&Text::new(count.to_string(), middle, text))?;
            }
        }
        Ok(())
    })
}

/// Plots cap and commanded speed over time. Without figures, it plots nothing.
/// Each row contains the time in s, and the cap and the speed in m/s.
pub fn speed(rows: &[(String, Vec<f64>)]) -> Result<String> {
    if rows.is_empty() {
        return Ok(String::new());
    }
    let line = |column: usize| -> Vec<(f64, f64)> {
        rows.iter().filter_map(|(_, row)| Some((*row.first()?, *row.get(column)?))).collect()
    };
    let lines = [("cap".to_owned(), line(1)), ("commanded".to_owned(), line(2))];
    chart("Speed by bends", ("s", "m/s"), &lines)
}

/// Plots the flange's paths from the side (x, z) and from above (x, y). Without figures, it plots nothing.
/// Each row contains the name of a motion, and x, y and z in m.
pub fn paths(rows: &[(String, Vec<f64>)]) -> Result<String> {
    if rows.is_empty() {
        return Ok(String::new());
    }
    let seen = |across: usize, up: usize| -> Vec<(String, Vec<(f64, f64)>)> {
        let mut lines: BTreeMap<&str, Vec<(f64, f64)>> = BTreeMap::new();
        for (name, row) in rows {
            if let (Some(&x), Some(&y)) = (row.get(across), row.get(up)) {
                lines.entry(name).or_default().push((x, y));
            }
        }
        lines.into_iter().map(|(name, points)| (name.to_owned(), points)).collect()
    };
    let side = chart("The flange's paths from home, from the side", ("x, m", "z, m"), &seen(0, 2))?;
    Ok(side + &chart("… and from above", ("x, m", "y, m"), &seen(0, 1))?)
}

/// Named lines.
fn chart(title: &str, (x_name, y_name): (&str, &str), lines: &[(String, Vec<(f64, f64)>)]) -> Result<String> {
    let range = |of: fn(&(f64, f64)) -> f64| {
        let values = || lines.iter().flat_map(|(_, points)| points.iter().map(of));
        let (low, high) =
            (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        let margin = ((high - low) * 0.05).max(0.01);
        low - margin..high + margin
    };
    drawn((470, 330), |area| {
        let mut chart = ChartBuilder::on(area)
            .caption(title, ("sans-serif", 14))
            .margin(8)
            .x_label_area_size(34)
            .y_label_area_size(48)
            .build_cartesian_2d(range(|point| point.0), range(|point| point.1))?;
        chart.configure_mesh().x_desc(x_name).y_desc(y_name).label_style(FONT).draw()?;
        for ((name, points), colour) in lines.iter().zip(COLOURS.iter().cycle()) {
            chart
                .draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?
                .label(name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
        }
        chart
            .configure_series_labels()
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK)
            .label_font(FONT)
            .draw()?;
        Ok(())
    })
}
