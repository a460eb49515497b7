//! How costs grow with the size of a task; `bench/growth/run` calls it.
//!
//! - `measure`: over intervals and joints, one line `panel,curve,x,y` for each point. CPU times of one thread, medians.
//! - `table FILE`: such lines as Markdown tables.
//! - `draw FILE PICTURE`: such lines as a picture (SVG), a panel for each.

#[path = "../stages/chain.rs"]
mod chain;

use chain::{Chain, DURATION, cpu_us};
use plotters::prelude::*;
use std::error::Error;
use std::hint::black_box;
use std::path::Path;
use upswing_model::{Dims, Lanes, Linearization, Model, Workspace};
use upswing_ocp::interior_point::{self, NlpOptions, NlpStatus};
use upswing_ocp::qp::{Backend, QpOptions, QpSolver, QpStatus};

/// Numbers of intervals, for the chain with the sizes of the shipped robot.
const INTERVALS: [usize; 5] = [50, 100, 200, 400, 800];
const ROBOT: (usize, usize) = (9, 7);
/// Joints and actuated joints of the chains, with [`N`] intervals.
const CHAINS: [(usize, usize); 8] = [(2, 1), (3, 1), (4, 2), (6, 4), (8, 6), (9, 7), (12, 10), (16, 14)];
const N: usize = 100;
/// Turns, of which the median counts, and evaluations of derivatives in each.
const TURNS: usize = 11;
const EVALUATIONS: usize = 400;
/// Knots side by side, as in the optimisation.
const LANES: usize = 4;

/// Names of panels, and of their axes.
const PANELS: [(&str, &str, &str); 4] = [
    ("intervals", "intervals N", "time (ms)"),
    ("joints", "joints", "time per knot (us)"),
    ("entries", "entries of a database", "time (ms)"),
    ("cores", "cores", "wall time, 1 core = 1"),
];

/// A measured point.
struct Point {
    panel: String,
    curve: String,
    x: f64,
    y: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments.as_slice() {
        ["measure"] => measure(),
        ["table", file] => table(&read(Path::new(file))?),
        ["draw", file, picture] => draw(&read(Path::new(file))?, Path::new(picture))?,
        other => {
            return Err(
                format!("expected `measure`, `table FILE` or `draw FILE PICTURE`, got {other:?}").into()
            );
        }
    }
    Ok(())
}

/// Prints the points over intervals and joints.
fn measure() {
    for intervals in INTERVALS {
        let chain = Chain::new(ROBOT.0, ROBOT.1, intervals);
        let ([qp, qp_iteration], offline_iteration) = (qp_times(&chain), offline_time(&chain));
        let point = |curve: &str, us: f64| println!("intervals,{curve},{intervals},{:.4}", 1e-3 * us);
        point("QP", qp);
        point("iteration of a QP", qp_iteration);
        point("offline iteration", offline_iteration);
    }
    for (n, actuated) in CHAINS {
        let chain = Chain::new(n, actuated, N);
        let [first, both] = derivative_times(&chain.model);
        let [_, qp_iteration] = qp_times(&chain);
        let knots = (N + 1) as f64;
        let point = |curve: &str, us: f64| println!("joints,{curve},{n},{us:.4}");
        point("A and B", first);
        point("A and B with the Hessian", both);
        point("iteration of a QP", qp_iteration / knots);
    }
}

fn median(mut us: Vec<f64>) -> f64 {
    us.sort_by(f64::total_cmp);
    us[us.len() / 2]
}

/// CPU times of a QP from cold, and of one of its iterations, us.
fn qp_times(chain: &Chain) -> [f64; 2] {
    let qp = chain.qp();
    let mut solver = QpSolver::new(Backend::Structured, qp.sizes(), qp.intervals());
    let mut solve = || cpu_us(|| assert_eq!(solver.solve(&qp, &QpOptions::new(1e-9)), QpStatus::Solved));
    let us = median((0..TURNS).map(|_| solve()).collect());
    [us, us / solver.solution().iterations as f64]
}

/// CPU time of an iteration of the full optimisation, us.
fn offline_time(chain: &Chain) -> f64 {
    let problem = chain.problem();
    let options = NlpOptions { tolerance: 1e-9, max_iterations: 3000, time_budget: None, cancelled: None };
    let guess = problem.straight_line(DURATION);
    let solve = || {
        let mut iterations = 0;
        let us = cpu_us(|| {
            let solution = interior_point::solve(&problem, &guess, &options);
            assert_eq!(solution.status, NlpStatus::Solved);
            iterations = solution.iterations;
        });
        us / iterations as f64
    };
    median((0..TURNS).map(|_| solve()).collect())
}

/// CPU times per knot of the first derivatives of the dynamics, and of those and the Hessian, us.
fn derivative_times(model: &Model) -> [f64; 2] {
    let sizes = model.sizes();
    let number = |i: usize, lane: usize| (0.3 * (1 + i) as f64 + 0.1 * lane as f64).sin();
    let vector = |count: usize, from: usize| -> Vec<Lanes<LANES>> {
        (0..count).map(|i| Lanes(std::array::from_fn(|lane| number(from + i, lane)))).collect()
    };
    let (x, u) = (vector(sizes.state(), 0), vector(sizes.actuated(), 40));
    let (w, mu) = (vector(sizes.unactuated(), 80), vector(sizes.actuated(), 120));
    let (mut work, mut first) = (Workspace::default(), Linearization::new(sizes));
    let mut hessian = vec![Lanes([0.0; LANES]); sizes.knot() * sizes.knot_row()];
    [false, true].map(|second| {
        let mut turn = || {
            cpu_us(|| {
                for _ in 0..EVALUATIONS {
                    model.linearize(black_box(&x), black_box(&u), &mut work, &mut first);
                    if second {
                        model.hessian(&w, &mu, &first, &mut work, &mut hessian);
                    }
                    black_box((&first, &hessian));
                }
            }) / (EVALUATIONS * LANES) as f64
        };
        median((0..TURNS).map(|_| turn()).collect())
    })
}

fn read(path: &Path) -> Result<Vec<Point>, Box<dyn Error>> {
    let text = std::fs::read_to_string(path).map_err(|e| format!("{}: {e}", path.display()))?;
    text.lines()
        .map(|line| {
            let [panel, curve, x, y] = line.split(',').collect::<Vec<_>>()[..] else {
                return Err(format!("{}: expected panel,curve,x,y, got `{line}`", path.display()).into());
            };
            Ok(Point { panel: panel.into(), curve: curve.into(), x: x.parse()?, y: y.parse()? })
        })
        .collect()
}

/// The curves of a panel in the order of the file, each with its points.
fn curves<'a>(points: &'a [Point], panel: &str) -> Vec<(&'a str, Vec<(f64, f64)>)> {
    let mut curves: Vec<(&str, Vec<(f64, f64)>)> = Vec::new();
    for point in points.iter().filter(|point| point.panel == panel) {
        match curves.iter_mut().find(|(name, _)| *name == point.curve) {
            Some((_, points)) => points.push((point.x, point.y)),
            None => curves.push((&point.curve, vec![(point.x, point.y)])),
        }
    }
    curves
}

/// The values of x in a panel, sorted.
fn positions(points: &[Point], panel: &str) -> Vec<f64> {
    let mut positions: Vec<f64> = points.iter().filter(|p| p.panel == panel).map(|p| p.x).collect();
    positions.sort_by(f64::total_cmp);
    positions.dedup();
    positions
}

fn table(points: &[Point]) {
    for (panel, x_label, y_label) in PANELS {
        let curves = curves(points, panel);
        let names: Vec<&str> = curves.iter().map(|(name, _)| *name).collect();
        println!("\n| {x_label}; {y_label} | {} |\n|{}", names.join(" | "), "---|".repeat(names.len() + 1));
        for x in positions(points, panel) {
            let cells = curves
                .iter()
                .map(|(_, points)| points.iter().find(|p| p.0 == x).map_or("-".into(), |p| rounded(p.1)));
            println!("| {x} | {} |", cells.collect::<Vec<String>>().join(" | "));
        }
    }
}

/// Two or three digits.
fn rounded(v: f64) -> String {
    let digits = (1.0 - v.abs().max(1e-9).log10().floor()).clamp(0.0, 6.0) as usize;
    format!("{v:.digits$}")
}

fn draw(points: &[Point], picture: &Path) -> Result<(), Box<dyn Error>> {
    /// Of a panel, px.
    const PANEL: (u32, u32) = (480, 320);
    /// Colours that differ in print and for the colour-blind (Okabe, Ito 2008).
    const COLOURS: [RGBColor; 4] =
        [RGBColor(0, 114, 178), RGBColor(213, 94, 0), RGBColor(0, 158, 115), RGBColor(204, 121, 167)];
    let root = SVGBackend::new(picture, (2 * PANEL.0, 2 * PANEL.1)).into_drawing_area();
    root.fill(&WHITE)?;
    for ((panel, x_label, y_label), area) in PANELS.iter().zip(root.split_evenly((2, 2))) {
        let curves = curves(points, panel);
        let all = || curves.iter().flat_map(|(_, points)| points);
        let range = |values: &mut dyn Iterator<Item = f64>| {
            values.fold((f64::INFINITY, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)))
        };
        let (x, y) = (range(&mut all().map(|p| p.0)), range(&mut all().map(|p| p.1)));
        if !(x.0 < x.1) {
            continue;
        }
        let y = (0.8 * y.0, 1.5 * y.1);
        let decades = (-4..6).flat_map(|power| [1.0, 2.0, 5.0].map(|digit| digit * 10_f64.powi(power)));
        let ticks = decades.filter(|tick| (y.0..y.1).contains(tick)).collect();
        let mut chart = ChartBuilder::on(&area)
            .margin(10)
            .x_label_area_size(40)
            .y_label_area_size(56)
            .build_cartesian_2d(
                (0.95 * x.0..1.05 * x.1).log_scale().with_key_points(positions(points, panel)),
                (y.0..y.1).log_scale().with_key_points(ticks),
            )?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(BLACK.mix(0.08))
            .label_style(("sans-serif", 12))
            .x_label_formatter(&|v| v.to_string())
            .y_label_formatter(&|v| ((v * 1e4).round() / 1e4).to_string())
            .x_desc(*x_label)
            .y_desc(*y_label)
            .draw()?;
        for ((name, points), colour) in curves.iter().zip(COLOURS) {
            chart
                .draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?
                .label(*name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
            chart.draw_series(points.iter().map(|point| Circle::new(*point, 3, colour.filled())))?;
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperLeft)
            .background_style(WHITE.mix(0.8))
            .label_font(("sans-serif", 12))
            .draw()?;
    }
    root.present()?;
    Ok(())
}
