//! Figures of a database as a whole: durations, costs, the worst certificate, and the start poses of its entries.

use serde::Serialize;
use upswing_model::{ActuatedVector, JointKind, Model};
use upswing_trajectory::{Certificate, Database, DatabaseError, DatabaseHeading, PoseOutcome};

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
    /// empty if there are fewer than two, or more pairs than a grid has.
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

/// What the overview needs of an entry.
struct EntryFigures {
    /// Start pose q_A, rad or m.
    start: ActuatedVector,
    certificate: Certificate,
}

impl DatabaseOverview {
    /// The figures of `database`, made for `model`; joints that the model does not have count as revolute.
    ///
    /// # Errors
    /// [`DatabaseError`] if a record is damaged.
    pub fn of(database: &Database, model: &Model) -> Result<Self, DatabaseError> {
        let mut entries = Vec::with_capacity(database.entries());
        let (mut rejected, mut failed) = (0, 0);
        for record in database.records() {
            match record?.outcome {
                PoseOutcome::Rejected => rejected += 1,
                PoseOutcome::Failed => failed += 1,
                PoseOutcome::Solved(entry) => entries.push(EntryFigures {
                    start: entry.trajectory.start().q_a(),
                    certificate: entry.certificate,
                }),
            }
        }
        let range = |values: &mut dyn Iterator<Item = f64>| {
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
        };
        let joints = joints(database.heading(), &entries, model);
        Ok(Self {
            entries: entries.len(),
            rejected,
            failed,
            t_f: range(&mut database.durations().iter().copied()),
            cost: range(&mut entries.iter().map(|e| e.certificate.cost)),
            worst: Certificate::worst(entries.iter().map(|e| &e.certificate)),
            map: match joints.as_slice() {
                [.., rows, columns] => map(&entries, rows, columns),
                _ => Vec::new(),
            },
            joints,
        })
    }
}

/// Start position of the actuated joint of index `coordinate`, deg or m, rounded: grid positions stay distinct, equal positions with
/// different rounding errors become equal, and 0 has no sign.
fn start(entry: &EntryFigures, coordinate: usize, kind: JointKind) -> f64 {
    (kind.shown(entry.start[coordinate]).0 * 1e3).round() / 1e3 + 0.0
}

fn joints(heading: &DatabaseHeading, entries: &[EntryFigures], model: &Model) -> Vec<JointCoverage> {
    let kind = |name: &str| {
        let joint = (0..model.sizes().joints()).find(|joint| model.joint_name(*joint) == name);
        joint.map_or(JointKind::Revolute, |joint| model.joint_kind(joint))
    };
    let coverage = |(coordinate, joint): (usize, &String)| {
        let kind = kind(joint);
        let mut starts: Vec<f64> = entries.iter().map(|e| start(e, coordinate, kind)).collect();
        starts.sort_by(f64::total_cmp);
        let (positions, entries) =
            starts.chunk_by(|a, b| a == b).map(|equal| (equal[0], equal.len())).unzip();
        JointCoverage { joint: joint.clone(), coordinate, kind, unit: kind.shown(0.0).1, entries, positions }
    };
    let actuated = heading.joints.iter().enumerate().take(heading.sizes.actuated());
    actuated.map(coverage).filter(|c| c.positions.len() > 1).collect()
}

fn map(entries: &[EntryFigures], rows: &JointCoverage, columns: &JointCoverage) -> Vec<Vec<usize>> {
    /// The positions of a grid have fewer pairs; random ones have as many as the square of the number of entries.
    const MOST_PAIRS: usize = 1 << 20;
    if rows.positions.len().saturating_mul(columns.positions.len()) > MOST_PAIRS {
        return Vec::new();
    }
    let mut map = vec![vec![0; columns.positions.len()]; rows.positions.len()];
    for entry in entries {
        let place = |joint: &JointCoverage| {
            let position = start(entry, joint.coordinate, joint.kind);
            joint.positions.binary_search_by(|p| p.total_cmp(&position))
        };
        if let (Ok(row), Ok(column)) = (place(rows), place(columns)) {
            map[row][column] += 1;
        }
    }
    map
}
