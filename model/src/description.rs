//! Reads a URDF file (<http://wiki.ros.org/urdf/XML>) as a tree of links and joints, and checks each number.
//!
//! URDF files are not trusted: the length of the text bounds the time and memory that reading it takes. Elements may be nested to
//! any depth; their number and that of their attributes is limited. Elements on which the motion of the robot does not depend
//! (meshes, textures, transmissions, elements of other programs) are skipped.

use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, UnitQuaternion, Vector3};
use roxmltree::{Document, Node, ParsingOptions};
use std::collections::{HashMap, HashSet};

use crate::urdf_error::{UrdfElement, UrdfElementError, UrdfError, UrdfSyntaxError};

/// Longest text, bytes: several times that of a humanoid.
const LENGTH: usize = 4 << 20;
/// Most elements, comments and texts between them.
const NODES: u32 = 100_000;
/// Most attributes of one element: the parser compares each of them with all others.
const ATTRIBUTES: usize = 1_000;
/// Most declarations of name spaces: all elements inside inherit each of them.
const NAME_SPACES: usize = 100;
/// Most warnings about one text.
const WARNINGS: usize = 20;

/// Largest offset or size, m.
const FAR: f64 = 100.0;
/// Largest angle of a frame, rad.
const TURNED: f64 = 100.0;
/// Largest mass, kg.
const HEAVY: f64 = 1e5;
/// Largest moment or product of inertia, kg m^2.
const INERT: f64 = 1e6;
/// Largest limit: rad, rad/s, N m, or m, m/s, N.
const LIMIT: f64 = 1e6;

/// A robot as described by its URDF: a tree of links.
#[derive(Clone, Debug)]
pub struct Urdf {
    /// The links in the order of the file.
    pub links: Vec<UrdfLink>,
    /// The joints in the order of the file.
    pub joints: Vec<UrdfJoint>,
    /// Index of the root link, which is the child of no joint.
    pub root: usize,
    /// Elements that were skipped although they may change the motion of the robot, one sentence each.
    pub warnings: Vec<String>,
}

/// A link of a URDF.
#[derive(Clone, Debug)]
pub struct UrdfLink {
    /// Name, unique among the links.
    pub name: String,
    /// Indices of the joints whose parent is this link.
    pub children: Vec<usize>,
    /// Shapes for drawings.
    pub visuals: Vec<UrdfVisual>,
    /// Body in the frame of the link; massless if the URDF states none.
    pub(crate) body: Body,
}

/// The kinds of joints that are supported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UrdfJointKind {
    /// The joint turns within limits.
    Revolute,
    /// The joint turns without limits.
    Continuous,
    /// The joint slides within limits.
    Prismatic,
    /// The joint does not move.
    Fixed,
}

/// A joint of a URDF.
#[derive(Clone, Debug)]
pub struct UrdfJoint {
    /// Name, unique among the joints.
    pub name: String,
    /// Kind of the joint.
    pub kind: UrdfJointKind,
    /// Index of the child link.
    pub child: usize,
    /// Frame of the child link in the frame of the parent link at q = 0, m.
    pub origin: Isometry3<f64>,
    /// Joint axis in the frame of the child link, of length 1.
    pub axis: Vector3<f64>,
    /// Viscous friction that the URDF states (`damping`), N m s/rad or N s/m; the model has none.
    pub damping: f64,
    /// Coulomb friction that the URDF states (`friction`), N m or N; the model has none.
    pub friction: f64,
    /// Limits, if the URDF states them.
    pub(crate) limit: Option<UrdfLimit>,
}

/// The numbers of an element `<limit>`; `None` where it states none.
#[derive(Clone, Copy, Debug)]
pub(crate) struct UrdfLimit {
    /// rad or m
    pub lower: Option<f64>,
    /// rad or m
    pub upper: Option<f64>,
    /// rad/s or m/s
    pub velocity: Option<f64>,
    /// N m or N
    pub effort: Option<f64>,
}

/// A shape centred at the origin of its frame; the axis of a cylinder or capsule is z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum UrdfShape {
    /// A cylinder, or a capsule without its round ends.
    Cylinder {
        /// m
        radius: f64,
        /// m
        length: f64,
    },
    /// A sphere.
    Sphere {
        /// m
        radius: f64,
    },
    /// A box.
    Box {
        /// Lengths of the edges, m.
        size: Vector3<f64>,
    },
}

/// A shape of a link for drawings. Meshes are skipped: no file other than the URDF is read.
#[derive(Clone, Debug)]
pub struct UrdfVisual {
    /// Frame of the shape in the frame of the link, m.
    pub origin: Isometry3<f64>,
    /// Shape and size.
    pub shape: UrdfShape,
    /// Red, green, blue, opacity, 0 to 1.
    pub colour: Option<[f64; 4]>,
}

/// A rigid body, in the frame of a link.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Body {
    /// kg
    pub mass: f64,
    /// Centre of mass, m.
    pub com: Vector3<f64>,
    /// Rotational inertia about the centre of mass, kg m^2.
    pub inertia: Matrix3<f64>,
}

impl Body {
    const NONE: Self = Self { mass: 0.0, com: Vector3::new(0.0, 0.0, 0.0), inertia: ZERO3 };

    /// The body in the frame in which its present frame has the pose `by`.
    pub(crate) fn moved(self, by: &Isometry3<f64>) -> Self {
        let r = by.rotation.to_rotation_matrix();
        Self {
            mass: self.mass,
            com: by * self.com + by.translation.vector,
            inertia: r.matrix() * self.inertia * r.matrix().transpose(),
        }
    }

    /// One rigid body made of both, which are in the same frame.
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

impl Urdf {
    /// The robot in the text of a URDF file.
    ///
    /// # Errors
    /// [`UrdfError`] if it is no URDF, no tree of links, or holds a number, joint or body that cannot be.
    pub fn read(text: &str) -> Result<Self, UrdfError> {
        let document = parse(text)?;
        let robot = document.root_element();
        let got = robot.tag_name().name();
        if got != "robot" {
            return Err(UrdfSyntaxError::Outermost { got: got.to_owned() }.into());
        }
        let colours = children(robot, "material").filter_map(|m| Some((m.attribute("name")?, colour(m)?)));
        // The first of a name counts.
        let colours: HashMap<_, _> = colours.collect::<Vec<_>>().into_iter().rev().collect();

        let mut warnings = UrdfWarnings::default();
        warnings
            .check(robot, &["link", "joint", "material", "gazebo", "transmission", "ros2_control", "sensor"]);
        let (mut links, mut by_name) = (Vec::new(), HashMap::new());
        let carried: HashSet<_> = children(robot, "joint").filter_map(|joint| end(joint, "child")).collect();
        for node in children(robot, "link") {
            let is_root = node.attribute("name").is_some_and(|name| !carried.contains(name));
            let link = read_link(node, is_root, &colours, &mut warnings)?;
            if by_name.insert(link.name.clone(), links.len()).is_some() {
                return Err(refuse(node, UrdfElementError::SameName { tag: "link" }));
            }
            links.push(link);
        }
        // The root link of several programs, which need no element for it.
        const WORLD: &str = "world";
        let names_world = children(robot, "joint").any(|joint| end(joint, "parent") == Some(WORLD));
        if names_world && !by_name.contains_key(WORLD) {
            by_name.insert(WORLD.to_owned(), links.len());
            let name = WORLD.to_owned();
            links.push(UrdfLink { name, children: Vec::new(), visuals: Vec::new(), body: Body::NONE });
        }
        let (mut joints, mut names) = (Vec::<UrdfJoint>::new(), HashMap::new());
        let mut above: Vec<Option<usize>> = vec![None; links.len()];
        for node in children(robot, "joint") {
            let (joint, parent) = read_joint(node, &by_name, &mut warnings)?;
            if names.insert(joint.name.clone(), joints.len()).is_some() {
                return Err(refuse(node, UrdfElementError::SameName { tag: "joint" }));
            }
            if let Some(first) = above[joint.child].replace(joints.len()) {
                let (link, joint) = (links[joint.child].name.clone(), joints[first].name.clone());
                return Err(refuse(node, UrdfElementError::SecondParent { link, joint }));
            }
            links[parent].children.push(joints.len());
            joints.push(joint);
        }

        let mut roots = (0..links.len()).filter(|i| above[*i].is_none());
        let root = roots.next().ok_or(UrdfError::NoRoot)?;
        if let Some(second) = roots.next() {
            let [first, second] = [root, second].map(|i| links[i].name.clone());
            return Err(UrdfError::Roots { first, second });
        }
        let (mut reached, mut pending) = (vec![false; links.len()], vec![root]);
        while let Some(link) = pending.pop() {
            reached[link] = true;
            pending.extend(links[link].children.iter().map(|joint| joints[*joint].child));
        }
        if let Some(loose) = reached.iter().position(|reached| !reached) {
            let element = UrdfElement::named("link", &links[loose].name);
            let cause = UrdfElementError::Loop { root: links[root].name.clone() }.into();
            return Err(UrdfError::Element { element, cause });
        }
        Ok(Self { links, joints, root, warnings: warnings.0 })
    }
}

/// The elements of a text that can be read in bounded time and memory.
pub(crate) fn parse(text: &str) -> Result<Document<'_>, UrdfSyntaxError> {
    let large = |what, limit, unit| Err(UrdfSyntaxError::Large { what, limit, unit });
    if text.len() > LENGTH {
        return large("a text", LENGTH, "bytes");
    }
    if text.matches("xmlns").nth(NAME_SPACES).is_some() {
        return large("declarations (xmlns)", NAME_SPACES, "name spaces");
    }
    let quotes = |tag: &str| tag.bytes().filter(|b| matches!(b, b'"' | b'\'')).count();
    if text.split('<').any(|tag| quotes(tag) > 2 * ATTRIBUTES) {
        return large("elements", ATTRIBUTES, "attributes");
    }
    let options = ParsingOptions { nodes_limit: NODES, ..ParsingOptions::default() };
    match Document::parse_with_options(text, options) {
        Ok(document) => Ok(document),
        Err(roxmltree::Error::NodesLimitReached) => large("a text", NODES as usize, "elements"),
        Err(cause) => {
            let incomplete =
                matches!(cause, roxmltree::Error::UnclosedRootNode | roxmltree::Error::UnexpectedEndOfStream);
            let end = incomplete.then(|| text.lines().count());
            let row = end.unwrap_or(cause.pos().row as usize);
            let before: usize = text.split_inclusive('\n').take(row).map(str::len).sum();
            Err(UrdfSyntaxError::Xml { cause: Box::new(cause), end, after: last_element(&text[..before]) })
        }
    }
}

/// Kind and name of the last link or joint that begins in a text.
fn last_element(text: &str) -> Option<UrdfElement> {
    let (at, kind) =
        ["link", "joint"].iter().filter_map(|k| Some((text.rfind(&format!("<{k} "))?, *k))).max()?;
    let name = text[at..].split(['"', '\'']).nth(1)?;
    Some(UrdfElement::named(kind, name))
}

/// Child elements in the name space of their parent.
fn elements<'a, 'i>(node: Node<'a, 'i>) -> impl Iterator<Item = Node<'a, 'i>> {
    let space = node.tag_name().namespace();
    node.children().filter(move |child| child.is_element() && child.tag_name().namespace() == space)
}

pub(crate) fn children<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> impl Iterator<Item = Node<'a, 'i>> {
    elements(node).filter(move |child| child.tag_name().name() == name)
}

/// The child element with a name, if there is one.
fn child<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> Result<Option<Node<'a, 'i>>, UrdfError> {
    let mut all = children(node, name);
    let first = all.next();
    if all.next().is_some() {
        return Err(refuse(node, UrdfElementError::Several { tag: name }));
    }
    Ok(first)
}

/// The error that names the link or joint to which `node` belongs.
fn refuse(node: Node<'_, '_>, cause: UrdfElementError) -> UrdfError {
    let kind = |n: &Node<'_, '_>| n.is_element() && matches!(n.tag_name().name(), "link" | "joint");
    let within =
        node.ancestors().filter(|n| n.parent_element().is_some_and(|p| p.parent_element().is_none()));
    let owner = within.into_iter().find(kind).unwrap_or(node);
    let tag = owner.tag_name().name();
    let element = match owner.attribute("name").filter(|name| !name.is_empty()) {
        Some(name) => UrdfElement::named(tag, name),
        None => UrdfElement::Unnamed { tag: tag.to_owned(), line: line(owner) },
    };
    UrdfError::Element { element, cause: cause.into() }
}

fn line(node: Node<'_, '_>) -> u32 {
    node.document().text_pos_at(node.range().start).row
}

fn required<'a>(node: Node<'a, '_>, attribute: &'static str) -> Result<&'a str, UrdfError> {
    let tag = || node.tag_name().name().to_owned();
    node.attribute(attribute)
        .ok_or_else(|| refuse(node, UrdfElementError::NoAttribute { tag: tag(), attribute }))
}

fn name_of(node: Node<'_, '_>) -> Result<String, UrdfError> {
    let name = node.attribute("name").filter(|name| !name.is_empty());
    name.map(str::to_owned).ok_or_else(|| refuse(node, UrdfElementError::NoName))
}

/// The `N` numbers in the `text` of an attribute; each may have a magnitude of at most `bound`.
fn numbers<const N: usize>(
    node: Node<'_, '_>,
    attribute: &'static str,
    text: &str,
    bound: f64,
    unit: &'static str,
) -> Result<[f64; N], UrdfError> {
    let all: Result<Vec<f64>, _> = text.split_whitespace().map(str::parse).collect();
    let all = all.ok().and_then(|all| <[f64; N]>::try_from(all).ok());
    all.filter(|all| all.iter().all(|v| v.abs() <= bound)).ok_or_else(|| {
        let (tag, got) = (node.tag_name().name().to_owned(), text.to_owned());
        refuse(node, UrdfElementError::Numbers { tag, attribute, count: N, bound, unit, got })
    })
}

fn number(
    node: Node<'_, '_>,
    attribute: &'static str,
    bound: f64,
    unit: &'static str,
) -> Result<Option<f64>, UrdfError> {
    let text = node.attribute(attribute);
    text.map(|text| numbers::<1>(node, attribute, text, bound, unit).map(|[v]| v)).transpose()
}

fn triple(
    node: Node<'_, '_>,
    attribute: &'static str,
    bound: f64,
    unit: &'static str,
) -> Result<Option<Vector3<f64>>, UrdfError> {
    let text = node.attribute(attribute);
    text.map(|text| numbers::<3>(node, attribute, text, bound, unit).map(Vector3::from)).transpose()
}

/// The frame in the element `<origin>` of a node; the identity without that element.
fn origin(node: Node<'_, '_>) -> Result<Isometry3<f64>, UrdfError> {
    let Some(origin) = child(node, "origin")? else { return Ok(Isometry3::identity()) };
    let xyz = triple(origin, "xyz", FAR, "m")?.unwrap_or_default();
    let rpy = triple(origin, "rpy", TURNED, "rad")?;
    let rotation = match (rpy, origin.attribute("quat_xyzw")) {
        (Some(_), Some(_)) => return Err(refuse(origin, UrdfElementError::TwoRotations)),
        (None, Some(text)) => {
            let [x, y, z, w] = numbers(origin, "quat_xyzw", text, 1.1, "")?;
            let quaternion = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 0.5);
            quaternion.ok_or_else(|| refuse(origin, UrdfElementError::Quaternion { got: text.to_owned() }))?
        }
        (rpy, None) => {
            let rpy = rpy.unwrap_or_default();
            UnitQuaternion::from_euler_angles(rpy.x, rpy.y, rpy.z)
        }
    };
    Ok(Isometry3::from_parts(Translation3::from(xyz), rotation))
}

/// Name of the `<parent>` or `<child>` link of an element `<joint>`.
pub(crate) fn end<'a>(joint: Node<'a, '_>, tag: &'static str) -> Option<&'a str> {
    children(joint, tag).next()?.attribute("link")
}

/// The link of an element `<link>`.
fn read_link(
    node: Node<'_, '_>,
    is_root: bool,
    colours: &HashMap<&str, [f64; 4]>,
    warnings: &mut UrdfWarnings,
) -> Result<UrdfLink, UrdfError> {
    let name = name_of(node)?;
    warnings.check(node, &["inertial", "visual", "collision", "self_collision_checking", "contact"]);
    let body = child(node, "inertial")?.map_or(Ok(Body::NONE), |inertial| read_body(inertial, is_root))?;
    let mut visuals = Vec::new();
    for visual in children(node, "visual") {
        let geometry = children(visual, "geometry").flat_map(elements).next();
        let Some(shape) = geometry.and_then(shape) else { continue };
        let material = children(visual, "material").next();
        let named = || colours.get(material?.attribute("name")?).copied();
        let colour = material.and_then(colour).or_else(named);
        visuals.push(UrdfVisual { origin: origin(visual)?, shape, colour });
    }
    Ok(UrdfLink { name, children: Vec::new(), visuals, body })
}

/// The body of an element `<inertial>`, in the frame of its link. Some programs mark a root link, which does not move, by a mass of 0.
fn read_body(node: Node<'_, '_>, is_root: bool) -> Result<Body, UrdfError> {
    let element = |tag| child(node, tag)?.ok_or_else(|| refuse(node, UrdfElementError::NoInertial { tag }));
    let mass_node = element("mass")?;
    let text = required(mass_node, "value")?;
    let [mass] = numbers(mass_node, "value", text, HEAVY, "kg")?;
    if mass < 0.0 {
        return Err(refuse(node, UrdfElementError::Mass { got: text.to_owned() }));
    }
    let inertia_node = element("inertia")?;
    let entry = |key| {
        let text = required(inertia_node, key)?;
        numbers(inertia_node, key, text, INERT, "kg m^2").map(|[v]| v)
    };
    let [ixx, ixy, ixz] = [entry("ixx")?, entry("ixy")?, entry("ixz")?];
    let [iyy, iyz, izz] = [entry("iyy")?, entry("iyz")?, entry("izz")?];
    let local = Matrix3::new(ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz);
    // A point mass has none; rounding may make a principal moment of a thin body negative.
    let moments = local.symmetric_eigenvalues();
    let largest = moments.amax();
    let got = || {
        let keys = ["ixx", "ixy", "ixz", "iyy", "iyz", "izz"].into_iter();
        let texts = keys.map(|key| format!("{key}={}", inertia_node.attribute(key).unwrap_or_default()));
        texts.collect::<Vec<_>>().join(" ")
    };
    if moments.iter().any(|moment| *moment < -1e-9 * largest) {
        return Err(refuse(node, UrdfElementError::Moments { got: got() }));
    }
    if mass == 0.0 && largest > 0.0 && !is_root {
        return Err(refuse(node, UrdfElementError::MasslessInertia { got: got() }));
    }
    let origin = origin(node)?;
    let r = origin.rotation.to_rotation_matrix();
    Ok(Body { mass, com: origin.translation.vector, inertia: r.matrix() * local * r.matrix().transpose() })
}

/// The joint of an element `<joint>`, and the index of its parent link.
fn read_joint(
    node: Node<'_, '_>,
    links: &HashMap<String, usize>,
    warnings: &mut UrdfWarnings,
) -> Result<(UrdfJoint, usize), UrdfError> {
    let name = name_of(node)?;
    let known = [
        "origin",
        "parent",
        "child",
        "axis",
        "limit",
        "mimic",
        "calibration",
        "dynamics",
        "safety_controller",
    ];
    warnings.check(node, &known);
    let link = |tag| {
        let end = child(node, tag)?.ok_or_else(|| refuse(node, UrdfElementError::NoChild { tag }))?;
        let link = required(end, "link")?;
        let index = links.get(link).copied();
        index.ok_or_else(|| refuse(node, UrdfElementError::NoLink { link: link.to_owned() }))
    };
    let (parent, child_link) = (link("parent")?, link("child")?);
    let kind = match required(node, "type")? {
        "revolute" => UrdfJointKind::Revolute,
        "continuous" => UrdfJointKind::Continuous,
        "prismatic" => UrdfJointKind::Prismatic,
        "fixed" => UrdfJointKind::Fixed,
        got => return Err(refuse(node, UrdfElementError::JointType { got: got.to_owned() })),
    };
    if let Some(mimic) = child(node, "mimic")?.filter(|_| kind != UrdfJointKind::Fixed) {
        let joint = mimic.attribute("joint").unwrap_or_default().to_owned();
        return Err(refuse(node, UrdfElementError::Mimic { joint }));
    }
    let mut stated = [0.0; 2];
    if kind != UrdfJointKind::Fixed {
        stated = friction(node, &name, warnings)?;
        if child(node, "safety_controller")?.is_some() {
            warnings.add(format!(
                "joint `{name}`: its <safety_controller> is not read: limits are those of <limit>"
            ));
        }
    }
    let [damping, friction] = stated;
    let axis = match child(node, "axis")? {
        None => Vector3::x(),
        Some(axis) => {
            let xyz = triple(axis, "xyz", FAR, "")?.unwrap_or_else(Vector3::x);
            let got = || axis.attribute("xyz").unwrap_or_default().to_owned();
            xyz.try_normalize(1e-9).ok_or_else(|| refuse(node, UrdfElementError::Axis { got: got() }))?
        }
    };
    let [position, velocity, effort] = match kind {
        UrdfJointKind::Prismatic => ["m", "m/s", "N"],
        _ => ["rad", "rad/s", "N m"],
    };
    let limit = child(node, "limit")?.filter(|_| kind != UrdfJointKind::Fixed);
    let limit = limit.map(|limit| -> Result<_, UrdfError> {
        Ok(UrdfLimit {
            lower: number(limit, "lower", LIMIT, position)?,
            upper: number(limit, "upper", LIMIT, position)?,
            velocity: number(limit, "velocity", LIMIT, velocity)?,
            effort: number(limit, "effort", LIMIT, effort)?,
        })
    });
    let limit = limit.transpose()?;
    let origin = origin(node)?;
    Ok((UrdfJoint { name, kind, child: child_link, origin, axis, damping, friction, limit }, parent))
}

/// Viscous and Coulomb friction of a joint, with a warning: it is part of the settings. What is no number or negative counts as none.
fn friction(node: Node<'_, '_>, name: &str, warnings: &mut UrdfWarnings) -> Result<[f64; 2], UrdfError> {
    let Some(dynamics) = child(node, "dynamics")? else { return Ok([0.0; 2]) };
    Ok(["damping", "friction"].map(|key| {
        let text = dynamics.attribute(key).unwrap_or("0").trim();
        if text.parse() != Ok(0.0) {
            warnings.add(format!(
                "joint `{name}`: its {key} `{text}` is not read: friction is part of plant.toml"
            ));
        }
        text.parse().ok().filter(|v| (0.0..=LIMIT).contains(v)).unwrap_or_default()
    }))
}

/// The shape of a geometry that can be drawn.
fn shape(node: Node<'_, '_>) -> Option<UrdfShape> {
    let size = |key| number(node, key, FAR, "m").ok()?.filter(|v| *v >= 0.0);
    match node.tag_name().name() {
        "cylinder" | "capsule" => {
            Some(UrdfShape::Cylinder { radius: size("radius")?, length: size("length")? })
        }
        "sphere" => Some(UrdfShape::Sphere { radius: size("radius")? }),
        "box" => {
            let size = triple(node, "size", FAR, "m").ok()??;
            size.iter().all(|v| *v >= 0.0).then_some(UrdfShape::Box { size })
        }
        _ => None,
    }
}

/// The colour of an element `<material>`: red, green, blue, opacity.
fn colour(material: Node<'_, '_>) -> Option<[f64; 4]> {
    let colour = children(material, "color").next()?;
    numbers(colour, "rgba", colour.attribute("rgba")?, 1.0, "").ok()
}

/// Warnings about skipped elements.
#[derive(Default)]
struct UrdfWarnings(Vec<String>);

impl UrdfWarnings {
    fn add(&mut self, warning: String) {
        if self.0.len() < WARNINGS && !self.0.contains(&warning) {
            self.0.push(warning);
        }
    }

    /// Adds a warning for each child element of a node that is neither `known` nor an element of another program.
    fn check(&mut self, node: Node<'_, '_>, known: &[&str]) {
        let space = node.tag_name().namespace();
        for child in node.children().filter(Node::is_element) {
            let (tag, own) = (child.tag_name(), child.tag_name().namespace() == space);
            let of_xacro = !own && tag.namespace().is_some_and(|uri| uri.contains("xacro"));
            if self.0.len() == WARNINGS || (own && known.contains(&tag.name())) || !(own || of_xacro) {
                continue;
            }
            // Only here: its search for the line begins at the top of the text.
            let (name, line) = (tag.name(), line(child));
            self.add(if of_xacro {
                format!("<xacro:{name}> in line {line} is not read: expand the file with xacro first")
            } else {
                format!("<{name}> in line {line} is no element of a URDF and is not read")
            });
        }
    }
}
