//! The model of a robot: its constants and its forward kinematics.

use crate::description::Body;
use crate::dynamics::Frame;
use crate::{ActuatedVector, JointVector, Limits, Order, Sizes, UnactuatedVector};
use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Pose of a frame in the world frame, m.
pub type Pose = Isometry3<f64>;

/// How a joint moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// The joint turns within limits.
    Revolute,
    /// The joint turns without limits.
    Continuous,
    /// The joint slides within limits.
    Prismatic,
}

impl JointKind {
    /// Unit of the position.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Revolute | Self::Continuous => "rad",
            Self::Prismatic => "m",
        }
    }

    /// The position `q` (rad or m) as a person reads it, in deg or m, and its unit.
    pub fn shown(self, q: f64) -> (f64, &'static str) {
        match self {
            Self::Revolute | Self::Continuous => (q.to_degrees(), "deg"),
            Self::Prismatic => (q, "m"),
        }
    }

    /// The position, rad or m, that a person writes as `shown`, in deg or m.
    pub fn position(self, shown: f64) -> f64 {
        match self {
            Self::Revolute | Self::Continuous => shown.to_radians(),
            Self::Prismatic => shown,
        }
    }
}

/// One body with the joint that connects it to its parent. The frame of the body is turned so that the joint axis is its z axis;
/// vectors and inertia in that frame.
#[derive(Clone, Debug)]
pub(crate) struct Joint {
    pub name: String,
    pub kind: JointKind,
    /// Rotation of the frame of the body in the frame of its parent at q = 0, by rows.
    pub rotation: [[f64; 3]; 3],
    /// Origin of the frame of the body in the frame of its parent at q = 0, m.
    pub origin: [f64; 3],
    /// Rotation of the body's frame in the URDF in the frame of the body.
    pub urdf_frame: Matrix3<f64>,
    /// kg
    pub mass: f64,
    /// Centre of mass, m.
    pub com: [f64; 3],
    /// Rotational inertia about the centre of mass, kg m^2, by rows.
    pub inertia: [[f64; 3]; 3],
}

/// A joint of a chain and the body on it, in the frames of the URDF.
#[derive(Clone, Debug)]
pub(crate) struct JointParameters {
    pub name: String,
    pub kind: JointKind,
    pub is_actuated: bool,
    /// Frame of the body in the frame of its parent at q = 0.
    pub placement: Isometry3<f64>,
    /// Joint axis in the frame of the body, of length 1.
    pub axis: Vector3<f64>,
    pub body: Body,
}

/// A rotation whose third column is `axis`, of length 1; exact if the axis is that of a coordinate.
fn rotation_onto(axis: &Vector3<f64>) -> Matrix3<f64> {
    let mut e = Vector3::zeros();
    // The coordinate axis that is least aligned with the axis.
    e[axis.iamin()] = 1.0;
    let x = e.cross(axis).normalize();
    Matrix3::from_columns(&[x, axis.cross(&x), *axis])
}

/// The rows of a matrix.
fn rows(m: &Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]))
}

/// The matrix with these rows.
fn matrix(rows: &[[f64; 3]; 3]) -> Matrix3<f64> {
    Matrix3::from_fn(|i, j| rows[i][j])
}

/// The model of a robot: a serial chain of joints, some of which are unactuated.
#[derive(Clone, Debug)]
pub struct Model {
    /// In the chain's order, from base to tip.
    pub(crate) joints: Vec<Joint>,
    pub(crate) order: Order,
    /// Tip of the rod in the frame of the last body, m.
    pub(crate) tip: Vector3<f64>,
    /// Inertia of the rotors, reflected to the actuated joints, kg m^2 or kg.
    pub(crate) rotors: ActuatedVector,
    /// Viscous friction D of the unactuated joints, N m s/rad or N s/m.
    pub(crate) friction: UnactuatedVector,
    /// Gravity in the world frame, m/s^2.
    pub(crate) gravity: Vector3<f64>,
    pub(crate) rated_limits: Limits,
    pub(crate) fingerprint: u64,
}

impl Model {
    /// The model of a chain; `tip` in the frame of the last body in the URDF.
    pub(crate) fn new(
        order: Order,
        chain: Vec<JointParameters>,
        tip: Vector3<f64>,
        gravity: Vector3<f64>,
        rated_limits: Limits,
    ) -> Self {
        let mut turn = Matrix3::identity();
        let joints = chain
            .into_iter()
            .map(|joint| {
                let parent = turn.transpose();
                turn = rotation_onto(&joint.axis);
                let placement = joint.placement.rotation.to_rotation_matrix();
                Joint {
                    name: joint.name,
                    kind: joint.kind,
                    rotation: rows(&(parent * placement.matrix() * turn)),
                    origin: (parent * joint.placement.translation.vector).into(),
                    urdf_frame: turn.transpose(),
                    mass: joint.body.mass,
                    com: (turn.transpose() * joint.body.com).into(),
                    inertia: rows(&(turn.transpose() * joint.body.inertia * turn)),
                }
            })
            .collect();
        let mut model = Self {
            joints,
            order,
            tip: turn.transpose() * tip,
            rotors: ActuatedVector::zeros(order.sizes()),
            friction: UnactuatedVector::zeros(order.sizes()),
            gravity,
            rated_limits,
            fingerprint: 0,
        };
        model.fingerprint = model.compute_fingerprint();
        model
    }

    /// Numbers of joints.
    #[inline(always)]
    pub fn sizes(&self) -> Sizes {
        self.order.sizes()
    }

    /// The index sets A and U: where each joint of the chain stands in sorted vectors.
    #[inline(always)]
    pub fn order(&self) -> &Order {
        &self.order
    }

    /// Fingerprint of the dynamics (XXH3, 64 bit, over all kinematic and inertial parameters): two models with the same
    /// fingerprint give the same numbers. Limits do not enter.
    pub fn fingerprint(&self) -> u64 {
        self.fingerprint
    }

    /// Limits in the URDF (100 %); infinite where the URDF states none.
    pub fn rated_limits(&self) -> &Limits {
        &self.rated_limits
    }

    /// Names of the joints in the URDF, in the chain's order.
    pub fn joint_names(&self) -> impl ExactSizeIterator<Item = &str> + Clone {
        self.joints.iter().map(|joint| joint.name.as_str())
    }

    /// Name of the joint of index `coordinate` in sorted vectors.
    pub fn joint_name(&self, coordinate: usize) -> &str {
        &self.joints[self.order.joint(coordinate)].name
    }

    /// Kind of the joint of index `coordinate` in sorted vectors.
    pub fn joint_kind(&self, coordinate: usize) -> JointKind {
        self.joints[self.order.joint(coordinate)].kind
    }

    /// Index in sorted vectors of the joint called `name`.
    pub fn coordinate(&self, name: &str) -> Option<usize> {
        self.joint_names().position(|joint| joint == name).map(|joint| self.order.coordinate(joint))
    }

    /// Forward kinematics: poses of the frames O_1..O_n of the bodies in the world frame, in the chain's order.
    pub fn poses(&self, q: &JointVector) -> Vec<Pose> {
        self.frames(q)
            .zip(&self.joints)
            .map(|((rotation, origin), joint)| {
                let rotation = Rotation3::from_matrix_unchecked(rotation * joint.urdf_frame);
                Isometry3::from_parts(origin.into(), UnitQuaternion::from_rotation_matrix(&rotation))
            })
            .collect()
    }

    /// Rotation and origin (m) of the frames of the bodies in the world frame, in the chain's order.
    fn frames(&self, q: &JointVector) -> impl Iterator<Item = (Matrix3<f64>, Vector3<f64>)> {
        let mut frame = Frame::base();
        let q = *q;
        self.joints.iter().enumerate().map(move |(i, joint)| {
            joint.advance(&mut frame, q[self.order.coordinate(i)]);
            (matrix(&frame.rotation.0), frame.origin.0.into())
        })
    }

    /// Rotation and origin (m) of the frame of the last body in the world frame.
    fn last_frame(&self, q: &JointVector) -> (Matrix3<f64>, Vector3<f64>) {
        self.frames(q).last().unwrap_or((Matrix3::identity(), Vector3::zeros()))
    }

    /// Position of the tip of the pendulum in the world frame, m.
    pub fn tip(&self, q: &JointVector) -> Vector3<f64> {
        let (rotation, origin) = self.last_frame(q);
        rotation * self.tip + origin
    }

    /// Vector from the last joint to the tip of the pendulum in the world frame (z up), m.
    pub fn rod(&self, q: &JointVector) -> Vector3<f64> {
        self.last_frame(q).0 * self.tip
    }

    /// Potential energy, J; zero at the world origin.
    pub fn potential_energy(&self, q: &JointVector) -> f64 {
        self.frames(q)
            .zip(&self.joints)
            .map(|((rotation, origin), j)| {
                -j.mass * self.gravity.dot(&(rotation * Vector3::from(j.com) + origin))
            })
            .sum()
    }

    /// A model with scaled masses and inertias: those of the bodies before the first unactuated joint times `arm`, those of the others
    /// times `pendulum` (dimensionless, above 0). For runs with a mismatched plant.
    pub fn with_scaled_masses(&self, arm: f64, pendulum: f64) -> Self {
        let mut scaled = self.clone();
        let first = self.first_unactuated();
        for (i, joint) in scaled.joints.iter_mut().enumerate() {
            let factor = if i < first { arm } else { pendulum };
            joint.mass *= factor;
            joint.inertia.as_flattened_mut().iter_mut().for_each(|v| *v *= factor);
        }
        scaled.fingerprint = scaled.compute_fingerprint();
        scaled
    }

    /// A model whose last body, the rod, is `scale` times as long with the same mass: the distances of centre of mass and tip
    /// from the joint grow by that factor, the inertia by its square. For runs with a mismatched plant.
    pub fn with_scaled_rod_length(&self, scale: f64) -> Self {
        let mut scaled = self.clone();
        if let Some(rod) = scaled.joints.last_mut() {
            rod.com.iter_mut().for_each(|v| *v *= scale);
            rod.inertia.as_flattened_mut().iter_mut().for_each(|v| *v *= scale * scale);
        }
        scaled.tip *= scale;
        scaled.fingerprint = scaled.compute_fingerprint();
        scaled
    }

    /// A model with a point `mass` (kg, 0 or above) on the last body before the first unactuated joint, at `com` in the frame of that
    /// body in the URDF (m). For runs with a mismatched plant. The mass has no effect if the first joint is unactuated.
    pub fn with_payload(&self, mass: f64, com: Vector3<f64>) -> Self {
        let mut loaded = self.clone();
        let link = self.first_unactuated().checked_sub(1).and_then(|last| loaded.joints.get_mut(last));
        // Joining nothing would still round.
        let Some(link) = link.filter(|_| mass != 0.0) else { return loaded };
        let body = Body { mass: link.mass, com: link.com.into(), inertia: matrix(&link.inertia) };
        let body = body.joined(Body { mass, com: link.urdf_frame * com, inertia: Matrix3::zeros() });
        (link.mass, link.com, link.inertia) = (body.mass, body.com.into(), rows(&body.inertia));
        loaded.fingerprint = loaded.compute_fingerprint();
        loaded
    }

    /// The first unactuated joint of the chain, counted from 0.
    fn first_unactuated(&self) -> usize {
        self.order.joint(self.sizes().actuated())
    }

    /// A model with the rotor inertias `rotors`, reflected to the actuated joints (kg m^2 or kg, 0 or above), on the diagonal of M:
    /// the usual approximation of a geared drive, without gyroscopic terms. f (5) does not depend on them.
    pub fn with_rotors(&self, rotors: &ActuatedVector) -> Self {
        let mut geared = self.clone();
        geared.rotors = *rotors;
        geared.fingerprint = geared.compute_fingerprint();
        geared
    }

    /// A model with viscous `friction` D of the unactuated joints (N m s/rad or N s/m, 0 or above): M_UA u + M_UU qdd_U + C_U qd + D qd_U
    /// + g_U = 0 replaces (3a), and all that follows from it. Inverse and forward dynamics are those of the bodies alone.
    pub fn with_friction(&self, friction: &UnactuatedVector) -> Self {
        let mut slowed = self.clone();
        slowed.friction = *friction;
        slowed.fingerprint = slowed.compute_fingerprint();
        slowed
    }

    /// Joint torques J^T F, N m or N, of a `force` F (N, world frame) on the tip of the pendulum.
    pub fn torque_of_tip_force(&self, q: &JointVector, force: &Vector3<f64>) -> JointVector {
        let tip = self.tip(q);
        let mut torque = JointVector::zeros(self.sizes());
        for (i, (rotation, origin)) in self.frames(q).enumerate() {
            let axis = rotation.column(2);
            torque[self.order.coordinate(i)] = match self.joints[i].kind {
                JointKind::Revolute | JointKind::Continuous => axis.dot(&(tip - origin).cross(force)),
                JointKind::Prismatic => axis.dot(force),
            };
        }
        torque
    }

    pub(crate) fn compute_fingerprint(&self) -> u64 {
        let mut hash = xxhash_rust::xxh3::Xxh3::new();
        for (i, j) in self.joints.iter().enumerate() {
            // Revolute and continuous joints differ in their limits only.
            hash.update(&[u8::from(j.kind == JointKind::Prismatic), u8::from(self.order.is_actuated(i))]);
        }
        let mut put = |v: f64| hash.update(&v.to_le_bytes());
        for j in &self.joints {
            j.origin.iter().chain(j.rotation.as_flattened()).for_each(|v| put(*v));
            j.com.iter().chain(j.inertia.as_flattened()).for_each(|v| put(*v));
            put(j.mass);
        }
        self.gravity.iter().for_each(|v| put(*v));
        // Without rotors and friction a model is what its URDF says.
        if self.rotors.iter().any(|v| *v != 0.0) {
            self.rotors.iter().for_each(|v| put(*v));
        }
        if self.friction.iter().any(|v| *v != 0.0) {
            self.friction.iter().for_each(|v| put(*v));
        }
        hash.digest()
    }
}
