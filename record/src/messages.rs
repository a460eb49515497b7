//! Messages of the topics other than the cycles, among them the standard types of ROS.

use super::cdr::{Cdr, CdrReader};
use crate::robot::Robot;
use upswing_ipc::{DamagedPlan, PlanHeader, PlanMessage, Telemetry};
use upswing_model::{Model, Order};

/// A topic: name, message type and definition of the message.
pub struct Topic {
    pub name: &'static str,
    pub kind: &'static str,
    pub definition: &'static str,
}

pub const JOINT_STATES: Topic = Topic {
    name: "/joint_states",
    kind: "sensor_msgs/msg/JointState",
    definition: include_str!("msg/JointState.msg"),
};
pub const TRANSFORMS: Topic =
    Topic { name: "/tf", kind: "tf2_msgs/msg/TFMessage", definition: include_str!("msg/TFMessage.msg") };
pub const PLANS: Topic =
    Topic { name: "/upswing/plan", kind: "upswing_msgs/msg/Plan", definition: include_str!("msg/Plan.msg") };
pub const DESCRIPTION: Topic =
    Topic { name: "/robot_description", kind: "std_msgs/msg/String", definition: "string data\n" };

/// Writes a `std_msgs/msg/Header` with the time `t_ns` of the message, ns.
fn header(cdr: &mut Cdr, t_ns: u64, frame: &str) {
    const NS: u64 = 1_000_000_000;
    cdr.u32((t_ns / NS) as u32);
    cdr.u32((t_ns % NS) as u32);
    cdr.text(frame);
}

/// Encodes a `JointState`: positions (rad or m) and velocities (rad/s or m/s) of all joints, measured torques or forces (N m or N) of the
/// actuated joints, 0 for the others.
pub fn joint_states(names: &[String], order: &Order, record: &Telemetry) -> Vec<u8> {
    let mut cdr = Cdr::new();
    header(&mut cdr, record.t_ns, "");
    cdr.length(names.len());
    names.iter().for_each(|name| cdr.text(name));
    cdr.sequence(record.of_joints(&record.q));
    cdr.sequence(record.of_joints(&record.qd));
    let mut effort = vec![0.0; names.len()];
    for (i, torque) in record.of_actuated(&record.tau_measured).iter().enumerate() {
        effort[order.joint(i)] = *torque;
    }
    cdr.sequence(&effort);
    cdr.bytes()
}

/// Encodes a `TFMessage`: the pose of each link in the frame of its parent, m and unit quaternion.
pub fn transforms(robot: &Robot, record: &Telemetry) -> Vec<u8> {
    let mut cdr = Cdr::new();
    let links: Vec<_> = robot.transforms(record.of_joints(&record.q)).collect();
    cdr.length(links.len());
    for (parent, link, pose) in links {
        header(&mut cdr, record.t_ns, parent);
        cdr.text(link);
        pose.translation.vector.iter().for_each(|v| cdr.f64(*v));
        pose.rotation.coords.iter().for_each(|v| cdr.f64(*v));
    }
    cdr.bytes()
}

/// Encodes a plan.
///
/// # Errors
/// [`DamagedPlan::Sizes`] and [`DamagedPlan::Length`].
pub fn plan(plan: &PlanMessage) -> Result<Vec<u8>, DamagedPlan> {
    let header = &plan.header;
    let (expected, got) = (header.length()?, plan.values.len());
    if got != expected {
        return Err(DamagedPlan::Length { expected, got });
    }
    let mut cdr = Cdr::new();
    let PlanHeader { id, fingerprint, activation_ns, replaces, t_f, joints, actuated, intervals, checksum } =
        *header;
    for word in
        [id, fingerprint, activation_ns, replaces, t_f.to_bits(), joints, actuated, intervals, checksum]
    {
        cdr.u64(word);
    }
    let mut rest = &plan.values[..];
    for length in plan_lists(header) {
        let (list, after) = rest.split_at(length);
        cdr.sequence(list);
        rest = after;
    }
    Ok(cdr.bytes())
}

/// Decodes a plan; `None` if the message has another length or header.
pub fn read_plan(message: &[u8]) -> Option<PlanMessage> {
    let mut cdr = CdrReader::new(message)?;
    let header = PlanHeader {
        id: cdr.u64()?,
        fingerprint: cdr.u64()?,
        activation_ns: cdr.u64()?,
        replaces: cdr.u64()?,
        t_f: cdr.f64()?,
        joints: cdr.u64()?,
        actuated: cdr.u64()?,
        intervals: cdr.u64()?,
        checksum: cdr.u64()?,
    };
    // The sizes in the header are possible, and so are the lengths of the lists.
    header.length().ok()?;
    let mut values = Vec::new();
    for length in plan_lists(&header) {
        if cdr.length()? != length {
            return None;
        }
        for _ in 0..length {
            values.push(cdr.f64()?);
        }
    }
    cdr.is_empty().then_some(PlanMessage { header, values })
}

/// Lengths of the lists of a plan whose header has possible sizes.
fn plan_lists(header: &PlanHeader) -> [usize; 5] {
    let [joints, actuated, intervals] =
        [header.joints, header.actuated, header.intervals].map(|n| n as usize);
    let (knots, state) = (intervals + 1, 2 * joints);
    [knots * state, knots * actuated, knots * state, knots * actuated * state, actuated * state]
}

/// The joint names of a model in the chain's order, as the metadata of a recording have them.
pub fn joint_names(model: &Model) -> String {
    model.joint_names().collect::<Vec<_>>().join(",")
}

/// Encodes a URDF as a `String`.
pub fn description(urdf: &str) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.text(urdf);
    cdr.bytes()
}
