//! A recording as one HTML file without network access: the robot in motion, the panels of the paper's Fig. 5, modes,
//! cycle times, summary and settings; and the page of a running system, of the same parts.

mod data;
mod digest;
mod motion;
pub mod times;

pub use data::{ModeSpan, PageData};
pub use digest::RecordingDigest;
pub(crate) use motion::MotionColumns;

use crate::requests::offered;
use data::RobotDrawing;
use serde::{Serialize, Serializer};
use std::io::{self, Write};
use upswing_config::Config;
use upswing_ipc::operator::OperatorRequest;
use upswing_model::{Sizes, UrdfError};
use upswing_record::robot::Robot;

const STYLE: &str = include_str!("page/page.css");
/// Policy of a page in a file: it loads nothing. The live page has its policy from the server.
const POLICY: &str = concat!(
    r#"<meta http-equiv="Content-Security-Policy" content="default-src 'none'; "#,
    r#"style-src 'unsafe-inline'; script-src 'unsafe-inline'">"#,
    "\n"
);
/// Scripts that draw, for both pages.
const DRAWING: &str = concat!(include_str!("page/scene.js"), include_str!("page/plots.js"));

/// Writes the page of a recording.
///
/// # Errors
/// Errors of the writer.
pub fn write(data: &PageData, to: &mut impl Write) -> io::Result<()> {
    let (body, script) = (include_str!("page/page.html"), include_str!("page/page.js"));
    fill(POLICY, body, script, &serde_json::to_string(data)?, to)
}

/// Data of the live page that are known before its first frame.
#[derive(Debug, Serialize)]
pub struct LivePageSetup {
    domain: String,
    /// Whether the page can make requests.
    control: bool,
    #[serde(serialize_with = "names")]
    requests: Vec<OperatorRequest>,
    period_us: f64,
    #[serde(skip)]
    sizes: Sizes,
    #[serde(flatten)]
    body: RobotDrawing,
}

impl LivePageSetup {
    /// Numbers of joints of the chain.
    pub(crate) fn sizes(&self) -> Sizes {
        self.sizes
    }

    /// The requests that the page offers.
    pub(crate) fn requests(&self) -> &[OperatorRequest] {
        &self.requests
    }

    /// Describes the page of the system `domain` with the robot of the settings.
    ///
    /// # Errors
    /// [`UrdfError`] if the robot of the URDF cannot be drawn.
    pub fn new(domain: &str, config: &Config, control: bool) -> Result<Self, UrdfError> {
        Ok(Self {
            domain: domain.to_owned(),
            control,
            requests: offered(config),
            period_us: config.daemon.cycle.period.seconds() * 1e6,
            sizes: config.model.sizes(),
            body: RobotDrawing::new(
                Robot::from_urdf(&config.urdf, &config.model)?,
                &config.model,
                &config.robot.limits,
            ),
        })
    }
}

fn names<S: Serializer>(requests: &[OperatorRequest], to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(requests.iter().map(OperatorRequest::name))
}

/// Returns the page of a running system as HTML.
pub fn live(setup: &LivePageSetup) -> String {
    let mut page = Vec::new();
    let data = serde_json::to_string(setup).unwrap_or_default();
    // Writing to a vector cannot fail.
    let _ = fill("", include_str!("page/live.html"), include_str!("page/live.js"), &data, &mut page);
    String::from_utf8_lossy(&page).into_owned()
}

/// Writes the frame of both pages with `head`, style, `body`, `script` and `data` in place of their marks, which are searched in
/// this order.
fn fill(head: &str, body: &str, script: &str, data: &str, to: &mut impl Write) -> io::Result<()> {
    // Without `<`, no text of the data can close the script element around it.
    let data = data.replace('<', "\\u003c");
    let mut rest = include_str!("page/frame.html");
    for (mark, parts) in [
        ("{{head}}", [head, ""]),
        ("{{style}}", [STYLE, ""]),
        ("{{body}}", [body, ""]),
        ("{{script}}", [DRAWING, script]),
        ("{{data}}", [&data, ""]),
    ] {
        let (before, after) = rest.split_once(mark).unwrap_or((rest, ""));
        for part in [before, parts[0], parts[1]] {
            to.write_all(part.as_bytes())?;
        }
        rest = after;
    }
    to.write_all(rest.as_bytes())
}
