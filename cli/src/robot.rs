//! The robot's links as its URDF draws them: frames for recordings, shapes for pictures.

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use serde::Serialize;
use upswing_model::{JointVector, Model};
use urdf_rs::{Geometry, Pose};

/// Why a URDF cannot be drawn.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// Not a URDF.
    #[error("not a readable URDF: {0}")]
    Parse(String),
    /// A link that no chain of joints leads to.
    #[error("expected every joint to hang on the root link, got joint `{0}` that does not")]
    Loose(String),
}

/// A capsule: all points within `radius` (m) of the line from `a` to `b` (m, frame of the link).
#[derive(Clone, Debug, Serialize)]
pub struct Capsule {
    /// One end.
    pub a: [f64; 3],
    /// The other end.
    pub b: [f64; 3],
    /// m
    pub radius: f64,
    /// Red, green, blue, 0 to 255.
    pub colour: [u8; 3],
}

/// One link.
#[derive(Clone, Debug)]
pub struct Link {
    /// Name in the URDF.
    pub name: String,
    /// Index of the parent, which stands before it; `None`: the root.
    pub parent: Option<usize>,
    /// Frame in the parent's at q = 0.
    pub origin: Isometry3<f64>,
    /// Index of its joint in q and the axis in its own frame; `None`: fixed.
    pub joint: Option<(usize, Unit<Vector3<f64>>)>,
    /// What it looks like.
    pub shapes: Vec<Capsule>,
}

/// A tree of links.
#[derive(Clone, Debug)]
pub struct Robot {
    /// Parents first; the root is the first one.
    pub links: Vec<Link>,
    /// The text it was read from.
    pub urdf: String,
}

impl Robot {
    /// Reads the links; `model` was read from the same text and says which joint is which.
    ///
    /// # Errors
    /// [`RobotError`]
    pub fn from_urdf(urdf: &str, model: &Model) -> Result<Self, RobotError> {
        let robot = urdf_rs::read_from_string(urdf).map_err(|e| RobotError::Parse(e.to_string()))?;
        let names = model.joint_names();
        let is_child = |name: &str| robot.joints.iter().any(|j| j.child.link == name);
        let mut links: Vec<Link> = Vec::new();
        for root in robot.links.iter().filter(|l| !is_child(&l.name)) {
            let origin = Isometry3::identity();
            links.push(Link {
                name: root.name.clone(),
                parent: None,
                origin,
                joint: None,
                shapes: shapes(&robot, &root.name),
            });
        }
        let mut pending: Vec<_> = robot.joints.iter().collect();
        while !pending.is_empty() {
            let before = pending.len();
            pending.retain(|joint| {
                let Some(parent) = links.iter().position(|l| l.name == joint.parent.link) else {
                    return true;
                };
                let index = names.iter().position(|name| *name == joint.name);
                links.push(Link {
                    name: joint.child.link.clone(),
                    parent: Some(parent),
                    origin: isometry(&joint.origin),
                    joint: index.map(|i| (i, Unit::new_normalize(Vector3::from(joint.axis.xyz.0)))),
                    shapes: shapes(&robot, &joint.child.link),
                });
                false
            });
            if pending.len() == before {
                return Err(RobotError::Loose(pending[0].name.clone()));
            }
        }
        Ok(Self { links, urdf: urdf.to_owned() })
    }

    /// Name of the parent, name, and frame in the parent's, of each link but the root, at the angles q, rad.
    pub fn transforms(&self, q: &JointVector) -> impl Iterator<Item = (&str, &str, Isometry3<f64>)> {
        self.links.iter().filter_map(|link| {
            let turn = link.joint.map_or_else(UnitQuaternion::identity, |(i, axis)| {
                UnitQuaternion::from_axis_angle(&axis, q[i])
            });
            let parent = &self.links[link.parent?];
            Some((parent.name.as_str(), link.name.as_str(), link.origin * turn))
        })
    }
}

fn isometry(pose: &Pose) -> Isometry3<f64> {
    let [r, p, y] = pose.rpy.0;
    let turn = UnitQuaternion::from_euler_angles(r, p, y);
    Isometry3::from_parts(Translation3::from(Vector3::from(pose.xyz.0)), turn)
}

/// The shapes of a link. Meshes are left out: nothing outside the URDF is read.
fn shapes(robot: &urdf_rs::Robot, link: &str) -> Vec<Capsule> {
    let Some(link) = robot.links.iter().find(|l| l.name == link) else { return Vec::new() };
    let capsule = |visual: &urdf_rs::Visual| {
        let (half, radius) = match &visual.geometry {
            Geometry::Cylinder { radius, length } | Geometry::Capsule { radius, length } => {
                (Vector3::z() * (*length / 2.0), *radius)
            }
            Geometry::Sphere { radius } => (Vector3::zeros(), *radius),
            Geometry::Box { size } => {
                let size = Vector3::from(size.0);
                let long = size.imax();
                let radius = (size.sum() - size[long]) / 4.0;
                (Vector3::ith(long, (size[long] / 2.0 - radius).max(0.0)), radius)
            }
            Geometry::Mesh { .. } => return None,
        };
        let pose = isometry(&visual.origin);
        let end = |v: Vector3<f64>| (pose * Point3::from(v)).coords.into();
        Some(Capsule { a: end(-half), b: end(half), radius, colour: colour(robot, visual) })
    };
    link.visual.iter().filter_map(capsule).collect()
}

fn colour(robot: &urdf_rs::Robot, visual: &urdf_rs::Visual) -> [u8; 3] {
    /// Where the URDF names none.
    const GREY: [f64; 4] = [0.6, 0.6, 0.6, 1.0];
    let own = visual.material.as_ref();
    let named = own.and_then(|own| robot.materials.iter().find(|m| m.name == own.name));
    let colour = own.and_then(|m| m.color.as_ref()).or_else(|| named.and_then(|m| m.color.as_ref()));
    let rgba = colour.map_or(GREY, |c| c.rgba.0);
    [rgba[0], rgba[1], rgba[2]].map(|v| (v.clamp(0.0, 1.0) * 255.0) as u8)
}
