//! Builds a [`View`] from telemetry, plans and the reports of the request thread.

use super::request_thread::LiveUpdate;
use super::{CycleView, DaemonStatus, EventView, JointView, PlanView, Severity, View};
use std::collections::VecDeque;
use upswing_config::Config;
use upswing_ipc::{CycleVectors, DamagedPlan, Mode, PlanMessage, Telemetry};
use upswing_model::{JointVector, Limits, Model, Posture, Workspace};
use upswing_record::Tally;
use upswing_record::evaluation::tilt;

/// Number of events kept.
const EVENTS: usize = 100;

/// The 100 % limits; positions have the limits of plans where these are wider: free joints swing past their target.
fn widest(rated: &Limits, planning: &Limits) -> Limits {
    Limits {
        q_min: rated.q_min.zip_map(&planning.q_min, f64::min),
        q_max: rated.q_max.zip_map(&planning.q_max, f64::max),
        ..*rated
    }
}

/// Builder of a [`View`] from the data that have arrived.
pub struct ViewBuilder {
    domain: String,
    model: Model,
    limits: Limits,
    /// Names of the first manoeuvres from hanging and from standing.
    first: [Option<String>; 2],
    t: f64,
    tally: Tally,
    newest: Option<Telemetry>,
    /// Codes of mode and fault of the newest cycle; a change is an event.
    state: Option<(u64, u64)>,
    /// Warnings reported since the last change of mode, bits as in the telemetry.
    warned: u64,
    status: Option<DaemonStatus>,
    plan: Option<PlanView>,
    present: Option<[bool; 3]>,
    asking: Option<String>,
    faults: u64,
    plans: u64,
    events: VecDeque<EventView>,
}

impl ViewBuilder {
    /// Creates a builder without data.
    pub fn new(config: &Config, domain: &str) -> Self {
        Self {
            domain: domain.to_owned(),
            model: config.model.clone(),
            limits: widest(&config.robot.limits, &config.robot.planning),
            first: [Posture::Hanging, Posture::Standing]
                .map(|start| config.first_manoeuvre(start).map(str::to_owned)),
            t: 0.0,
            tally: Tally::default(),
            newest: None,
            state: None,
            warned: 0,
            status: None,
            plan: None,
            present: None,
            asking: None,
            faults: 0,
            plans: 0,
            events: VecDeque::new(),
        }
    }

    /// Sets the time since the start of the view, s.
    pub fn now(&mut self, t: f64) {
        self.t = t;
    }

    /// Takes the record of a cycle.
    pub fn cycle(&mut self, record: &Telemetry) {
        let lost = self.tally.lost;
        self.tally.count(record);
        if self.tally.lost > lost {
            let lost = self.tally.lost - lost;
            self.tell(Severity::Warning, format!("{lost} cycles were lost on the way here"));
        }
        if self.state != Some((record.mode, record.fault)) {
            self.state = Some((record.mode, record.fault));
            self.warned = 0;
            match upswingd::fault_text(record.fault).filter(|_| record.mode() == Ok(Mode::Fault)) {
                Some(cause) => {
                    self.faults += 1;
                    self.tell(Severity::Fault, format!("fault: {cause}"));
                }
                None => self.tell(Severity::Note, format!("mode {}", record.mode_text())),
            }
        }
        let new = record.warnings & !self.warned;
        self.warned |= record.warnings;
        for text in upswingd::warning_texts(new) {
            self.tell(Severity::Warning, format!("warning: {text}"));
        }
        self.newest = Some(*record);
    }

    /// Notes that no cycle has arrived for a while.
    pub fn silence(&mut self) {
        if self.newest.take().is_some() {
            self.tell(Severity::Warning, "no cycles arrive any more".into());
        }
        self.state = None;
    }

    /// Takes a plan. A damaged plan, which the daemon refuses, is only an event here.
    pub fn plan(&mut self, plan: Result<PlanMessage, DamagedPlan>) {
        let plan = match plan.and_then(|plan| plan.plan(self.model.order())) {
            Ok(plan) => plan,
            Err(damage) => {
                return self.tell(Severity::Warning, format!("a damaged plan was published: {damage}"));
            }
        };
        let t_f = plan.trajectory.t_f;
        let posture = self.model.posture(&plan.trajectory.end().q(), &mut Workspace::default());
        let stands = posture == Posture::Standing;
        let view = PlanView { id: format!("{:016x}", plan.id), t_f, stands };
        self.tell(Severity::Note, format!("plan of {t_f:.3} s that ends {posture}"));
        self.plan = Some(view);
        self.plans += 1;
    }

    /// Takes a report of the request thread.
    pub(super) fn update(&mut self, update: LiveUpdate) {
        match update {
            LiveUpdate::Processes(present) => {
                let before = self.present.replace(present);
                for (i, name) in ["daemon", "planner", "plant"].into_iter().enumerate() {
                    if before.is_some_and(|before| before[i] != present[i]) {
                        let text = if present[i] { "has started" } else { "is gone" };
                        self.tell(Severity::Note, format!("the {name} {text}"));
                    }
                }
            }
            LiveUpdate::Status(answer) => {
                let status = answer.map(|answer| DaemonStatus::new(&answer));
                let told = |s: &Option<DaemonStatus>| s.as_ref().and_then(|s| s.last_overrun.clone());
                if let Some(late) =
                    told(&status).filter(|_| self.status.is_some() && told(&status) != told(&self.status))
                {
                    self.tell(Severity::Warning, format!("late: {late}"));
                }
                self.status = status;
            }
            LiveUpdate::Sent(request) => {
                self.asking = Some(request.name().to_owned());
                self.tell(Severity::Note, format!("asked: {}", request.name()));
            }
            LiveUpdate::Answered(request, answer) => {
                if self.asking.as_deref() == Some(request.name()) {
                    self.asking = None;
                }
                match answer {
                    Ok(accepted) => self.tell(Severity::Note, format!("{}: {accepted}", request.name())),
                    Err(why) => self.tell(Severity::Warning, format!("{}: {why}", request.name())),
                }
            }
        }
    }

    fn tell(&mut self, kind: Severity, text: String) {
        if self.events.len() == EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(EventView { t: self.t, kind, text });
    }

    /// Returns the view of the current state.
    pub fn view(&self) -> View {
        let [daemon, planner, plant] = self.present.unwrap_or_default();
        let cycle = self.newest.as_ref();
        let mode = cycle.map(Telemetry::mode_text);
        // The status contains more than the mode, but may be older than the newest cycle.
        let status = self.status.as_ref().filter(|s| mode.as_ref().is_none_or(|mode| *mode == s.mode));
        let first = |start| match start {
            Posture::Hanging => self.first[0].as_deref(),
            Posture::Standing => self.first[1].as_deref(),
        };
        let of_mode = || cycle.and_then(|record| Some(record.mode().ok()?.next_action(first).to_string()));
        let next = status.map(|s| s.next.clone()).or_else(of_mode);
        View {
            next,
            domain: self.domain.clone(),
            t: self.t,
            daemon,
            planner,
            plant,
            mode: mode.or_else(|| self.status.as_ref().map(|s| s.mode.clone())),
            status: self.status.clone(),
            cycle: cycle.map(|record| self.show(record)),
            plan: self.plan.clone(),
            lost: self.tally.lost,
            faults: self.faults,
            plans: self.plans,
            asking: self.asking.clone(),
            events: self.events.iter().cloned().collect(),
        }
    }

    fn show(&self, r: &Telemetry) -> CycleView {
        let follows = matches!(r.mode(), Ok(Mode::Track | Mode::Balance));
        let vectors = r.vectors(self.model.order()).ok();
        let q = vectors.as_ref().map_or(JointVector::zeros(self.model.sizes()), |v| v.x.q());
        let error = vectors.as_ref().filter(|_| follows).map_or(q * 0.0, |v| v.x.q() - v.x_d.q());
        let rod = self.model.rod(&q);
        CycleView {
            seq: r.seq,
            t: r.t_ns as f64 * 1e-9,
            fault: upswingd::fault_text(r.fault),
            warnings: upswingd::warning_texts(r.warnings).collect(),
            brakes: r.flags & Telemetry::BRAKE != 0,
            limited: r.flags & Telemetry::LIMITED != 0,
            plan: (r.plan_id != 0).then(|| format!("{:016x}", r.plan_id)),
            t_plan: r.t_plan,
            tilt: tilt(&self.model, &q),
            rod: (rod / rod.norm()).into(),
            error_arm: error.actuated().amax(),
            error_pendulum: error.unactuated().amax(),
            joints: vectors.map_or_else(Vec::new, |vectors| self.joints(&vectors)),
        }
    }

    fn joints(&self, vectors: &CycleVectors) -> Vec<JointView> {
        let limits = &self.limits;
        let joint = |(i, name): (usize, &str)| {
            let c = self.model.order().coordinate(i);
            let q = vectors.x.q()[c];
            let (shown, unit) = self.model.joint_kind(c).shown(q);
            JointView {
                name: name.to_owned(),
                q,
                shown,
                unit,
                qd: vectors.x.qd()[c],
                tau: vectors.tau.get(c).copied().unwrap_or_default(),
                q_min: limits.q_min[c],
                q_max: limits.q_max[c],
                qd_max: limits.qd_max[c],
                tau_max: limits.tau_max.get(c).copied(),
            }
        };
        self.model.joint_names().enumerate().map(joint).collect()
    }
}
