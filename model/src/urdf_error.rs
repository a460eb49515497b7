//! Errors of reading a URDF and of building a model from it: the element, the expected and the actual value, and a remedy.

use crate::MOST_JOINTS;
use std::fmt;

/// Reason why a URDF gives no model.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UrdfError {
    /// The text is not a URDF.
    #[error("not a readable URDF: {0}")]
    Parse(#[from] UrdfSyntaxError),
    /// The chain has no actuated joint.
    #[error(
        "expected a joint with a motor, got none among {}: state effort=\"...\" (N m or N) and velocity=\"...\" (rad/s or m/s) in the \
         <limit> of those that have one",
        .joints.join(", ")
    )]
    NoActuatedJoint {
        /// Names of the movable joints.
        joints: Vec<String>,
    },
    /// The chain has no unactuated joint.
    #[error(
        "expected a joint without a motor, got none: set effort=\"0\" in the <limit> of the free joints among {}; \
         `upswing system new DIR --urdf FILE --free JOINT` does it",
        .joints.join(", ")
    )]
    NoUnactuatedJoint {
        /// Names of the movable joints.
        joints: Vec<String>,
    },
    /// The chain has more than [`MOST_JOINTS`] movable joints.
    #[error(
        "expected at most {MOST_JOINTS} movable joints in one chain, got {got}: fix those that do not matter (type=\"fixed\")"
    )]
    TooManyJoints {
        /// Number of movable joints.
        got: usize,
    },
    /// No link moves.
    #[error("expected a chain of movable joints, got none: all joints are fixed")]
    NoJoint,
    /// A link carries two movable joints, so that the joints are no serial chain.
    #[error(
        "expected one unbranched chain, got a link `{link}` that carries the joints {}: set type=\"fixed\" for those that do not matter; \
         `upswing system new DIR --urdf FILE --tip LINK` does it for all but those that lead to LINK, for example {}",
        .joints.join(", "), .tips.join(" or ")
    )]
    Branch {
        /// Name of the link.
        link: String,
        /// Names of the movable joints on the link.
        joints: Vec<String>,
        /// Name of the last link behind each of them.
        tips: Vec<String>,
    },
    /// A text that shall be changed has no joint or link of this name.
    #[error("expected a {tag} of the robot, {}; got `{got}`", list(.names))]
    NoElement {
        /// Kind of the element: link or joint.
        tag: &'static str,
        /// Names of the elements of this kind.
        names: Vec<String>,
        /// Name given.
        got: String,
    },
    /// A joint, a link or the body of a link is physically impossible or not supported.
    #[error("{element}: {cause}")]
    Element {
        /// The joint or link.
        element: UrdfElement,
        /// What was expected, and what the URDF has.
        cause: Box<UrdfElementError>,
    },
    /// The URDF has no root link: its joints form a circle.
    #[error("no root link: every link is the child of some joint")]
    NoRoot,
    /// The URDF has several root links: no joint connects them.
    #[error(
        "expected one root link, got `{first}` and `{second}`: a joint has to connect every other link to the root"
    )]
    Roots {
        /// Name of one root link.
        first: String,
        /// Name of another root link.
        second: String,
    },
}

/// Reason why a text is not a URDF.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UrdfSyntaxError {
    /// Reading the text would take too long or too much memory.
    #[error("expected {what} of at most {limit} {unit}, got more: is it a robot?")]
    Large {
        /// What is too large, for example "a text".
        what: &'static str,
        /// Largest number that is read.
        limit: usize,
        /// What is counted, for example "bytes".
        unit: &'static str,
    },
    /// The outermost element is not `<robot>`.
    #[error("expected <robot> as the outermost element, got <{got}>: convert the file to URDF first")]
    Outermost {
        /// Name of the outermost element.
        got: String,
    },
    /// The text is not XML.
    #[error(
        "{cause}{}{}",
        end.map_or_else(String::new, |line| format!(", the text ends in line {line}: is the file complete?")),
        after.as_ref().map_or_else(String::new, |element| format!(", at or after {element}"))
    )]
    Xml {
        /// Error of the XML parser, with its place.
        cause: Box<roxmltree::Error>,
        /// Number of lines of a text that ends too early.
        end: Option<usize>,
        /// The last link or joint that begins before the error.
        after: Option<UrdfElement>,
    },
}

/// An element of a URDF, as messages name it.
#[derive(Clone, Debug, PartialEq)]
pub enum UrdfElement {
    /// An element with a name.
    Named {
        /// Kind of the element: link or joint.
        tag: String,
        /// Name of the element.
        name: String,
    },
    /// An element without a name.
    Unnamed {
        /// Kind of the element: link or joint.
        tag: String,
        /// Line in which the element begins, counted from 1.
        line: u32,
    },
}

impl UrdfElement {
    /// The element of a kind and a name.
    pub(crate) fn named(tag: &str, name: &str) -> Self {
        Self::Named { tag: tag.to_owned(), name: name.to_owned() }
    }
}

impl fmt::Display for UrdfElement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Named { tag, name } => write!(f, "{tag} `{name}`"),
            Self::Unnamed { tag, line } => write!(f, "{tag} in line {line}"),
        }
    }
}

/// Reason why a joint or a link of a URDF is impossible or not supported.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum UrdfElementError {
    /// The element has no name.
    #[error("expected a name, got none")]
    NoName,
    /// Two elements of a kind have the same name.
    #[error("expected a name of its own, got that of another {tag}")]
    SameName {
        /// Kind of the elements: link or joint.
        tag: &'static str,
    },
    /// A child element is missing.
    #[error("expected a <{tag}>, got none")]
    NoChild {
        /// Name of the child element.
        tag: &'static str,
    },
    /// A child element appears more than once.
    #[error("expected one <{tag}>, got several")]
    Several {
        /// Name of the child element.
        tag: &'static str,
    },
    /// An attribute is missing.
    #[error("expected {attribute}=\"...\" in its <{tag}>, got none")]
    NoAttribute {
        /// Name of the element that should have the attribute.
        tag: String,
        /// Name of the attribute.
        attribute: &'static str,
    },
    /// An attribute does not hold the expected numbers.
    #[error("{tag} {attribute}: expected {}, got `{}`{}", numbers(*count, *bound, unit), shown(got), hint(got))]
    Numbers {
        /// Name of the element.
        tag: String,
        /// Name of the attribute.
        attribute: &'static str,
        /// Expected count of numbers.
        count: usize,
        /// Largest magnitude of a number.
        bound: f64,
        /// Unit of the numbers; may be empty.
        unit: &'static str,
        /// Text of the attribute.
        got: String,
    },
    /// The origin of a frame has both kinds of rotation.
    #[error("expected one of rpy and quat_xyzw, got both")]
    TwoRotations,
    /// A quaternion is far from length 1.
    #[error("expected a quaternion of length 1, got `{got}`")]
    Quaternion {
        /// Text of the quaternion.
        got: String,
    },
    /// The inertial properties of a link are incomplete.
    #[error("its <inertial> has no <{tag}>")]
    NoInertial {
        /// Name of the missing element: mass or inertia.
        tag: &'static str,
    },
    /// The mass of a link is negative.
    #[error("expected a mass of 0 or above, got `{got}` kg")]
    Mass {
        /// Text of the mass.
        got: String,
    },
    /// A principal moment of inertia of a link is negative.
    #[error("expected an inertia whose principal moments are 0 or above, got `{got}`")]
    Moments {
        /// Text of the inertia.
        got: String,
    },
    /// A link has an inertia but no mass.
    #[error("expected no inertia without a mass, got `{got}`")]
    MasslessInertia {
        /// Text of the inertia.
        got: String,
    },
    /// No joints lead from the root link to this link.
    #[error("expected joints that lead to it from the root link `{root}`, got joints in a loop")]
    Loop {
        /// Name of the root link.
        root: String,
    },
    /// The child link of a joint is the child of another joint, too.
    #[error("its link `{link}` is the child of joint `{joint}` already")]
    SecondParent {
        /// Name of the child link.
        link: String,
        /// Name of the other joint.
        joint: String,
    },
    /// A joint names a link that does not exist.
    #[error(
        "expected two links of the robot, there is no link `{link}`: correct the name, or add <link name=\"{link}\"/>"
    )]
    NoLink {
        /// Name given for the link.
        link: String,
    },
    /// The type of a joint is not supported.
    #[error(
        "expected a revolute, continuous, prismatic or fixed joint, got `{got}`: others are not supported yet"
    )]
    JointType {
        /// Type of the joint.
        got: String,
    },
    /// A joint is coupled to another joint.
    #[error("it follows joint `{joint}` (<mimic>): coupled joints are not supported yet")]
    Mimic {
        /// Name of the other joint.
        joint: String,
    },
    /// The axis of a joint has length 0.
    #[error("the axis is zero, got `{got}`")]
    Axis {
        /// Text of the axis.
        got: String,
    },
    /// A revolute or prismatic joint has no limits.
    #[error("expected a <limit> of a revolute or prismatic joint, got none")]
    NoLimit,
    /// The range of a joint is empty.
    #[error("expected a lower limit below the upper one, got {lower} and {upper} {unit}")]
    PositionLimits {
        /// Lower limit.
        lower: f64,
        /// Upper limit.
        upper: f64,
        /// rad or m.
        unit: &'static str,
    },
    /// The velocity limit of a joint is 0 or negative.
    #[error("expected a velocity limit above 0, got {got} {unit}")]
    VelocityLimit {
        /// Velocity limit.
        got: f64,
        /// rad/s or m/s.
        unit: &'static str,
    },
    /// An actuated joint has no velocity limit.
    #[error("expected a velocity in the <limit> of a joint with a motor, got none")]
    NoVelocityLimit,
    /// A movable joint does not state whether it has a motor.
    #[error("expected an effort in its <limit>: that of its motor, or 0 without a motor; got none")]
    NoEffortLimit,
    /// The effort limit of a joint is negative.
    #[error("expected an effort above 0 of a motor, or 0 without a motor, got {got} {unit}")]
    EffortLimit {
        /// Effort limit.
        got: f64,
        /// N m or N.
        unit: &'static str,
    },
    /// The body on a movable joint has no mass.
    #[error("expected a body with a mass above 0 on it, got {got} kg")]
    NoMass {
        /// Mass of the body, kg.
        got: f64,
    },
    /// The inertia of the body on a movable joint is not positive definite.
    #[error("expected a positive definite inertia of the body on it about the centre of mass")]
    Inertia,
}

/// Names for a message.
fn list(names: &[String]) -> String {
    match names {
        [] => "which has none".into(),
        [name] => name.clone(),
        names => format!("one of {}", names.join(", ")),
    }
}

/// Text of what was expected of an attribute.
fn numbers(count: usize, bound: f64, unit: &str) -> String {
    let count = if count == 1 { "a number".to_owned() } else { format!("{count} numbers") };
    let space = if unit.is_empty() { "" } else { " " };
    format!("{count} of at most {bound}{space}{unit}")
}

/// The beginning of the text of an attribute.
fn shown(got: &str) -> String {
    const MOST: usize = 80;
    got.chars().take(MOST).collect()
}

/// Remedy for a text that does not hold the expected numbers.
fn hint(got: &str) -> &'static str {
    if got.contains("${") || got.contains("$(") {
        ": expand the file with xacro first"
    } else if got.contains(',') {
        ": a number is written with a point, and a blank stands between two"
    } else {
        ""
    }
}
