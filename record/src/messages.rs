//! Messages of the topics other than the cycles, among them the standard types of ROS.

use super::cdr::Cdr;
use crate::robot::Robot;
use upswing_ipc::Telemetry;
use upswing_model::{JointVector, NQ, NU};

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
pub const STEPS: Topic =
    Topic { name: "/upswing/step", kind: "upswing_msgs/msg/Step", definition: include_str!("msg/Step.msg") };
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

/// Encodes a `JointState`: positions (rad) and velocities (rad/s) of all joints, measured torques (N m) of the actuated joints,
/// 0 for the others.
pub fn joint_states(names: &[&str; NQ], record: &Telemetry) -> Vec<u8> {
    let mut cdr = Cdr::new();
    header(&mut cdr, record.t_ns, "");
    cdr.length(NQ);
    names.iter().for_each(|name| cdr.text(name));
    cdr.sequence(&record.q);
    cdr.sequence(&record.qd);
    let mut effort = [0.0; NQ];
    effort[..NU].copy_from_slice(&record.tau_measured);
    cdr.sequence(&effort);
    cdr.bytes()
}

/// Encodes a `TFMessage`: the pose of each link in the frame of its parent, m and unit quaternion.
pub fn transforms(robot: &Robot, record: &Telemetry) -> Vec<u8> {
    let mut cdr = Cdr::new();
    let q = JointVector::from(record.q);
    let links: Vec<_> = robot.transforms(&q).collect();
    cdr.length(links.len());
    for (parent, link, pose) in links {
        header(&mut cdr, record.t_ns, parent);
        cdr.text(link);
        pose.translation.vector.iter().for_each(|v| cdr.f64(*v));
        pose.rotation.coords.iter().for_each(|v| cdr.f64(*v));
    }
    cdr.bytes()
}

/// Encodes a URDF as a `String`.
pub fn description(urdf: &str) -> Vec<u8> {
    let mut cdr = Cdr::new();
    cdr.text(urdf);
    cdr.bytes()
}
