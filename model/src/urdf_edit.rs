//! Changes of the text of a URDF that leave everything else as it is: joints without a motor, and joints that do not move.

use crate::Urdf;
use crate::description::{children, end, parse};
use crate::urdf_error::UrdfError;
use roxmltree::Node;
use std::collections::HashMap;
use std::ops::Range;

/// A text that replaces a range of bytes.
type Change = (Range<usize>, String);

impl Urdf {
    /// The `text` of a URDF in which the joints called `free` state effort="0" in their `<limit>`: they have no motor. A joint without a
    /// `<limit>` stays as it is.
    ///
    /// # Errors
    /// [`UrdfError`] if the text is not a URDF, or has no joint of one of the names.
    pub fn with_free_joints(text: &str, free: &[String]) -> Result<String, UrdfError> {
        let document = parse(text)?;
        let joints: Vec<_> = children(document.root_element(), "joint").collect();
        let mut changes = Vec::new();
        for name in free {
            let joint = joints.iter().find(|joint| joint.attribute("name") == Some(name));
            let joint = joint.ok_or_else(|| no_element("joint", &joints, name))?;
            if let Some(limit) = children(*joint, "limit").next() {
                changes.push(with_attribute(limit, "effort", "0"));
            }
        }
        Ok(changed(text, changes))
    }

    /// The `text` of a URDF in which those joints that do not lead from the root link to the link called `tip` are fixed at 0.
    ///
    /// # Errors
    /// [`UrdfError`] if the text is not a URDF, or has no link of this name.
    pub fn with_one_chain(text: &str, tip: &str) -> Result<String, UrdfError> {
        let document = parse(text)?;
        let robot = document.root_element();
        let links: Vec<_> = children(robot, "link").collect();
        if !links.iter().any(|link| link.attribute("name") == Some(tip)) {
            return Err(no_element("link", &links, tip));
        }
        let joints: Vec<_> = children(robot, "joint").collect();
        // The joint that carries each link; removed when visited, so that a loop ends the walk.
        let mut above: HashMap<_, _> =
            joints.iter().filter_map(|joint| Some((end(*joint, "child")?, joint))).collect();
        let (mut current, mut chain) = (Some(tip), Vec::new());
        while let Some(joint) = current.and_then(|link| above.remove(link)) {
            chain.push(joint.id());
            current = end(*joint, "parent");
        }
        let others = joints.iter().filter(|joint| !chain.contains(&joint.id()));
        let moves = others.filter(|joint| joint.attribute("type") != Some("fixed"));
        Ok(changed(text, moves.map(|joint| with_attribute(*joint, "type", "fixed")).collect()))
    }
}

/// The error of a name that none of the `elements` has.
fn no_element(tag: &'static str, elements: &[Node<'_, '_>], got: &str) -> UrdfError {
    let names = elements.iter().filter_map(|element| element.attribute("name")).map(str::to_owned).collect();
    UrdfError::NoElement { tag, names, got: got.to_owned() }
}

/// The change that gives an attribute of an element the value `value`.
fn with_attribute(element: Node<'_, '_>, name: &str, value: &str) -> Change {
    match element.attribute_node(name) {
        Some(attribute) => (attribute.range_value(), value.to_owned()),
        None => {
            let at = element.range().start + "<".len() + tag_length(element);
            (at..at, format!(" {name}=\"{value}\""))
        }
    }
}

/// Length of the name in the tag of an element, with its prefix, bytes.
fn tag_length(element: Node<'_, '_>) -> usize {
    let text = &element.document().input_text()[element.range()]["<".len()..];
    text.find(|c: char| c.is_whitespace() || c == '/' || c == '>').unwrap_or(text.len())
}

/// The text with all changes, which do not overlap.
fn changed(text: &str, mut changes: Vec<Change>) -> String {
    changes.sort_by_key(|(range, _)| range.start);
    changes.dedup();
    let mut text = text.to_owned();
    for (range, by) in changes.into_iter().rev() {
        text.replace_range(range, &by);
    }
    text
}
