//! The robot's links as its URDF draws them: frames for recordings, shapes for pictures.

use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};
use serde::Serialize;
use upswing_model::{JointVector, Model, Urdf, UrdfError, UrdfLink, UrdfShape, UrdfVisual};

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
    /// [`UrdfError`]
    pub fn from_urdf(urdf: &str, model: &Model) -> Result<Self, UrdfError> {
        let robot = Urdf::read(urdf)?;
        let names = model.joint_names();
        let root = &robot.links[robot.root];
        let mut links = vec![Link {
            name: root.name.clone(),
            parent: None,
            origin: Isometry3::identity(),
            joint: None,
            shapes: shapes(root),
        }];
        // Index of the parent in `links` and the joint, those of a link in the order of the file.
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
                joint: index.map(|i| (i, Unit::new_unchecked(joint.axis))),
                shapes: shapes(link),
            });
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

/// The shapes of a link, each as the capsule that is closest to it.
fn shapes(link: &UrdfLink) -> Vec<Capsule> {
    /// Where the URDF names none.
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
