//! Figures of a database as a whole: durations, costs, the worst certificate, and the start poses of its entries.

use serde::Serialize;
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
    /// Distribution of the start angles of each actuated joint that has more than one.
    pub joints: Vec<JointCoverage>,
    /// Number of entries for each pair of start angles of the last two of `joints`, one row per angle of the first of them;
    /// empty if there are fewer than two.
    pub map: Vec<Vec<usize>>,
}

/// Distribution of the entries over the start angles of a joint.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointCoverage {
    /// Name of the joint.
    pub joint: String,
    #[serde(skip)]
    coordinate: usize,
    /// The start angles, ascending, deg.
    pub angles_deg: Vec<f64>,
    /// Number of entries at each angle.
    pub entries: Vec<usize>,
}

impl DatabaseOverview {
    /// The figures of `database`.
    pub fn of(database: &Database) -> Self {
        let entries: Vec<&Entry> = database.entries().collect();
        let range = |value: fn(&Entry) -> f64| {
            let limits = (f64::INFINITY, f64::NEG_INFINITY);
            entries.iter().map(|e| value(e)).fold(limits, |(a, b), v| (a.min(v), b.max(v)))
        };
        let count = |outcome: PoseOutcome| database.records.iter().filter(|r| r.outcome == outcome).count();
        let joints = joints(&database.heading, &entries);
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

/// Start angle of the joint of index `coordinate` in sorted vectors, deg, rounded: grid angles stay distinct, equal angles with
/// different rounding errors become equal.
fn start_deg(entry: &Entry, coordinate: usize) -> f64 {
    (entry.trajectory.start()[coordinate].to_degrees() * 1e3).round() / 1e3
}

fn joints(heading: &DatabaseHeading, entries: &[&Entry]) -> Vec<JointCoverage> {
    let coverage = |(coordinate, joint): (usize, &String)| {
        let mut angles_deg: Vec<f64> = entries.iter().map(|e| start_deg(e, coordinate)).collect();
        angles_deg.sort_by(f64::total_cmp);
        angles_deg.dedup();
        let count = |a: &f64| entries.iter().filter(|e| start_deg(e, coordinate) == *a).count();
        let entries = angles_deg.iter().map(count).collect();
        JointCoverage { joint: joint.clone(), coordinate, entries, angles_deg }
    };
    let actuated = heading.joints.iter().enumerate().take(heading.sizes.actuated());
    actuated.map(coverage).filter(|c| c.angles_deg.len() > 1).collect()
}

fn map(entries: &[&Entry], rows: &JointCoverage, columns: &JointCoverage) -> Vec<Vec<usize>> {
    let count = |r: f64, c: f64| {
        let here = |e: &&&Entry| start_deg(e, rows.coordinate) == r && start_deg(e, columns.coordinate) == c;
        entries.iter().filter(here).count()
    };
    rows.angles_deg.iter().map(|r| columns.angles_deg.iter().map(|c| count(*r, *c)).collect()).collect()
}
