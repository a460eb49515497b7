//! Picture of a plan and the trajectory from which it was adapted, as in the paper's Fig. 4.

use super::{CurvePair, POINTS, PanelStyle, PictureError, draw_panels, write};
use upswing_model::{ActuatedVector, Limits, Model, State, Workspace};
use upswing_process::output::OutputFile;
use upswing_trajectory::Trajectory;

/// Samples of the spline (12) of a trajectory, with the torques (9).
struct Samples {
    t: Vec<f64>,
    x: Vec<State>,
    tau: Vec<ActuatedVector>,
}

impl Samples {
    fn of(trajectory: &Trajectory, model: &Model) -> Self {
        let mut work = Workspace::default();
        let f = trajectory.f(model);
        let spline = trajectory.spline(&f);
        let t: Vec<f64> = (0..=POINTS).map(|i| trajectory.t_f * i as f64 / POINTS as f64).collect();
        let x: Vec<State> = t.iter().map(|t| spline.state(*t)).collect();
        let tau = t.iter().zip(&x).map(|(t, x)| model.torque(x, &spline.input(*t), &mut work)).collect();
        Self { t, x, tau }
    }

    fn position(&self, i: usize, scale: f64) -> Vec<(f64, f64)> {
        self.t.iter().zip(&self.x).map(|(t, x)| (*t, x.q()[i] / scale)).collect()
    }

    fn velocity(&self, i: usize, scale: f64) -> Vec<(f64, f64)> {
        self.t.iter().zip(&self.x).map(|(t, x)| (*t, x.qd()[i] / scale)).collect()
    }

    fn torque(&self, i: usize, scale: f64) -> Vec<(f64, f64)> {
        self.t.iter().zip(&self.tau).map(|(t, tau)| (*t, tau[i] / scale)).collect()
    }
}

/// Draws `plan` solid and `reference` dashed, scaled by `limits`, as an SVG.
///
/// # Errors
/// [`PictureError`] if the picture could not be drawn or written.
pub fn draw(
    output: &OutputFile,
    model: &Model,
    limits: &Limits,
    plan: &Trajectory,
    reference: &Trajectory,
) -> Result<(), PictureError> {
    let look = PanelStyle { begin: 0.0, end: plan.t_f.max(reference.t_f), dashes: None };
    let (plan, reference) = (Samples::of(plan, model), Samples::of(reference, model));
    let drawing = draw_panels(&look, model, |i| {
        let c = model.order().coordinate(i);
        let curve = |values: &dyn Fn(&Samples) -> Vec<(f64, f64)>| CurvePair {
            solid: values(&plan),
            dashed: values(&reference),
        };
        [
            Some(curve(&|s| s.position(c, limits.largest_position(c)))),
            Some(curve(&|s| s.velocity(c, limits.qd_max[c]))),
            limits.tau_max.get(c).map(|tau_max| curve(&|s| s.torque(c, *tau_max))),
        ]
    })?;
    write(output, drawing.as_bytes())
}
