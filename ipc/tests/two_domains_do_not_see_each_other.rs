//! Domains are separate, even if the name of one is a prefix of the other's.

mod common;

use common::{SIZES, plan};
use std::time::Duration;
use upswing_ipc::{
    CallError, Command, ControlKind, ControlRequest, Domain, DomainError, PlanMessage, TempDomain,
};

#[test]
fn writers_plans_and_servers_stay_in_their_domain() {
    let (here, there) = (TempDomain::new("here").unwrap(), TempDomain::new("there").unwrap());
    let (near, far) = (here.join("daemon").unwrap(), there.join("daemon").unwrap());

    let writer = near.writer::<Command>().unwrap();
    writer.write(Command { seq: 1, ..Command::default() });
    assert!(near.finder::<Command>().poll().unwrap().is_some());
    assert!(far.finder::<Command>().poll().unwrap().is_none());

    let (subscriber_near, subscriber_far) =
        (near.subscriber::<PlanMessage>().unwrap(), far.subscriber::<PlanMessage>().unwrap());
    let (publisher_near, _publisher_far) =
        (near.plan_publisher(SIZES.0, SIZES.1).unwrap(), far.plan_publisher(SIZES.0, SIZES.1).unwrap());
    publisher_near.publish(&plan(1)).unwrap();
    assert!(subscriber_near.receive().unwrap().is_some());
    assert!(subscriber_far.receive().unwrap().is_none());

    let _server = near.server::<ControlRequest>().unwrap();
    assert!(near.client::<ControlRequest>().unwrap().has_server());
    let request = ControlRequest::new(ControlKind::Enable);
    let error = far.client::<ControlRequest>().unwrap().call(&request, Duration::from_secs(30)).unwrap_err();
    assert!(matches!(error, CallError::NoServer { .. }), "{error}");
}

#[test]
fn a_peer_in_the_same_domain_is_seen() {
    let domain = TempDomain::new("same").unwrap();
    let twin = Domain::new(domain.name()).unwrap();
    assert_eq!(*domain, twin);
    let _writer = domain.join("daemon").unwrap().writer::<Command>().unwrap();
    assert!(twin.join("plant").unwrap().finder::<Command>().poll().unwrap().is_some());
}

#[test]
fn removing_a_domain_leaves_those_whose_names_begin_alike() {
    let short = TempDomain::new("alike").unwrap();
    // An ending like the hash in a file name is the worst case for telling the files apart.
    let longer: Vec<_> =
        ["_1", "_0123456789", "-c"].iter().map(|end| format!("{}{end}", short.name())).collect();
    let longer: Vec<_> = longer.iter().map(|name| Domain::new(name).unwrap()).collect();
    let files = |domain: &Domain| {
        let prefix = format!("upswing_{}_", domain.name());
        let names =
            std::fs::read_dir("/dev/shm").unwrap().map(|e| e.unwrap().file_name().into_string().unwrap());
        let mut names: Vec<_> = names.filter(|n| n.starts_with(&prefix)).collect();
        names.sort();
        names
    };
    let nodes: Vec<_> = longer.iter().map(|domain| domain.join("daemon").unwrap()).collect();
    let ends: Vec<_> = nodes
        .iter()
        .map(|n| {
            (
                n.subscriber::<PlanMessage>().unwrap(),
                n.plan_publisher(SIZES.0, SIZES.1).unwrap(),
                n.writer::<Command>().unwrap(),
            )
        })
        .collect();
    let before: Vec<_> = longer.iter().map(files).collect();
    assert!(before.iter().all(|names| names.iter().any(|n| n.ends_with(".connection"))), "{before:?}");

    drop(short.join("daemon").unwrap().plan_publisher(SIZES.0, SIZES.1).unwrap());
    assert!(short.remove_if_unused().unwrap());
    let after: Vec<_> = longer.iter().map(files).collect();
    assert_eq!(before, after);

    drop((ends, nodes));
    for domain in longer {
        assert!(domain.remove_if_unused().unwrap());
    }
}

#[test]
fn names_that_are_no_plain_words_are_refused() {
    assert_eq!(Domain::new(""), Err(DomainError::Length { name: String::new(), got: 0 }));
    let longest = "x".repeat(Domain::MAX_NAME);
    assert!(Domain::new(&longest).is_ok());
    let too_long = longest + "x";
    assert_eq!(
        Domain::new(&too_long),
        Err(DomainError::Length { name: too_long.clone(), got: Domain::MAX_NAME + 1 })
    );
    for (name, found, at) in
        [("a/b", '/', 2), ("../etc", '.', 1), ("Lab", 'L', 1), ("häl", 'ä', 2), ("a b", ' ', 2)]
    {
        assert_eq!(Domain::new(name), Err(DomainError::Character { name: name.to_owned(), found, at }));
    }
    assert!(Domain::new("a\0").is_err());
    assert_eq!(Domain::new("lab_1-b").unwrap().name(), "lab_1-b");
}
