//! Processes that are suspended, that die with a future epoch, that send requests without end, or that put pipes in place
//! of files, do not keep others from communicating.

mod common;

use common::{SIZES, Victim, domain_of_child, until_killed, wait_for};
use iceoryx2::prelude::{Config, FileName, Node as IoxNode, NodeBuilder, Path, SemanticString, ipc};
use std::ffi::CString;
use std::os::unix::ffi::OsStrExt;
use std::sync::mpsc;
use std::time::Duration;
use upswing_ipc::{
    BlackboardPayload, Command, ControlKind, ControlRequest, ControlResponse, Domain, FinderThread, IpcError,
    Measurement, PlanMessage, TempDomain,
};

/// Far beyond anything that is waited for.
const LONG: Duration = Duration::from_secs(60);

/// The result of `body`, which must not hang.
fn ends<T: Send + 'static>(what: &str, body: impl FnOnce() -> T + Send + 'static) -> T {
    let (tell, told) = mpsc::channel();
    std::thread::spawn(move || tell.send(body()));
    told.recv_timeout(LONG).unwrap_or_else(|e| panic!("{what}: {e}"))
}

fn lock(domain: &Domain) -> std::path::PathBuf {
    domain.root().join("creation.lock")
}

/// Entry of the child process: stops while it creates.
#[test]
fn child_stops_with_the_lock() {
    let Some(domain) = domain_of_child() else { return };
    let _node = domain.join("victim").unwrap();
    let file = std::fs::File::options().write(true).open(lock(&domain)).unwrap();
    file.lock().unwrap();
    std::fs::write(domain.root().join("locked"), "").unwrap();
    // SAFETY: plain system call on this process.
    unsafe { libc::raise(libc::SIGSTOP) };
    until_killed(|| {});
}

#[test]
fn nobody_waits_for_a_lock_whose_holder_is_stopped() {
    let domain = TempDomain::new("stopped").unwrap();
    let node = domain.join("daemon").unwrap();
    let mut finder = node.finder::<Measurement>();
    let victim = Victim::start("child_stops_with_the_lock", &domain);
    wait_for("the lock", || domain.root().join("locked").exists().then_some(()));
    wait_for("the stop", || victim.is_stopped().then_some(()));
    let plant = domain.join("plant").unwrap();
    let _server = node.server::<ControlRequest>().unwrap();
    let client = plant.client::<ControlRequest>().unwrap();
    assert!(client.has_server());
    let _ends = (node.plan_publisher(SIZES.0, SIZES.1).unwrap(), plant.subscriber::<PlanMessage>().unwrap());
    let writer = plant.writer::<Measurement>().unwrap();
    assert_eq!(finder.poll().unwrap().unwrap().epoch(), writer.epoch());
    victim.kill();
}

#[test]
fn a_search_does_not_wait_for_the_lock() {
    let domain = TempDomain::new("search").unwrap();
    let node = domain.join("daemon").unwrap();
    let search = FinderThread::<Measurement>::start(&node).unwrap();
    assert!(search.first().unwrap().is_none());
    let writer = node.writer::<Measurement>().unwrap();
    let reader = wait_for("the writer", || search.poll().unwrap());
    assert_eq!(reader.epoch(), writer.epoch());
    // Nobody knows that this thread will give the lock back.
    let held = std::fs::File::options().write(true).open(lock(&domain)).unwrap();
    held.lock().unwrap();
    assert!((0..1000).all(|_| search.poll().unwrap().is_none()));
    drop(held);
}

/// An iceoryx2 node of somebody who does not use this library.
fn foreign_node(domain: &Domain) -> IoxNode<ipc::Service> {
    let mut config = Config::default();
    config.global.set_root_path(&Path::new(domain.root().as_os_str().as_bytes()).unwrap());
    config.global.prefix = FileName::new(format!("upswing_{}_", domain.name()).as_bytes()).unwrap();
    NodeBuilder::new().config(&config).create().unwrap()
}

/// A writer of `value` with an epoch of its choice lives for as long as `body` runs.
fn with_writer<
    T: BlackboardPayload,
    V: iceoryx2::prelude::ZeroCopySend + Copy + Default + std::fmt::Debug + 'static,
>(
    domain: &Domain,
    epoch: u64,
    body: impl FnOnce(),
) {
    let node = foreign_node(domain);
    let name = format!("{}/{epoch:020}", T::CHANNEL);
    let service = node
        .service_builder(&name.as_str().try_into().unwrap())
        .blackboard_creator::<u64>()
        .add::<V>(0, V::default())
        .create()
        .unwrap();
    let _writer = service.writer_builder().create().unwrap();
    body();
}

#[test]
fn an_epoch_of_the_future_is_not_looked_at() {
    let domain = TempDomain::new("future").unwrap();
    let node = domain.join("daemon").unwrap();
    let writer = node.writer::<Measurement>().unwrap();
    let (mut finder, mut late) = (node.finder::<Measurement>(), node.finder::<Measurement>());
    assert_eq!(finder.poll().unwrap().unwrap().epoch(), writer.epoch());
    with_writer::<Measurement, Measurement>(&domain, u64::MAX, || {
        assert!(finder.poll().unwrap().is_none());
        assert_eq!(late.poll().unwrap().unwrap().epoch(), writer.epoch());
    });
    let next = node.writer::<Measurement>().unwrap();
    assert_eq!(finder.poll().unwrap().unwrap().epoch(), next.epoch());
}

#[test]
fn a_newer_writer_that_is_gone_gives_way_to_the_one_that_lives() {
    let domain = TempDomain::new("newer").unwrap();
    let node = domain.join("plant").unwrap();
    let writer = node.writer::<Command>().unwrap();
    let mut finder = node.finder::<Command>();
    assert_eq!(finder.poll().unwrap().unwrap().epoch(), writer.epoch());
    with_writer::<Command, Command>(&domain, writer.epoch() + 1, || {
        assert_eq!(finder.poll().unwrap().unwrap().epoch(), writer.epoch() + 1);
    });
    let reader = wait_for("the living one", || finder.poll().unwrap());
    assert_eq!(reader.epoch(), writer.epoch());
    assert!(finder.poll().unwrap().is_none());
}

#[test]
fn a_writer_of_something_else_does_not_hide_the_others() {
    let domain = TempDomain::new("else").unwrap();
    let node = domain.join("plant").unwrap();
    let writer = node.writer::<Command>().unwrap();
    with_writer::<Command, u64>(&domain, writer.epoch() + 1, || {
        let mut finder = node.finder::<Command>();
        assert_eq!(finder.poll().unwrap().unwrap().epoch(), writer.epoch());
        let error = finder.poll().err().expect("the newer one is named");
        assert!(matches!(error, IpcError::Layout { .. }), "{error}");
    });
}

#[test]
fn clients_who_always_ask_let_the_server_do_other_things() {
    let domain = TempDomain::new("greedy").unwrap();
    let node = domain.join("daemon").unwrap();
    let server = node.server::<ControlRequest>().unwrap();
    let (tell, told) = mpsc::channel();
    let greedy: Vec<_> = (0..2)
        .map(|_| {
            let (domain, tell) = (domain.clone(), tell.clone());
            std::thread::spawn(move || {
                let client = domain.join("cli").unwrap().client::<ControlRequest>().unwrap();
                tell.send(()).unwrap();
                while client.call(&ControlRequest::new(ControlKind::Enable), LONG).is_ok() {}
            })
        })
        .collect();
    (0..2).for_each(|_| told.recv().unwrap());
    let mut rounds = 0;
    wait_for("requests", || Some(server.poll(|_| ControlResponse::default()).unwrap()).filter(|&n| n > 0));
    // Requests that take long end a turn.
    let answered = server
        .poll(|_| {
            rounds += 1;
            assert!(rounds < 10, "no end of this turn");
            std::thread::sleep(Duration::from_millis(60));
            ControlResponse::default()
        })
        .unwrap();
    assert!(answered <= 2, "{answered} in one turn");
    drop(server);
    greedy.into_iter().for_each(|client| client.join().unwrap());
}

fn make_pipe(path: &std::path::Path) {
    let path = CString::new(path.as_os_str().as_bytes()).unwrap();
    // SAFETY: the path ends with a zero.
    assert_eq!(unsafe { libc::mkfifo(path.as_ptr(), 0o600) }, 0);
}

#[test]
fn a_pipe_in_place_of_a_file_is_refused_or_passed_over() {
    for name in ["creation.lock", "iceoryx2.toml"] {
        let domain = TempDomain::new("pipe").unwrap();
        std::fs::create_dir(domain.root()).unwrap();
        let path = domain.root().join(name);
        make_pipe(&path);
        let other = (*domain).clone();
        let refused = ends(name, move || other.join("daemon").err().map(|e| e.to_string()));
        // The settings are written once in a process, by the test that came first.
        if name == "creation.lock" {
            let told = refused.expect("a refusal");
            assert!(told.contains(path.to_str().unwrap()) && told.contains("regular file"), "{told}");
        }
    }
    let domain = TempDomain::new("pipe").unwrap();
    let memory = format!("/dev/shm/upswing_{}_{}_1.data", domain.name(), "0".repeat(40));
    make_pipe(memory.as_ref());
    let other = (*domain).clone();
    ends("memory", move || other.join("daemon").unwrap().writer::<Command>().map(drop).unwrap());
    std::fs::remove_file(memory).unwrap();
}
