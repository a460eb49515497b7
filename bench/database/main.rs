//! Measures databases of any number of entries; `bench/database/run` calls it.
//!
//! - `generate FILE ENTRIES`: writes a database with the shipped robot's trajectories, moved to random start poses. They are no solutions, but
//!   files and searches do not differ from those of solutions.
//! - `measure FILE`: time to load it, memory, time to find the nearest three entries, time to read one.
//! - `grid`: the same search among 10^6 poses of a regular grid, without a file.

use std::io::{BufWriter, Write};
use std::path::Path;
use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_model::{JointVector, State};
use upswing_planner::database::DatabaseFile;
use upswing_planner::replan::Planner;
use upswing_rig::montecarlo::Spread;
use upswing_trajectory::{Entry, Index, KeyTree, PoseOutcome, PoseRecord};

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
        other => {
            eprintln!("error: expected `generate FILE ENTRIES`, `measure FILE` or `grid`, got {other:?}");
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

fn generate(path: &Path, entries: u64) {
    let config = config();
    let shipped = DatabaseFile::of(&config, 0).unwrap_or_else(|e| panic!("{e}")).expect("a database");
    let shipped = shipped.load().unwrap_or_else(|e| panic!("{e}"));
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
