//! A recording as one HTML file that needs no network: the robot in motion, the panels of the paper's Fig. 5, modes,
//! cycle times, summary and settings.

mod data;
pub mod times;

pub use data::{Data, Span, limits, period, spans, zero};

use std::io::{self, Write};

const TEMPLATE: &str = include_str!("page/page.html");
/// What takes the place of the marks in the template, in this order; the data stands last.
const PARTS: [(&str, &str); 3] = [
    ("{{style}}", include_str!("page/page.css")),
    (
        "{{script}}",
        concat!(include_str!("page/scene.js"), include_str!("page/plots.js"), include_str!("page/page.js")),
    ),
    ("{{data}}", ""),
];

/// Writes the page.
///
/// # Errors
/// Those of the writer.
pub fn write(data: &Data, to: &mut impl Write) -> io::Result<()> {
    // No text of the recording can end the element it stands in.
    let data = serde_json::to_string(data)?.replace('<', "\\u003c");
    let mut rest = TEMPLATE;
    for (mark, part) in PARTS {
        let (before, after) = rest.split_once(mark).unwrap_or((rest, ""));
        to.write_all(before.as_bytes())?;
        to.write_all(if part.is_empty() { data.as_bytes() } else { part.as_bytes() })?;
        rest = after;
    }
    to.write_all(rest.as_bytes())
}
