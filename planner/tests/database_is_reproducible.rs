//! A database has the same bytes however it is built: on any number of cores, in shards, with interruptions and after
//! a kill. Finished lines are never lost; files of different builds are refused.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;
use upswing_config::{Config, GridAxis, System};
use upswing_ocp::multistart::Search;
use upswing_planner::database::{
    self, BuildError, BuildSummary, DatabaseFile, Discrepancy, RecordFlaw, certify, improve_line, verify,
};
use upswing_planner::offline::{optimize, options, problem_fingerprint, problem_with_margin, target};
use upswing_planner::replan::{Planner, PlannerError};
use upswing_process::output::{OutputError, Overwrite};
use upswing_process::shard::{JournalError, MissingShards, Shard};
use upswing_trajectory::{
    Database, DatabaseContents, DatabaseError, DatabaseSource, Entry, PoseOutcome, PoseRecord, Trajectory,
};

/// Six poses in three lines; the first of each line has no rest position within the limits.
fn small_grid() -> Config {
    let mut config = Config::embedded().expect("embedded settings");
    let deg = |d: f64| d.to_radians();
    config.manoeuvres[0].grid.axes = vec![
        GridAxis { joint: 1, from: deg(-10.0), to: deg(10.0), points: 3 },
        GridAxis { joint: 3, from: deg(-10.0), to: deg(-100.0), points: 2 },
    ];
    config
}

/// [`database::build`] that may replace an existing output file.
fn build(
    config: &Config,
    shard: Shard,
    path: &Path,
    stop: &AtomicBool,
    progress: impl Fn(usize) + Sync,
) -> Result<BuildSummary, BuildError> {
    database::build(config, 0, shard, &Overwrite { force: true }.output(path), stop, progress)
}

/// [`database::merge`] that may replace an existing output file.
fn merge(inputs: &[PathBuf], path: &Path) -> Result<BuildSummary, BuildError> {
    database::merge(inputs, &Overwrite { force: true }.output(path))
}

fn go() -> AtomicBool {
    AtomicBool::new(false)
}

/// The contents of a database file.
fn read(path: &Path) -> Result<DatabaseContents, DatabaseError> {
    DatabaseContents::decode(bytes(path))
}

/// A database with these contents.
fn stored(contents: &DatabaseContents) -> Database {
    Database::load(DatabaseSource::Memory(contents.encode().into())).expect("it is whole")
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).expect("the file is there")
}

fn whole(dir: &Path) -> PathBuf {
    let path = dir.join("whole.bin");
    let summary = build(&small_grid(), Shard::WHOLE, &path, &go(), |_| ()).expect("it builds");
    assert_eq!((summary.poses, summary.solved, summary.rejected, summary.left), (6, 3, 3, 0));
    assert!(summary.failed.is_empty());
    path
}

#[test]
fn in_one_piece_in_shards_and_on_one_core() {
    let dir = tempfile::tempdir().expect("a folder");
    let whole = whole(dir.path());
    let again = dir.path().join("again.bin");
    let one_core = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    one_core.install(|| build(&small_grid(), Shard::WHOLE, &again, &go(), |_| ())).expect("it builds");
    assert_eq!(bytes(&whole), bytes(&again));

    let shards: Vec<PathBuf> = (1..=2)
        .map(|number| {
            let path = dir.path().join(format!("shard-{number}.bin"));
            build(&small_grid(), Shard { number, of: 2 }, &path, &go(), |_| ()).expect("it builds");
            path
        })
        .collect();
    let merged = dir.path().join("merged.bin");
    for order in [[0, 1, 0], [1, 0, 0]] {
        let order: Vec<_> = order.iter().map(|i| shards[*i].clone()).collect();
        let summary = merge(&order, &merged).expect("it merges");
        assert_eq!((summary.poses, summary.solved, summary.rejected, summary.left), (6, 3, 3, 0));
        assert!(summary.failed.is_empty(), "{:?}", summary.failed);
        assert_eq!(bytes(&whole), bytes(&merged));
    }
    let mut unsolved = read(&shards[1]).expect("it reads");
    unsolved.records[0].outcome = PoseOutcome::Failed;
    let with_unsolved = dir.path().join("unsolved.bin");
    std::fs::write(&with_unsolved, unsolved.encode()).expect("written");
    let summary = merge(&[shards[0].clone(), with_unsolved], &merged).expect("it merges");
    assert_eq!(summary.failed, [unsolved.records[0].pose]);
    let missing = merge(&shards[1..], &merged).expect_err("shard 1 is missing");
    assert!(
        matches!(missing, BuildError::Missing(MissingShards { ref missing, of: 2 }) if *missing == [1]),
        "{missing}"
    );
    let mut unfinished = read(&shards[0]).expect("it reads");
    unfinished.records.pop();
    std::fs::write(&shards[0], unfinished.encode()).expect("written");
    let incomplete = merge(&shards, &merged).expect_err("a pose is missing");
    assert!(matches!(incomplete, BuildError::Incomplete { poses: 6, got: 5 }), "{incomplete}");
}

#[test]
fn interrupted_between_two_guesses_for_a_pose() {
    /// Number of moments during a solve at which it is interrupted.
    const MOMENTS: u32 = 16;
    let dir = tempfile::tempdir().expect("a folder");
    let mut config = small_grid();
    for axis in &mut config.manoeuvres[0].grid.axes {
        (axis.from, axis.points) = (axis.to, 1);
    }
    let whole = dir.path().join("whole.bin");
    let begin = Instant::now();
    let summary = build(&config, Shard::WHOLE, &whole, &go(), |_| ()).expect("it builds");
    let time = begin.elapsed();
    assert_eq!((summary.poses, summary.solved), (1, 1));
    for moment in 1..MOMENTS {
        let path = dir.path().join(format!("interrupted-{moment}.bin"));
        let stop = go();
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(time * moment / MOMENTS);
                stop.store(true, Ordering::Release);
            });
            build(&config, Shard::WHOLE, &path, &stop, |_| ()).expect("an interruption is no error");
        });
        build(&config, Shard::WHOLE, &path, &go(), |_| ()).expect("it goes on");
        assert!(bytes(&whole) == bytes(&path), "interrupted after {moment}/{MOMENTS} of the time");
    }
}

/// Of the two families of swing-ups of the double pendulum on a cart, the second pose of five keeps the better one, the first pose has no
/// solution, and the third one that of the first guess: both get the better one again.
#[test]
fn a_dearer_solution_gives_way_to_that_of_the_next_pose() {
    let config = Config::load(&"cart-double".parse().expect("a system")).expect("its settings");
    let file = DatabaseFile::of(&config, 0).expect("readable").expect("shipped");
    let best = DatabaseContents::of(&file.load().expect("it loads")).expect("whole").records;
    let cost = |record: &PoseRecord| match &record.outcome {
        PoseOutcome::Solved(entry) => entry.certificate.cost,
        _ => f64::INFINITY,
    };
    let PoseOutcome::Solved(third) = &best[2].outcome else { panic!("solved") };
    let target = target(&config, 0, &[]).expect("a target");
    let first = optimize(
        &problem_with_margin(&config, target, *third.trajectory.start()),
        Search::First,
        &[],
        &options(&config),
    )
    .trajectory;
    let mut line = best.clone();
    line[0].outcome = PoseOutcome::Failed;
    line[2].outcome = PoseOutcome::Solved(Box::new(Entry::new(&first, |t| certify(&config, t))));
    assert!(cost(&line[2]) > 1.1 * cost(&best[2]), "{}, best {}", cost(&line[2]), cost(&best[2]));
    improve_line(&config, 0, &mut line, &options(&config)).expect("it is not stopped");
    for (got, best) in line.iter().zip(&best) {
        assert!(cost(got) < 1.001 * cost(best), "pose {}: {}, best {}", got.pose, cost(got), cost(best));
    }
    // Again, there is nothing to improve.
    let again = line.clone();
    improve_line(&config, 0, &mut line, &options(&config)).expect("it is not stopped");
    assert!(line == again);
}

#[test]
fn after_an_interruption_and_after_a_kill() {
    let dir = tempfile::tempdir().expect("a folder");
    let whole = whole(dir.path());
    let path = dir.path().join("interrupted.bin");
    let stop = go();
    let done = AtomicUsize::new(0);
    let one_core = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
    let summary = one_core.install(|| {
        build(&small_grid(), Shard::WHOLE, &path, &stop, |n| {
            if done.fetch_add(n, Ordering::Relaxed) + n >= 2 {
                stop.store(true, Ordering::Release);
            }
        })
    });
    let summary = summary.expect("an interruption is no error");
    assert_eq!((summary.left, path.exists()), (4, false));
    // A process killed while writing leaves half a record.
    let journal = dir.path().join("interrupted.bin.journal");
    let mut torn = bytes(&journal);
    torn.extend_from_slice(&[7; 100]);
    std::fs::write(&journal, torn).expect("written");
    let summary = build(&small_grid(), Shard::WHOLE, &path, &go(), |_| ()).expect("it goes on");
    assert_eq!((summary.resumed, summary.left), (2, 0));
    assert_eq!(bytes(&whole), bytes(&path));
    assert!(!journal.exists());
    let summary = build(&small_grid(), Shard::WHOLE, &path, &go(), |_| ()).expect("nothing to do");
    assert_eq!(summary.resumed, 6);
}

#[test]
fn a_journal_that_holds_a_line_twice() {
    let dir = tempfile::tempdir().expect("a folder");
    let whole = whole(dir.path());
    let database = read(&whole).expect("it reads");
    let path = dir.path().join("twice.bin");
    let mut journal = database.heading.journal();
    for record in database.records[..2].iter().chain(&database.records[..2]) {
        journal.extend(record.encode());
    }
    std::fs::write(dir.path().join("twice.bin.journal"), journal).expect("written");
    let summary = build(&small_grid(), Shard::WHOLE, &path, &go(), |_| ()).expect("it goes on");
    assert_eq!((summary.resumed, summary.left), (2, 0));
    assert_eq!(bytes(&whole), bytes(&path));
}

#[test]
fn a_second_build_of_the_same_file_is_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("database.bin");
    let journal = std::fs::File::create(dir.path().join("database.bin.journal")).expect("created");
    journal.lock().expect("locked");
    let refusal = build(&small_grid(), Shard::WHOLE, &path, &go(), |_| ()).expect_err("refused");
    assert!(matches!(refusal, BuildError::Journal(JournalError::Busy(_))), "{refusal}");
}

#[test]
fn a_file_of_another_build_is_left_as_it_is_unless_it_may_be_replaced() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("database.bin");
    std::fs::write(&path, "mine").expect("written");
    let carefully = Overwrite::default().output(&path);
    let shards = [whole(dir.path())];
    let refusals = [
        database::build(&small_grid(), 0, Shard::WHOLE, &carefully, &go(), |_| panic!("it began")),
        database::merge(&shards, &carefully),
    ];
    for refusal in refusals {
        let refusal = refusal.expect_err("refused");
        assert!(matches!(refusal, BuildError::Output(OutputError::Exists { .. })), "{refusal}");
        assert_eq!(bytes(&path), b"mine");
        assert!(!dir.path().join("database.bin.journal").exists());
    }
    merge(&shards, &path).expect("it is replaced");
    database::merge(&shards, &carefully).expect("it is the same");
    // The file is the result of this build now: it is not changed.
    let summary =
        database::build(&small_grid(), 0, Shard::WHOLE, &carefully, &go(), |_| ()).expect("nothing to do");
    assert_eq!(summary.resumed, 6);
}

#[test]
fn a_journal_of_other_settings_is_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("database.bin");
    let stopped = AtomicBool::new(true);
    build(&small_grid(), Shard::WHOLE, &path, &stopped, |_| ()).expect("stopped at once");
    let mut other = small_grid();
    other.robot.planning.qd_max[0] *= 0.9;
    let refusal = build(&other, Shard::WHOLE, &path, &go(), |_| ()).expect_err("refused");
    let expected = problem_fingerprint(&other, 0);
    assert!(matches!(refusal, BuildError::Foreign { expected: e, .. } if e == expected), "{refusal}");
}

#[test]
fn disagreeing_duplicates_are_refused() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut database = read(&whole(dir.path())).expect("it reads");
    let other = dir.path().join("other.bin");
    let PoseOutcome::Solved(entry) = &mut database.records[1].outcome else { panic!("solved") };
    entry.certificate.cost += 1e-12;
    std::fs::write(&other, database.encode()).expect("written");
    let refusal = merge(&[dir.path().join("whole.bin"), other], &dir.path().join("merged.bin"));
    assert!(matches!(refusal, Err(BuildError::Disagree { pose: 1, .. })));
}

#[test]
fn certificates_are_recomputed() {
    let dir = tempfile::tempdir().expect("a folder");
    let mut database = read(&whole(dir.path())).expect("it reads");
    assert!(verify(&small_grid(), 0, &stored(&database), || ()).expect("whole").is_empty());
    let PoseOutcome::Solved(entry) = &mut database.records[3].outcome else { panic!("solved") };
    entry.trajectory.u[50][0] += 1e-3;
    // The index has the end of another trajectory than that of these torques.
    let found = verify(&small_grid(), 0, &stored(&database), || ()).expect("whole");
    assert!(matches!(found[..], [Discrepancy { pose: 3, flaw: RecordFlaw::Index }]), "{found:?}");
    let PoseOutcome::Solved(entry) = &mut database.records[3].outcome else { panic!("solved") };
    **entry = Entry::new(&entry.trajectory, |_| entry.certificate);
    let found = verify(&small_grid(), 0, &stored(&database), || ()).expect("whole");
    assert_eq!(found.iter().map(|d| d.pose).collect::<Vec<_>>(), [3]);
    assert!(matches!(found[0].flaw, RecordFlaw::Certificate { .. }), "{found:?}");
}

#[test]
fn consistent_records_of_something_else_are_found() {
    let dir = tempfile::tempdir().expect("a folder");
    let config = small_grid();
    let whole = read(&whole(dir.path())).expect("it reads");
    let solved =
        |d: &DatabaseContents| d.records.iter().position(|r| matches!(r.outcome, PoseOutcome::Solved(_)));
    let found = |change: &dyn Fn(&mut PoseRecord)| {
        let mut database = whole.clone();
        let record = solved(&database).expect("an entry");
        change(&mut database.records[record]);
        let found = verify(&config, 0, &stored(&database), || ()).expect("whole");
        assert_eq!(found.len(), 1, "{found:?}");
        found[0].flaw
    };
    // Changed entries, each with the certificate of its changed trajectory.
    let entry = |change: &dyn Fn(&mut Trajectory)| {
        found(&|record: &mut PoseRecord| {
            let PoseOutcome::Solved(entry) = &record.outcome else { panic!("solved") };
            let mut trajectory = entry.trajectory.clone();
            change(&mut trajectory);
            record.outcome = PoseOutcome::Solved(Box::new(Entry::new(&trajectory, |t| certify(&config, t))));
        })
    };
    let hanging = entry(&|t| {
        let start = t.x[0];
        t.x.fill(start);
        t.u.fill(upswing_model::ActuatedVector::zeros(config.model.sizes()));
    });
    assert!(matches!(hanging, RecordFlaw::End { row: 4.., .. }), "{hanging}");
    let elsewhere = entry(&|t| t.x.iter_mut().for_each(|x| x[0] += 0.1));
    assert!(matches!(elsewhere, RecordFlaw::Start { row: 0, .. }), "{elsewhere}");
    let jumping = entry(&|t| t.x[50].q_u_mut()[1] += 0.01);
    assert!(matches!(jumping, RecordFlaw::Defect { .. }), "{jumping}");
    let hurried = entry(&|t| t.t_f *= 0.99);
    assert!(matches!(hurried, RecordFlaw::Defect { .. }), "{hurried}");
    let failed = found(&|record| record.outcome = PoseOutcome::Failed);
    assert!(matches!(failed, RecordFlaw::Solvable { .. }), "{failed}");
    let rejected = found(&|record| record.outcome = PoseOutcome::Rejected);
    assert_eq!(rejected, RecordFlaw::Rule { leaves_out: false });
    // Narrower limits than those for which the trajectories were computed.
    let mut narrower = config.clone();
    narrower.robot.planning.tau_max *= 0.5;
    let mut database = whole.clone();
    for record in &mut database.records {
        if let PoseOutcome::Solved(entry) = &record.outcome {
            record.outcome =
                PoseOutcome::Solved(Box::new(Entry::new(&entry.trajectory, |t| certify(&narrower, t))));
        }
    }
    let found = verify(&narrower, 0, &stored(&database), || ()).expect("whole");
    assert_eq!(found.len(), 3, "{found:?}");
    assert!(found.iter().all(|d| matches!(d.flaw, RecordFlaw::Limit { what: "torque", .. })), "{found:?}");
}

#[test]
fn every_shipped_database_holds() {
    for system in System::shipped() {
        let config = Config::load(&system.name().parse().expect("shipped")).expect("settings");
        for (number, manoeuvre) in config.manoeuvres.iter().enumerate() {
            let Some(file) = DatabaseFile::of(&config, number).expect("readable") else { continue };
            let found = verify(&config, number, &file.load().expect("it loads"), || ()).expect("whole");
            let name = &manoeuvre.name;
            assert!(
                found.is_empty(),
                "{name} of {}, pose {}: {}",
                system.name(),
                found[0].pose,
                found[0].flaw
            );
        }
    }
}

#[test]
fn entries_that_feedback_does_not_hold_are_found() {
    let mut config = Config::load(&"cart-double".parse().expect("shipped")).expect("settings");
    // So few knots that the trapezoidal rule says little about the motion of the rods; limits between them are not the question here.
    config.planner.offline.intervals = 20;
    config.planner.replan.knot_margin = 0.0;
    config.manoeuvres[0].grid.axes = vec![GridAxis { joint: 0, from: 0.0, to: 0.0, points: 1 }];
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("coarse.bin");
    build(&config, Shard::WHOLE, &path, &go(), |_| ()).expect("it builds");
    let database = stored(&read(&path).expect("it reads"));
    config.planner.replan.knot_margin = 1e3;
    let found = verify(&config, 0, &database, || ()).expect("whole");
    let flaws: Vec<_> = found.iter().map(|d| d.flaw).collect();
    assert!(matches!(flaws[..], [RecordFlaw::EndError { .. }]), "{flaws:?}");
}

#[test]
fn a_read_only_folder_gives_one_clear_error() {
    let nowhere = Path::new("/proc/database.bin");
    let refusal = build(&small_grid(), Shard::WHOLE, nowhere, &go(), |_| ()).expect_err("refused");
    assert!(refusal.to_string().starts_with("cannot write /proc/database.bin"), "{refusal}");
}

#[test]
fn other_limits_are_refused_with_both_fingerprints() {
    let mut config = Config::embedded().expect("embedded settings");
    let got = problem_fingerprint(&config, 0);
    config.robot.planning.qd_max[0] *= 0.9;
    let expected = problem_fingerprint(&config, 0);
    let refusal = Planner::new(config).expect_err("made for other limits");
    let what = "set of limits and weights";
    let cause = DatabaseError::Fingerprint { what, expected, got };
    let text = refusal.to_string();
    assert!(matches!(refusal, PlannerError::Database { cause: found, .. } if found == cause), "{text}");
    assert!(text.starts_with("embedded iiwa-pendulum/swing-up.bin: "), "{text}");
}

#[test]
fn another_number_of_intervals_is_refused() {
    let mut config = Config::embedded().expect("embedded settings");
    config.planner.offline.intervals = 50;
    let refusal = Planner::new(config).expect_err("made for 100 intervals");
    assert!(
        matches!(refusal, PlannerError::Database { cause: DatabaseError::Fingerprint { .. }, .. }),
        "{refusal}"
    );
}

#[test]
fn a_full_disk_gives_one_clear_error_and_loses_nothing_that_was_finished() {
    let dir = tempfile::tempdir().expect("a folder");
    let disk = dir.path().join("disk");
    std::fs::create_dir(&disk).expect("a folder");
    // Disk space for the records of one or two poses.
    let Some(_mounted) = Tmpfs::mount(&disk, "size=32k") else {
        println!("skipped: mounting a small tmpfs needs rights that this user does not have");
        return;
    };
    let path = disk.join("database.bin");
    let refusal = build(&small_grid(), Shard::WHOLE, &path, &go(), |_| ()).expect_err("no room");
    let text = refusal.to_string();
    assert!(text.starts_with("cannot write") && text.contains("No space left on device"), "{text}");

    // With more disk space the build continues after its last line.
    run("mount", &["-o", "remount,size=4m", &disk.to_string_lossy()]).expect("a larger disk");
    let summary = build(&small_grid(), Shard::WHOLE, &path, &go(), |_| ()).expect("it builds");
    assert!(summary.resumed > 0, "nothing was left to resume from");
    assert_eq!((summary.solved, summary.rejected), (3, 3));
    assert_eq!(bytes(&path), bytes(&whole(dir.path())));
}

/// A file system in memory; unmounted when dropped.
struct Tmpfs<'a>(&'a Path);

impl<'a> Tmpfs<'a> {
    fn mount(path: &'a Path, options: &str) -> Option<Self> {
        run("mount", &["-t", "tmpfs", "-o", options, "tmpfs", &path.to_string_lossy()]).map(|()| Self(path))
    }
}

impl Drop for Tmpfs<'_> {
    fn drop(&mut self) {
        let _ = run("umount", &[&self.0.to_string_lossy()]);
    }
}

fn run(program: &str, arguments: &[&str]) -> Option<()> {
    let status = std::process::Command::new(program)
        .args(arguments)
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .status();
    status.is_ok_and(|s| s.success()).then_some(())
}
