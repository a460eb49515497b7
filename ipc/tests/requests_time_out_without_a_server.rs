//! A request ends with an answer or with an error that distinguishes why no answer came.

mod common;

use common::{Victim, domain_of_child, until_killed, wait_for};
use std::time::Duration;
use upswing_ipc::{
    CallError, ControlKind, ControlRequest, ControlResponse, IpcError, Mode, PlannerRequest, PlantRequest,
    TelemetryBatch, TempDomain, Text,
};

const PATIENCE: Duration = Duration::from_secs(30);
const BRIEF: Duration = Duration::from_millis(20);

/// Entry of the child process: serves `control` until it is killed.
#[test]
fn child_serves() {
    let Some(domain) = domain_of_child() else { return };
    let server = domain.join("daemon").unwrap().server::<ControlRequest>().unwrap();
    let mut seq = 0;
    until_killed(|| {
        server
            .poll(|_| {
                seq += 1;
                ControlResponse { accepted: 1, seq, ..ControlResponse::default() }
            })
            .unwrap();
    });
}

/// Entry of the child process: creates the server of `control` and never answers.
#[test]
fn child_is_deaf() {
    let Some(domain) = domain_of_child() else { return };
    let _server = domain.join("daemon").unwrap().server::<ControlRequest>().unwrap();
    until_killed(|| {});
}

#[test]
fn without_a_server_every_request_says_so() {
    let domain = TempDomain::new("absent").unwrap();
    let node = domain.join("cli").unwrap();
    let control = node.client::<ControlRequest>().unwrap();
    assert!(!control.has_server());
    let error = control.call(&ControlRequest::new(ControlKind::Enable), PATIENCE).unwrap_err();
    assert!(
        matches!(&error, CallError::NoServer { service: "control", domain: d, .. } if d == domain.name()),
        "{error}"
    );
    let error =
        node.client::<PlannerRequest>().unwrap().call(&PlannerRequest::default(), PATIENCE).unwrap_err();
    assert!(matches!(error, CallError::NoServer { service: "planner", .. }), "{error}");
    let error = node.client::<PlantRequest>().unwrap().call(&PlantRequest::default(), PATIENCE).unwrap_err();
    assert!(matches!(error, CallError::NoServer { service: "plant", .. }), "{error}");
}

#[test]
fn a_server_that_does_not_poll_times_out_and_never_sees_the_withdrawn_request() {
    let domain = TempDomain::new("deaf").unwrap();
    let node = domain.join("cli").unwrap();
    let server = node.server::<ControlRequest>().unwrap();
    let client = node.client::<ControlRequest>().unwrap();
    // More often than a client may have requests under way: the withdrawn ones must not count.
    for _ in 0..50 {
        let error = client.call(&ControlRequest::new(ControlKind::Enable), BRIEF).unwrap_err();
        assert!(
            matches!(error, CallError::Timeout { service: "control", waited } if waited >= BRIEF),
            "{error}"
        );
    }
    let handled = server.poll(|_| panic!("nobody waits for this request any more")).unwrap();
    assert_eq!(handled, 0);
}

#[test]
fn answers_carry_the_request_and_the_reason() {
    let domain = TempDomain::new("answer").unwrap();
    let serving = std::sync::atomic::AtomicBool::new(true);
    let node = domain.join("cli").unwrap();
    std::thread::scope(|threads| {
        threads.spawn(|| {
            let server = domain.join("daemon").unwrap().server::<ControlRequest>().unwrap();
            let mut seq = 0;
            while serving.load(std::sync::atomic::Ordering::Relaxed) {
                server
                    .poll(|request| {
                        seq += 1;
                        ControlResponse {
                            accepted: u64::from(request.kind() == Ok(ControlKind::Hold)),
                            mode: Mode::Hold.code(),
                            seq,
                            reason: Text::new("asked for"),
                            ..ControlResponse::default()
                        }
                    })
                    .unwrap();
                std::thread::yield_now();
            }
        });
        let client = node.client::<ControlRequest>().unwrap();
        wait_for("the server", || client.has_server().then_some(()));
        for seq in 1..=1000 {
            let command = if seq % 2 == 0 { ControlKind::Hold } else { ControlKind::Stop };
            let answer = client.call(&ControlRequest::new(command), PATIENCE).unwrap();
            assert_eq!((answer.accepted, answer.seq), (u64::from(seq % 2 == 0), seq));
            assert_eq!(answer.mode(), Ok(Mode::Hold));
            assert_eq!(answer.reason.as_str(), Ok("asked for"));
        }
        serving.store(false, std::sync::atomic::Ordering::Relaxed);
    });
}

#[test]
fn a_killed_server_is_reported_and_its_successor_answers() {
    let domain = TempDomain::new("killed").unwrap();
    let node = domain.join("cli").unwrap();
    let client = node.client::<ControlRequest>().unwrap();
    let request = ControlRequest::new(ControlKind::Status);
    for _ in 0..3 {
        let daemon = Victim::start("child_serves", &domain);
        wait_for("the server", || client.has_server().then_some(()));
        assert_eq!(client.call(&request, PATIENCE).unwrap().seq, 1);
        assert_eq!(client.call(&request, PATIENCE).unwrap().seq, 2);
        daemon.kill();
        // It was alive a moment ago: the first request may find out only while it waits.
        let error = client.call(&request, PATIENCE).unwrap_err();
        assert!(matches!(error, CallError::ServerGone { .. } | CallError::NoServer { .. }), "{error}");
        let error = client.call(&request, PATIENCE).unwrap_err();
        assert!(matches!(error, CallError::NoServer { .. }), "{error}");
    }
}

#[test]
fn a_server_killed_during_a_request_is_reported() {
    let domain = TempDomain::new("during").unwrap();
    let node = domain.join("cli").unwrap();
    let client = node.client::<ControlRequest>().unwrap();
    let daemon = Victim::start("child_is_deaf", &domain);
    wait_for("the server", || client.has_server().then_some(()));
    let killer = std::thread::spawn(move || {
        std::thread::sleep(BRIEF);
        daemon.kill();
    });
    let error = client.call(&ControlRequest::new(ControlKind::Status), PATIENCE).unwrap_err();
    // Where the kill is quicker than the request there is no server at all.
    assert!(matches!(error, CallError::ServerGone { .. } | CallError::NoServer { .. }), "{error}");
    killer.join().unwrap();
}

#[test]
fn a_second_server_and_a_second_publisher_are_refused() {
    let domain = TempDomain::new("second").unwrap();
    let first = domain.join("daemon").unwrap();
    let second = domain.join("daemon").unwrap();

    let server = first.server::<ControlRequest>().unwrap();
    let error = second.server::<ControlRequest>().err().unwrap();
    assert!(matches!(&error, IpcError::Taken { port: "server", max: 1, .. }), "{error}");
    let holder =
        format!("control` already has its 1 server(s) in live processes (pid {})", std::process::id());
    assert!(error.to_string().contains(&holder), "{error}");
    drop(server);
    second.server::<ControlRequest>().unwrap();

    let publisher = first.publisher::<TelemetryBatch>().unwrap();
    let error = second.publisher::<TelemetryBatch>().err().unwrap();
    assert!(matches!(&error, IpcError::Taken { port: "publisher", .. }), "{error}");
    drop(publisher);
    second.publisher::<TelemetryBatch>().unwrap();
}
