//! Offline optimisation of a manoeuvre, (6), (8), (9)/(11), under the settings of a configuration.

use upswing_config::{
    Config, GivenError, LqrRecursion, PlannerSettings, ReplanSettings, TargetValue, TorqueForm,
};
use upswing_model::{JointVector, Sizes, State};
use upswing_ocp::interior_point::{self, NlpOptions, NlpSolution, NlpStatus};
use upswing_ocp::kkt::TargetRow;
use upswing_ocp::lqr::{LqrWeights, Recursion};
use upswing_ocp::multistart::{self, Search, limit_in_the_way};
use upswing_ocp::problem::{Problem, TorqueConstraint};
use upswing_ocp::qp::QpWeights;
use upswing_ocp::slab::{KnotParts as _, KnotVector};
use upswing_trajectory::Trajectory;
use xxhash_rust::xxh3::Xxh3;

/// The target (8) of manoeuvre number `manoeuvre` of the settings, at rest, with the values that a request gives, rad or m.
///
/// # Errors
/// Those of [`upswing_config::Manoeuvre::rows`].
pub fn target(config: &Config, manoeuvre: usize, given: &[f64]) -> Result<Vec<TargetRow>, GivenError> {
    let sizes = config.model.sizes();
    let rows = config.manoeuvres[manoeuvre].rows(&config.model, given)?;
    let at_rest = JointVector::zeros(sizes);
    let positions = rows
        .into_iter()
        .map(|(coefficients, value)| TargetRow { coefficients: State::new(&coefficients, &at_rest), value });
    Ok(positions.chain(velocities_zero(sizes)).collect())
}

/// The rows of a target at rest.
fn velocities_zero(sizes: Sizes) -> impl Iterator<Item = TargetRow> {
    (sizes.joints()..sizes.state()).map(move |i| TargetRow::unit(sizes, i, 0.0))
}

/// The optimisation problem (6), (8) from a start state (rad, rad/s) to `target` under the limits and weights of the settings.
pub fn problem(config: &Config, target: Vec<TargetRow>, start: State) -> Problem<'_> {
    let offline = &config.planner.offline;
    Problem {
        model: &config.model,
        limits: config.robot.planning,
        narrower: Vec::new(),
        torque: torque_constraint(config, offline.torque),
        input_weight: offline.input_weight,
        t_f: (offline.t_f_min, offline.t_f_max),
        intervals: offline.intervals,
        start,
        target,
    }
}

/// [`problem()`] for trajectories that the robot shall follow, those of the database and of replans: its limits are narrowed by
/// `replan.knot_margin`, because the trapezoidal rule constrains the knots only. They contain start and target nevertheless.
pub fn problem_with_margin(config: &Config, target: Vec<TargetRow>, start: State) -> Problem<'_> {
    let mut problem = problem(config, target, start);
    let share = 1.0 - config.planner.replan.knot_margin;
    let l = &mut problem.limits;
    let (middle, half) = ((l.q_max + l.q_min) * 0.5, (l.q_max - l.q_min) * 0.5);
    l.tau_max *= share;
    // A start outside the narrowed limits, or measured slightly outside the limits, must not make the first step infeasible.
    l.q_min = (middle - half * share).inf(&start.q());
    l.q_max = (middle + half * share).sup(&start.q());
    l.qd_max = (l.qd_max * share).sup(&start.qd().abs());
    for row in &problem.target {
        if let Some(i) = row.joint() {
            l.q_min[i] = l.q_min[i].min(row.value);
            l.q_max[i] = l.q_max[i].max(row.value);
        }
    }
    problem
}

/// The torque constraint (9), or (11) with the bound c of the settings.
pub fn torque_constraint(config: &Config, form: TorqueForm) -> TorqueConstraint {
    match (form, config.robot.coriolis_bound) {
        (TorqueForm::Paper, Some(bound)) => {
            TorqueConstraint::WithoutCoriolis { lower: bound.lower, upper: bound.upper }
        }
        // Settings with (11) and without a bound are refused when they are read.
        _ => TorqueConstraint::Exact,
    }
}

/// XXH3 hash of the inputs of the database of a manoeuvre other than the robot: limits, knot margin, torque constraint, weights, target,
/// dimensions. Where a request gives a value, or it follows from the rest of the target, that fact counts instead of a value.
pub fn problem_fingerprint(config: &Config, manoeuvre: usize) -> u64 {
    let sizes = config.model.sizes();
    let manoeuvre = &config.manoeuvres[manoeuvre];
    let p = problem(config, Vec::new(), State::zeros(sizes));
    let at_rest = JointVector::zeros(sizes);
    let mut hash = Xxh3::new();
    let mut put = |v: f64| hash.update(&v.to_le_bytes());
    let l = &p.limits;
    [&l.q_min, &l.q_max, &l.qd_max]
        .into_iter()
        .flat_map(|v| v.iter())
        .chain(l.tau_max.iter())
        .for_each(|v| put(*v));
    let (lower, upper) = p.torque.bounds(&l.tau_max);
    lower.iter().chain(upper.iter()).for_each(|v| put(*v));
    put(f64::from(u8::from(p.torque == TorqueConstraint::Exact)));
    let margin = config.planner.replan.knot_margin;
    [margin, p.input_weight, p.t_f.0, p.t_f.1].into_iter().for_each(&mut put);
    for row in &manoeuvre.target {
        State::new(&row.coefficients, &at_rest).iter().for_each(|v| put(*v));
        put(match row.value {
            TargetValue::Fixed(value) => value,
            TargetValue::Given(_) => f64::INFINITY,
            TargetValue::Rest => f64::NEG_INFINITY,
        });
    }
    for row in velocities_zero(sizes) {
        row.coefficients.iter().for_each(|v| put(*v));
        put(row.value);
    }
    [sizes.state(), sizes.actuated(), p.intervals].into_iter().for_each(|n| put(n as f64));
    hash.digest()
}

/// Solves a problem of this module; the solutions of `neighbours` are further initial guesses. A time budget in `options` applies to each
/// guess.
pub fn optimize(
    problem: &Problem<'_>,
    search: Search,
    neighbours: &[Trajectory],
    options: &NlpOptions<'_>,
) -> NlpSolution {
    let mut best = multistart::solve(problem, search, neighbours, options);
    if matches!(best.status, NlpStatus::Infeasible(_))
        && let Some(limit) = limit_in_the_way(problem, options)
    {
        best.status = NlpStatus::Infeasible(limit);
    }
    best
}

/// Optimises a trajectory for a database, from a start state (rad, rad/s) to `target`: within the limits of the settings, and from there
/// [with the knot margin](problem_with_margin). Of several families of solutions the guesses of a search find fewer within narrower limits.
pub fn optimize_entry(
    config: &Config,
    target: Vec<TargetRow>,
    start: State,
    neighbours: &[Trajectory],
    options: &NlpOptions<'_>,
) -> NlpSolution {
    let narrower = problem_with_margin(config, target.clone(), start);
    let widest = optimize(&problem(config, target, start), Search::Best, neighbours, options);
    match widest.status {
        NlpStatus::Solved => {}
        NlpStatus::Interrupted => return widest,
        _ => return optimize(&narrower, Search::Best, neighbours, options),
    }
    let near = interior_point::solve(&narrower, &widest.trajectory, options);
    match near.status {
        NlpStatus::Solved | NlpStatus::Interrupted => near,
        _ => optimize(&narrower, Search::Best, neighbours, options),
    }
}

/// The options of the interior-point method in the settings; no time budget.
pub fn options(config: &Config) -> NlpOptions<'static> {
    let offline = &config.planner.offline;
    NlpOptions {
        tolerance: offline.tolerance,
        max_iterations: offline.max_iterations,
        time_budget: None,
        cancelled: None,
    }
}

/// The weights of the settings for the gains (20), and for the gain that balances at x_N.
pub fn lqr_weights(settings: &PlannerSettings, sizes: Sizes) -> LqrWeights {
    let PlannerSettings { lqr: weights, balance, .. } = settings;
    let mut q = State::zeros(sizes);
    q.q_mut().fill(weights.q_angles);
    q.qd_a_mut().fill(weights.q_velocities_actuated);
    q.qd_u_mut().fill(weights.q_velocities_unactuated);
    let mut q_end = q;
    q_end.q_a_mut().fill(balance.q_angles_actuated);
    q_end.q_u_mut().fill(balance.q_angles_unactuated);
    LqrWeights { q, q_end, r: weights.r }
}

/// How the settings compute (23).
pub fn lqr_recursion(settings: &PlannerSettings) -> Recursion {
    match settings.lqr.recursion {
        LqrRecursion::Extrapolated => Recursion::Extrapolated,
        LqrRecursion::Periods => Recursion::Periods,
    }
}

/// The weights of the settings for the objective (17) of a replan.
pub fn qp_weights(settings: &ReplanSettings) -> QpWeights {
    let ReplanSettings { weight_q, weight_qd, weight_u, .. } = settings;
    let mut z = KnotVector::zeros(weight_q.sizes());
    z.x_mut().copy_from_slice(&State::new(weight_q, weight_qd));
    z.u_mut().copy_from_slice(weight_u);
    QpWeights { t_f: settings.weight_t_f, z }
}
