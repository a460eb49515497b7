//! Replanning from a start near a database entry: (14)-(17), linearised again around each result.

use crate::kkt::{KnotDynamics, KnotVector, TargetRow};
use crate::lqr::{self, Gains};
use crate::nearest::{NearestPose, Neighbour};
use crate::offline::{problem, problem_fingerprint, torque_constraint};
use crate::problem::{KnotDerivatives, Problem, TorqueConstraint};
use crate::qp::{Conflict, Options, Qp, Solver, Status, TorqueRows};
use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_model::{NU, NX, NZ, State, Workspace, position, state, velocity};
use upswing_trajectory::{Database, DatabaseError, Entry, Margins, N, Plan, Trajectory};

/// Accuracy of each QP. A tenth of the defect that four linearisations reach.
const QP_TOLERANCE: f64 = 1e-9;
/// Its complementarity: an entry, whose bounds are all touched without force, is found again to 1e-6 s.
const QP_COMPLEMENTARITY: f64 = 1e-12;
/// Points between two knots at which margins are checked.
const BETWEEN: usize = 4;
/// Share of a limit's range by which a spline may exceed a limit: a start is measured a hair outside.
const MARGIN_SLACK: f64 = 1e-3;

/// Largest defect (rad, rad/s per interval) of a replan that is accepted; the feedback absorbs it.
const LARGEST_DEFECT: f64 = 1e-3;

/// One neighbour that was tried.
#[derive(Clone, Debug)]
pub struct Attempt {
    /// The entry and its distance.
    pub entry: Neighbour,
    /// Why it was not used, `None` for the one that was.
    pub refused: Option<Refusal>,
}

/// Why a neighbour gave no plan.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The constraints of a QP cannot be met together.
    #[error("QP {iteration} is infeasible{}", conflict.map_or(String::new(), |c| format!(": it would exceed {c}")))]
    Infeasible {
        /// Which linearisation, from 1.
        iteration: usize,
        /// The limit that stands in the way, where the solver knows it.
        conflict: Option<Conflict>,
    },
    /// A QP was neither solved nor found infeasible.
    #[error("QP {iteration}: the solver made no progress")]
    Stalled {
        /// Which linearisation, from 1.
        iteration: usize,
    },
    /// The real dynamics are not met.
    #[error(
        "defect {defect:.1e} rad/s of the real dynamics after {iterations} QPs; expected at most {LARGEST_DEFECT:.0e}"
    )]
    Defect {
        /// Largest component of (6b).
        defect: f64,
        /// QPs solved.
        iterations: usize,
    },
    /// A limit is exceeded between the knots.
    #[error("{limit} limit of joint {} is exceeded by {:.2} % at {time:.3} s", joint + 1, -100.0 * share)]
    Limit {
        /// Position, velocity or torque.
        limit: &'static str,
        /// 0-based.
        joint: usize,
        /// Share of the range, negative.
        share: f64,
        /// s
        time: f64,
    },
    /// The time budget was used up.
    #[error("the time budget was used up before QP {iteration} was solved")]
    Deadline {
        /// The QP that was not begun or not finished, from 1.
        iteration: usize,
    },
    /// No stabilising gain at the end.
    #[error(transparent)]
    Gain(#[from] lqr::NotStabilisable),
}

/// Times of the steps of a replan.
#[derive(Clone, Copy, Debug, Default)]
pub struct Times {
    /// Search of the database.
    pub nearest: Duration,
    /// All QPs, with their linearisations.
    pub qp: Duration,
    /// Checks of the result on the real dynamics.
    pub check: Duration,
    /// Gains.
    pub lqr: Duration,
    /// Everything.
    pub total: Duration,
}

/// A replanned trajectory with its gains.
#[derive(Clone, Debug)]
pub struct Replan {
    /// The trajectory from the given start.
    pub trajectory: Trajectory,
    /// Its gains.
    pub gains: Gains,
    /// The entries tried, in order; the last one was used.
    pub attempts: Vec<Attempt>,
    /// Linearisations for the entry used.
    pub iterations: usize,
    /// Largest defect (6b) of the real dynamics.
    pub defect: f64,
    /// Margins to the limits, between knots too.
    pub margins: Margins,
    /// How long it took.
    pub times: Times,
}

/// No neighbour led to a plan.
#[derive(Clone, Debug)]
pub struct NoPlan {
    /// The entries tried, with the reasons.
    pub attempts: Vec<Attempt>,
}

impl std::fmt::Display for NoPlan {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "none of the {} nearest database entries could be adapted", self.attempts.len())?;
        for a in &self.attempts {
            if let Some(refusal) = &a.refused {
                write!(f, "; entry {} ({:.3} rad away): {refusal}", a.entry.index, a.entry.distance)?;
            }
        }
        Ok(())
    }
}

impl std::error::Error for NoPlan {}

/// A trajectory from the start, made of one entry.
struct Adapted {
    trajectory: Trajectory,
    gains: Gains,
    iterations: usize,
    defect: f64,
    margins: Margins,
}

/// Replans from measured starts.
#[derive(Clone, Debug)]
pub struct Planner {
    config: Config,
    entries: Vec<Entry>,
    tree: NearestPose,
}

impl Planner {
    /// Decodes the configuration's database and builds the tree.
    ///
    /// # Errors
    /// [`DatabaseError`] if the file is damaged or was made for another robot or other settings.
    pub fn new(config: Config) -> Result<Self, DatabaseError> {
        let database = Database::decode(&config.database.bytes)?;
        let entries = database.entries_for(config.model.fingerprint(), problem_fingerprint(&config))?;
        let poses = entries.iter().map(|e| pose(&e.trajectory.x[0]));
        let tree = NearestPose::new(poses, &config.planner.replan.metric);
        Ok(Self { config, entries, tree })
    }

    /// The settings.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The entries of the database.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// The nearest entries to a start state, nearest first.
    pub fn nearest(&self, start: &State) -> Vec<Neighbour> {
        self.tree.nearest(&pose(start), self.config.planner.replan.neighbours)
    }

    /// A QP solver as the settings ask for, with its memory.
    pub fn solver(&self) -> Solver {
        let settings = &self.config.planner.replan;
        Solver::new(settings.backend, N / settings.sub_horizons)
    }

    /// [`Self::replan_with`] a new solver.
    ///
    /// # Errors
    /// [`NoPlan`] with the reason for each entry tried.
    pub fn replan(
        &self,
        start: &State,
        iterations: usize,
        deadline: Option<Instant>,
    ) -> Result<Replan, NoPlan> {
        self.replan_with(&mut self.solver(), start, iterations, deadline)
    }

    /// Plans from `start` (rad, rad/s) with at most `iterations` linearisations per entry (at least one), fewer where
    /// the defect closes before. No iteration of a QP is begun after `deadline`. What `solver` did before has no influence.
    ///
    /// # Errors
    /// [`NoPlan`] with the reason for each entry tried.
    pub fn replan_with(
        &self,
        solver: &mut Solver,
        start: &State,
        iterations: usize,
        deadline: Option<Instant>,
    ) -> Result<Replan, NoPlan> {
        let begin = Instant::now();
        let neighbours = self.nearest(start);
        let mut times = Times { nearest: begin.elapsed(), ..Times::default() };
        let mut attempts: Vec<Attempt> = Vec::new();
        for entry in neighbours {
            match self.adapt(start, entry.index, iterations, deadline, solver, &mut times) {
                Ok(Adapted { trajectory, gains, iterations, defect, margins }) => {
                    attempts.push(Attempt { entry, refused: None });
                    times.total = begin.elapsed();
                    return Ok(Replan { trajectory, gains, attempts, iterations, defect, margins, times });
                }
                Err(refusal) => attempts.push(Attempt { entry, refused: Some(refusal) }),
            }
        }
        Err(NoPlan { attempts })
    }

    fn adapt(
        &self,
        start: &State,
        entry: usize,
        iterations: usize,
        deadline: Option<Instant>,
        solver: &mut Solver,
        times: &mut Times,
    ) -> Result<Adapted, Refusal> {
        let settings = &self.config.planner.replan;
        let problem = self.problem(start);
        let reference = &self.entries[entry].trajectory;
        let mut work = Workspace::default();
        let mut trajectory = reference.clone();
        let begin = Instant::now();
        let (mut done, mut defect) = (0, f64::INFINITY);
        while done < iterations.max(1) && !(defect <= settings.defect) {
            done += 1;
            if deadline.is_some_and(|d| Instant::now() >= d) {
                return Err(Refusal::Deadline { iteration: done });
            }
            let qp = self.qp(&problem, reference, &trajectory, &mut work);
            self.step(&qp, solver, done, deadline, &mut trajectory)?;
            defect = trajectory.defect(&self.config.model, &mut work);
        }
        times.qp += begin.elapsed();
        let begin = Instant::now();
        let margins = Margins::of(&trajectory, &self.config.model, &self.config.robot.planning, BETWEEN);
        times.check += begin.elapsed();
        // A NaN fails, too. With a single QP, the paper's mode, the defect is what it is.
        if iterations > 1 && !(defect <= LARGEST_DEFECT) {
            return Err(Refusal::Defect { defect, iterations: done });
        }
        for (limit, m) in [("position", &margins.q), ("velocity", &margins.qd), ("torque", &margins.tau)] {
            if !(m.share >= -MARGIN_SLACK) {
                return Err(Refusal::Limit { limit, joint: m.joint, share: m.share, time: m.time });
            }
        }
        let begin = Instant::now();
        let ts = self.config.daemon.cycle.period.as_secs_f64();
        let gains =
            lqr::synthesize(&self.config.model, &trajectory, &self.config.planner.lqr, ts, &mut work)?;
        times.lqr += begin.elapsed();
        Ok(Adapted { trajectory, gains, iterations: done, defect, margins })
    }

    /// The problem of a replan: the limits with the margin that the trapezoidal rule needs between the knots.
    pub fn problem(&self, start: &State) -> Problem<'_> {
        let settings = &self.config.planner.replan;
        let mut problem = problem(&self.config, *start);
        problem.torque = torque_constraint(&self.config, settings.torque);
        let l = &mut problem.limits;
        let (middle, half) = ((l.q_max + l.q_min) * 0.5, (l.q_max - l.q_min) * 0.5);
        let share = 1.0 - settings.knot_margin;
        l.tau_max *= share;
        // A start beyond these limits, or measured a hair outside, must not make the first step infeasible.
        l.q_min = (middle - half * share).inf(&position(start));
        l.q_max = (middle + half * share).sup(&position(start));
        l.qd_max = (l.qd_max * share).sup(&velocity(start).abs());
        problem
    }

    /// Solves one QP, or its sub-horizons one after the other, and moves the trajectory by the solution.
    fn step(
        &self,
        qp: &Qp,
        solver: &mut Solver,
        iteration: usize,
        deadline: Option<Instant>,
        trajectory: &mut Trajectory,
    ) -> Result<(), Refusal> {
        let options = Options { deadline, complementarity: QP_COMPLEMENTARITY, ..Options::new(QP_TOLERANCE) };
        let mut solve = |qp: &Qp, again: bool| match if again {
            solver.solve_again(qp, &options)
        } else {
            solver.solve(qp, &options)
        } {
            Status::Solved => Ok(solver.solution().clone()),
            Status::Infeasible(conflict) => Err(Refusal::Infeasible { iteration, conflict }),
            Status::Deadline => Err(Refusal::Deadline { iteration }),
            Status::Stalled => Err(Refusal::Stalled { iteration }),
        };
        let parts = self.config.planner.replan.sub_horizons;
        let length = N / parts;
        let mut z = vec![KnotVector::zeros(); N + 1];
        z[0].fixed_rows_mut::<NX>(0).copy_from(&qp.start);
        let mut dt = None;
        for first in (0..N).step_by(length) {
            let last = first + length;
            let solution = if parts == 1 {
                solve(qp, iteration > 1)?
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

    /// (16) linearised around `at`, for the deviation from `reference`.
    pub fn qp(
        &self,
        problem: &Problem<'_>,
        reference: &Trajectory,
        at: &Trajectory,
        work: &mut Workspace,
    ) -> Qp {
        let weights = &self.config.planner.replan.weights;
        let weight = KnotVector::from_fn(|i, _| match i {
            i if i < NX / 2 => weights.q[i],
            i if i < NX => weights.qd[i - NX / 2],
            i => weights.u[i - NX],
        });
        let (tau_min, tau_max) = problem.torque.bounds(&problem.limits.tau_max);
        let x_min = state(&problem.limits.q_min, &-problem.limits.qd_max);
        let x_max = state(&problem.limits.q_max, &problem.limits.qd_max);
        let mut dynamics = Vec::with_capacity(N + 1);
        let mut torque = Vec::with_capacity(N + 1);
        let mut gradient = Vec::with_capacity(N + 1);
        for k in 0..=N {
            let (x, u) = (&at.x[k], &at.u[k]);
            let knot = KnotDerivatives {
                dynamics: problem.model.derivatives(x, u, work),
                constraint: match problem.torque {
                    TorqueConstraint::Exact => None,
                    TorqueConstraint::WithoutCoriolis { .. } => {
                        Some(problem.model.derivatives_without_coriolis(x, u, work))
                    }
                },
            };
            dynamics.push(KnotDynamics::new(&knot.dynamics, x, u));
            let d = knot.torque();
            torque.push(TorqueRows {
                jacobian: nalgebra::SMatrix::<f64, NU, NZ>::from_fn(|i, j| {
                    if j < NX { d.tau_x[(i, j)] } else { d.tau_u[(i, j - NX)] }
                }),
                lower: tau_min - d.value.tau,
                upper: tau_max - d.value.tau,
            });
            let (dx, du) = (x - reference.x[k], u - reference.u[k]);
            gradient.push(KnotVector::from_fn(|i, _| weight[i] * if i < NX { dx[i] } else { du[i - NX] }));
        }
        let half_h = 0.5 * at.h();
        Qp {
            weight: vec![weight; N + 1],
            weight_t: weights.t_f,
            gradient,
            gradient_t: weights.t_f * (at.t_f - reference.t_f),
            h: at.h(),
            defects: (0..N)
                .map(|k| at.x[k + 1] - at.x[k] - (dynamics[k].f + dynamics[k + 1].f) * half_h)
                .collect(),
            dynamics,
            start: problem.start - at.x[0],
            target: problem
                .target
                .iter()
                .map(|row| TargetRow {
                    coefficients: row.coefficients,
                    value: row.value - row.coefficients.dot(&at.x[N]),
                })
                .collect(),
            x: (1..=N).map(|k| (x_min - at.x[k], x_max - at.x[k])).collect(),
            t: (problem.t_f.0 - at.t_f, problem.t_f.1 - at.t_f),
            torque,
            compliance: 0.0,
        }
    }
}

impl NoPlan {
    /// Whether time, not feasibility, was the reason.
    pub fn out_of_time(&self) -> bool {
        self.attempts.iter().any(|a| matches!(a.refused, Some(Refusal::Deadline { .. })))
    }
}

impl Replan {
    /// The plan the daemon executes.
    pub fn plan(&self, config: &Config) -> Plan {
        let mut work = Workspace::default();
        Plan {
            id: self.id(),
            fingerprint: config.model.fingerprint(),
            f: self.trajectory.f(&config.model, &mut work),
            trajectory: self.trajectory.clone(),
            gains: self.gains.knots.clone(),
            final_gain: self.gains.end,
        }
    }
}

impl Replan {
    /// A name that follows from the contents: equal plans have equal ids, different ones different ids.
    fn id(&self) -> u64 {
        let mut hash = xxhash_rust::xxh3::Xxh3::new();
        let t = &self.trajectory;
        let numbers = t.x.iter().flat_map(|x| x.iter()).chain(t.u.iter().flat_map(|u| u.iter()));
        numbers.chain(std::iter::once(&t.t_f)).for_each(|v| hash.update(&v.to_le_bytes()));
        hash.digest().max(1)
    }
}

/// q_A of a state, rad.
fn pose(x: &State) -> [f64; NU] {
    std::array::from_fn(|i| x[i])
}
