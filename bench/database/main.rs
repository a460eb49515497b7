//! Measures databases of any number of entries; `bench/database/run` calls it.
//!
//! - `generate FILE ENTRIES`: writes a database with the shipped robot's trajectories, moved to random start poses. They are no solutions, but
//!   files and searches do not differ from those of solutions.
//! - `measure FILE`: time to load it, memory, time to find the nearest three entries, time to read one.
//! - `grid`: the same search among 10^6 poses of a regular grid, without a file.
//! - `compressed`: size and error of the shipped entries in shorter forms, which no file has.

use std::io::{BufWriter, Write};
use std::path::Path;
use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_model::{JointVector, State};
use upswing_planner::database::{DatabaseFile, certify};
use upswing_planner::replan::Planner;
use upswing_rig::montecarlo::Spread;
use upswing_trajectory::{Database, Entry, Index, KeyTree, PoseOutcome, PoseRecord, Trajectory};

/// Number of queries of which the median counts.
const QUERIES: usize = 1000;
/// Coordinates of the grid, and its points along each.
const GRID: (usize, usize) = (6, 10);

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments.as_slice() {
        ["generate", file, entries] => generate(Path::new(file), entries.parse().expect("a number")),
        ["measure", file] => measure(Path::new(file)),
        ["grid"] => grid(),
        ["compressed"] => compressed(),
        other => {
            eprintln!(
                "error: expected `generate FILE ENTRIES`, `measure FILE`, `grid` or `compressed`, got {other:?}"
            );
            std::process::exit(2);
        }
    }
}

/// Random number generator SplitMix64 (Steele, Lea, Flood 2014).
struct Random(u64);

impl Random {
    /// A random number, uniform in 0..1.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A pose of the actuated joints within the planner's limits, rad or m.
    fn pose(&mut self, config: &Config) -> Vec<f64> {
        let limits = &config.robot.planning;
        let joints = 0..config.model.sizes().actuated();
        joints.map(|i| limits.q_min[i] + (limits.q_max[i] - limits.q_min[i]) * self.next()).collect()
    }
}

fn config() -> Config {
    Config::embedded().unwrap_or_else(|e| panic!("{e}"))
}

fn shipped(config: &Config) -> Database {
    let shipped = DatabaseFile::of(config, 0).unwrap_or_else(|e| panic!("{e}")).expect("a database");
    shipped.load().unwrap_or_else(|e| panic!("{e}"))
}

fn generate(path: &Path, entries: u64) {
    let config = config();
    let shipped = shipped(&config);
    let examples: Vec<Entry> = (0..shipped.entries().min(64))
        .map(|entry| shipped.entry(entry).unwrap_or_else(|e| panic!("{e}")))
        .collect();
    let mut heading = shipped.heading().clone();
    heading.poses = entries;
    let mut out = BufWriter::new(std::fs::File::create(path).unwrap_or_else(|e| panic!("{e}")));
    let mut put = |bytes: &[u8]| out.write_all(bytes).unwrap_or_else(|e| panic!("{e}"));
    put(&heading.encode(entries, entries));
    let (mut index, mut random) = (Index::default(), Random(0));
    for pose in 0..entries {
        let example = &examples[pose as usize % examples.len()];
        let mut trajectory = example.trajectory.clone();
        trajectory.x[0].q_a_mut().copy_from_slice(&random.pose(&config)[..]);
        let entry = Entry::new(&trajectory, |_| example.certificate);
        let record = PoseRecord { pose, outcome: PoseOutcome::Solved(Box::new(entry)) };
        let bytes = record.encode();
        index.push(&record, &bytes);
        put(&bytes);
    }
    put(&index.encode(&heading));
    out.flush().unwrap_or_else(|e| panic!("{e}"));
}

/// Median and 99th percentile of times, us.
fn shown(times: Vec<Duration>) -> String {
    let times: Vec<f64> = times.iter().map(|t| 1e6 * t.as_secs_f64()).collect();
    let spread = Spread::of(times).expect("some times");
    format!("median {:.1} us, p99 {:.1} us", spread.median, spread.p99)
}

fn measure(path: &Path) {
    let config = config();
    let begin = Instant::now();
    let file = DatabaseFile::open(path).unwrap_or_else(|e| panic!("{e}"));
    let planner = Planner::with_database(config, 0, file).unwrap_or_else(|e| panic!("{e}"));
    let load = begin.elapsed();
    let sizes = planner.config().model.sizes();
    let mut random = Random(1);
    let (mut searches, mut reads) = (Vec::new(), Vec::new());
    for _ in 0..QUERIES {
        let mut q = JointVector::zeros(sizes);
        q.actuated_mut().copy_from_slice(&random.pose(planner.config())[..]);
        let start = State::new(&q, &JointVector::zeros(sizes));
        let begin = Instant::now();
        let nearest = planner.nearest(0, &[], &start);
        searches.push(begin.elapsed());
        let begin = Instant::now();
        planner.entry(0, nearest[0].index).unwrap_or_else(|e| panic!("{e}"));
        reads.push(begin.elapsed());
    }
    let status = std::fs::read_to_string("/proc/self/status").expect("Linux");
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).expect("a peak");
    let kib: f64 = peak.split_whitespace().next().and_then(|n| n.parse().ok()).expect("a number");
    println!(
        "{:>8} entries, {:>7.1} MB: loaded in {:.1} ms, peak memory {:.1} MB, nearest three {}, one entry read {}",
        planner.entries(0),
        std::fs::metadata(path).map_or(0.0, |file| 1e-6 * file.len() as f64),
        1e3 * load.as_secs_f64(),
        1024e-6 * kib,
        shown(searches),
        shown(reads)
    );
}

fn grid() {
    let (width, points) = GRID;
    let position = |number: usize, axis: usize| (number / points.pow(axis as u32) % points) as f64;
    let count = points.pow(width as u32);
    let keys: Vec<f64> = (0..count).flat_map(|n| (0..width).map(move |axis| position(n, axis))).collect();
    let tree = KeyTree::new(width, &keys);
    let mut random = Random(2);
    let mut searches = Vec::new();
    for _ in 0..QUERIES {
        let wanted: Vec<f64> = (0..width).map(|_| (points - 1) as f64 * random.next()).collect();
        let begin = Instant::now();
        let nearest = tree.nearest(&wanted, &[1.0; GRID.0], 3);
        searches.push(begin.elapsed());
        assert_eq!(nearest.len(), 3);
    }
    println!("{count:>8} poses of a regular grid over {width} joints: nearest three {}", shown(searches));
}

/// Name, bytes of a number and of what is stored once per coordinate, and the values of a coordinate at all knots as they are read again.
type Form = (&'static str, usize, usize, fn(&[f64]) -> Vec<f64>);

const FORMS: [Form; 4] = [
    ("float32", 4, 0, |values| values.iter().map(|v| f64::from(*v as f32)).collect()),
    ("float32, difference to the knot before", 4, 16, |values| {
        predicted(values, |before, _| before, |difference| f64::from(difference as f32))
    }),
    ("int16 in the range of a coordinate", 2, 16, |values| {
        let (low, high) =
            values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
        let step = ((high - low) / f64::from(u16::MAX)).max(f64::MIN_POSITIVE);
        values.iter().map(|v| low + step * ((v - low) / step).round()).collect()
    }),
    ("int16, difference to the line through two knots before", 2, 24, |values| {
        let line = |before: f64, second: f64| before + before - second;
        let bends = values.windows(3).map(|v| (v[2] - line(v[1], v[0])).abs());
        // Rounding lengthens a difference by two steps at most.
        let step = (bends.fold(0.0, f64::max) / f64::from(i16::MAX - 2)).max(f64::MIN_POSITIVE);
        predicted(values, line, |difference| step * (difference / step).round())
    }),
];

/// Values that are stored as the rounded difference to a prediction from the two values before them, as read: errors do not add up. The
/// first two values are exact.
fn predicted(values: &[f64], predict: impl Fn(f64, f64) -> f64, round: impl Fn(f64) -> f64) -> Vec<f64> {
    let mut read = values[..values.len().min(2)].to_vec();
    for v in &values[read.len()..] {
        let prediction = predict(read[read.len() - 1], read[read.len() - 2]);
        read.push(prediction + round(v - prediction));
    }
    read
}

/// Prints for each form the size of an entry, and how far the shipped entries differ when they are read: inputs, unactuated joints, the arm,
/// which follows from the inputs, and the largest defect.
fn compressed() {
    let config = config();
    let database = shipped(&config);
    let entries: Vec<Entry> = (0..database.entries())
        .map(|entry| database.entry(entry).unwrap_or_else(|e| panic!("{e}")))
        .collect();
    let heading = database.heading();
    let coordinates = heading.sizes.actuated() + 2 * heading.sizes.unactuated();
    let record =
        PoseRecord { pose: 0, outcome: PoseOutcome::Solved(Box::new(entries[0].clone())) }.encode().len();
    let numbers = coordinates * (heading.intervals + 1);
    let defect = entries.iter().map(|entry| entry.certificate.defect).fold(0.0, f64::max);
    println!("{:<56} {record:>5} bytes; largest defect {defect:.1e}", "float64");
    for (name, of_number, of_coordinate, form) in FORMS {
        let size = record - 8 * numbers + of_number * numbers + of_coordinate * coordinates;
        let (mut u, mut unactuated, mut arm, mut defect) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
        for entry in &entries {
            let read = Entry::new(&in_form(&entry.trajectory, form), |t| certify(&config, t));
            for ((x, input), (x_read, input_read)) in entry.trajectory.knots().zip(read.trajectory.knots()) {
                u = u.max((*input - *input_read).amax());
                unactuated = unactuated.max((x.q_u() - x_read.q_u()).amax());
                arm = arm.max((x.q_a() - x_read.q_a()).amax());
            }
            defect = defect.max(read.certificate.defect);
        }
        println!(
            "{name:<56} {size:>5} bytes; largest defect {defect:.1e}; largest errors: u {u:.1e} rad/s^2, q_U {unactuated:.1e}, \
             q_A {arm:.1e} rad"
        );
    }
}

/// A trajectory with u, q_U and qd_U as they are read from a form.
fn in_form(trajectory: &Trajectory, form: fn(&[f64]) -> Vec<f64>) -> Trajectory {
    let mut read = trajectory.clone();
    let sizes = read.x[0].sizes();
    for a in 0..sizes.actuated() {
        let values: Vec<f64> = trajectory.u.iter().map(|u| u[a]).collect();
        read.u.iter_mut().zip(form(&values)).for_each(|(u, v)| u[a] = v);
    }
    for c in 0..sizes.unactuated() {
        let (q, qd): (Vec<f64>, Vec<f64>) = trajectory.x.iter().map(|x| (x.q_u()[c], x.qd_u()[c])).unzip();
        for (x, (q, qd)) in read.x.iter_mut().zip(form(&q).into_iter().zip(form(&qd))) {
            (x.q_u_mut()[c], x.qd_u_mut()[c]) = (q, qd);
        }
    }
    read
}
