//! Builds a [`Model`] from a URDF: one unbranched chain of revolute joints. Bodies on fixed joints are merged with the body that
//! carries them.

use crate::description::{Urdf, UrdfJoint, UrdfJointKind};
use crate::model::{Frame, Joint, Model};
use crate::urdf_error::{UrdfElement, UrdfElementError, UrdfError};
use crate::{ActuatedVector, JointVector, Limits, NQ, NU};
use nalgebra::{Isometry3, Matrix3, Vector3};

/// Gravity as in the paper, m/s^2, along -z of the root frame of the URDF.
const GRAVITY: f64 = 9.81;

/// Error about the joint of this name.
fn refuse(joint: &str, cause: UrdfElementError) -> UrdfError {
    UrdfError::Element { element: UrdfElement::named("joint", joint), cause: cause.into() }
}

impl Model {
    /// The model of the robot in the text of a URDF file. The frame of the root link is the world frame, whose z axis points
    /// up; the last `N_UNACTUATED` revolute joints are the unactuated ones.
    ///
    /// # Errors
    /// [`UrdfError`] if the text is no URDF, not one chain of `NQ` revolute joints, or physically impossible.
    pub fn from_urdf(text: &str) -> Result<Self, UrdfError> {
        Self::from_description(&Urdf::read(text)?)
    }

    /// The model of a robot whose URDF has been read, as in [`Model::from_urdf`].
    ///
    /// # Errors
    /// [`UrdfError`] if the robot is not one chain of `NQ` revolute joints, or physically impossible.
    pub fn from_description(robot: &Urdf) -> Result<Self, UrdfError> {
        // Walk from the root: `frame` is the current link's frame in the frame of the last movable body.
        let mut current = robot.root;
        let mut joints: Vec<Joint> = Vec::new();
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
                    UrdfJointKind::Revolute | UrdfJointKind::Continuous => next.push((joint, placement)),
                }
            }
            if next.len() > 1 {
                let joints = next.iter().rev().map(|(joint, _)| joint.name.clone()).collect();
                return Err(UrdfError::Branch { link: robot.links[current].name.clone(), joints });
            }
            if let Some(last) = joints.last_mut() {
                (last.mass, last.com, last.inertia) = (body.mass, body.com, body.inertia);
                check_body(last)?;
                tip = rod_tip(body.com);
            }
            let Some((joint, placement)) = next.pop() else { break };
            joints.push(Joint {
                name: joint.name.clone(),
                placement: Frame::new(&placement),
                axis: joint.axis,
                mass: 0.0,
                com: Vector3::zeros(),
                inertia: Matrix3::zeros(),
            });
            chain.push(joint);
            current = joint.child;
        }
        let joints: [Joint; NQ] = joints.try_into().map_err(|joints: Vec<Joint>| UrdfError::JointCount {
            got: joints.into_iter().map(|joint| joint.name).collect(),
        })?;
        let rated_limits = rated_limits(&chain)?;
        let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
        let mut model = Self {
            joints,
            base: Frame::new(&Isometry3::identity()),
            tip,
            rotors: ActuatedVector::zeros(),
            gravity,
            rated_limits,
            fingerprint: 0,
        };
        model.fingerprint = model.compute_fingerprint();
        Ok(model)
    }
}

/// The limits of the joints of the chain; infinite where the URDF states none.
fn rated_limits(chain: &[&UrdfJoint]) -> Result<Limits, UrdfError> {
    let mut limits = Limits {
        q_min: JointVector::repeat(f64::NEG_INFINITY),
        q_max: JointVector::repeat(f64::INFINITY),
        qd_max: JointVector::repeat(f64::INFINITY),
        tau_max: ActuatedVector::zeros(),
    };
    for (i, joint) in chain.iter().enumerate() {
        let fail = |cause| Err(refuse(&joint.name, cause));
        if joint.kind == UrdfJointKind::Revolute {
            let Some(limit) = joint.limit else {
                return fail(UrdfElementError::NoLimit);
            };
            // As the format has it, what is not stated is 0.
            let (lower, upper) = (limit.lower.unwrap_or(0.0), limit.upper.unwrap_or(0.0));
            if lower >= upper {
                return fail(UrdfElementError::PositionLimits { lower, upper });
            }
            (limits.q_min[i], limits.q_max[i]) = (lower, upper);
        }
        let (velocity, effort) = joint.limit.map_or((None, None), |limit| (limit.velocity, limit.effort));
        if let Some(velocity) = velocity {
            if velocity <= 0.0 {
                return fail(UrdfElementError::VelocityLimit { got: velocity });
            }
            limits.qd_max[i] = velocity;
        }
        if i < NU {
            let (Some(_), Some(effort)) = (velocity, effort) else {
                return fail(UrdfElementError::NoDriveLimits);
            };
            if effort <= 0.0 {
                return fail(UrdfElementError::EffortLimit { got: effort });
            }
            limits.tau_max[i] = effort;
        } else if let Some(effort) = effort.filter(|effort| *effort != 0.0) {
            return fail(UrdfElementError::PendulumEffort { got: effort });
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
fn check_body(joint: &Joint) -> Result<(), UrdfError> {
    if joint.mass <= 0.0 {
        return Err(refuse(&joint.name, UrdfElementError::NoMass { got: joint.mass }));
    }
    // Only whether the factor exists counts; `positive` is written out for M of all joints.
    if nalgebra::Cholesky::new(joint.inertia).is_none() {
        return Err(refuse(&joint.name, UrdfElementError::Inertia));
    }
    Ok(())
}
