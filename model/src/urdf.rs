//! Reads a [`Model`] from a URDF: one unbranched chain of revolute joints; bodies on fixed joints are
//! joined to the body that carries them.

use crate::model::{Frame, Joint, Limits, Model};
use crate::{ActuatedVector, JointVector, NQ, NU};
use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};
use urdf_rs::JointType;

/// Standard gravity as used by the paper, m/s^2, along -z of the URDF's root frame.
const GRAVITY: f64 = 9.81;

/// Why a URDF cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum UrdfError {
    /// Not a URDF at all.
    #[error("not a readable URDF: {0}")]
    Parse(String),
    /// The number of revolute joints is not that of this build.
    #[error("expected {NQ} revolute joints in one chain (the last {} unactuated), got {got}", NQ - NU)]
    JointCount {
        /// Revolute joints found.
        got: usize,
    },
    /// Two joints share a parent: not a serial chain.
    #[error("link `{link}` carries {joints} revolute chains; expected one unbranched chain")]
    Branch {
        /// The link.
        link: String,
        /// Movable children.
        joints: usize,
    },
    /// A joint type without meaning here.
    #[error("joint `{joint}` is {got}; expected revolute, continuous or fixed")]
    JointType {
        /// The joint.
        joint: String,
        /// Its type.
        got: String,
    },
    /// A joint, or the body that it carries, that cannot be.
    #[error("joint `{joint}`: {reason}")]
    Impossible {
        /// The joint.
        joint: String,
        /// What is wrong.
        reason: String,
    },
    /// There is no root link.
    #[error("no root link: every link is the child of some joint")]
    NoRoot,
}

/// Mass, centre of mass and inertia about it, in some link's frame.
#[derive(Clone, Copy)]
pub(crate) struct Body {
    pub mass: f64,
    pub com: Vector3<f64>,
    pub inertia: Matrix3<f64>,
}

impl Body {
    const NONE: Self = Self { mass: 0.0, com: Vector3::new(0.0, 0.0, 0.0), inertia: ZERO3 };

    fn of_link(link: &urdf_rs::Link) -> Self {
        let i = &link.inertial.inertia;
        let local = Matrix3::new(i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz);
        let origin = isometry(&link.inertial.origin);
        let r = origin.rotation.to_rotation_matrix();
        Self {
            mass: link.inertial.mass.value,
            com: origin.translation.vector,
            inertia: r.matrix() * local * r.matrix().transpose(),
        }
    }

    fn moved(self, by: &Isometry3<f64>) -> Self {
        let r = by.rotation.to_rotation_matrix();
        Self {
            mass: self.mass,
            com: by * self.com + by.translation.vector,
            inertia: r.matrix() * self.inertia * r.matrix().transpose(),
        }
    }

    /// Both as one rigid body.
    pub(crate) fn joined(self, other: Self) -> Self {
        let mass = self.mass + other.mass;
        if mass == 0.0 {
            return self;
        }
        let com = (self.com * self.mass + other.com * other.mass) / mass;
        let about = |b: &Self| {
            let d = b.com - com;
            b.inertia + (Matrix3::identity() * d.dot(&d) - d * d.transpose()) * b.mass
        };
        Self { mass, com, inertia: about(&self) + about(&other) }
    }
}

const ZERO3: Matrix3<f64> = Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);

fn isometry(pose: &urdf_rs::Pose) -> Isometry3<f64> {
    let [r, p, y] = pose.rpy.0;
    Isometry3::from_parts(
        Translation3::from(Vector3::from(pose.xyz.0)),
        UnitQuaternion::from_euler_angles(r, p, y),
    )
}

impl Model {
    /// Reads the robot from the text of a URDF file. The root link's frame is the world frame, its z axis
    /// points up; the last `N_UNACTUATED` revolute joints are the unactuated ones.
    ///
    /// # Errors
    /// [`UrdfError`] if the text is no URDF, not one chain of `NQ` revolute joints, or physically impossible.
    pub fn from_urdf(text: &str) -> Result<Self, UrdfError> {
        let robot = urdf_rs::read_from_string(text).map_err(|e| UrdfError::Parse(e.to_string()))?;
        let link = |name: &str| robot.links.iter().find(|l| l.name == name);
        let children = |name: &str| robot.joints.iter().filter(|j| j.parent.link == name).collect::<Vec<_>>();
        let root = robot
            .links
            .iter()
            .find(|l| robot.joints.iter().all(|j| j.child.link != l.name))
            .ok_or(UrdfError::NoRoot)?;
        check_joints(&robot)?;

        // Walk from the root: `frame` is the current link's frame in the frame of the last movable body.
        let (mut current, mut frame) = (root.name.clone(), Isometry3::identity());
        let mut joints: Vec<Joint> = Vec::new();
        let mut urdf_limits = Vec::new();
        let mut tip = Vector3::zeros();
        for _ in 0..=robot.joints.len() {
            let mut body = link(&current).map_or(Body::NONE, Body::of_link).moved(&frame);
            let mut next: Option<(&urdf_rs::Joint, Isometry3<f64>)> = None;
            let mut found = 0;
            // Fixed children belong to this body; one movable joint, here or on them, leads on.
            let mut pending: Vec<_> = children(&current).into_iter().map(|j| (j, frame)).collect();
            while let Some((joint, parent)) = pending.pop() {
                let placement = parent * isometry(&joint.origin);
                match joint.joint_type {
                    JointType::Fixed => {
                        let child = link(&joint.child.link).map_or(Body::NONE, Body::of_link);
                        body = body.joined(child.moved(&placement));
                        pending.extend(children(&joint.child.link).into_iter().map(|j| (j, placement)));
                    }
                    JointType::Revolute | JointType::Continuous => {
                        found += 1;
                        next = Some((joint, placement));
                    }
                    ref other => {
                        return Err(UrdfError::JointType {
                            joint: joint.name.clone(),
                            got: format!("{other:?}").to_lowercase(),
                        });
                    }
                }
            }
            if found > 1 {
                return Err(UrdfError::Branch { link: current, joints: found });
            }
            if let Some(last) = joints.last_mut() {
                (last.mass, last.com, last.inertia) = (body.mass, body.com, body.inertia);
                check_body(last)?;
                tip = rod_tip(body.com);
            }
            let Some((joint, placement)) = next else { break };
            joints.push(Joint {
                name: joint.name.clone(),
                placement: Frame::new(&placement),
                axis: Vector3::from(joint.axis.xyz.0).try_normalize(1e-9).ok_or_else(|| {
                    UrdfError::Impossible { joint: joint.name.clone(), reason: "the axis is zero".into() }
                })?,
                mass: 0.0,
                com: Vector3::zeros(),
                inertia: ZERO3,
            });
            urdf_limits.push(joint.limit.clone());
            (current, frame) = (joint.child.link.clone(), Isometry3::identity());
        }
        let got = joints.len();
        let joints: [Joint; NQ] = joints.try_into().map_err(|_| UrdfError::JointCount { got })?;
        let rated_limits = Limits {
            q_min: JointVector::from_fn(|i, _| urdf_limits[i].lower),
            q_max: JointVector::from_fn(|i, _| urdf_limits[i].upper),
            qd_max: JointVector::from_fn(|i, _| urdf_limits[i].velocity),
            tau_max: ActuatedVector::from_fn(|i, _| urdf_limits[i].effort),
        };
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

/// A uniform rod ends at twice the distance of its centre of mass.
fn rod_tip(com: Vector3<f64>) -> Vector3<f64> {
    com * 2.0
}

/// Each joint connects two links of the robot and is somewhere, and no link hangs on two joints: from the root, which is
/// the child of none, no walk comes to a link twice.
fn check_joints(robot: &urdf_rs::Robot) -> Result<(), UrdfError> {
    for (i, joint) in robot.joints.iter().enumerate() {
        let fail = |reason: String| Err(UrdfError::Impossible { joint: joint.name.clone(), reason });
        for name in [&joint.parent.link, &joint.child.link] {
            if robot.links.iter().all(|l| l.name != *name) {
                return fail(format!("expected two links of the robot, there is no link `{name}`"));
            }
        }
        let child = &joint.child.link;
        if let Some(first) = robot.joints[..i].iter().find(|j| j.child.link == *child) {
            return fail(format!("its link `{child}` is the child of joint `{}` already", first.name));
        }
        let numbers = [("xyz", joint.origin.xyz.0), ("rpy", joint.origin.rpy.0), ("axis", joint.axis.xyz.0)];
        for (what, v) in numbers {
            if !v.iter().all(|v| v.is_finite()) {
                return fail(format!("expected finite numbers for {what}, got {v:?}"));
            }
        }
    }
    Ok(())
}

/// A body needs a positive mass and a positive definite inertia. The triangle inequality of its principal
/// moments is not demanded: identified parameters miss it by rounding, and the joint-space mass matrix
/// stays positive definite.
fn check_body(joint: &Joint) -> Result<(), UrdfError> {
    let fail = |reason: String| Err(UrdfError::Impossible { joint: joint.name.clone(), reason });
    let all_finite = joint.inertia.iter().chain(joint.com.iter()).all(|v| v.is_finite());
    if !all_finite || !joint.mass.is_finite() || joint.mass <= 0.0 {
        let got = joint.mass;
        return fail(format!(
            "expected a body with a positive, finite mass and finite inertia, got {got} kg"
        ));
    }
    if nalgebra::Cholesky::new(joint.inertia).is_none() {
        return fail("expected a positive definite inertia of its body about the centre of mass".into());
    }
    Ok(())
}
