//! Success curves: the share of successful runs over a varied parameter, with the confidence interval of the probability.

use super::{Area, COLOURS, DrawResult, PictureError, svg, write};
use plotters::prelude::*;
use upswing_process::output::OutputFile;

/// Most panels side by side.
const COLUMNS: usize = 3;
const PANEL: (u32, u32) = (380, 260);
/// Half the width of the bars at the ends of an interval, as a share of the axis.
const TICK: f64 = 0.012;

/// Success of the runs at one value of the varied parameter.
#[derive(Clone, Copy, Debug)]
pub struct CurvePoint {
    /// Value of the parameter.
    pub x: f64,
    /// Share of the runs that succeeded, 0 to 1.
    pub share: f64,
    /// Confidence interval of the probability of success, 0 to 1.
    pub interval: (f64, f64),
}

/// Panel for one varied parameter.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Name and unit of the parameter.
    pub label: String,
    /// Names and points of the curves.
    pub series: Vec<(String, Vec<CurvePoint>)>,
}

/// Draws the panels as an SVG.
///
/// # Errors
/// [`PictureError`] if the picture could not be drawn or written.
pub fn draw(output: &OutputFile, panels: &[Panel]) -> Result<(), PictureError> {
    let columns = panels.len().clamp(1, COLUMNS);
    let rows = panels.len().div_ceil(columns).max(1);
    let size = (PANEL.0 * columns as u32, PANEL.1 * rows as u32);
    let drawing = svg(size, |root| {
        let mut areas = panels.iter().zip(root.split_evenly((rows, columns)));
        areas.try_for_each(|(panel, area)| draw_panel(&area, panel))
    })?;
    write(output, drawing.as_bytes())
}

fn draw_panel(area: &Area<'_>, panel: &Panel) -> DrawResult {
    let values = panel.series.iter().flat_map(|(_, points)| points).map(|p| p.x);
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
    // A range without width is extended, so that the axis has a length.
    let (low, high) = if low < high { (low, high) } else { (low.min(0.0) - 1.0, high.max(0.0) + 1.0) };
    let margin = 0.04 * (high - low);
    let mut chart = ChartBuilder::on(area)
        .margin(10)
        .x_label_area_size(40)
        .y_label_area_size(44)
        .build_cartesian_2d(low - margin..high + margin, 0.0..103.0)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.08))
        .label_style(("sans-serif", 12))
        .x_labels(7)
        .y_labels(6)
        // Labels like 60 and 0.025, without trailing zeros.
        .x_label_formatter(&|v| ((v * 1e6).round() / 1e6).to_string())
        .y_label_formatter(&|v| format!("{v:.0}"))
        .x_desc(panel.label.as_str())
        .y_desc("balanced (%)")
        .draw()?;
    for ((name, points), colour) in panel.series.iter().zip(COLOURS) {
        let line = points.iter().map(|p| (p.x, 100.0 * p.share));
        chart
            .draw_series(LineSeries::new(line.clone(), colour.stroke_width(2)))?
            .label(name.as_str())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
        chart.draw_series(line.map(|point| Circle::new(point, 3, colour.filled())))?;
        let tick = TICK * (high - low);
        for p in points {
            let (a, b) = (100.0 * p.interval.0, 100.0 * p.interval.1);
            for ends in
                [[(p.x, a), (p.x, b)], [(p.x - tick, a), (p.x + tick, a)], [(p.x - tick, b), (p.x + tick, b)]]
            {
                chart.draw_series(LineSeries::new(ends, colour.mix(0.6)))?;
            }
        }
    }
    if panel.series.len() > 1 {
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::LowerLeft)
            .background_style(WHITE.mix(0.8))
            .label_font(("sans-serif", 12))
            .draw()?;
    }
    Ok(())
}
