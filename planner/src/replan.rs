//! Replanning from a start near a database entry: (14)-(17), linearised again around each result.
//!
//! QPs only reach as far as the linearisation of an entry. Farther away, and where they end with a needlessly long
//! motion, the full optimisation (6) takes over, with the same limits: it takes some tenths of a second.
//!
//! A swing-down adapts an entry run backwards: with the velocities reversed it meets the same dynamics (without
//! friction), limits and torques, from upright to hanging at rest.

mod outcome;

pub use outcome::{Attempt, Method, NoPlan, Refusal, Replan, SecondOpinion, Statistics};

use crate::database::{DatabaseFile, NearestPose, Neighbour};
use crate::offline::{self, lqr_weights, problem, problem_fingerprint, qp_weights, torque_constraint};
use std::time::Instant;
use upswing_config::{Config, ConfigError, QpBackend};
use upswing_ipc::operator::Manoeuvre;
use upswing_model::{LimitKind, NU, NX, State, StateParts, Workspace};
use upswing_ocp::interior_point;
use upswing_ocp::kkt::{KnotVector, TargetRow};
use upswing_ocp::lqr;
use upswing_ocp::multistart::{self, Search};
use upswing_ocp::problem::Problem;
use upswing_ocp::qp::{Backend, Options, Qp, Solution, Solver, Status};
use upswing_trajectory::{Database, DatabaseError, Entry, Gains, Margins, N, Trajectory, Unfit};

/// Accuracy of each QP. A tenth of the defect that four linearisations reach.
const QP_TOLERANCE: f64 = 1e-9;
/// Its complementarity: an entry, whose bounds are all touched without force, is found again to 1e-6 s.
const QP_COMPLEMENTARITY: f64 = 1e-12;

/// Distance to the nearest entry, rad, beyond which QPs are not tried where the full optimisation may be: half a diagonal of
/// a cell is 0.40 for the shipped grid and 0.53 for the paper's.
const REACH: f64 = 0.6;
/// How much longer a plan of QPs may take than the shortest of the nearest entries, whose duration is about that of the optimum.
/// The knot margin alone takes 1.5 %.
const LONGER: f64 = 1.035;
/// The same, of the shortest of as many entries as lie within two cells, which may not be near.
const MUCH_LONGER: f64 = 1.06;
const AROUND: usize = 24;
/// How often bounds are narrowed for what a trajectory exceeds between its knots.
const NARROWED: usize = 20;

/// A trajectory from the start that the daemon would accept.
struct Accepted {
    trajectory: Trajectory,
    gains: Gains,
    method: Method,
    iterations: usize,
    defect: f64,
    margins: Margins,
}

/// How much may be spent on a plan.
#[derive(Clone, Copy)]
pub struct Effort<'a> {
    /// Most linearisations per entry, at least one; fewer where the defect closes before.
    pub iterations: usize,
    /// Whether to optimise in full where QPs do not lead to a plan with a closed defect and about the shortest duration.
    pub optimise: bool,
    /// No iteration of a solver is begun after this.
    pub deadline: Option<Instant>,
    /// Asked before each iteration of the structured solver, and before the first one of Clarabel: whether to stop, because the client
    /// is gone.
    pub cancelled: Option<&'a dyn Fn() -> bool>,
}

impl Effort<'_> {
    /// Without limits of time; with the full optimisation, but for one QP, the paper's mode.
    pub fn iterations(iterations: usize) -> Self {
        Self { iterations, optimise: iterations > 1, deadline: None, cancelled: None }
    }

    /// Whether the deadline has passed.
    fn out_of_time(&self) -> bool {
        self.deadline.is_some_and(|d| Instant::now() >= d)
    }

    /// Whether the client is gone.
    fn is_cancelled(&self) -> bool {
        self.cancelled.is_some_and(|cancelled| cancelled())
    }
}

/// Why there is no planner.
#[derive(Debug, thiserror::Error)]
pub enum PlannerError {
    /// The database cannot be read.
    #[error(transparent)]
    File(#[from] ConfigError),
    /// The database cannot be used.
    #[error("{origin}: {cause}")]
    Database {
        /// Where it comes from.
        origin: String,
        /// What is wrong with it.
        cause: DatabaseError,
    },
}

/// Replans from measured starts.
#[derive(Clone, Debug)]
pub struct Planner {
    config: Config,
    /// Where the entries come from.
    origin: String,
    entries: Vec<Entry>,
    /// Poses from which the entries start, and in which they end.
    starts: NearestPose,
    ends: NearestPose,
}

impl Planner {
    /// Plans with the database of the settings.
    ///
    /// # Errors
    /// [`PlannerError`] if the database is unreadable, damaged, or was made for another robot or other settings.
    pub fn new(config: Config) -> Result<Self, PlannerError> {
        let database = DatabaseFile::of(&config)?;
        Self::with_database(config, database)
    }

    /// Plans with another database than that of the settings.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_database(config: Config, database: DatabaseFile) -> Result<Self, PlannerError> {
        let DatabaseFile { bytes, origin } = database;
        let decoded = Database::decode(&bytes).and_then(|database| {
            database.entries_for(config.model.fingerprint(), problem_fingerprint(&config))
        });
        match decoded {
            Ok(entries) => Ok(Self::with_entries(config, origin, entries)),
            Err(cause) => Err(PlannerError::Database { origin, cause }),
        }
    }

    /// Plans with `entries` that were made for these settings; `origin` says where they come from.
    pub fn with_entries(config: Config, origin: String, entries: Vec<Entry>) -> Self {
        let poses = |knot: usize| entries.iter().map(move |e| pose(&e.trajectory.x[knot]));
        let metric = &config.planner.replan.metric;
        let (starts, ends) = (NearestPose::new(poses(0), metric), NearestPose::new(poses(N), metric));
        Self { config, origin, entries, starts, ends }
    }

    /// The settings.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Where the database comes from, for messages.
    pub fn origin(&self) -> &str {
        &self.origin
    }

    /// The entries of the database.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// The entries nearest to a start state, nearest first.
    pub fn nearest(&self, manoeuvre: Manoeuvre, start: &State) -> Vec<Neighbour> {
        self.tree(manoeuvre).nearest(&pose(start), self.config.planner.replan.neighbours)
    }

    /// The poses in which trajectories of a manoeuvre begin.
    fn tree(&self, manoeuvre: Manoeuvre) -> &NearestPose {
        match manoeuvre {
            Manoeuvre::SwingUp => &self.starts,
            Manoeuvre::SwingDown => &self.ends,
        }
    }

    /// A QP solver as the settings ask for, with its memory.
    pub fn solver(&self) -> Solver {
        let settings = &self.config.planner.replan;
        let backend = match settings.backend {
            QpBackend::Structured => Backend::Structured,
            QpBackend::Clarabel => Backend::Clarabel,
        };
        Solver::new(backend, N / settings.sub_horizons)
    }

    /// A swing-up from `start` by [`Self::replan_with`] a new solver.
    ///
    /// # Errors
    /// [`NoPlan`] with the reason for each entry tried.
    pub fn replan(
        &self,
        start: &State,
        iterations: usize,
        deadline: Option<Instant>,
    ) -> Result<Replan, NoPlan> {
        let effort = Effort { deadline, ..Effort::iterations(iterations) };
        self.replan_with(&mut self.solver(), Manoeuvre::SwingUp, start, &effort)
    }

    /// Plans from `start` (rad, rad/s). What `solver` did before has no influence.
    ///
    /// # Errors
    /// [`NoPlan`] with the reason for each entry tried.
    pub fn replan_with(
        &self,
        solver: &mut Solver,
        manoeuvre: Manoeuvre,
        start: &State,
        effort: &Effort<'_>,
    ) -> Result<Replan, NoPlan> {
        let begin = Instant::now();
        let neighbours = self.nearest(manoeuvre, start);
        let mut statistics = Statistics { nearest: begin.elapsed(), ..Statistics::default() };
        let mut refused = Vec::new();
        let mut adapted = None;
        for entry in &neighbours {
            if effort.optimise && entry.distance > REACH {
                break;
            }
            match self.adapt(manoeuvre, start, entry.index, effort, solver, &mut statistics) {
                Ok(accepted) => {
                    adapted = Some((*entry, accepted));
                    break;
                }
                Err(refusal) => {
                    let no_time = matches!(refusal, Refusal::Deadline { .. } | Refusal::Cancelled { .. });
                    refused.push(Attempt { entry: *entry, refusal });
                    if no_time {
                        return Err(NoPlan {
                            refused,
                            optimisation: None,
                            second_opinions: statistics.second_opinions,
                        });
                    }
                }
            }
        }
        let mut optimisation = None;
        let shortest = |of: &[Neighbour]| {
            let durations = of.iter().map(|n| self.entries[n.index].trajectory.t_f);
            durations.fold(f64::INFINITY, f64::min)
        };
        // Nearer entries alone may all be of another, longer local optimum.
        let around = self.tree(manoeuvre).nearest(&pose(start), AROUND);
        let longest = (LONGER * shortest(&neighbours)).min(MUCH_LONGER * shortest(&around));
        let good = |(_, accepted): &(Neighbour, Accepted)| {
            accepted.defect <= self.config.planner.replan.defect && accepted.trajectory.t_f <= longest
        };
        if effort.optimise
            && !adapted.as_ref().is_some_and(good)
            && let Some(nearest) = neighbours.first()
        {
            match self.optimise(manoeuvre, start, nearest.index, effort, &mut statistics) {
                Ok(optimised) => adapted = Some((*nearest, optimised)),
                Err(refusal) => optimisation = Some(refusal),
            }
        }
        let Some((entry, accepted)) = adapted else {
            return Err(NoPlan { refused, optimisation, second_opinions: statistics.second_opinions });
        };
        statistics.total = begin.elapsed();
        let Accepted { trajectory, gains, method, iterations, defect, margins } = accepted;
        Ok(Replan { trajectory, gains, method, entry, refused, iterations, defect, margins, statistics })
    }

    /// The trajectory of an entry, backwards for a swing-down.
    fn reference(&self, manoeuvre: Manoeuvre, entry: usize) -> Trajectory {
        match manoeuvre {
            Manoeuvre::SwingUp => self.entries[entry].trajectory.clone(),
            Manoeuvre::SwingDown => self.entries[entry].trajectory.reversed(),
        }
    }

    /// The problem of a replan from `start`; a swing-down ends where `reference` ends.
    fn problem_of(
        &self,
        manoeuvre: Manoeuvre,
        start: &State,
        reference: &Trajectory,
        knot_margin: f64,
    ) -> Problem<'_> {
        let mut problem = self.problem_with_margin(start, knot_margin);
        if manoeuvre == Manoeuvre::SwingDown {
            let end = &reference.x[N];
            problem.target = (0..NX).map(|i| TargetRow::unit(i, end[i])).collect();
            keep_target_within(&mut problem);
        }
        problem
    }

    /// Adapts an entry by QPs, (14)-(17).
    fn adapt(
        &self,
        manoeuvre: Manoeuvre,
        start: &State,
        entry: usize,
        effort: &Effort<'_>,
        solver: &mut Solver,
        statistics: &mut Statistics,
    ) -> Result<Accepted, Refusal> {
        let iterations = effort.iterations.max(1);
        let reference = self.reference(manoeuvre, entry);
        let problem = self.problem_of(manoeuvre, start, &reference, self.config.planner.replan.knot_margin);
        let mut work = Workspace::default();
        let mut trajectory = reference.clone();
        let weights = qp_weights(&self.config.planner.replan);
        let begin = Instant::now();
        let (mut done, mut defect) = (0, f64::INFINITY);
        while done < iterations && !(defect <= self.config.planner.replan.defect) {
            done += 1;
            let qp = Qp::new(&problem, &reference, &trajectory, &weights, &mut work);
            self.move_by_qp(
                &qp,
                solver,
                (entry, done),
                effort,
                &mut trajectory,
                &mut statistics.second_opinions,
            )?;
            defect = trajectory.defect(&self.config.model, &mut work);
        }
        statistics.qp += begin.elapsed();
        self.accept(trajectory, Method::Quadratic, done, statistics)
    }

    /// Finds the optimum (6) as for a database entry, or from the nearest `entry`, and narrows the bounds where it exceeds a
    /// limit between knots: the intervals of a slow motion are long.
    fn optimise(
        &self,
        manoeuvre: Manoeuvre,
        start: &State,
        entry: usize,
        effort: &Effort<'_>,
        statistics: &mut Statistics,
    ) -> Result<Accepted, Refusal> {
        use interior_point::Status as Ending;
        let mut begin = Instant::now();
        let reference = self.reference(manoeuvre, entry);
        let halted = || effort.is_cancelled() || effort.out_of_time();
        let options = interior_point::Options { cancelled: Some(&halted), ..offline::options(&self.config) };
        let mut problem = self.problem_of(manoeuvre, start, &reference, 0.0);
        let mut solution = multistart::solve(&problem, Search::Best, None, &options);
        if solution.status != Ending::Solved {
            solution = interior_point::solve(&problem, &problem.shifted(&reference), &options);
        }
        let mut iterations = 0;
        // A plan that exceeds limits between its knots by no more than the daemon tolerates.
        let mut tolerable = None;
        for round in 0.. {
            statistics.optimisation += begin.elapsed();
            iterations += solution.iterations;
            // Of a stalled one all constraints are kept, too.
            if !matches!(solution.status, Ending::Solved | Ending::Stalled) {
                let ending = match solution.status {
                    _ if effort.is_cancelled() => Ending::Interrupted,
                    _ if effort.out_of_time() => Ending::OutOfTime,
                    ending => ending,
                };
                return tolerable.ok_or(Refusal::Optimisation(ending));
            }
            let found = solution.trajectory;
            let verdict = self.accept(found.clone(), Method::Optimisation, iterations, statistics);
            let exceeds = problem.narrow(&found);
            match verdict {
                Ok(plan) if exceeds && tolerable.is_none() => tolerable = Some(plan),
                Err(Refusal::Unfit { unfit: Unfit::Limit { kind, joint, got, highest, .. }, .. })
                    if tolerable.is_none() && round < NARROWED =>
                {
                    if kind == LimitKind::Torque {
                        problem.limits.tau_max[joint] -= 1.5 * (got.abs() - highest);
                    }
                }
                verdict => return verdict.or_else(|refusal| tolerable.ok_or(refusal)),
            }
            begin = Instant::now();
            solution = interior_point::solve(&problem, &found, &options);
            let solved = matches!(solution.status, Ending::Solved | Ending::Stalled);
            if !solved && tolerable.is_none() && !halted() {
                solution = multistart::solve(&problem, Search::Best, Some(&reference), &options);
            }
        }
        unreachable!("the last round returns")
    }

    /// Gives a trajectory its gains, if the daemon will accept both.
    fn accept(
        &self,
        trajectory: Trajectory,
        method: Method,
        iterations: usize,
        statistics: &mut Statistics,
    ) -> Result<Accepted, Refusal> {
        let mut work = Workspace::default();
        let begin = Instant::now();
        let model = &self.config.model;
        let criteria = self.config.plan_criteria();
        let unfit = |unfit| Refusal::Unfit { method, iterations, unfit };
        let f = trajectory.f(model, &mut work);
        let spline = trajectory.spline(&f);
        let margins = criteria.check_motion(model, &spline).map_err(unfit)?;
        let defect = spline.defect();
        statistics.check += begin.elapsed();
        let begin = Instant::now();
        let ts = self.config.daemon.cycle.period.seconds();
        let gains = lqr::synthesize(model, &trajectory, &lqr_weights(&self.config.planner), ts, &mut work)?;
        statistics.lqr += begin.elapsed();
        let begin = Instant::now();
        criteria.check_feedback(model, &trajectory, &gains).map_err(unfit)?;
        statistics.check += begin.elapsed();
        Ok(Accepted { trajectory, gains, method, iterations, defect, margins })
    }

    /// The problem of a replan: the limits with the margin that the trapezoidal rule needs between the knots.
    pub fn problem(&self, start: &State) -> Problem<'_> {
        self.problem_with_margin(start, self.config.planner.replan.knot_margin)
    }

    fn problem_with_margin(&self, start: &State, knot_margin: f64) -> Problem<'_> {
        let settings = &self.config.planner.replan;
        let mut problem = problem(&self.config, *start);
        problem.torque = torque_constraint(&self.config, settings.torque);
        let l = &mut problem.limits;
        let (middle, half) = ((l.q_max + l.q_min) * 0.5, (l.q_max - l.q_min) * 0.5);
        let share = 1.0 - knot_margin;
        l.tau_max *= share;
        // A start beyond these limits, or measured a hair outside, must not make the first step infeasible.
        l.q_min = (middle - half * share).inf(&start.q());
        l.q_max = (middle + half * share).sup(&start.q());
        l.qd_max = (l.qd_max * share).sup(&start.qd().abs());
        keep_target_within(&mut problem);
        problem
    }

    /// Solves one QP, or its sub-horizons one after the other, and moves the trajectory by the solution. Where the structured
    /// solver stalls, Clarabel solves the QP: it scales the program and compares objectives relatively, so that it
    /// also solves programs whose numbers are very large or very different.
    fn move_by_qp(
        &self,
        qp: &Qp,
        solver: &mut Solver,
        (entry, iteration): (usize, usize),
        effort: &Effort<'_>,
        trajectory: &mut Trajectory,
        second_opinions: &mut Vec<SecondOpinion>,
    ) -> Result<(), Refusal> {
        let options = Options {
            deadline: effort.deadline,
            cancelled: effort.cancelled,
            complementarity: QP_COMPLEMENTARITY,
            ..Options::new(QP_TOLERANCE)
        };
        // A solve that stalled leaves no multipliers to start from.
        let stalled_before =
            second_opinions.last().is_some_and(|o| o.entry == entry && o.iteration + 1 == iteration);
        let warm = iteration > 1 && !stalled_before;
        let mut solve = |qp: &Qp, again: bool| {
            let status = if again { solver.solve_again(qp, &options) } else { solver.solve(qp, &options) };
            if let (Status::Stalled(stall), Solver::Structured(_)) = (status, &*solver) {
                let mut second = Solver::new(Backend::Clarabel, qp.defects.len());
                let clarabel = second.solve(qp, &options);
                second_opinions.push(SecondOpinion { entry, iteration, stall, clarabel });
                return solution_of(&second, clarabel, iteration);
            }
            solution_of(solver, status, iteration)
        };
        let parts = self.config.planner.replan.sub_horizons;
        let length = N / parts;
        let mut z = vec![KnotVector::zeros(); N + 1];
        z[0].fixed_rows_mut::<NX>(0).copy_from(&qp.start);
        let mut dt = None;
        for first in (0..N).step_by(length) {
            let last = first + length;
            let solution = if parts == 1 {
                solve(qp, warm)?
            } else {
                solve(&qp.part((first, last), &z[first], dt), false)?
            };
            z[first..=last].copy_from_slice(&solution.z);
            dt = dt.or(Some(solution.t * parts as f64));
        }
        trajectory.t_f += dt.unwrap_or(0.0);
        for (k, dz) in z.iter().enumerate() {
            trajectory.x[k] += dz.fixed_rows::<NX>(0);
            trajectory.u[k] += dz.fixed_rows::<NU>(NX);
        }
        Ok(())
    }
}

/// What `solver` found in the linearisation `iteration`, or why it found nothing.
fn solution_of(solver: &Solver, status: Status, iteration: usize) -> Result<Solution, Refusal> {
    match status {
        Status::Solved => Ok(solver.solution().clone()),
        Status::Infeasible(conflict) => Err(Refusal::Infeasible { iteration, conflict }),
        Status::Deadline => Err(Refusal::Deadline { iteration }),
        Status::Cancelled => Err(Refusal::Cancelled { iteration }),
        Status::Stalled(stall) => Err(Refusal::Stalled { iteration, stall }),
    }
}

/// Widens the limits of position to what the target asks for: it may lie on a limit, which the knot margin would put out
/// of reach.
fn keep_target_within(problem: &mut Problem<'_>) {
    for row in &problem.target {
        if let Some(i) = row.joint() {
            let l = &mut problem.limits;
            l.q_min[i] = l.q_min[i].min(row.value);
            l.q_max[i] = l.q_max[i].max(row.value);
        }
    }
}

/// q_A of a state, rad.
fn pose(x: &State) -> [f64; NU] {
    std::array::from_fn(|i| x[i])
}
