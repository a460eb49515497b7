//! Links of the robot in its URDF: frames for recordings, shapes for pictures.

use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};
use serde::Serialize;
use upswing_model::{Model, Urdf, UrdfError, UrdfJointKind, UrdfLink, UrdfShape, UrdfVisual};

/// A capsule: all points within `radius` of the line segment from `a` to `b`.
#[derive(Clone, Debug, Serialize)]
pub struct Capsule {
    /// First end of the segment, m, frame of the link.
    pub a: [f64; 3],
    /// Second end of the segment, m, frame of the link.
    pub b: [f64; 3],
    /// Radius, m.
    pub radius: f64,
    /// Colour: red, green, blue, 0 to 255.
    pub colour: [u8; 3],
}

/// Joint of a link.
#[derive(Clone, Copy, Debug)]
pub struct LinkJoint {
    /// Number of the joint in the chain, from 0.
    pub index: usize,
    /// Axis in the frame of the link.
    pub axis: Unit<Vector3<f64>>,
    /// Whether the joint slides along its axis; otherwise it turns about it.
    pub slides: bool,
}

/// A link of the robot.
#[derive(Clone, Debug)]
pub struct Link {
    /// Name in the URDF.
    pub name: String,
    /// Index of the parent link, lower than that of this link; `None` for the root.
    pub parent: Option<usize>,
    /// Pose of the link in the frame of its parent at q = 0, m.
    pub origin: Isometry3<f64>,
    /// Joint of the link; `None` for a fixed link.
    pub joint: Option<LinkJoint>,
    /// Shapes of the link for pictures.
    pub shapes: Vec<Capsule>,
}

/// Kinematic tree of the links of a robot, with its URDF.
#[derive(Clone, Debug)]
pub struct Robot {
    /// Links, parents before children; the root is the first link.
    pub links: Vec<Link>,
    /// Text of the URDF.
    pub urdf: String,
}

impl Robot {
    /// Reads the links from a URDF; `model`, read from the same URDF, gives the order of the joints.
    ///
    /// # Errors
    /// [`UrdfError`] if the text is no usable URDF.
    pub fn from_urdf(urdf: &str, model: &Model) -> Result<Self, UrdfError> {
        let robot = Urdf::read(urdf)?;
        let names: Vec<_> = model.joint_names().collect();
        let root = &robot.links[robot.root];
        let mut links = vec![Link {
            name: root.name.clone(),
            parent: None,
            origin: Isometry3::identity(),
            joint: None,
            shapes: shapes(root),
        }];
        // Index of the parent in `links`, and the joints of a link, reversed: they are popped in the order of the file.
        let on = |link: &UrdfLink, place: usize| {
            let joints: Vec<_> = link.children.iter().rev().map(|joint| (place, *joint)).collect();
            joints
        };
        let mut pending = on(root, 0);
        while let Some((parent, joint)) = pending.pop() {
            let joint = &robot.joints[joint];
            let link = &robot.links[joint.child];
            pending.extend(on(link, links.len()));
            let index = names.iter().position(|name| *name == joint.name);
            links.push(Link {
                name: link.name.clone(),
                parent: Some(parent),
                origin: joint.origin,
                joint: index.map(|index| LinkJoint {
                    index,
                    axis: Unit::new_unchecked(joint.axis),
                    slides: joint.kind == UrdfJointKind::Prismatic,
                }),
                shapes: shapes(link),
            });
        }
        Ok(Self { links, urdf: urdf.to_owned() })
    }

    /// Name of the parent, name of the link, and its pose in the frame of the parent (m), for each link except the root, at the
    /// joint positions `q` (rad or m) in the chain's order. Joints beyond the end of `q` are at 0.
    pub fn transforms(&self, q: &[f64]) -> impl Iterator<Item = (&str, &str, Isometry3<f64>)> {
        self.links.iter().filter_map(|link| {
            let motion = link.joint.map_or_else(Isometry3::identity, |LinkJoint { index, axis, slides }| {
                let q = q.get(index).copied().unwrap_or_default();
                match slides {
                    true => Translation3::from(axis.into_inner() * q).into(),
                    false => Isometry3::from_parts(
                        Translation3::identity(),
                        UnitQuaternion::from_axis_angle(&axis, q),
                    ),
                }
            });
            let parent = &self.links[link.parent?];
            Some((parent.name.as_str(), link.name.as_str(), link.origin * motion))
        })
    }
}

/// The visual shapes of a link, each approximated by a capsule, m.
fn shapes(link: &UrdfLink) -> Vec<Capsule> {
    /// Colour of a shape without one in the URDF: red, green, blue, alpha, 0 to 1.
    const GREY: [f64; 4] = [0.6, 0.6, 0.6, 1.0];
    let capsule = |visual: &UrdfVisual| {
        let (half, radius) = match visual.shape {
            UrdfShape::Cylinder { radius, length } => (Vector3::z() * (length / 2.0), radius),
            UrdfShape::Sphere { radius } => (Vector3::zeros(), radius),
            UrdfShape::Box { size } => {
                let long = size.imax();
                let radius = (size.sum() - size[long]) / 4.0;
                (Vector3::ith(long, (size[long] / 2.0 - radius).max(0.0)), radius)
            }
        };
        let end = |v: Vector3<f64>| (visual.origin * Point3::from(v)).coords.into();
        let [red, green, blue, _] = visual.colour.unwrap_or(GREY).map(|v| (v.clamp(0.0, 1.0) * 255.0) as u8);
        Capsule { a: end(-half), b: end(half), radius, colour: [red, green, blue] }
    };
    link.visuals.iter().map(capsule).collect()
}
