//! Continuous replanning: the rest of a running plan, planned again and again from the newest measured state (model predictive control with a
//! shrinking horizon).
//!
//! A step predicts the state in which the system will be when the new plan takes over, and solves a few QPs (16) around the rest of the
//! running plan, with that state as x_0 and the same target. The gains are those of (23), as for any plan.

use crate::offline::{lqr_recursion, lqr_weights, qp_weights, target};
use crate::predict;
use crate::replan::{Method, Planner, PlanningFailure, solution_of};
use upswing_model::{State, Workspace};
use upswing_ocp::kkt::TargetRow;
use upswing_ocp::lqr;
use upswing_ocp::problem::Problem;
use upswing_ocp::qp::{Backend, Qp, QpOptions, QpSolver, QpStatus, QpWeights};
use upswing_trajectory::{Plan, PlanCriteria, Trajectory};

/// Tolerance and complementarity of a QP. A plan lives for some hundredths of a second: what they leave is less than the resolution of an
/// encoder.
const TOLERANCE: f64 = 1e-6;
const COMPLEMENTARITY: f64 = 1e-7;
/// Most QPs of a step under the same limits. Where they do not close the defect, the feedback compensates what is left until the next step.
const LINEARISATIONS: usize = 3;
/// Weight of the duration relative to that of a replan: there are a hundred steps in a motion, each may prolong the rest, and none shortens it
/// again, because limits are active.
const DURATION_WEIGHT: f64 = 10.0;
/// Share of the rated velocities and torques that a step may use where no motion keeps the limits of plans. The rest is for the feedback.
const RATED_SHARE: f64 = 0.9;
/// Shortest duration of the rest, s: it only keeps the duration above 0.
const SHORTEST: f64 = 0.05;

/// A motion that follows a plan, as measured.
#[derive(Clone, Copy, Debug)]
pub struct TrackedMotion<'a> {
    /// The running plan.
    pub plan: &'a Plan,
    /// Time of the plan at the measurement, s.
    pub t: f64,
    /// Measured positions and estimated velocities, rad and rad/s.
    pub x: State,
    /// Time of the measurement on the daemon's clock, ns.
    pub t_ns: u64,
}

/// Replanning of one manoeuvre while its plan is tracked, with its memory.
pub struct ContinuousReplanning<'a> {
    planner: &'a Planner,
    target: Vec<TargetRow>,
    weights: QpWeights,
    solver: QpSolver,
    /// Whether the solver has the multipliers of the step before.
    warm: bool,
    work: Workspace,
}

impl<'a> ContinuousReplanning<'a> {
    /// Begins with a first `plan` of the manoeuvre number `manoeuvre` of the settings for `given` values (rad or m). A reversal ends where its
    /// first plan ends.
    ///
    /// # Errors
    /// [`PlanningFailure::Target`] if the given values make no target.
    pub fn new(
        planner: &'a Planner,
        manoeuvre: usize,
        given: &[f64],
        plan: &Plan,
    ) -> Result<Self, PlanningFailure> {
        let config = planner.config();
        let (sizes, end) = (config.model.sizes(), plan.trajectory.end());
        let weights = qp_weights(&config.planner.replan);
        let target = match config.manoeuvres[manoeuvre].reverses {
            None => target(config, manoeuvre, given)?,
            Some(_) => (0..sizes.state()).map(|i| TargetRow::unit(sizes, i, end[i])).collect(),
        };
        Ok(Self {
            planner,
            target,
            weights: QpWeights { t_f: DURATION_WEIGHT * weights.t_f, ..weights },
            solver: QpSolver::new(Backend::Structured, sizes, plan.trajectory.intervals()),
            warm: false,
            work: Workspace::default(),
        })
    }

    /// Plans the rest of `motion` again: the plan takes over `lead` ns after the measurement. `None` if less than the shortest rest of the settings
    /// would be left then.
    ///
    /// # Errors
    /// [`PlanningFailure`]; the running plan remains the best one.
    pub fn step(&mut self, motion: &TrackedMotion<'_>, lead: u64) -> Result<Option<Plan>, PlanningFailure> {
        let config = self.planner.config();
        let (plan, seconds) = (motion.plan, lead as f64 * 1e-9);
        let t_0 = motion.t + seconds;
        if plan.trajectory.t_f - t_0 < config.planner.continuous.shortest_rest {
            return Ok(None);
        }
        let criteria = config.replacement_criteria();
        let start = predict::tracked(
            &config.model,
            &criteria.delays,
            plan,
            motion.t,
            &motion.x,
            seconds,
            &mut self.work,
        );
        let reference = rest(plan, t_0);
        let mut problem = self.planner.problem(self.target.clone(), &start);
        problem.t_f.0 = SHORTEST;
        let mut adapted = self.adapt(&problem, &reference, &criteria);
        if adapted.is_err() {
            let (limits, rated) = (&mut problem.limits, &config.robot.limits);
            limits.qd_max = limits.qd_max.sup(&(rated.qd_max * RATED_SHARE));
            limits.tau_max = limits.tau_max.sup(&(rated.tau_max * RATED_SHARE));
            self.warm = false;
            adapted = self.adapt(&problem, &reference, &criteria);
        }
        let trajectory = adapted?;
        let gains = lqr::synthesize(
            &config.model,
            &trajectory,
            &lqr_weights(&config.planner, config.model.sizes()),
            config.daemon.cycle.period.seconds(),
            lqr_recursion(&config.planner),
            &mut self.work,
        )?;
        Ok(Some(Plan {
            activation_ns: Some(motion.t_ns.saturating_add(lead)),
            replaces: Some(plan.id),
            ..Plan::new(&config.model, trajectory, gains)
        }))
    }

    /// Adapts `reference` by QPs, each linearised around the result of the last one, until the defect is closed.
    fn adapt(
        &mut self,
        problem: &Problem<'_>,
        reference: &Trajectory,
        criteria: &PlanCriteria,
    ) -> Result<Trajectory, PlanningFailure> {
        let options = QpOptions { complementarity: COMPLEMENTARITY, ..QpOptions::new(TOLERANCE) };
        let closed = self.planner.config().daemon.plans.defect;
        let mut trajectory = reference.clone();
        for iteration in 1.. {
            let qp = Qp::new(problem, reference, &trajectory, &self.weights);
            let status = if self.warm {
                self.solver.solve_again(&qp, &options)
            } else {
                self.solver.solve(&qp, &options)
            };
            self.warm = status == QpStatus::Solved;
            let solution = solution_of(&self.solver, status, iteration)?;
            trajectory.t_f += solution.t;
            for (k, (x, u)) in trajectory.x.iter_mut().zip(&mut trajectory.u).enumerate() {
                *x += solution.z.x(k);
                *u += solution.z.u(k);
            }
            let f = trajectory.f(problem.model);
            let spline = trajectory.spline(&f);
            if spline.defect() <= closed || iteration == LINEARISATIONS {
                let unmet = |criterion| PlanningFailure::Criterion {
                    method: Method::Quadratic,
                    iterations: iteration,
                    criterion,
                };
                criteria.check_motion(problem.model, &spline).map_err(unmet)?;
                break;
            }
        }
        Ok(trajectory)
    }
}

/// The trajectory of `plan` from the time `t_0` (s) on, at as many knots.
fn rest(plan: &Plan, t_0: f64) -> Trajectory {
    let (spline, n) = (plan.spline(), plan.trajectory.intervals());
    let t_f = plan.trajectory.t_f - t_0;
    let time = |k: usize| t_0 + t_f * k as f64 / n as f64;
    Trajectory {
        t_f,
        x: (0..=n).map(|k| spline.state(time(k))).collect(),
        u: (0..=n).map(|k| spline.input(time(k))).collect(),
    }
}
