//! The `planner` service: requests for plans, and the planner's responses.

use super::chain::{self, OtherChain, PerJoint};
use super::codes::{PlannerKind, PlannerStatus, UnknownCode};
use super::manoeuvre::ManoeuvreRequest;
use super::text::Text;
use super::words::WORD;
use iceoryx2::prelude::ZeroCopySend;
use upswing_model::{Order, State};

/// A request to the planner.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[type_name("upswing.PlannerRequest.v4")]
pub struct PlannerRequest {
    /// Code of the [`PlannerKind`].
    pub kind: u64,
    /// 1: start from the state in the newest telemetry and ignore `q` and `qd`; 0: start from these.
    pub from_now: u64,
    /// With `from_now`: `seq` of the newest record that the client knows of. The planner waits for that record or a later one, so
    /// that equal runs plan from equal states; 0: it takes what it has.
    pub known_seq: u64,
    /// n, number of joints.
    pub joints: u64,
    /// n_A, number of actuated joints.
    pub actuated: u64,
    /// q of the start state x_0 = [q, qd].
    pub q: PerJoint,
    /// qd of the start state.
    pub qd: PerJoint,
    /// The manoeuvre to be planned.
    pub manoeuvre: ManoeuvreRequest,
    /// Iterations of the replanning QP, 0: as the planner's settings say.
    pub iterations: u64,
    /// Time budget, ms, 0: none.
    pub budget_ms: u64,
    /// 1: publish the plan to the daemon, 0: only respond.
    pub publish: u64,
}

const _: () = assert!(
    size_of::<PlannerRequest>() == WORD * 8 + 2 * size_of::<PerJoint>() + size_of::<ManoeuvreRequest>()
);

impl PlannerRequest {
    /// A request for a plan from the state `x`, without publication.
    pub fn from_state(manoeuvre: ManoeuvreRequest, order: &Order, x: &State) -> Self {
        let (joints, actuated) = chain::numbers(order.sizes());
        let (q, qd) = (order.in_chain(&x.q()), order.in_chain(&x.qd()));
        Self { manoeuvre, joints, actuated, q, qd, ..Self::default() }
    }

    /// x_0 = [q, qd], the start state; without meaning if `from_now` is 1.
    ///
    /// # Errors
    /// [`OtherChain`] unless the numbers of joints are those of `order`.
    pub fn start(&self, order: &Order) -> Result<State, OtherChain> {
        chain::check("planner request", (self.joints, self.actuated), order.sizes())?;
        Ok(chain::state(order, &self.q, &self.qd))
    }

    /// The kind of request.
    ///
    /// # Errors
    /// [`UnknownCode`] if `kind` names none.
    pub fn kind(&self) -> Result<PlannerKind, UnknownCode> {
        PlannerKind::try_from(self.kind)
    }
}

/// Response of the planner to a [`PlannerRequest`]; numbers that do not apply to the status are 0.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
#[type_name("upswing.PlannerResponse.v3")]
pub struct PlannerResponse {
    /// Code of the [`PlannerStatus`].
    pub status: u64,
    /// Id of the new plan, 0: none.
    pub plan_id: u64,
    /// Time of the plan's t = 0, ns on the daemon's clock; 0: the time at which it is started.
    pub activation_ns: u64,
    /// t_F, duration of the plan, s.
    pub t_f: f64,
    /// Index of the nearest entry of the manoeuvre's trajectory database.
    pub nearest_entry: u64,
    /// Distance from the start to that entry in the metric of the settings, rad; NaN: there is no database.
    pub distance: f64,
    /// QPs of the replan, each linearised around the result before; of a full optimisation its iterations.
    pub iterations: u64,
    /// Largest collocation defect of the plan, rad or rad/s.
    pub defect: f64,
    /// Smallest distance of a joint position to its limit, as a share of half the range; negative: violated.
    pub margin_q: f64,
    /// Smallest distance of a joint velocity to its limit, as a share of it; negative: violated.
    pub margin_qd: f64,
    /// Smallest distance of a torque to its limit, as a share of it; negative: violated.
    pub margin_tau: f64,
    /// Search of the nearest entry, us.
    pub time_nearest_us: f64,
    /// All QPs and, where no entry is near enough, the full optimisation, us.
    pub time_qp_us: f64,
    /// Gain synthesis, us.
    pub time_lqr_us: f64,
    /// From the request to the response, us.
    pub time_total_us: f64,
    /// Why there is no plan, or a remark; for people.
    pub reason: Text,
}

const _: () = assert!(size_of::<PlannerResponse>() == WORD * 15 + size_of::<Text>());

impl PlannerResponse {
    /// How the request ended.
    ///
    /// # Errors
    /// [`UnknownCode`] if `status` names none.
    pub fn status(&self) -> Result<PlannerStatus, UnknownCode> {
        PlannerStatus::try_from(self.status)
    }
}
