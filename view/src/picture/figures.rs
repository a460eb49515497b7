//! Writes the figures of a recording to files: trajectories, modes, cycle times.

use super::{Area, DrawResult, PictureError, svg, swing_up};
use crate::page::times::LatencyHistogram;
use crate::page::{ModeSpan, RecordingDigest};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::path::PathBuf;
use upswing_ipc::Mode;
use upswing_process::output::{OutputError, OutputFile};

/// Size of the figure of the cycle times, px.
const TIMES_SIZE: (u32, u32) = (900, 420);
const MODES_SIZE: (u32, u32) = (1200, 260);
/// Pixels of a PNG per unit of the SVG: sharp in print.
const SCALE: f32 = 2.0;

/// Suffixes of the file names of the figures.
const TRAJECTORIES: &str = "trajectories";
const MODES: &str = "modes";
const CYCLE_TIMES: &str = "cycle-times";

/// Returns the file of a figure, in the directory of `page`.
fn figure(page: &OutputFile, name: &str, extension: &str) -> OutputFile {
    let stem = page.path().file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    page.beside(&format!("{stem}-{name}.{extension}"))
}

/// Checks whether all figures could be written, without drawing them.
///
/// # Errors
/// [`OutputError`] of the first figure that cannot be written.
pub fn check(page: &OutputFile, as_svg: bool, as_png: bool) -> Result<(), OutputError> {
    let kinds = [(as_svg, "svg"), (as_png, "png")];
    let names = [TRAJECTORIES, MODES, CYCLE_TIMES];
    kinds
        .into_iter()
        .filter(|(wanted, _)| *wanted)
        .flat_map(|(_, extension)| names.map(|name| figure(page, name, extension)))
        .try_for_each(|figure| figure.check())
}

/// Draws the figures for which there are data to files like `NAME-trajectories.svg` beside `page`. Returns their paths.
///
/// # Errors
/// [`PictureError`] if a figure could not be drawn or written.
pub fn draw(
    page: &OutputFile,
    digest: &RecordingDigest,
    as_svg: bool,
    as_png: bool,
) -> Result<Vec<PathBuf>, PictureError> {
    let mut written = Vec::new();
    let mut finish = |name: &str, drawing: &str| -> Result<(), PictureError> {
        let mut write = |extension: &str, bytes: &[u8]| {
            let figure = figure(page, name, extension);
            super::write(&figure, bytes)?;
            written.push(figure.path().to_owned());
            Ok::<_, PictureError>(())
        };
        if as_svg {
            write("svg", drawing.as_bytes())?;
        }
        if as_png {
            write("png", &rasterise(drawing)?)?;
        }
        Ok(())
    };
    if digest.samples.iter().any(|t| matches!(t.mode(), Ok(Mode::Track | Mode::Balance))) {
        finish(
            TRAJECTORIES,
            &swing_up(&digest.samples, &digest.model, &digest.model.rated_limits().scale(), digest.step())?,
        )?;
    }
    finish(MODES, &modes(&digest.spans())?)?;
    let times = digest.times.times();
    if !times.is_empty() {
        finish(CYCLE_TIMES, &cycle_times(&times, digest.period * 1e6)?)?;
    }
    Ok(written)
}

/// Rasterises an SVG drawing as PNG.
fn rasterise(svg: &str) -> Result<Vec<u8>, PictureError> {
    let mut options = resvg::usvg::Options::default();
    options.fontdb_mut().load_system_fonts();
    if options.fontdb.is_empty() {
        return Err(PictureError::NoFont);
    }
    // The family of `sans-serif` is chosen here: the settings of the system do not change the picture.
    let family = options.fontdb.faces().find_map(|face| {
        let name = &face.families.first()?.0;
        ["DejaVu Sans", "Liberation Sans", "Noto Sans", "Arial"]
            .contains(&name.as_str())
            .then(|| name.clone())
    });
    let any = options.fontdb.faces().find_map(|face| Some(face.families.first()?.0.clone()));
    if let Some(family) = family.or(any) {
        options.fontdb_mut().set_sans_serif_family(family);
    }
    let tree = resvg::usvg::Tree::from_str(svg, &options)?;
    let size = tree.size();
    let (width, height) = ((size.width() * SCALE) as u32, (size.height() * SCALE) as u32);
    let mut pixels = resvg::tiny_skia::Pixmap::new(width, height).ok_or(PictureError::Empty)?;
    resvg::render(&tree, resvg::tiny_skia::Transform::from_scale(SCALE, SCALE), &mut pixels.as_mut());
    pixels.encode_png().map_err(|e| PictureError::Png(e.into()))
}

/// Draws the modes as bars over time.
fn modes(spans: &[ModeSpan]) -> Result<String, PictureError> {
    svg(MODES_SIZE, |root| draw_modes(root, spans))
}

fn draw_modes(root: &Area<'_>, spans: &[ModeSpan]) -> DrawResult {
    let (from, to) =
        (spans.first().map_or(0.0, |s| s.from), spans.last().map_or(1.0, |s| s.to).max(f64::MIN_POSITIVE));
    let rows = Mode::ALL.len();
    let mut chart = ChartBuilder::on(root)
        .margin(12)
        .x_label_area_size(42)
        .y_label_area_size(74)
        .build_cartesian_2d(from..to.max(from + 1e-3), 0.0..rows as f64)?;
    chart
        .configure_mesh()
        .disable_y_axis()
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.08))
        .label_style(("sans-serif", 14))
        .x_desc("time (s)")
        .draw()?;
    let label = TextStyle::from(("sans-serif", 14).into_font()).pos(Pos::new(HPos::Right, VPos::Center));
    for (row, mode) in Mode::ALL.iter().enumerate() {
        let (_, y) = chart.backend_coord(&(from, row as f64 + 0.4));
        root.draw_text(&mode.to_string(), &label, (74, y))?;
    }
    for span in spans {
        let row =
            Mode::ALL.iter().position(|mode| span.name.starts_with(&mode.to_string())).unwrap_or(0) as f64;
        let bar = [(span.from, row), (span.to, row + 0.8)];
        chart.draw_series([Rectangle::new(bar, super::COLOURS[row as usize % 3].filled())])?;
    }
    Ok(())
}

/// Draws histograms of wake-up and computing times with logarithmic axes, and the control period.
fn cycle_times(all: &[LatencyHistogram], period_us: f64) -> Result<String, PictureError> {
    svg(TIMES_SIZE, |root| draw_times(root, all, period_us))
}

/// Label of a value with a unit prefix, 100, 1k, 10k, 100k, 1M: each fits into its space.
fn short(value: f64) -> String {
    let (scale, letter) = match value {
        v if v >= 1e9 => (1e9, "G"),
        v if v >= 1e6 => (1e6, "M"),
        v if v >= 1e3 => (1e3, "k"),
        _ => (1.0, ""),
    };
    format!("{}{letter}", (value / scale * 1e3).round() / 1e3)
}

fn draw_times(root: &Area<'_>, all: &[LatencyHistogram], period_us: f64) -> DrawResult {
    let ends = |t: &LatencyHistogram| (t.first, t.first * t.ratio.powi(t.counts.len() as i32));
    let from = all.iter().map(|t| ends(t).0).fold(period_us, f64::min);
    let to = all.iter().map(|t| ends(t).1).fold(period_us * 1.3, f64::max);
    let most = all.iter().flat_map(|t| &t.counts).max().map_or(1.0, |n| *n as f64 * 1.5);
    let mut chart = ChartBuilder::on(root)
        .margin(12)
        .x_label_area_size(42)
        .y_label_area_size(64)
        .build_cartesian_2d((from..to).log_scale(), (0.5..most).log_scale())?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(BLACK.mix(0.08))
        .label_style(("sans-serif", 14))
        .x_label_formatter(&|v| short(*v))
        .y_label_formatter(&|v| short(*v))
        .x_desc("us")
        .y_desc("cycles")
        .draw()?;
    for (times, colour) in all.iter().zip(super::COLOURS) {
        let edge = |i: usize| times.first * times.ratio.powi(i as i32);
        let steps = times.counts.iter().enumerate().flat_map(|(i, n)| {
            let n = (*n as f64).max(0.5);
            [(edge(i), n), (edge(i + 1), n)]
        });
        let [p50, p99, p99_9, max] = times.percentiles;
        let label = format!("{}: p50 {p50:.1}, p99 {p99:.1}, p99.9 {p99_9:.1}, max {max:.1} us", times.name);
        chart
            .draw_series(LineSeries::new(steps, colour.stroke_width(2)))?
            .label(label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
    }
    chart
        .draw_series(LineSeries::new([(period_us, 0.5), (period_us, most)], BLACK.mix(0.6)))?
        .label(format!("period {period_us:.0} us"))
        .legend(|(x, y)| PathElement::new([(x, y), (x + 16, y)], BLACK.mix(0.6)));
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .margin(20)
        .background_style(WHITE.mix(0.7))
        .label_font(("sans-serif", 14))
        .draw()
}
