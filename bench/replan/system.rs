//! A running system on the clock `paced`: from request to plan accepted, and the memory of the planner.

use crate::{config, print, starts};
use std::time::{Duration, Instant};
use upswing_config::Config;
use upswing_ipc::operator::OperatorRequest;
use upswing_ipc::{Clock, PlannerRequest, PlannerResponse};
use upswing_model::State;
use upswing_planner::database::DatabaseFile;
use upswing_rig::course::first_manoeuvre;
use upswing_rig::session::{Role, Session};
use upswing_tests::System;
use upswing_trajectory::DatabaseContents;

/// How long an answer may take.
const PATIENCE: Duration = Duration::from_secs(30);
/// Where the arm holds, deg.
const POSE_DEG: &[f64] = &[0.0, -15.0, 0.0, -95.0, 0.0, 10.0, 0.0];
/// Entries of the paper's database.
const PAPER_ENTRIES: usize = 256;

/// Requests from `count` starts, and as many of a plan that is kept ready.
pub fn run(count: u64) {
    requests(&starts(&config(), count));
    let folder = tempfile::tempdir().expect("a folder");
    let settings = folder.path().join("config");
    upswing_planner::export(&Config::embedded().expect("embedded settings"), &settings, Default::default())
        .unwrap_or_else(|e| panic!("{e}"));
    memory(&System::start_with(Clock::Paced, POSE_DEG, Some(&settings)), entries(&config()));
    shorten(&settings);
    let shortened = Config::from_dir(&settings).unwrap_or_else(|e| panic!("{e}"));
    memory(&System::start_with(Clock::Paced, POSE_DEG, Some(&settings)), entries(&shortened));
}

fn requests(starts: &[State]) {
    let mut system = System::start(Clock::Paced, POSE_DEG);
    let period = system.period();
    let session = &mut system.session;
    session.advance(1).expect("time passes");
    session.request(OperatorRequest::Enable).unwrap_or_else(|e| panic!("{e}"));
    // Time to settle, and for the planner to make its plan.
    session.advance((1.0 / period) as u64).expect("time passes");
    let from_now = PlannerRequest::from_now(first_manoeuvre(&config()));
    let order = *system.config.model.order();
    let fresh = |start: &State| PlannerRequest {
        publish: 1,
        ..PlannerRequest::from_state(first_manoeuvre(&config()), &order, start)
    };
    let (mut computed, mut ready, mut planning, mut status) = (vec![], vec![], vec![], vec![]);
    // In turns, so that the id of the loaded plan changes with each request.
    for start in starts {
        let (plan, time) = request(session, fresh(start));
        planning.push(Duration::from_secs_f64(1e-6 * plan.time_total_us));
        computed.push(time);
        let (plan, time) = request(session, from_now);
        let reason = plan.reason.as_str().expect("a text");
        assert!(reason.contains("ready"), "the plan was not kept ready: {reason}");
        ready.push(time);
        let begin = Instant::now();
        session.status().unwrap_or_else(|e| panic!("{e}"));
        status.push(begin.elapsed());
        // The records of the telemetry are of no use here.
        session.collect().unwrap_or_else(|e| panic!("{e}"));
        session.records.clear();
    }
    print("request to plan accepted, computed, wall", computed);
    print("  its time in the planner, wall", planning);
    print("request to plan accepted, kept ready, wall", ready);
    print("one question for the daemon's status, wall", status);
}

/// Asks for a swing-up and waits until the daemon has accepted the plan.
fn request(session: &mut Session, request: PlannerRequest) -> (PlannerResponse, Duration) {
    let client = session.node().client::<PlannerRequest>().unwrap_or_else(|e| panic!("{e}"));
    let begin = Instant::now();
    let plan = client.call(&request, PATIENCE).unwrap_or_else(|e| panic!("{e}"));
    assert_ne!(plan.plan_id, 0, "the planner refused: {:?}", plan.reason.as_str());
    loop {
        let status = session.status().unwrap_or_else(|e| panic!("{e}"));
        if status.plan_id == plan.plan_id {
            return (plan, begin.elapsed());
        }
        assert!(begin.elapsed() < PATIENCE, "the daemon refused the plan: {:?}", status.reason.as_str());
    }
}

fn entries(config: &Config) -> usize {
    let database = DatabaseFile::of(config, 0).unwrap_or_else(|e| panic!("{e}")).expect("a database");
    database.load().map_or(0, |database| database.entries())
}

/// Keeps as many entries of the database in a settings folder as the paper's has.
fn shorten(settings: &std::path::Path) {
    let path = settings.join("swing-up.bin");
    let bytes = std::fs::read(&path).expect("the exported database");
    let mut database = DatabaseContents::decode(bytes).unwrap_or_else(|e| panic!("{e}"));
    database.records.retain(|r| r.entry().is_some());
    database.records.truncate(PAPER_ENTRIES);
    std::fs::write(&path, database.encode()).expect("written");
}

/// Prints the resident memory of a system's planner.
fn memory(system: &System, entries: usize) {
    let pid = system.session.pid(Role::Planner).expect("a running planner");
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).expect("Linux");
    let mib = |key: &str| {
        let line = status.lines().find(|l| l.starts_with(key)).unwrap_or_else(|| panic!("no {key}"));
        let kib = line.split_whitespace().nth(1).and_then(|n| n.parse::<f64>().ok());
        kib.unwrap_or_else(|| panic!("{line}")) / 1024.0
    };
    println!(
        "planner with {entries} entries: resident {:.1} MiB, of which heap and stack {:.1}, files {:.1}, shared \
         memory {:.1}",
        mib("VmRSS:"),
        mib("RssAnon:"),
        mib("RssFile:"),
        mib("RssShmem:")
    );
}
