//! The model of a robot: its constants and its forward kinematics.

use crate::description::Body;
use crate::spatial::{SpatialInertia, skew};
use crate::{ActuatedVector, JointVector, Limits, NQ, NU};
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Pose of a frame in the world frame, m.
pub type Pose = Isometry3<f64>;

/// Pose of a frame in another frame, with a rotation matrix, which is cheaper to apply than a quaternion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Frame {
    pub rotation: Matrix3<f64>,
    /// m
    pub origin: Vector3<f64>,
}

impl Frame {
    pub(crate) fn new(pose: &Isometry3<f64>) -> Self {
        Self { rotation: *pose.rotation.to_rotation_matrix().matrix(), origin: pose.translation.vector }
    }

    fn pose(&self) -> Pose {
        let rotation = Rotation3::from_matrix_unchecked(self.rotation);
        Isometry3::from_parts(self.origin.into(), UnitQuaternion::from_rotation_matrix(&rotation))
    }
}

/// One body with the revolute joint that connects it to its parent. Vectors and inertia in the frame of the body.
#[derive(Clone, Debug)]
pub(crate) struct Joint {
    pub name: String,
    /// Frame of the body in the frame of its parent at q = 0.
    pub placement: Frame,
    /// Joint axis in the frame of the body, of length 1.
    pub axis: Vector3<f64>,
    /// kg
    pub mass: f64,
    /// Centre of mass, m.
    pub com: Vector3<f64>,
    /// Rotational inertia about the centre of mass, kg m^2.
    pub inertia: Matrix3<f64>,
}

impl Joint {
    /// Frame of the body at the joint angle `q` (rad), for the frame of its parent.
    #[inline]
    pub(crate) fn frame(&self, parent: &Frame, q: f64) -> Frame {
        let (sin, cos) = q.sin_cos();
        let axis = &self.axis;
        let turn = Matrix3::identity() * cos + skew(axis) * sin + axis * axis.transpose() * (1.0 - cos);
        Frame {
            rotation: parent.rotation * self.placement.rotation * turn,
            origin: parent.rotation * self.placement.origin + parent.origin,
        }
    }

    /// Spatial inertia of the body in the world frame, for its `frame`.
    #[inline]
    pub(crate) fn world_inertia(&self, frame: &Frame) -> SpatialInertia {
        let about_com = frame.rotation * self.inertia * frame.rotation.transpose();
        SpatialInertia::new(self.mass, frame.rotation * self.com + frame.origin, about_com)
    }
}

/// The model of a robot: a serial chain of revolute joints of which the last ones are unactuated.
#[derive(Clone, Debug)]
pub struct Model {
    pub(crate) joints: [Joint; NQ],
    /// Frame of the base in the world frame, which is the root frame of the URDF.
    pub(crate) base: Frame,
    /// Tip of the rod in the frame of the last body, m.
    pub(crate) tip: Vector3<f64>,
    /// Inertia of the rotors, reflected to the actuated joints, kg m^2.
    pub(crate) rotors: ActuatedVector,
    /// Gravity in the world frame, m/s^2.
    pub(crate) gravity: Vector3<f64>,
    pub(crate) rated_limits: Limits,
    pub(crate) fingerprint: u64,
}

impl Model {
    /// Fingerprint of the dynamics (XXH3, 64 bit, over all kinematic and inertial parameters): two models with the same
    /// fingerprint give the same numbers. Limits do not enter.
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint
    }

    /// Limits in the URDF (100 %); infinite where the URDF states none.
    pub fn rated_limits(&self) -> &Limits {
        &self.rated_limits
    }

    /// Name of each joint, as in the URDF.
    pub fn joint_names(&self) -> [&str; NQ] {
        std::array::from_fn(|i| self.joints[i].name.as_str())
    }

    /// Forward kinematics: poses of the frames O_1..O_9 of the bodies in the world frame, for `q` in rad.
    pub fn poses(&self, q: &JointVector) -> [Pose; NQ] {
        self.frames(q).map(|frame| frame.pose())
    }

    fn frames(&self, q: &JointVector) -> [Frame; NQ] {
        let mut parent = self.base;
        std::array::from_fn(|i| {
            parent = self.joints[i].frame(&parent, q[i]);
            parent
        })
    }

    /// Position of the tip of the pendulum in the world frame, m, for `q` in rad.
    pub fn tip(&self, q: &JointVector) -> Vector3<f64> {
        let last = self.frames(q)[NQ - 1];
        last.rotation * self.tip + last.origin
    }

    /// Vector from the last joint to the tip of the pendulum in the world frame (z up), m, for `q` in rad.
    pub fn rod(&self, q: &JointVector) -> Vector3<f64> {
        self.frames(q)[NQ - 1].rotation * self.tip
    }

    /// Potential energy at `q` (rad), J; zero at the world origin.
    pub fn potential_energy(&self, q: &JointVector) -> f64 {
        let frames = self.frames(q);
        frames
            .iter()
            .zip(&self.joints)
            .map(|(f, j)| -j.mass * self.gravity.dot(&(f.rotation * j.com + f.origin)))
            .sum()
    }

    /// A model with scaled masses and inertias: those of the arm times `arm`, those of the pendulum times `pendulum`
    /// (dimensionless, above 0). For runs with a mismatched plant.
    pub fn with_scaled_masses(&self, arm: f64, pendulum: f64) -> Self {
        let mut scaled = self.clone();
        for (i, joint) in scaled.joints.iter_mut().enumerate() {
            let factor = if i < NU { arm } else { pendulum };
            joint.mass *= factor;
            joint.inertia *= factor;
        }
        scaled.fingerprint = scaled.compute_fingerprint();
        scaled
    }

    /// A model whose last body, the rod, is `scale` times as long with the same mass: the distances of centre of mass and tip
    /// from the joint grow by that factor, the inertia by its square. For runs with a mismatched plant.
    pub fn with_scaled_rod_length(&self, scale: f64) -> Self {
        let mut scaled = self.clone();
        let rod = &mut scaled.joints[NQ - 1];
        rod.com *= scale;
        rod.inertia *= scale * scale;
        scaled.tip *= scale;
        scaled.fingerprint = scaled.compute_fingerprint();
        scaled
    }

    /// A model with a point `mass` (kg, 0 or above) on its last actuated body, at `com` in the frame of that body (m). For
    /// runs with a mismatched plant.
    pub fn with_payload(&self, mass: f64, com: Vector3<f64>) -> Self {
        let mut loaded = self.clone();
        // Joining nothing would still round.
        if mass == 0.0 {
            return loaded;
        }
        let link = &mut loaded.joints[NU - 1];
        let body = Body { mass: link.mass, com: link.com, inertia: link.inertia };
        let body = body.joined(Body { mass, com, inertia: Matrix3::zeros() });
        (link.mass, link.com, link.inertia) = (body.mass, body.com, body.inertia);
        loaded.fingerprint = loaded.compute_fingerprint();
        loaded
    }

    /// A model with the rotor inertias `rotors`, reflected to the actuated joints (kg m^2, 0 or above), on the diagonal of M:
    /// the usual approximation of a geared drive, without gyroscopic terms. f (5) does not depend on them.
    pub fn with_rotors(&self, rotors: [f64; NU]) -> Self {
        let mut geared = self.clone();
        geared.rotors = rotors.into();
        geared.fingerprint = geared.compute_fingerprint();
        geared
    }

    /// Joint torques J^T F, N m, of a `force` F (N, world frame) on the tip of the pendulum, for `q` in rad.
    pub fn torque_of_tip_force(&self, q: &JointVector, force: &Vector3<f64>) -> JointVector {
        let frames = self.frames(q);
        let last = &frames[NQ - 1];
        let tip = last.rotation * self.tip + last.origin;
        JointVector::from_fn(|i, _| {
            let axis = frames[i].rotation * self.joints[i].axis;
            axis.dot(&(tip - frames[i].origin).cross(force))
        })
    }

    pub(crate) fn compute_fingerprint(&self) -> u64 {
        let mut hash = xxhash_rust::xxh3::Xxh3::new();
        let mut put = |v: f64| hash.update(&v.to_le_bytes());
        for frame in std::iter::once(&self.base).chain(self.joints.iter().map(|j| &j.placement)) {
            frame.origin.iter().chain(frame.rotation.iter()).for_each(|v| put(*v));
        }
        for j in &self.joints {
            j.axis.iter().chain(j.com.iter()).chain(j.inertia.iter()).for_each(|v| put(*v));
            put(j.mass);
        }
        self.gravity.iter().for_each(|v| put(*v));
        // Without rotors a model is what its URDF says.
        if self.rotors != ActuatedVector::zeros() {
            self.rotors.iter().for_each(|v| put(*v));
        }
        hash.digest()
    }
}
