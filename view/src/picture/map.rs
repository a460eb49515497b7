//! Map of plans over the ranges of their start angles: for each kind of limit and each pair of joints, the smallest margin of
//! the plans whose start is in a cell of the two angles, over all values of the other angles.

use super::{Area, DrawResult, PictureError, svg, write};
use plotters::prelude::*;
use upswing_config::GridAxis;
use upswing_model::Model;
use upswing_process::output::OutputFile;

/// Edge length of a panel, px.
const PANEL: u32 = 200;
const SCALE_WIDTH: u32 = 110;
/// Kinds of limits, one per row.
const ROWS: [&str; 3] = ["position", "velocity", "torque"];
/// Starts per cell, on average.
const STARTS_PER_CELL: f64 = 20.0;
const CELLS: (f64, f64) = (4.0, 20.0);
/// Colour of a cell in which a start has no plan.
const NO_PLAN: RGBColor = RGBColor(213, 94, 0);

/// Start of a plan and the margins of the plan.
#[derive(Clone, Debug)]
pub struct MapPoint {
    /// Start positions q_A, deg or m.
    pub q: Vec<f64>,
    /// Smallest margins of position, velocity and torque, as shares of half the range; `None` if there is no plan.
    pub margins: Option<[f64; 3]>,
}

/// Content of a cell: no start, a start without a plan, or the smallest margin.
#[derive(Clone, Copy, Debug, PartialEq)]
enum MapCell {
    Empty,
    NoPlan,
    Margin(f64),
}

/// Range of one joint, deg or m, divided into cells.
struct MapAxis {
    joint: usize,
    /// Name of the joint with the unit.
    label: String,
    from: f64,
    to: f64,
    cells: usize,
}

impl MapAxis {
    fn cell(&self, q: &[f64]) -> usize {
        let share = (q[self.joint] - self.from) / (self.to - self.from);
        ((share * self.cells as f64) as usize).min(self.cells - 1)
    }

    fn edge(&self, cell: usize) -> f64 {
        self.from + (self.to - self.from) * cell as f64 / self.cells as f64
    }
}

/// Draws the map as an SVG. `axes`: ranges of the start positions of joints of `model`, rad or m; joints with a range of no width are left out.
///
/// # Errors
/// [`PictureError`] if fewer than two joints have a range, or the picture could not be drawn or written.
pub fn draw(
    output: &OutputFile,
    model: &Model,
    axes: &[GridAxis],
    points: &[MapPoint],
) -> Result<(), PictureError> {
    let cells = (points.len() as f64 / STARTS_PER_CELL).sqrt().clamp(CELLS.0, CELLS.1) as usize;
    let side = |a: &GridAxis| {
        let [(from, unit), (to, _)] = [a.from, a.to].map(|q| model.joint_kind(a.joint).shown(q));
        MapAxis { joint: a.joint, label: format!("{} ({unit})", model.joint_name(a.joint)), from, to, cells }
    };
    let sides: Vec<MapAxis> = axes.iter().filter(|a| a.to > a.from).map(side).collect();
    let pairs: Vec<(&MapAxis, &MapAxis)> = (0..sides.len())
        .flat_map(|i| (i + 1..sides.len()).map(move |j| (i, j)))
        .map(|(i, j)| (&sides[i], &sides[j]))
        .collect();
    if pairs.is_empty() {
        return Err(PictureError::NoPair);
    }
    let size = (PANEL * pairs.len() as u32 + SCALE_WIDTH, PANEL * ROWS.len() as u32);
    let drawing = svg(size, |root| {
        for (kind, area) in root.split_evenly((ROWS.len(), 1)).iter().enumerate() {
            let (panels, scale) = area.split_horizontally(PANEL * pairs.len() as u32);
            let margins = points.iter().filter_map(|p| p.margins).map(|m| m[kind]).filter(|m| m.is_finite());
            let range = margins.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), m| (a.min(m), b.max(m)));
            for (panel, (x, y)) in panels.split_evenly((1, pairs.len())).iter().zip(&pairs) {
                draw_panel(panel, x, y, &smallest(points, kind, x, y), range)?;
            }
            draw_scale(&scale, ROWS[kind], range)?;
        }
        Ok(())
    })?;
    write(output, drawing.as_bytes())
}

/// Returns the cells of a panel, by rows of constant `y`.
fn smallest(points: &[MapPoint], kind: usize, x: &MapAxis, y: &MapAxis) -> Vec<MapCell> {
    let mut cells = vec![MapCell::Empty; x.cells * y.cells];
    for p in points {
        let cell = &mut cells[y.cell(&p.q) * x.cells + x.cell(&p.q)];
        *cell = match (*cell, p.margins) {
            (_, None) | (MapCell::NoPlan, _) => MapCell::NoPlan,
            (MapCell::Empty, Some(m)) => MapCell::Margin(m[kind]),
            (MapCell::Margin(known), Some(m)) => MapCell::Margin(known.min(m[kind])),
        };
    }
    cells
}

/// Colour of a share from 0, dark, to 1, light; brightness grows with the share, for print and for the colour-blind.
fn shade(share: f64) -> RGBColor {
    const STOPS: [[f64; 3]; 3] = [[68.0, 1.0, 84.0], [33.0, 145.0, 140.0], [253.0, 231.0, 37.0]];
    let place = share.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let i = (place as usize).min(STOPS.len() - 2);
    let mix = |c: usize| (STOPS[i][c] + (STOPS[i + 1][c] - STOPS[i][c]) * (place - i as f64)).round() as u8;
    RGBColor(mix(0), mix(1), mix(2))
}

fn draw_panel(area: &Area<'_>, x: &MapAxis, y: &MapAxis, cells: &[MapCell], range: (f64, f64)) -> DrawResult {
    let mut chart = ChartBuilder::on(area)
        .margin(6)
        .x_label_area_size(34)
        .y_label_area_size(42)
        .build_cartesian_2d(x.from..x.to, y.from..y.to)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .label_style(("sans-serif", 12))
        .x_labels(4)
        .y_labels(4)
        // Labels like 60 and 0.25, without trailing zeros.
        .x_label_formatter(&|v| ((v * 1e6).round() / 1e6).to_string())
        .y_label_formatter(&|v| ((v * 1e6).round() / 1e6).to_string())
        .x_desc(x.label.as_str())
        .y_desc(y.label.as_str())
        .draw()?;
    chart.draw_series(cells.iter().enumerate().filter_map(|(i, cell)| {
        let (column, row) = (i % x.cells, i / x.cells);
        let fill = match cell {
            MapCell::Empty => return None,
            MapCell::NoPlan => NO_PLAN,
            MapCell::Margin(m) if range.1 > range.0 => shade((m - range.0) / (range.1 - range.0)),
            MapCell::Margin(_) => shade(1.0),
        };
        let corners = [(x.edge(column), y.edge(row)), (x.edge(column + 1), y.edge(row + 1))];
        Some(Rectangle::new(corners, fill.filled()))
    }))?;
    Ok(())
}

/// Draws the colour scale of a row and the range of its margins.
fn draw_scale(area: &Area<'_>, name: &str, range: (f64, f64)) -> DrawResult {
    const STEPS: i32 = 40;
    let (top, height, left, width) = (44, 110, 6, 14);
    let text = |t: String, x: i32, y: i32| Text::new(t, (x, y), ("sans-serif", 12).into_font());
    area.draw(&text(format!("{name} margin"), left, 10))?;
    area.draw(&text("(half range = 1)".into(), left, 24))?;
    for i in 0..STEPS {
        let (y0, y1) = (top + height * i / STEPS, top + height * (i + 1) / STEPS);
        let fill = shade(1.0 - f64::from(i) / f64::from(STEPS - 1));
        area.draw(&Rectangle::new([(left, y0), (left + width, y1)], fill.filled()))?;
    }
    let (low, high) = range;
    for (share, value) in [(0.0, high), (0.5, 0.5 * (low + high)), (1.0, low)] {
        if value.is_finite() {
            area.draw(&text(
                format!("{value:.4}"),
                left + width + 6,
                top - 6 + (share * f64::from(height)) as i32,
            ))?;
        }
    }
    area.draw(&Rectangle::new(
        [(left, top + height + 14), (left + width, top + height + 26)],
        NO_PLAN.filled(),
    ))?;
    area.draw(&text("no plan".into(), left + width + 6, top + height + 14))
}
