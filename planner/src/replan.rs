//! Replanning from a start state near a database entry: QPs (14)-(17), each linearised around the result of the last one.
//!
//! QPs converge only where the linearisation of an entry is accurate. Farther away, and where their plan takes needlessly
//! long, the full optimisation (6) follows, with the same limits: it takes some tenths of a second.
//!
//! A manoeuvre that reverses another one (a swing-down) adapts an entry of that one run backwards: with the velocities reversed it
//! meets the same dynamics (without friction), limits and torques, and ends at rest where the entry began.
//!
//! Without entries every plan is a full optimisation.

mod outcome;
mod summary;

pub use outcome::{FailedAttempt, Method, NoPlan, PlanningFailure, Replan, ReplanStatistics, SecondOpinion};
pub use summary::{MarginShares, PlanSummary};

use crate::database::{DatabaseFile, heading};
use crate::offline::{
    self, lqr_recursion, lqr_weights, problem, problem_fingerprint, problem_with_margin, qp_weights,
    torque_constraint,
};
use std::sync::Arc;
use std::time::Instant;
use tracing::warn;
use upswing_config::{Config, ConfigError, Manoeuvre, QpBackend};
use upswing_model::{JointVector, LimitKind, State, Workspace};
use upswing_ocp::interior_point::{self, NlpOptions, NlpStatus};
use upswing_ocp::kkt::TargetRow;
use upswing_ocp::lqr;
use upswing_ocp::multistart::{self, Search};
use upswing_ocp::problem::Problem;
use upswing_ocp::qp::{Backend, Qp, QpOptions, QpSolution, QpSolver, QpStatus};
use upswing_ocp::slab::Slab;
use upswing_process::shard::Shard;
use upswing_trajectory::{
    Database, DatabaseContents, DatabaseError, DatabaseSource, Entry, Gains, Margins, Neighbour, PoseOutcome,
    PoseRecord, Trajectory, UnmetCriterion,
};

/// Tolerance of each QP: a tenth of the defect that four linearisations reach.
const QP_TOLERANCE: f64 = 1e-9;
/// Complementarity tolerance of each QP: a replan from the start of an entry, where the multipliers of all active bounds are 0,
/// reproduces the duration of the entry to 1e-6 s.
const QP_COMPLEMENTARITY: f64 = 1e-12;

/// Distance to the nearest entry, rad or m, beyond which QPs are skipped if the full optimisation is allowed: half the diagonal of a
/// cell is 0.40 for the shipped grid of the arm's swing-up and 0.53 for the grid of the paper.
const REACH: f64 = 0.6;
/// Distance to an entry, rad or m, beyond which the full optimisation follows in any case where the request gives the target: a move takes
/// less time the less far it goes, and the duration of an entry says nothing about the optimum.
const SAME_MOVE: f64 = 0.05;
/// Largest ratio of the duration of a plan from QPs to that of the shortest of the nearest entries, which is about the optimum.
const LONGER: f64 = 1.035;
/// Largest ratio to the shortest of the [`AROUND`] nearest entries, not all of which are near.
const MUCH_LONGER: f64 = 1.06;
/// Number of entries within about two cells, where keys have more than one coordinate.
const AROUND: usize = 24;
/// Largest number of times that bounds are narrowed because a trajectory exceeds limits between its knots.
const NARROWED: usize = 20;

/// A trajectory from the requested start that meets the daemon's criteria of acceptance.
struct AcceptableTrajectory {
    trajectory: Trajectory,
    gains: Gains,
    method: Method,
    iterations: usize,
    defect: f64,
    margins: Margins,
}

/// What a plan is asked for.
#[derive(Clone, Copy)]
struct Wanted<'a> {
    /// Number of the manoeuvre in the settings.
    manoeuvre: usize,
    /// Values for the rows of its target that ask for one, rad or m.
    given: &'a [f64],
    /// rad, rad/s
    start: &'a State,
}

/// Limits on the computation of a plan.
#[derive(Clone, Copy)]
pub struct Effort<'a> {
    /// Largest number of linearisations per entry, at least 1; fewer if the defect is closed earlier.
    pub iterations: usize,
    /// Whether to run the full optimisation if QPs give no plan with a closed defect and about the shortest duration.
    pub optimise: bool,
    /// No iteration of a solver begins after this moment.
    pub deadline: Option<Instant>,
    /// Returns whether to stop, because the client has disconnected; called before each iteration of the structured solver and
    /// before the first iteration of Clarabel.
    pub cancelled: Option<&'a dyn Fn() -> bool>,
}

impl Effort<'_> {
    /// No time limit; with the full optimisation, except for one QP, the mode of the paper.
    pub fn iterations(iterations: usize) -> Self {
        Self { iterations, optimise: iterations > 1, deadline: None, cancelled: None }
    }

    /// Whether the deadline has passed.
    fn out_of_time(&self) -> bool {
        self.deadline.is_some_and(|d| Instant::now() >= d)
    }

    /// Whether the client has disconnected.
    fn is_cancelled(&self) -> bool {
        self.cancelled.is_some_and(|cancelled| cancelled())
    }
}

/// Error of loading the database of a planner.
#[derive(Debug, thiserror::Error)]
pub enum PlannerError {
    /// The database cannot be read.
    #[error(transparent)]
    File(#[from] ConfigError),
    /// The database cannot be used.
    #[error("{origin}: {cause}")]
    Database {
        /// Source of the database.
        origin: String,
        /// Error of the database.
        cause: DatabaseError,
    },
}

/// Planner of the manoeuvres of the settings from a measured start: settings and databases.
#[derive(Clone, Debug)]
pub struct Planner {
    config: Config,
    /// One per manoeuvre; that of a reversal is empty, because it runs the entries of another manoeuvre backwards.
    databases: Vec<ManoeuvreEntries>,
}

/// Database entries of a manoeuvre.
#[derive(Clone, Debug, Default)]
struct ManoeuvreEntries {
    /// Source of the entries, for messages.
    origin: String,
    /// `None` without entries.
    database: Option<Arc<Database>>,
}

impl ManoeuvreEntries {
    fn load(config: &Config, manoeuvre: usize, file: DatabaseFile) -> Result<Self, PlannerError> {
        let DatabaseFile { source, origin } = file;
        let checked = Database::load(source).and_then(|database| {
            database.check_for(&config.model, problem_fingerprint(config, manoeuvre)).map(|()| database)
        });
        match checked {
            Ok(database) => Ok(Self { origin, database: Some(Arc::new(database)) }),
            Err(cause) => Err(PlannerError::Database { origin, cause }),
        }
    }

    /// Durations of the entries, s.
    fn durations(&self) -> &[f64] {
        self.database.as_ref().map_or(&[], |database| database.durations())
    }
}

impl Planner {
    /// Creates a planner with the databases of the settings. A missing one is a warning: its manoeuvre is solved by the full
    /// optimisation.
    ///
    /// # Errors
    /// [`PlannerError`] if a database is unreadable, damaged, or was made for another robot or other settings, or if the solvers
    /// do not serve the robot.
    pub fn new(config: Config) -> Result<Self, PlannerError> {
        let mut databases = Vec::new();
        for (number, manoeuvre) in config.manoeuvres.iter().enumerate() {
            databases.push(match DatabaseFile::of(&config, number)? {
                Some(database) => ManoeuvreEntries::load(&config, number, database)?,
                None => {
                    if manoeuvre.reverses.is_none() {
                        let name = &manoeuvre.name;
                        warn!(
                            "no database of `{name}`, every plan is optimised in full; build it with `upswing db build \
                             --manoeuvre {name}`"
                        );
                    }
                    ManoeuvreEntries::default()
                }
            });
        }
        Ok(Self { config, databases })
    }

    /// Checks the databases of the settings as [`Planner::new`] does.
    ///
    /// # Errors
    /// [`PlannerError`] as [`Planner::new`].
    pub fn check_databases(config: &Config) -> Result<(), PlannerError> {
        (0..config.manoeuvres.len()).try_for_each(|number| {
            let database = DatabaseFile::of(config, number)?;
            database.map_or(Ok(()), |database| ManoeuvreEntries::load(config, number, database).map(|_| ()))
        })
    }

    /// Creates a planner with `database` for the manoeuvre number `manoeuvre`, and no other entries.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_database(
        config: Config,
        manoeuvre: usize,
        database: DatabaseFile,
    ) -> Result<Self, PlannerError> {
        let mut databases = vec![ManoeuvreEntries::default(); config.manoeuvres.len()];
        databases[manoeuvre] = ManoeuvreEntries::load(&config, manoeuvre, database)?;
        Ok(Self { config, databases })
    }

    /// Creates a planner with `entries` that were made for the manoeuvre number `manoeuvre` of these settings, and no others; `origin`
    /// names their source in messages.
    ///
    /// # Errors
    /// [`PlannerError::Database`] for an entry that no file may have.
    pub fn with_entries(
        config: Config,
        manoeuvre: usize,
        origin: String,
        entries: Vec<Entry>,
    ) -> Result<Self, PlannerError> {
        let Some(first) = entries.first() else {
            let mut databases = vec![ManoeuvreEntries::default(); config.manoeuvres.len()];
            databases[manoeuvre].origin = origin;
            return Ok(Self { config, databases });
        };
        let mut heading = heading(&config, manoeuvre, Shard::WHOLE);
        heading.intervals = first.trajectory.intervals();
        let record = |(pose, entry)| PoseRecord { pose, outcome: PoseOutcome::Solved(Box::new(entry)) };
        let records = (0..).zip(entries).map(record).collect();
        let bytes = DatabaseContents { heading, records }.encode();
        let file = DatabaseFile { source: DatabaseSource::Memory(bytes.into()), origin };
        Self::with_database(config, manoeuvre, file)
    }

    /// The settings.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Source of the database of a manoeuvre, for messages.
    pub fn origin(&self, manoeuvre: usize) -> &str {
        &self.databases[self.source(manoeuvre)].origin
    }

    /// Number of the database entries from which plans of a manoeuvre are adapted.
    pub fn entries(&self, manoeuvre: usize) -> usize {
        self.databases[self.source(manoeuvre)].durations().len()
    }

    /// Fingerprint of the database of a manoeuvre; 0 without one.
    pub fn fingerprint(&self, manoeuvre: usize) -> u64 {
        self.databases[self.source(manoeuvre)].database.as_ref().map_or(0, |database| database.fingerprint())
    }

    /// Reads a database entry from which plans of a manoeuvre are adapted.
    ///
    /// # Errors
    /// [`DatabaseError`] if it is damaged, or if there is none of this number.
    pub fn entry(&self, manoeuvre: usize, number: usize) -> Result<Entry, DatabaseError> {
        let database = self.databases[self.source(manoeuvre)].database.as_ref();
        database.map_or(Err(DatabaseError::Empty), |database| database.entry(number))
    }

    /// Number of the entries of all manoeuvres.
    pub fn entries_of_all(&self) -> usize {
        self.databases.iter().map(|database| database.durations().len()).sum()
    }

    /// The manoeuvre whose entries a manoeuvre adapts.
    fn source(&self, manoeuvre: usize) -> usize {
        self.config.manoeuvres[manoeuvre].reverses.unwrap_or(manoeuvre)
    }

    /// The `replan.neighbours` entries nearest to a start state (rad, rad/s) and `given` values (rad or m), nearest first. The first call for
    /// a reversal reads the ends of the entries; none if that fails.
    pub fn nearest(&self, manoeuvre: usize, given: &[f64], start: &State) -> Vec<Neighbour> {
        self.nearest_of(manoeuvre, given, start, self.config.planner.replan.neighbours)
    }

    fn nearest_of(&self, manoeuvre: usize, given: &[f64], start: &State, count: usize) -> Vec<Neighbour> {
        let ManoeuvreEntries { origin, database } = &self.databases[self.source(manoeuvre)];
        let Some(database) = database else { return Vec::new() };
        if self.config.manoeuvres[manoeuvre].reverses.is_none() {
            let metric = metric(&self.config, &self.config.manoeuvres[manoeuvre]);
            return database.keys().nearest(&key(start, given), &metric, count);
        }
        match database.ends() {
            Ok(ends) => ends.nearest(&start.q_a(), &self.config.planner.replan.metric, count),
            Err(e) => {
                warn!("{origin}: {e}; the plan is optimised in full");
                Vec::new()
            }
        }
    }

    /// A QP solver of the back end in the settings, with its memory.
    pub fn solver(&self) -> QpSolver {
        let settings = &self.config.planner.replan;
        let backend = match settings.backend {
            QpBackend::Structured => Backend::Structured,
            QpBackend::Clarabel => Backend::Clarabel,
        };
        QpSolver::new(
            backend,
            self.config.model.sizes(),
            self.config.planner.offline.intervals / settings.sub_horizons,
        )
    }

    /// Plans the first manoeuvre, which has no given values, from `start` (rad, rad/s): [`Self::replan_with`] a new solver.
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
        self.replan_with(&mut self.solver(), 0, &[], start, &effort)
    }

    /// Plans the manoeuvre number `manoeuvre` of the settings from `start` (rad, rad/s), with one `given` value (rad or m) for each row of
    /// its target that asks for one. Earlier solves of `solver` have no influence.
    ///
    /// # Errors
    /// [`NoPlan`] with the reason for each entry tried.
    pub fn replan_with(
        &self,
        solver: &mut QpSolver,
        manoeuvre: usize,
        given: &[f64],
        start: &State,
        effort: &Effort<'_>,
    ) -> Result<Replan, NoPlan> {
        let begin = Instant::now();
        let wanted = Wanted { manoeuvre, given, start };
        let neighbours = self.nearest(manoeuvre, given, start);
        let mut statistics = ReplanStatistics { nearest: begin.elapsed(), ..ReplanStatistics::default() };
        let durations = self.databases[self.source(manoeuvre)].durations();
        let shortest = |of: &[Neighbour]| of.iter().map(|n| durations[n.index]).fold(f64::INFINITY, f64::min);
        // The nearest entries may all belong to another, longer local optimum.
        let around = self.nearest_of(manoeuvre, given, start, around(key(start, given).len()));
        let longest = (LONGER * shortest(&neighbours)).min(MUCH_LONGER * shortest(&around));
        let near = match self.config.manoeuvres[manoeuvre].given().next() {
            None => f64::INFINITY,
            Some(_) => SAME_MOVE,
        };
        let good = |(entry, accepted): &(Neighbour, AcceptableTrajectory)| {
            accepted.defect <= self.config.planner.replan.defect
                && accepted.trajectory.t_f <= longest
                && entry.distance <= near
        };
        let mut failed = Vec::new();
        let mut adapted = None;
        // Without entries nothing but the full optimisation can give a plan.
        let optimise = effort.optimise || neighbours.is_empty();
        for entry in &neighbours {
            if optimise && entry.distance > REACH {
                break;
            }
            match self.adapt(&wanted, entry.index, effort, solver, &mut statistics) {
                Ok(accepted) => {
                    let found = (*entry, accepted);
                    // Where the full optimisation would follow, the next entry is tried first: its QPs take a tenth of the time.
                    let last = good(&found) || !optimise || entry.distance > near;
                    if last || adapted.is_none() {
                        adapted = Some(found);
                    }
                    if last {
                        break;
                    }
                }
                Err(failure) => {
                    let no_time = matches!(
                        failure,
                        PlanningFailure::Deadline { .. } | PlanningFailure::Cancelled { .. }
                    );
                    failed.push(FailedAttempt { entry: *entry, failure });
                    if no_time {
                        return Err(NoPlan {
                            failed,
                            optimisation: None,
                            second_opinions: statistics.second_opinions,
                        });
                    }
                }
            }
        }
        let mut optimisation = None;
        let mut plan = None;
        if optimise && !adapted.as_ref().is_some_and(good) {
            let nearest = neighbours.first().copied();
            match self.optimise(&wanted, nearest.map(|entry| entry.index), effort, &mut statistics) {
                Ok(optimised) => plan = Some((nearest, optimised)),
                Err(failure) => optimisation = Some(Box::new(failure)),
            }
        }
        let Some((entry, accepted)) = plan.or(adapted.map(|(entry, accepted)| (Some(entry), accepted)))
        else {
            return Err(NoPlan { failed, optimisation, second_opinions: statistics.second_opinions });
        };
        statistics.total = begin.elapsed();
        let AcceptableTrajectory { trajectory, gains, method, iterations, defect, margins } = accepted;
        Ok(Replan { trajectory, gains, method, entry, failed, iterations, defect, margins, statistics })
    }

    /// The trajectory of an entry, run backwards for a reversal.
    fn reference(&self, manoeuvre: usize, entry: usize) -> Result<Trajectory, DatabaseError> {
        let trajectory = self.entry(manoeuvre, entry)?.trajectory;
        Ok(match self.config.manoeuvres[manoeuvre].reverses {
            None => trajectory,
            Some(_) => trajectory.reversed(),
        })
    }

    /// The target of a replan. A reversal ends where `reference` ends; without reference the arm ends in the pose in which it begins,
    /// and the unactuated joints hang.
    fn target_of(
        &self,
        wanted: &Wanted<'_>,
        reference: Option<&Trajectory>,
    ) -> Result<Vec<TargetRow>, PlanningFailure> {
        let model = &self.config.model;
        let state = |x: &State| (0..x.len()).map(|i| TargetRow::unit(x.sizes(), i, x[i])).collect();
        Ok(match (self.config.manoeuvres[wanted.manoeuvre].reverses, reference) {
            (None, _) => offline::target(&self.config, wanted.manoeuvre, wanted.given)?,
            (Some(_), Some(reference)) => state(reference.end()),
            (Some(_), None) => {
                let mut q = JointVector::zeros(model.sizes());
                q.actuated_mut().copy_from_slice(&wanted.start.q_a());
                let q = model.rest_position(&q, &mut Workspace::default())?;
                state(&State::new(&q, &JointVector::zeros(model.sizes())))
            }
        })
    }

    /// Adapts an entry by QPs, (14)-(17).
    fn adapt(
        &self,
        wanted: &Wanted<'_>,
        entry: usize,
        effort: &Effort<'_>,
        solver: &mut QpSolver,
        statistics: &mut ReplanStatistics,
    ) -> Result<AcceptableTrajectory, PlanningFailure> {
        let iterations = effort.iterations.max(1);
        let mut reference = self.reference(wanted.manoeuvre, entry)?;
        let problem = self.problem(self.target_of(wanted, Some(&reference))?, wanted.start);
        let mut trajectory = reference.clone();
        let settings = &self.config.planner.replan;
        reference.t_f *= 1.0 - settings.shortening;
        let weights = qp_weights(settings);
        let begin = Instant::now();
        let (mut done, mut defect) = (0, f64::INFINITY);
        while done < iterations && !(defect <= settings.defect) {
            done += 1;
            let qp = Qp::new(&problem, &reference, &trajectory, &weights);
            self.move_by_qp(
                &qp,
                solver,
                (entry, done),
                effort,
                &mut trajectory,
                &mut statistics.second_opinions,
            )?;
            defect = trajectory.defect(&self.config.model);
        }
        statistics.qp += begin.elapsed();
        self.accept(trajectory, Method::Quadratic, done, statistics)
    }

    /// Solves the full optimisation (6) as for a database entry, then from the nearest `entry`, if there is one, if that fails, and
    /// narrows the bounds where the result exceeds a limit between knots: the intervals of a slow motion are long.
    fn optimise(
        &self,
        wanted: &Wanted<'_>,
        entry: Option<usize>,
        effort: &Effort<'_>,
        statistics: &mut ReplanStatistics,
    ) -> Result<AcceptableTrajectory, PlanningFailure> {
        let mut begin = Instant::now();
        let reference = entry.map(|entry| self.reference(wanted.manoeuvre, entry)).transpose()?;
        let halted = || effort.is_cancelled() || effort.out_of_time();
        let options = NlpOptions { cancelled: Some(&halted), ..offline::options(&self.config) };
        let mut problem = self.with_torque(problem(
            &self.config,
            self.target_of(wanted, reference.as_ref())?,
            *wanted.start,
        ));
        let mut solution = multistart::solve(&problem, Search::Quick, &[], &options);
        if solution.status != NlpStatus::Solved
            && let Some(reference) = &reference
        {
            solution = interior_point::solve(&problem, &problem.shifted(reference), &options);
        }
        let mut iterations = 0;
        // A plan that exceeds limits between its knots by no more than the daemon tolerates.
        let mut tolerable = None;
        for round in 0.. {
            statistics.optimisation += begin.elapsed();
            iterations += solution.iterations;
            // A stalled solution satisfies all constraints, too.
            if !matches!(solution.status, NlpStatus::Solved | NlpStatus::Stalled) {
                let ending = match solution.status {
                    _ if effort.is_cancelled() => NlpStatus::Interrupted,
                    _ if effort.out_of_time() => NlpStatus::OutOfTime,
                    ending => ending,
                };
                return tolerable.ok_or(PlanningFailure::Optimisation(ending));
            }
            let found = solution.trajectory;
            let verdict = self.accept(found.clone(), Method::Optimisation, iterations, statistics);
            let exceeds = problem.narrow(&found);
            match verdict {
                Ok(plan) if exceeds && tolerable.is_none() => tolerable = Some(plan),
                Err(PlanningFailure::Criterion {
                    criterion: UnmetCriterion::Limit { kind, joint, got, highest, .. },
                    ..
                }) if tolerable.is_none() && round < NARROWED => {
                    if kind == LimitKind::Torque {
                        problem.limits.tau_max[joint] -= 1.5 * (got.abs() - highest);
                    }
                }
                verdict => return verdict.or_else(|failure| tolerable.ok_or(failure)),
            }
            begin = Instant::now();
            solution = interior_point::solve(&problem, &found, &options);
            let solved = matches!(solution.status, NlpStatus::Solved | NlpStatus::Stalled);
            if !solved && tolerable.is_none() && !halted() {
                solution = multistart::solve(&problem, Search::Quick, reference.as_slice(), &options);
            }
        }
        unreachable!("the last round returns")
    }

    /// Synthesises the gains of a trajectory, if trajectory and gains meet the daemon's criteria of acceptance.
    fn accept(
        &self,
        trajectory: Trajectory,
        method: Method,
        iterations: usize,
        statistics: &mut ReplanStatistics,
    ) -> Result<AcceptableTrajectory, PlanningFailure> {
        let mut work = Workspace::default();
        let begin = Instant::now();
        let model = &self.config.model;
        let criteria = self.config.plan_criteria();
        let unmet = |criterion| PlanningFailure::Criterion { method, iterations, criterion };
        let f = trajectory.f(model);
        let spline = trajectory.spline(&f);
        let margins = criteria.check_motion(model, &spline).map_err(unmet)?;
        let defect = spline.defect();
        statistics.check += begin.elapsed();
        let begin = Instant::now();
        let ts = self.config.daemon.cycle.period.seconds();
        let gains = lqr::synthesize(
            model,
            &trajectory,
            &lqr_weights(&self.config.planner, model.sizes()),
            ts,
            lqr_recursion(&self.config.planner),
            &mut work,
        )?;
        statistics.lqr += begin.elapsed();
        let begin = Instant::now();
        criteria.check_feedback(model, &trajectory, &gains).map_err(unmet)?;
        statistics.check += begin.elapsed();
        Ok(AcceptableTrajectory { trajectory, gains, method, iterations, defect, margins })
    }

    /// The optimisation problem of a replan by QPs from `start` (rad, rad/s) to `target`.
    pub fn problem(&self, target: Vec<TargetRow>, start: &State) -> Problem<'_> {
        self.with_torque(problem_with_margin(&self.config, target, *start))
    }

    /// The problem with the torque constraint of replans.
    fn with_torque<'a>(&self, problem: Problem<'a>) -> Problem<'a> {
        Problem { torque: torque_constraint(&self.config, self.config.planner.replan.torque), ..problem }
    }

    /// Solves one QP, or its sub-horizons one after the other, and adds the solution to the trajectory. If the structured solver
    /// stalls, Clarabel solves the QP: it scales the program and compares objectives relatively, so that it also solves programs
    /// with very large or very different numbers.
    fn move_by_qp(
        &self,
        qp: &Qp,
        solver: &mut QpSolver,
        (entry, iteration): (usize, usize),
        effort: &Effort<'_>,
        trajectory: &mut Trajectory,
        second_opinions: &mut Vec<SecondOpinion>,
    ) -> Result<(), PlanningFailure> {
        let options = QpOptions {
            deadline: effort.deadline,
            cancelled: effort.cancelled,
            complementarity: QP_COMPLEMENTARITY,
            ..QpOptions::new(QP_TOLERANCE)
        };
        // A solve that stalled leaves no multipliers to start from.
        let stalled_before =
            second_opinions.last().is_some_and(|o| o.entry == entry && o.iteration + 1 == iteration);
        let warm = iteration > 1 && !stalled_before;
        let mut solve = |qp: &Qp, again: bool| {
            let status = if again { solver.solve_again(qp, &options) } else { solver.solve(qp, &options) };
            if let (QpStatus::Stalled(stall), QpSolver::Structured(_)) = (status, &*solver) {
                let mut second = QpSolver::new(Backend::Clarabel, qp.start.sizes(), qp.x.len());
                let clarabel = second.solve(qp, &options);
                second_opinions.push(SecondOpinion { entry, iteration, stall, clarabel });
                return solution_of(&second, clarabel, iteration);
            }
            solution_of(solver, status, iteration)
        };
        let parts = self.config.planner.replan.sub_horizons;
        let n = trajectory.intervals();
        let length = n / parts;
        let mut z = Slab::zeros(trajectory.sizes(), n + 1, 1);
        z.x_mut(0).copy_from_slice(&qp.start);
        let mut dt = None;
        for first in (0..n).step_by(length) {
            let last = first + length;
            let solution = if parts == 1 {
                solve(qp, warm)?
            } else {
                solve(&qp.part((first, last), &z.knot(first), dt), false)?
            };
            (first..=last).for_each(|k| z.set(k, &solution.z.knot(k - first)));
            dt = dt.or(Some(solution.t * parts as f64));
        }
        trajectory.t_f += dt.unwrap_or(0.0);
        for (k, (x, u)) in trajectory.x.iter_mut().zip(&mut trajectory.u).enumerate() {
            *x += z.x(k);
            *u += z.u(k);
        }
        Ok(())
    }
}

/// The solution of `solver` in the linearisation `iteration`, or the reason of its failure.
pub(crate) fn solution_of(
    solver: &QpSolver,
    status: QpStatus,
    iteration: usize,
) -> Result<QpSolution, PlanningFailure> {
    match status {
        QpStatus::Solved => Ok(solver.solution().clone()),
        QpStatus::Infeasible(conflict) => Err(PlanningFailure::Infeasible { iteration, conflict }),
        QpStatus::Deadline => Err(PlanningFailure::Deadline { iteration }),
        QpStatus::Cancelled => Err(PlanningFailure::Cancelled { iteration }),
        QpStatus::Stalled(stall) => Err(PlanningFailure::Stalled { iteration, stall }),
    }
}

/// Number of entries within about two cells, for keys of this many coordinates: on a line five, two on each side.
fn around(coordinates: usize) -> usize {
    if coordinates == 1 { 5 } else { AROUND }
}

/// Key of a plan in the search trees: q_A of its start, then the given values, rad or m.
pub fn key(start: &State, given: &[f64]) -> Vec<f64> {
    start.q_a().iter().chain(given).copied().collect()
}

/// Weights of the coordinates of the [`key`]s of a manoeuvre in the search of the nearest one: those of the actuated joints, then for each given value that of its joint.
pub fn metric(config: &Config, manoeuvre: &Manoeuvre) -> Vec<f64> {
    let metric = &config.planner.replan.metric;
    let of_given = manoeuvre.given().map(|axis| metric[axis.joint]);
    metric.iter().copied().chain(of_given).collect()
}
