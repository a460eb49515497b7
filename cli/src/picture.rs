//! A picture like the paper's Fig. 5: positions, velocities and torques over time, each scaled by its limit,
//! measured values in colour, desired ones dashed.

pub mod figures;
pub mod map;

use plotters::prelude::*;
use upswing_ipc::{Mode, Telemetry};
use upswing_model::{Limits, NQ, NU};

/// Size of the picture, px.
const SIZE: (u32, u32) = (1200, 820);
/// Points per curve: more than the picture can show would only make the file large.
const POINTS: usize = 500;
/// Joints of each row, 0-based, as in Fig. 4 and 5 (joint 7 is shown with the pendulum).
const ROWS: [&[usize]; 3] = [&[0, 1, 2], &[3, 4, 5], &[6, 7, 8]];
/// Colours that differ in print and for the colour-blind (Okabe, Ito 2008).
const COLOURS: [RGBColor; 3] = [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115)];

/// One curve: measured and desired values of a joint, scaled.
struct Curve {
    joint: usize,
    measured: Vec<(f64, f64)>,
    desired: Vec<(f64, f64)>,
}

/// Draws the records from 0.2 s before the plan starts to the end of the balance as an SVG.
///
/// # Errors
/// A text that says why the file could not be drawn.
pub fn draw(
    path: &std::path::Path,
    records: &[Telemetry],
    limits: &Limits,
    period: f64,
) -> Result<(), String> {
    let moving = |t: &&Telemetry| matches!(t.mode(), Ok(Mode::Track | Mode::Balance));
    let first = records.iter().position(|t| moving(&t)).ok_or("there is no swing-up to draw")?;
    let last = records.iter().rposition(|t| moving(&t)).unwrap_or(first);
    let lead = (0.2 / period) as usize;
    let shown = &records[first.saturating_sub(lead)..=last];
    let start = records[first].t_ns;
    let step = (shown.len() / POINTS).max(1);
    let shown: Vec<_> = shown.iter().step_by(step).collect();
    let time = |t: &Telemetry| (t.t_ns as i128 - start as i128) as f64 * 1e-9;
    let curve = |joint: usize,
                 measured: &dyn Fn(&Telemetry) -> f64,
                 desired: Option<&dyn Fn(&Telemetry) -> f64>| Curve {
        joint,
        measured: shown.iter().map(|t| (time(t), measured(t))).collect(),
        desired: desired
            .map_or_else(Vec::new, |d| shown.iter().filter(|t| moving(t)).map(|t| (time(t), d(t))).collect()),
    };
    let end = shown.last().map_or(1.0, |t| time(t));

    let root = SVGBackend::new(path, SIZE).into_drawing_area();
    let failed = |e: &dyn std::fmt::Display| format!("cannot write {}: {e}", path.display());
    root.fill(&WHITE).map_err(|e| failed(&e))?;
    let panels = root.split_evenly((ROWS.len(), 3));
    for (row, joints) in ROWS.iter().enumerate() {
        let positions = joints.iter().map(|&i| {
            let scale = limits.q_max[i];
            curve(i, &|t| t.q[i] / scale, Some(&|t: &Telemetry| t.q_d[i] / scale))
        });
        let velocities = joints.iter().map(|&i| {
            let scale = limits.qd_max[i];
            curve(i, &|t| t.qd[i] / scale, Some(&|t: &Telemetry| t.qd_d[i] / scale))
        });
        let torques =
            joints.iter().filter(|&&i| i < NU).map(|&i| curve(i, &|t| t.tau[i] / limits.tau_max[i], None));
        let columns: [(&str, Vec<Curve>); 3] = [
            ("position / limit", positions.collect()),
            ("velocity / limit", velocities.collect()),
            ("torque / limit", torques.collect()),
        ];
        for (column, (title, curves)) in columns.iter().enumerate() {
            let title = if row == 0 { *title } else { "" };
            let bottom = row + 1 == ROWS.len();
            panel(&panels[row * 3 + column], title, bottom, end, curves).map_err(|e| failed(&e))?;
        }
    }
    root.present().map_err(|e| failed(&e))
}

fn panel<'a>(
    area: &DrawingArea<SVGBackend<'a>, plotters::coord::Shift>,
    title: &str,
    bottom: bool,
    end: f64,
    curves: &[Curve],
) -> Result<(), DrawingAreaErrorKind<<SVGBackend<'a> as DrawingBackend>::ErrorType>> {
    let values = curves.iter().flat_map(|c| c.measured.iter().chain(&c.desired)).map(|p| p.1.abs());
    // The limits at +-1 are always in sight.
    let top = values.fold(1.0, f64::max) * 1.08;
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .caption(title, ("sans-serif", 18))
        .x_label_area_size(if bottom { 38 } else { 22 })
        .y_label_area_size(38)
        // The legend stands to the right of the curves.
        .build_cartesian_2d(-0.2..end * 1.42, -top..top)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.08))
        .label_style(("sans-serif", 13))
        .x_labels(8)
        .y_labels(5)
        .x_desc(if bottom { "time (s)" } else { "" })
        .draw()?;
    for limit in [-1.0, 1.0] {
        chart.draw_series(LineSeries::new([(-0.2, limit), (end, limit)], BLACK.mix(0.35)))?;
    }
    for (curve, colour) in curves.iter().zip(COLOURS) {
        chart
            .draw_series(LineSeries::new(curve.measured.iter().copied(), colour.stroke_width(2)))?
            .label(format!("joint {}", curve.joint + 1))
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
    }
    // The desired curves lie on top, or the measured ones would hide them.
    for curve in curves {
        chart.draw_series(DashedLineSeries::new(
            curve.desired.iter().copied(),
            4,
            4,
            BLACK.stroke_width(1),
        ))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::MiddleRight)
        .label_font(("sans-serif", 13))
        .draw()
}

const _: () = assert!(NQ == 9, "the rows of the picture are those of the paper's robot");
