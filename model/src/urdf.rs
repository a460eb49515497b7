//! Builds a [`Model`] from a URDF: one unbranched chain of revolute, continuous and prismatic joints, of which those with effort="0" are
//! unactuated. Bodies on fixed joints are merged with the body that carries them.

use crate::description::{Urdf, UrdfJoint, UrdfJointKind};
use crate::model::{JointKind, JointParameters, Model};
use crate::urdf_error::{UrdfElement, UrdfElementError, UrdfError};
use crate::{ActuatedVector, JointVector, LimitKind, Limits, MOST_JOINTS, Order};
use nalgebra::{Isometry3, Vector3};

/// Gravity as in the paper, m/s^2, along -z of the root frame of the URDF.
const GRAVITY: f64 = 9.81;

/// Error about the joint of this name.
fn refuse(joint: &str, cause: UrdfElementError) -> UrdfError {
    UrdfError::Element { element: UrdfElement::named("joint", joint), cause: cause.into() }
}

impl Model {
    /// The model of the robot in the text of a URDF file. The frame of the root link is the world frame, whose z axis points
    /// up; the joints with effort="0" in their `<limit>`, and continuous joints without an effort, are the unactuated ones.
    ///
    /// # Errors
    /// [`UrdfError`] if the text is no URDF, no chain with 1 to [`MOST_JOINTS`] joints, both actuated and unactuated ones, or physically
    /// impossible.
    pub fn from_urdf(text: &str) -> Result<Self, UrdfError> {
        Self::from_description(&Urdf::read(text)?)
    }

    /// The model of a robot whose URDF has been read, as in [`Model::from_urdf`].
    ///
    /// # Errors
    /// [`UrdfError`] if the robot is no chain with 1 to [`MOST_JOINTS`] joints, both actuated and unactuated ones, or physically
    /// impossible.
    pub fn from_description(robot: &Urdf) -> Result<Self, UrdfError> {
        // Walk from the root: `frame` is the current link's frame in the frame of the last movable body.
        let mut current = robot.root;
        let mut joints: Vec<JointParameters> = Vec::new();
        let mut chain: Vec<&UrdfJoint> = Vec::new();
        let mut tip = Vector3::zeros();
        loop {
            let mut body = robot.links[current].body;
            let mut next: Vec<(&UrdfJoint, Isometry3<f64>)> = Vec::new();
            // Fixed children belong to this body; one movable joint, here or on them, leads on.
            let on = |link: usize, frame: Isometry3<f64>| {
                robot.links[link].children.iter().map(move |joint| (&robot.joints[*joint], frame))
            };
            let mut pending: Vec<_> = on(current, Isometry3::identity()).collect();
            while let Some((joint, parent)) = pending.pop() {
                let placement = parent * joint.origin;
                match joint.kind {
                    UrdfJointKind::Fixed => {
                        body = body.joined(robot.links[joint.child].body.moved(&placement));
                        pending.extend(on(joint.child, placement));
                    }
                    UrdfJointKind::Revolute | UrdfJointKind::Continuous | UrdfJointKind::Prismatic => {
                        next.push((joint, placement));
                    }
                }
            }
            if next.len() > 1 {
                let joints = || next.iter().rev().map(|(joint, _)| joint);
                return Err(UrdfError::Branch {
                    link: robot.links[current].name.clone(),
                    joints: joints().map(|joint| joint.name.clone()).collect(),
                    tips: joints().map(|joint| robot.last_link(joint.child).to_owned()).collect(),
                });
            }
            if let Some(last) = joints.last_mut() {
                last.body = body;
                check_body(last)?;
                tip = rod_tip(body.com);
            }
            let Some((joint, placement)) = next.pop() else { break };
            let kind = match joint.kind {
                UrdfJointKind::Continuous => JointKind::Continuous,
                UrdfJointKind::Prismatic => JointKind::Prismatic,
                UrdfJointKind::Revolute | UrdfJointKind::Fixed => JointKind::Revolute,
            };
            joints.push(JointParameters {
                name: joint.name.clone(),
                kind,
                is_actuated: is_actuated(joint, kind)?,
                placement,
                axis: joint.axis,
                body,
            });
            chain.push(joint);
            current = joint.child;
        }
        let actuated: Vec<bool> = joints.iter().map(|joint| joint.is_actuated).collect();
        let names = || joints.iter().map(|joint| joint.name.clone()).collect();
        let Some(order) = Order::new(&actuated) else {
            return Err(match actuated.len() {
                0 => UrdfError::NoJoint,
                got if got > MOST_JOINTS => UrdfError::TooManyJoints { got },
                _ if actuated[0] => UrdfError::NoUnactuatedJoint { joints: names() },
                _ => UrdfError::NoActuatedJoint { joints: names() },
            });
        };
        let rated_limits = rated_limits(&order, &joints, &chain)?;
        let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
        Ok(Self::new(order, joints, tip, gravity, rated_limits))
    }
}

impl Urdf {
    /// Name of the last movable link behind the link of index `link`, along the first branch.
    fn last_link(&self, link: usize) -> &str {
        let (mut current, mut last) = (link, link);
        // Each link has one parent: the walk ends.
        while let Some(joint) = self.links[current].children.first().map(|joint| &self.joints[*joint]) {
            current = joint.child;
            if joint.kind != UrdfJointKind::Fixed {
                last = current;
            }
        }
        &self.links[last].name
    }
}

/// Whether the URDF states a motor of the joint. Only a continuous joint may do without the statement: the format asks for none.
fn is_actuated(joint: &UrdfJoint, kind: JointKind) -> Result<bool, UrdfError> {
    match joint.limit.and_then(|limit| limit.effort) {
        None if kind == JointKind::Continuous => Ok(false),
        None if joint.limit.is_none() => Err(refuse(&joint.name, UrdfElementError::NoLimit)),
        None => Err(refuse(&joint.name, UrdfElementError::NoEffortLimit)),
        Some(got) if got < 0.0 => Err(refuse(
            &joint.name,
            UrdfElementError::EffortLimit { got, unit: LimitKind::Torque.unit(kind) },
        )),
        Some(effort) => Ok(effort > 0.0),
    }
}

/// The limits of the joints of the chain; infinite where the URDF states none.
fn rated_limits(
    order: &Order,
    joints: &[JointParameters],
    chain: &[&UrdfJoint],
) -> Result<Limits, UrdfError> {
    let sizes = order.sizes();
    let mut limits = Limits {
        q_min: JointVector::repeat(sizes, f64::NEG_INFINITY),
        q_max: JointVector::repeat(sizes, f64::INFINITY),
        qd_max: JointVector::repeat(sizes, f64::INFINITY),
        tau_max: ActuatedVector::zeros(sizes),
    };
    for (i, (JointParameters { kind, .. }, joint)) in joints.iter().zip(chain).enumerate() {
        let c = order.coordinate(i);
        let fail = |cause| Err(refuse(&joint.name, cause));
        if *kind != JointKind::Continuous {
            let Some(limit) = joint.limit else {
                return fail(UrdfElementError::NoLimit);
            };
            // As the format has it, what is not stated is 0.
            let (lower, upper) = (limit.lower.unwrap_or(0.0), limit.upper.unwrap_or(0.0));
            if lower >= upper {
                return fail(UrdfElementError::PositionLimits { lower, upper, unit: kind.unit() });
            }
            (limits.q_min[c], limits.q_max[c]) = (lower, upper);
        }
        let (velocity, effort) = joint.limit.map_or((None, None), |limit| (limit.velocity, limit.effort));
        // CAD exporters write 0 for what they do not know.
        let velocity = velocity.filter(|velocity| *velocity != 0.0 || order.is_actuated(i));
        if let Some(velocity) = velocity {
            if velocity <= 0.0 {
                let unit = LimitKind::Velocity.unit(*kind);
                return fail(UrdfElementError::VelocityLimit { got: velocity, unit });
            }
            limits.qd_max[c] = velocity;
        }
        if order.is_actuated(i) {
            if velocity.is_none() {
                return fail(UrdfElementError::NoVelocityLimit);
            }
            limits.tau_max[c] = effort.unwrap_or(0.0);
        }
    }
    Ok(limits)
}

/// Tip of a uniform rod, at twice the distance of its centre of mass, m.
fn rod_tip(com: Vector3<f64>) -> Vector3<f64> {
    com * 2.0
}

/// Checks that the body on a joint has a positive mass and a positive definite inertia. The triangle inequality of the principal
/// moments is not checked: identified parameters violate it by rounding, and the mass matrix M stays positive definite.
fn check_body(joint: &JointParameters) -> Result<(), UrdfError> {
    if joint.body.mass <= 0.0 {
        return Err(refuse(&joint.name, UrdfElementError::NoMass { got: joint.body.mass }));
    }
    if nalgebra::Cholesky::new(joint.body.inertia).is_none() {
        return Err(refuse(&joint.name, UrdfElementError::Inertia));
    }
    Ok(())
}
