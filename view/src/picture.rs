//! Pictures like the paper's Fig. 4 and 5: positions, velocities and torques over time, scaled by their 100 % limits, so
//! that plans and recorded motions can be compared.

pub mod curves;
pub mod figures;
pub mod map;
pub mod plan;

use plotters::coord::Shift;
use plotters::prelude::*;
use upswing_ipc::{Mode, Telemetry};
use upswing_model::{JointKind, Limits, Model};
use upswing_process::output::{OutputError, OutputFile};

/// Width of a picture, and height of a row of panels, px.
const SIZE: (u32, u32) = (1200, 273);
/// Most points per curve: more would enlarge the file without being visible.
const POINTS: usize = 500;
/// Most joints in a row of panels, as in Fig. 4 and 5.
const JOINTS_PER_ROW: usize = 3;
/// Upper end of the vertical axes in units of the 100 % limits, equal in all pictures, so that they can be compared. Plans may
/// use up to 1.11 of the limit of a free joint.
const SHOWN: f64 = 1.2;
/// Number of columns: positions, velocities, torques or forces.
const COLUMNS: usize = 3;
/// Colours that differ in print and for the colour-blind (Okabe, Ito 2008).
const COLOURS: [RGBColor; 3] = [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115)];

/// A solid curve and a dashed one to compare with it: scaled values over time, s.
struct CurvePair {
    solid: Vec<(f64, f64)>,
    dashed: Vec<(f64, f64)>,
}

/// Time range of a panel, s, and the colour of its dashed curves; `None`: the colour of the solid curves.
struct PanelStyle {
    begin: f64,
    end: f64,
    dashes: Option<RGBColor>,
}

/// Reason why a picture cannot be drawn or written.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The records hold no swing-up.
    #[error("there is no swing-up to draw")]
    NoSwingUp,
    /// A map has fewer than two axes.
    #[error("a map needs a grid with ranges of two joints or more")]
    NoPair,
    /// The drawing library reports an error.
    #[error("cannot draw: {0}")]
    Draw(#[from] DrawingAreaErrorKind<std::io::Error>),
    /// The machine has no font for the texts of a PNG.
    #[error("--png: expected a font on this machine, got none; install one, or use --svg")]
    NoFont,
    /// The drawing cannot be read for its conversion to PNG.
    #[error(transparent)]
    Svg(#[from] resvg::usvg::Error),
    /// The drawing has no pixels.
    #[error("an empty drawing")]
    Empty,
    /// The pixels cannot be encoded as PNG.
    #[error(transparent)]
    Png(Box<dyn std::error::Error + Send + Sync>),
    /// The file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// Result of a drawing function: the errors of the drawing library.
type DrawResult = Result<(), DrawingAreaErrorKind<std::io::Error>>;

/// Returns a drawing of `size` (px) as SVG text.
///
/// # Errors
/// [`PictureError::Draw`]
fn svg(size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> DrawResult) -> Result<String, PictureError> {
    let mut text = String::new();
    let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
    let drawn = root.fill(&WHITE).and_then(|()| draw(&root)).and_then(|()| root.present());
    drop(root);
    drawn?;
    Ok(text)
}

/// Writes a drawing to a file. The file output of plotters would not report a full disk.
fn write(output: &OutputFile, drawing: &[u8]) -> Result<(), PictureError> {
    Ok(output.write(drawing)?)
}

/// Draws the records from 0.2 s before the plan starts to the end of the balance, or of the hold after the plan, as an SVG: measured values in colour,
/// desired ones dashed, as in Fig. 5.
///
/// # Errors
/// [`PictureError`] if there is no swing-up, or the picture could not be drawn or written.
pub fn draw(
    output: &OutputFile,
    records: &[Telemetry],
    model: &Model,
    limits: &Limits,
    period: f64,
) -> Result<(), PictureError> {
    write(output, swing_up(records, model, limits, period)?.as_bytes())
}

/// Returns the drawing of [`draw`] as SVG text.
fn swing_up(
    records: &[Telemetry],
    model: &Model,
    limits: &Limits,
    period: f64,
) -> Result<String, PictureError> {
    const LEAD: f64 = 0.2;
    let moving = |t: &&Telemetry| matches!(t.mode(), Ok(Mode::Track | Mode::Balance));
    let first = records.iter().position(|t| moving(&t)).ok_or(PictureError::NoSwingUp)?;
    let last = records.iter().rposition(|t| moving(&t)).unwrap_or(first);
    // After a plan that ends hanging the mode is Hold.
    let held = records[last + 1..].iter().take_while(|t| t.mode() == Ok(Mode::Hold)).count();
    let shown = &records[first.saturating_sub((LEAD / period) as usize)..=last + held];
    let start = records[first].t_ns;
    let step = (shown.len() / POINTS).max(1);
    let shown: Vec<_> = shown.iter().step_by(step).collect();
    let time = |t: &Telemetry| (t.t_ns as i128 - start as i128) as f64 * 1e-9;
    let measured = |value: &dyn Fn(&Telemetry) -> f64| shown.iter().map(|t| (time(t), value(t))).collect();
    let desired = |value: &dyn Fn(&Telemetry) -> f64| {
        shown.iter().filter(|t| moving(t)).map(|t| (time(t), value(t))).collect()
    };
    let end = shown.last().map_or(1.0, |t| time(t));
    draw_panels(&PanelStyle { begin: -LEAD, end, dashes: Some(BLACK) }, model, |i| {
        let c = model.order().coordinate(i);
        let (q, qd) = (limits.largest_position(c), limits.qd_max[c]);
        [
            Some(CurvePair { solid: measured(&|t| t.q[i] / q), dashed: desired(&|t| t.q_d[i] / q) }),
            Some(CurvePair { solid: measured(&|t| t.qd[i] / qd), dashed: desired(&|t| t.qd_d[i] / qd) }),
            limits
                .tau_max
                .get(c)
                .map(|tau_max| CurvePair { solid: measured(&|t| t.tau[c] / tau_max), dashed: Vec::new() }),
        ]
    })
}

/// Draws all panels; `curves` returns the curves of a joint of the chain (0-based) in the order of the columns.
fn draw_panels(
    look: &PanelStyle,
    model: &Model,
    curves: impl Fn(usize) -> [Option<CurvePair>; COLUMNS],
) -> Result<String, PictureError> {
    let names: Vec<&str> = model.joint_names().collect();
    let titles = ["position", "velocity", effort(model)].map(|title| format!("{title} / 100 % limit"));
    let rows = names.len().div_ceil(JOINTS_PER_ROW);
    // The space to the right of the curves, in units of the time range, is for the legend with its names.
    let longest = names.iter().map(|name| name.chars().count()).max().unwrap_or(0);
    let legend = 0.25 + 0.028 * longest as f64;
    svg((SIZE.0, SIZE.1 * rows as u32), |root| {
        let panels = root.split_evenly((rows, COLUMNS));
        for (row, names) in names.chunks(JOINTS_PER_ROW).enumerate() {
            let mut columns = [const { Vec::new() }; COLUMNS];
            for (i, name) in names.iter().enumerate() {
                for (column, curve) in columns.iter_mut().zip(curves(row * JOINTS_PER_ROW + i)) {
                    column.extend(curve.map(|c| (*name, c)));
                }
            }
            for (column, curves) in columns.iter().enumerate() {
                let title = if row == 0 { titles[column].as_str() } else { "" };
                let bottom = row + 1 == rows;
                draw_panel(&panels[row * COLUMNS + column], title, (bottom, legend), look, curves)?;
            }
        }
        Ok(())
    })
}

/// What the motors of a robot give: torques, forces of prismatic joints, or both.
fn effort(model: &Model) -> &'static str {
    let slides = |joint: usize| model.joint_kind(joint) == JointKind::Prismatic;
    let actuated = || 0..model.sizes().actuated();
    match (actuated().any(slides), actuated().all(slides)) {
        (false, _) => "torque",
        (true, false) => "torque, force",
        (true, true) => "force",
    }
}

/// Clamps a point to the vertical range of its panel.
fn shown((t, value): &(f64, f64)) -> (f64, f64) {
    (*t, value.clamp(-SHOWN, SHOWN))
}

fn draw_panel(
    area: &Area<'_>,
    title: &str,
    (bottom, legend): (bool, f64),
    look: &PanelStyle,
    curves: &[(&str, CurvePair)],
) -> DrawResult {
    let mut chart = ChartBuilder::on(area)
        .margin(8)
        .caption(title, ("sans-serif", 18))
        .x_label_area_size(if bottom { 38 } else { 22 })
        .y_label_area_size(38)
        .build_cartesian_2d(look.begin..look.end * (1.0 + legend), -SHOWN..SHOWN)?;
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
        chart.draw_series(LineSeries::new([(look.begin, limit), (look.end, limit)], BLACK.mix(0.35)))?;
    }
    for ((name, curve), colour) in curves.iter().zip(COLOURS) {
        chart
            .draw_series(LineSeries::new(curve.solid.iter().map(shown), colour.stroke_width(2)))?
            .label(*name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
    }
    // The dashed curves are drawn last, so that the solid curves do not hide them.
    for ((_, curve), colour) in curves.iter().zip(COLOURS) {
        let style = look.dashes.unwrap_or(colour).stroke_width(1);
        chart.draw_series(DashedLineSeries::new(curve.dashed.iter().map(shown), 4, 4, style))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::MiddleRight)
        .label_font(("sans-serif", 13))
        .draw()
}
