//! Evaluation of the first manoeuvre of the settings, such as a swing-up, from its telemetry: motion statistics and success.

use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use upswing_config::Config;
use upswing_ipc::operator::planning_text;
use upswing_ipc::{Mode, PlannerResponse, Telemetry};
use upswing_model::thresholds::{REPORT_POSITION_SLACK, REST_SHARE_REPORT, REST_SPEED_REPORT};
use upswing_model::{JointVector, Limits, Model, Posture, UnactuatedVector};

/// Figures of a motion: `T` is a number, or a statistic of the numbers of many motions.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct MotionFigures<T = f64> {
    /// Largest difference between a position of an actuated joint and its reference while tracking, rad or m.
    pub tracking_error_arm: T,
    /// Largest difference between a position of an unactuated joint and its reference while tracking, rad or m.
    pub tracking_error_pendulum: T,
    /// Largest share of the half of its 100 % position range that an actuated joint was away from the middle.
    pub peak_position: T,
    /// Largest share of the 100 % velocity limits that the actuated joints reached.
    pub peak_velocity: T,
    /// Largest share of the 100 % velocity limits that the unactuated joints reached while tracking or balancing.
    pub peak_velocity_pendulum: T,
    /// Largest share of the 100 % torque limits in the commanded torques, at most 1 because of the limiter.
    pub peak_torque: T,
    /// Share of the cycles of tracking and balancing in which the limiter cut a torque.
    pub limited_share: T,
    /// Largest difference between an unactuated joint and the end x_N of the plan in the last second of balance, deg; of a prismatic
    /// joint, 1 m counts as 1 rad.
    pub final_error_deg: T,
    /// Largest velocity of the actuated joints in the last second of balance, rad/s or m/s.
    pub final_speed: T,
}

impl MotionFigures {
    /// A statistic of each figure: `of` computes it, given the function that reads the figure of one motion.
    pub fn statistic<T>(of: impl Fn(fn(&Self) -> f64) -> T) -> MotionFigures<T> {
        MotionFigures {
            tracking_error_arm: of(|m| m.tracking_error_arm),
            tracking_error_pendulum: of(|m| m.tracking_error_pendulum),
            peak_position: of(|m| m.peak_position),
            peak_velocity: of(|m| m.peak_velocity),
            peak_velocity_pendulum: of(|m| m.peak_velocity_pendulum),
            peak_torque: of(|m| m.peak_torque),
            limited_share: of(|m| m.limited_share),
            final_error_deg: of(|m| m.final_error_deg),
            final_speed: of(|m| m.final_speed),
        }
    }
}

/// Statistics of a sequence of telemetry records.
#[derive(Clone, Debug, Serialize)]
pub struct MotionStatistics {
    /// Figures of the motion.
    #[serde(flatten)]
    pub motion: MotionFigures,
    /// Time in balance, s; for a manoeuvre that ends hanging, in Hold after its plan.
    pub balance_s: f64,
    /// Number of recorded cycles.
    pub cycles: u64,
    /// Number of records that were lost between daemon and recorder, or are of another robot.
    pub dropped: u64,
    /// Number of late cycles (clocks `wall` and `paced`).
    pub overruns: u64,
}

/// Evaluation of a swing-up, or of what else the first manoeuvre of the settings is: success, failures, plan and motion statistics.
#[derive(Clone, Debug, Serialize)]
pub struct SwingUpEvaluation {
    /// Name of the manoeuvre.
    pub manoeuvre: String,
    /// Posture in which it ends: standing, in Balance, or hanging, in Hold.
    #[serde(skip)]
    pub end: Posture,
    /// Whether the system stayed at the end of the plan within all limits.
    pub success: bool,
    /// Failed criteria as sentences; empty after a success.
    pub failures: Vec<String>,
    /// Duration of the plan t_F, s.
    pub t_f: f64,
    /// Time from the request to the plan, s.
    pub planning_s: f64,
    /// Index of the database entry that the plan was adapted from; none without a database.
    pub nearest_entry: Option<u64>,
    /// Weighted distance of the start to that entry, rad.
    pub distance: Option<f64>,
    /// Largest defect of the plan under the nonlinear dynamics, rad or rad/s per interval.
    pub defect: f64,
    /// Motion statistics of the records.
    #[serde(flatten)]
    pub statistics: MotionStatistics,
}

/// Largest distance of an unactuated joint from the end of the plan, deg.
const BALANCED_DEG: f64 = 2.0;

/// Largest share of the cycles in which the limiter may cut a torque. Assumed: while the limiter cuts, the loop is not the loop
/// for which the gains were computed; one hard push takes about 0.02 s in two seconds.
const LIMITED_SHARE: f64 = 0.01;

/// Angle of the rod from upright at joint positions q, rad: between the line from the last joint to the tip and the vertical.
pub fn tilt(model: &Model, q: &JointVector) -> f64 {
    let rod = model.rod(q);
    libm::acos((rod.z / rod.norm()).clamp(-1.0, 1.0))
}

/// Excess of a joint position over its limit, with the name of the joint and the record.
struct LimitExcess<'a> {
    /// rad or m
    by: f64,
    unit: &'static str,
    joint: &'a str,
    record: Option<&'a Telemetry>,
}

impl std::fmt::Display for LimitExcess<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "joint `{}` went {:.5} {} past its position limit", self.joint, self.by, self.unit)?;
        if let Some((record, mode)) = self.record.and_then(|r| Some((r, r.mode().ok()?))) {
            write!(f, " in mode {mode}, {:.3} s after the plan's start", record.t_plan)?;
        }
        Ok(())
    }
}

/// Accumulator of [`MotionStatistics`], one record after the other.
#[derive(Clone, Debug)]
pub struct MotionStatisticsCounter {
    /// Mode after the plan: Balance, or Hold for a manoeuvre that ends hanging.
    end_mode: Mode,
    /// q_U of the newest reference of a plan, rad or m.
    end_q_u: Option<UnactuatedVector>,
    /// Tracking errors and peaks; the other figures follow at the end.
    motion: MotionFigures,
    cycles: u64,
    /// Number of records of another robot, which do not count as cycles.
    foreign: u64,
    overruns: u64,
    /// Number of cycles of tracking and balancing.
    controlled: u64,
    /// Number of these cycles in which the limiter cut a torque.
    limited: u64,
    /// Sum of the times between successive balanced cycles, ns: by the clock, because a cycle missed between balanced cycles
    /// counts as balanced, too.
    balance_ns: u64,
    /// Number of phases of balance; each has one cycle more than intervals.
    balances: u64,
    /// Time of the preceding cycle if it was balanced, ns.
    balanced_ns: Option<u64>,
    /// Cycles of the last second of balance: time (ns), distance of the unactuated joints from x_N (rad or m), speed of the fastest actuated joint (rad/s or m/s).
    end: VecDeque<(u64, f64, f64)>,
}

impl MotionStatisticsCounter {
    /// Counts nothing yet; the manoeuvre ends in the posture `end`.
    pub fn new(end: Posture) -> Self {
        Self {
            end_mode: Mode::from_posture(end),
            end_q_u: None,
            motion: MotionFigures::default(),
            cycles: 0,
            foreign: 0,
            overruns: 0,
            controlled: 0,
            limited: 0,
            balance_ns: 0,
            balances: 0,
            balanced_ns: None,
            end: VecDeque::new(),
        }
    }

    /// Adds the next record.
    pub fn count(&mut self, model: &Model, limits: &Limits, t: &Telemetry) {
        /// One second, ns.
        const SECOND: u64 = 1_000_000_000;
        let Ok(vectors) = t.vectors(model.order()) else {
            self.foreign += 1;
            return;
        };
        let (q, qd) = (vectors.x.q(), vectors.x.qd());
        let motion = &mut self.motion;
        self.cycles += 1;
        self.overruns += u64::from(t.flags & Telemetry::OVERRUN != 0);
        let middle = (limits.q_max + limits.q_min) / 2.0;
        let reach = (limits.q_max - limits.q_min) / 2.0;
        let most =
            |shares: &[f64], before: f64| shares.iter().fold(before, |most, share| most.max(share.abs()));
        let speeds = qd.component_div(&limits.qd_max);
        motion.peak_position = most(&(q - middle).component_div(&reach).actuated(), motion.peak_position);
        motion.peak_velocity = most(&speeds.actuated(), motion.peak_velocity);
        motion.peak_torque = most(&vectors.tau.component_div(&limits.tau_max), motion.peak_torque);
        if matches!(t.mode(), Ok(Mode::Track | Mode::Balance)) {
            self.controlled += 1;
            self.limited += u64::from(t.flags & Telemetry::LIMITED != 0);
            motion.peak_velocity_pendulum = most(&speeds.unactuated(), motion.peak_velocity_pendulum);
        }
        if t.mode() == Ok(Mode::Track) {
            let error = q - vectors.x_d.q();
            motion.tracking_error_arm = most(&error.actuated(), motion.tracking_error_arm);
            motion.tracking_error_pendulum = most(&error.unactuated(), motion.tracking_error_pendulum);
        }
        if matches!(t.mode(), Ok(Mode::Track | Mode::Balance)) {
            self.end_q_u = Some(vectors.x_d.q_u());
        }
        let before = self.balanced_ns.take();
        if let Some(end_q_u) = self.end_q_u.filter(|_| t.mode() == Ok(self.end_mode)) {
            match before {
                Some(before) => self.balance_ns += t.t_ns.saturating_sub(before),
                None => self.balances += 1,
            }
            self.balanced_ns = Some(t.t_ns);
            // The time restarts with another plant.
            if self.end.back().is_some_and(|(last, ..)| t.t_ns < *last) {
                self.end.clear();
            }
            self.end.push_back((t.t_ns, (q.unactuated() - end_q_u).amax(), qd.actuated().amax()));
            while self.end.front().is_some_and(|(begin, ..)| t.t_ns.saturating_sub(*begin) >= SECOND) {
                self.end.pop_front();
            }
        }
    }

    /// The statistics of all records so far; `dropped`: number of lost records; `period`: control period, s.
    pub fn statistics(&self, period: f64, dropped: u64) -> MotionStatistics {
        let most = |of: fn(&(u64, f64, f64)) -> f64| match self.end.is_empty() {
            true => f64::NAN,
            false => self.end.iter().map(of).fold(0.0, f64::max),
        };
        MotionStatistics {
            motion: MotionFigures {
                limited_share: self.limited as f64 / self.controlled.max(1) as f64,
                final_error_deg: most(|end| end.1).to_degrees(),
                final_speed: most(|end| end.2),
                ..self.motion
            },
            balance_s: self.balance_ns as f64 * 1e-9 + self.balances as f64 * period,
            cycles: self.cycles,
            dropped: dropped + self.foreign,
            overruns: self.overruns,
        }
    }
}

impl<'a> LimitExcess<'a> {
    fn most(model: &'a Model, limits: &Limits, records: &'a [Telemetry]) -> Self {
        let mut most = Self { by: f64::NEG_INFINITY, unit: "", joint: "", record: None };
        for t in records {
            let Ok(vectors) = t.vectors(model.order()) else { continue };
            for (i, q) in vectors.x.q_a().iter().enumerate() {
                let by = (q - limits.q_max[i]).max(limits.q_min[i] - q);
                if by > most.by {
                    let (unit, joint) = (model.joint_kind(i).unit(), model.joint_name(i));
                    most = Self { by, unit, joint, record: Some(t) };
                }
            }
        }
        most
    }
}

impl SwingUpEvaluation {
    /// Evaluates the records of a swing-up that has to balance for `seconds`. `fastest`: the largest true speeds of all joints,
    /// rad/s or m/s, if a simulated plant provides them; they count in addition to the estimated speeds, which the filter smooths.
    pub fn new(
        config: &Config,
        plan: &PlannerResponse,
        records: &[Telemetry],
        dropped: u64,
        seconds: f64,
        fastest: Option<&JointVector>,
    ) -> Self {
        let limits = &config.robot.limits;
        let period = config.daemon.cycle.period.seconds();
        let first = config.manoeuvres.first();
        let (manoeuvre, end) = first.map_or((String::new(), Posture::Standing), |m| (m.name.clone(), m.end));
        let mut counter = MotionStatisticsCounter::new(end);
        records.iter().for_each(|record| counter.count(&config.model, limits, record));
        let mut statistics = counter.statistics(period, dropped);
        if let Some(fastest) = fastest {
            let shares = fastest.component_div(&limits.qd_max);
            let motion = &mut statistics.motion;
            motion.peak_velocity = shares.actuated().amax().max(motion.peak_velocity);
            motion.peak_velocity_pendulum = shares.unactuated().amax().max(motion.peak_velocity_pendulum);
        }
        let beyond = LimitExcess::most(&config.model, limits, records);
        let mut failures = Vec::new();
        let (s, m) = (&statistics, &statistics.motion);
        let at_rest = REST_SPEED_REPORT.max(REST_SHARE_REPORT * limits.qd_max.actuated().amax());
        let mut fail = |bad: bool, text: String| {
            if bad {
                failures.push(text);
            }
        };
        fail(
            !(m.final_error_deg <= BALANCED_DEG),
            format!(
                "an unactuated joint is {:.2} deg from the end of the plan in the last second, expected at most {BALANCED_DEG}",
                m.final_error_deg
            ),
        );
        fail(
            s.balance_s + 2.0 * period < seconds,
            format!("{} {:.3} s, expected {seconds} s", stayed(end).0, s.balance_s),
        );
        fail(
            !(m.final_speed <= at_rest),
            format!(
                "the actuated joints move at {:.3} rad/s or m/s in the last second, expected at most {at_rest:.3}",
                m.final_speed
            ),
        );
        fail(
            m.peak_velocity > 1.0,
            format!("a velocity reached {:.0} % of its limit", 100.0 * m.peak_velocity),
        );
        fail(
            m.peak_velocity_pendulum > 1.0,
            format!(
                "an unactuated joint reached {:.0} % of its velocity limit",
                100.0 * m.peak_velocity_pendulum
            ),
        );
        fail(
            m.limited_share > LIMITED_SHARE,
            format!(
                "torques were cut at their limit in {:.1} % of the cycles, expected at most {} %",
                100.0 * m.limited_share,
                100.0 * LIMITED_SHARE
            ),
        );
        fail(beyond.by > REPORT_POSITION_SLACK, beyond.to_string());
        fail(s.dropped > 0, format!("{} telemetry records were lost", s.dropped));
        Self {
            manoeuvre,
            end,
            success: failures.is_empty(),
            failures,
            t_f: plan.t_f,
            planning_s: plan.time_total_us * 1e-6,
            nearest_entry: plan.distance.is_finite().then_some(plan.nearest_entry),
            distance: Some(plan.distance).filter(|distance| distance.is_finite()),
            defect: plan.defect,
            statistics,
        }
    }
}

/// What the system did at the end of a plan that ends in a posture, and a word for its time there.
fn stayed(end: Posture) -> (&'static str, &'static str) {
    match end {
        Posture::Standing => ("balanced", "balance"),
        Posture::Hanging => ("held", "hold"),
    }
}

impl std::fmt::Display for SwingUpEvaluation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let MotionStatistics { motion, balance_s, cycles, dropped, overruns } = &self.statistics;
        let (stayed, stay) = stayed(self.end);
        writeln!(f, "{}: {}", self.manoeuvre, if self.success { stayed } else { "FAILED" })?;
        for reason in &self.failures {
            writeln!(f, "  {reason}")?;
        }
        write!(f, "  plan      {:.3} s long, {}", self.t_f, planning_text(self.planning_s))?;
        if let Some((entry, distance)) = self.nearest_entry.zip(self.distance) {
            write!(f, " from database entry {entry} ({distance:.2} rad away)")?;
        }
        writeln!(f, ", defect {:.1e}", self.defect)?;
        writeln!(
            f,
            "  tracking  within {:.3} (actuated joints), {:.3} (unactuated joints), rad or m",
            motion.tracking_error_arm, motion.tracking_error_pendulum
        )?;
        writeln!(
            f,
            "  {stay:<9} {:.2} s, unactuated joints within {:.2} deg of the end of the plan, actuated joints below {:.3} rad/s or m/s in the last second",
            balance_s, motion.final_error_deg, motion.final_speed
        )?;
        writeln!(
            f,
            "  peaks     position {:.0} %, velocity {:.0} %, torque {:.0} % of the 100 % limits of the actuated joints",
            100.0 * motion.peak_position,
            100.0 * motion.peak_velocity,
            100.0 * motion.peak_torque
        )?;
        write!(f, "  cycles    {cycles} recorded, {dropped} lost, {overruns} late")
    }
}
