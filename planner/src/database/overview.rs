//! Figures of a database as a whole: durations, costs, the worst certificate, and the start poses of its entries.

use serde::Serialize;
use upswing_model::{JointKind, Model};
use upswing_trajectory::{Certificate, Database, DatabaseHeading, Entry, PoseOutcome};

/// Figures of all records of a database.
#[derive(Clone, Debug)]
pub struct DatabaseOverview {
    /// Number of entries, the poses with a trajectory.
    pub entries: usize,
    /// Number of poses left out by the grid's rules.
    pub rejected: usize,
    /// Number of poses without a solution.
    pub failed: usize,
    /// Shortest and longest duration t_F, s; without entries infinite and minus infinite.
    pub t_f: (f64, f64),
    /// Lowest and highest cost J (6a), s; without entries as `t_f`.
    pub cost: (f64, f64),
    /// Worst value of each figure of the certificates.
    pub worst: Certificate,
    /// Distribution of the start positions of each actuated joint that has more than one.
    pub joints: Vec<JointCoverage>,
    /// Number of entries for each pair of start positions of the last two of `joints`, one row per position of the first of them;
    /// empty if there are fewer than two.
    pub map: Vec<Vec<usize>>,
}

/// Distribution of the entries over the start positions of a joint.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointCoverage {
    /// Name of the joint.
    pub joint: String,
    #[serde(skip)]
    coordinate: usize,
    #[serde(skip)]
    kind: JointKind,
    /// Unit of the positions, deg or m.
    pub unit: &'static str,
    /// The start positions, ascending, in this unit.
    pub positions: Vec<f64>,
    /// Number of entries at each position.
    pub entries: Vec<usize>,
}

impl DatabaseOverview {
    /// The figures of `database`, made for `model`; joints that the model does not have count as revolute.
    pub fn of(database: &Database, model: &Model) -> Self {
        let entries: Vec<&Entry> = database.entries().collect();
        let range = |value: fn(&Entry) -> f64| {
            let limits = (f64::INFINITY, f64::NEG_INFINITY);
            entries.iter().map(|e| value(e)).fold(limits, |(a, b), v| (a.min(v), b.max(v)))
        };
        let count = |outcome: PoseOutcome| database.records.iter().filter(|r| r.outcome == outcome).count();
        let joints = joints(&database.heading, &entries, model);
        Self {
            entries: entries.len(),
            rejected: count(PoseOutcome::Rejected),
            failed: count(PoseOutcome::Failed),
            t_f: range(|e| e.trajectory.t_f),
            cost: range(|e| e.certificate.cost),
            worst: Certificate::worst(entries.iter().map(|e| &e.certificate)),
            map: match joints.as_slice() {
                [.., rows, columns] => map(&entries, rows, columns),
                _ => Vec::new(),
            },
            joints,
        }
    }
}

/// Start position of the joint of index `coordinate` in sorted vectors, deg or m, rounded: grid positions stay distinct, equal positions with
/// different rounding errors become equal.
fn start(entry: &Entry, coordinate: usize, kind: JointKind) -> f64 {
    (kind.shown(entry.trajectory.start()[coordinate]).0 * 1e3).round() / 1e3
}

fn joints(heading: &DatabaseHeading, entries: &[&Entry], model: &Model) -> Vec<JointCoverage> {
    let kind = |name: &str| {
        let joint = (0..model.sizes().joints()).find(|joint| model.joint_name(*joint) == name);
        joint.map_or(JointKind::Revolute, |joint| model.joint_kind(joint))
    };
    let coverage = |(coordinate, joint): (usize, &String)| {
        let kind = kind(joint);
        let mut positions: Vec<f64> = entries.iter().map(|e| start(e, coordinate, kind)).collect();
        positions.sort_by(f64::total_cmp);
        positions.dedup();
        let count = |a: &f64| entries.iter().filter(|e| start(e, coordinate, kind) == *a).count();
        let entries = positions.iter().map(count).collect();
        JointCoverage { joint: joint.clone(), coordinate, kind, unit: kind.shown(0.0).1, entries, positions }
    };
    let actuated = heading.joints.iter().enumerate().take(heading.sizes.actuated());
    actuated.map(coverage).filter(|c| c.positions.len() > 1).collect()
}

fn map(entries: &[&Entry], rows: &JointCoverage, columns: &JointCoverage) -> Vec<Vec<usize>> {
    let count = |r: f64, c: f64| {
        let at = |e: &Entry, joint: &JointCoverage| start(e, joint.coordinate, joint.kind);
        let here = |e: &&&Entry| at(e, rows) == r && at(e, columns) == c;
        entries.iter().filter(here).count()
    };
    rows.positions.iter().map(|r| columns.positions.iter().map(|c| count(*r, *c)).collect()).collect()
}
