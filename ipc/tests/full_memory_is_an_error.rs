//! Where /dev/shm is too small or full, a process gets an error that says so; it does not die of SIGBUS.
//!
//! The parent runs itself with a /dev/shm of its own. Where the system does not allow that, the test says so.

mod common;

use common::{SIZES, plan};
use std::process;
use upswing_ipc::{
    Command, ControlRequest, Domain, IpcError, Measurement, PlanMessage, PlannerRequest, PlantRequest,
    StepBatch, TelemetryBatch,
};
use upswing_model::{MOST_JOINTS, Sizes};
use upswing_trajectory::INTERVALS;

const CHILD: &str = "UPSWING_TEST_SMALL_MEMORY";

/// Runs test `name` again where /dev/shm has `size` bytes. `None`: this system does not allow that.
fn with_memory_of(size: &str, name: &str) -> Option<process::Output> {
    let unshare = ["--mount", "--map-root-user", "--", "sh", "-c"];
    let mount = format!("mount -t tmpfs -o size={size} tmpfs /dev/shm || exit 77; exec \"$0\" \"$@\"");
    let output = process::Command::new("unshare")
        .args(unshare)
        .arg(mount)
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", name, "--nocapture"])
        .env(CHILD, size)
        .output()
        .ok()?;
    let refused = output.status.code() == Some(77) || output.stderr.starts_with(b"unshare:");
    if refused {
        println!("skipped: {}", String::from_utf8_lossy(&output.stderr).trim());
    }
    (!refused).then_some(output)
}

fn is_child() -> bool {
    std::env::var_os(CHILD).is_some()
}

fn check(size: &str, name: &str) {
    let Some(output) = with_memory_of(size, name) else { return };
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{:?}: {text}", output.status);
    assert!(text.contains("1 passed"), "{text}");
}

fn expect_full<T>(result: Result<T, IpcError>) {
    match result {
        Err(error @ IpcError::Full { needed, free, .. }) => {
            assert!(needed > free, "{error}");
            assert!(error.to_string().contains("/dev/shm is too full"), "{error}");
        }
        Err(error) => panic!("{error}"),
        Ok(_) => panic!("there was room"),
    }
}

#[test]
fn too_small_for_anything() {
    if is_child() {
        return expect_full(Domain::new("small").unwrap().join("daemon"));
    }
    check("1m", "too_small_for_anything");
}

#[test]
fn too_small_for_telemetry() {
    if is_child() {
        let node = Domain::new("small").unwrap().join("daemon").unwrap();
        return expect_full(node.publisher::<TelemetryBatch>());
    }
    check("16m", "too_small_for_telemetry");
}

#[test]
fn full_later_does_no_harm() {
    if is_child() {
        let node = Domain::new("later").unwrap().join("daemon").unwrap();
        let telemetry = node.publisher::<TelemetryBatch>().unwrap();
        let plans = node.plan_publisher(SIZES.0, SIZES.1).unwrap();
        let subscribers: Vec<_> = (0..8).map(|_| node.subscriber::<TelemetryBatch>().unwrap()).collect();
        telemetry.publish(&TelemetryBatch::boxed_zeroed()).unwrap();
        // All but the room for connections, which are there already.
        let free = Domain::free_memory().unwrap();
        let filler = vec![1_u8; usize::try_from(free).unwrap()];
        let _ = std::fs::write("/dev/shm/filler", filler);
        assert!(Domain::free_memory().unwrap() < 4096);
        // Every place of every queue is written.
        for _ in 0..5000 {
            telemetry.publish(&TelemetryBatch::boxed_zeroed()).unwrap();
            plans.publish(&plan(1)).unwrap();
        }
        assert!(subscribers.iter().all(|s| s.receive().unwrap().is_some()));
        return expect_full(node.server::<ControlRequest>());
    }
    check("128m", "full_later_does_no_harm");
}

#[test]
fn the_largest_system_fits_into_what_it_says() {
    if is_child() {
        let node = Domain::new("largest").unwrap().join("all").unwrap();
        let sizes = Sizes::new(MOST_JOINTS, MOST_JOINTS - 1).unwrap();
        let _writers = (node.writer::<Measurement>().unwrap(), node.writer::<Command>().unwrap());
        let _publishers = (
            node.publisher::<TelemetryBatch>().unwrap(),
            node.publisher::<StepBatch>().unwrap(),
            node.plan_publisher(sizes, *INTERVALS.end()).unwrap(),
        );
        let _servers = (
            node.server::<ControlRequest>().unwrap(),
            node.server::<PlannerRequest>().unwrap(),
            node.server::<PlantRequest>().unwrap(),
        );
        let subscribers = || {
            let steps = (node.subscriber::<StepBatch>().unwrap(), node.subscriber::<PlanMessage>().unwrap());
            (node.subscriber::<TelemetryBatch>().unwrap(), steps)
        };
        let clients = || {
            let planner = node.client::<PlannerRequest>().unwrap();
            (node.client::<ControlRequest>().unwrap(), planner, node.client::<PlantRequest>().unwrap())
        };
        let _subscribers: Vec<_> = (0..8).map(|_| subscribers()).collect();
        let _clients: Vec<_> = (0..16).map(|_| clients()).collect();
        return;
    }
    check(&Domain::MEMORY.to_string(), "the_largest_system_fits_into_what_it_says");
}
