//! Removal of the files that killed processes left unfinished. [`remove`] is for the holder of the creation lock
//! only: nobody else is creating then, so what is unfinished is left over. The other functions need no lock.
//!
//! iceoryx2 0.10 takes an unfinished file for the work of a process that is still at it: to open that service fails for
//! good, and as root even to list services or to clean up waits without end. It takes unfinished nodes for starting ones
//! for good, and forgets the connections of ports that are gone.

use super::layout::{
    Layout, files, has_suffix, id, is_connection, is_old, is_readable, is_unfinished_memory,
    is_unfinished_text, ports_of_connection,
};
use std::collections::HashSet;
use std::fs::{Metadata, OpenOptions};
use std::path::Path;

/// Removes unfinished shared memory, service descriptions and nodes, and connections whose ports are gone.
pub(super) fn remove(layout: &Layout) {
    layout.memory().for_each(|path| remove_if(&path, is_unfinished_memory));
    layout.descriptions().for_each(|path| remove_if(&path, |_, state| is_unfinished_text(state)));
    let ports = remove_unfinished_nodes(&layout.nodes());
    layout.memory().for_each(|path| {
        remove_if(&path, |path, state| is_old(state) && is_without_port(path, &ports));
    });
}

/// Whether nothing is unfinished, as far as a process without the creation lock can see: then iceoryx2 can list and open
/// services without waiting.
pub(crate) fn are_none(layout: &Layout) -> bool {
    let state = |path: &Path| path.symlink_metadata();
    layout.memory().all(|path| state(&path).is_ok_and(|state| !is_unfinished_memory(&path, &state)))
        && layout.descriptions().all(|path| state(&path).is_ok_and(|state| !is_unfinished_text(&state)))
}

/// Gives each connection that has no memory yet one byte of it. To be called before iceoryx2 cleans up after dead nodes.
///
/// To clean up after a port, iceoryx2 0.10 opens its connections. It recognises an unfinished one, unless that is empty:
/// then, as root, it waits for the creator without end, even for one that was killed. A creator that lives sets the size
/// itself.
pub(crate) fn fill_empty_connections(layout: &Layout) {
    let connections = layout.memory().filter(|path| is_connection(path));
    for path in connections.filter(|path| path.metadata().is_ok_and(|state| state.len() == 0)) {
        // A connection that cannot be opened is gone, or complete by now.
        let _ = OpenOptions::new().write(true).open(path).and_then(|file| file.set_len(1));
    }
}

fn remove_if(path: &Path, condition: impl FnOnce(&Path, &Metadata) -> bool) {
    if path.symlink_metadata().is_ok_and(|state| state.is_file() && condition(path, &state)) {
        // A file that cannot be removed is gone already, or this user cannot open it anyway.
        let _ = std::fs::remove_file(path);
    }
}

/// Removes old nodes that were never finished, and old unfinished tags of the others, which iceoryx2 overlooks when it
/// removes the rest of a dead node; returns the ids of the ports of all finished nodes.
///
/// iceoryx2 first makes a folder `<id>` with the details of a node and the tags of its ports, then files `*_<id>.*`, and
/// makes the context, one of them, readable last.
fn remove_unfinished_nodes(nodes: &Path) -> HashSet<String> {
    let kind = |suffix: &'static str| files(nodes).filter(move |path| has_suffix(path, suffix));
    // iceoryx2 removes the monitor of a node before its context: a process killed in between leaves a context that nobody
    // looks at. Where nothing came or went lately, nobody is removing.
    let calm = nodes.symlink_metadata().is_ok_and(|state| is_old(&state));
    let monitored: HashSet<_> = kind("node_monitor").filter_map(|path| id(&path)).collect();
    let finished: HashSet<_> = kind("node_monitor_context")
        .filter(|path| path.metadata().is_ok_and(|state| is_readable(&state)))
        .filter_map(|path| id(&path))
        .filter(|id| monitored.contains(id) || !calm)
        .collect();
    let mut ports = HashSet::new();
    for path in files(nodes) {
        let Some(node) = id(&path) else { continue };
        if finished.contains(&node) {
            files(&path)
                .for_each(|tag| remove_if(&tag, |_, state| is_unfinished_text(state) && is_old(state)));
            ports.extend(files(&path).filter(|tag| has_suffix(tag, "port_tag")).filter_map(|tag| id(&tag)));
        } else if path.symlink_metadata().is_ok_and(|state| is_old(&state)) {
            let _ = if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
        }
    }
    ports
}

/// Whether a file is a connection of which at least one of the two ports is not among `ports`.
fn is_without_port(path: &Path, ports: &HashSet<String>) -> bool {
    ports_of_connection(path).is_some_and(|ends| ends.iter().any(|port| !ports.contains(*port)))
}
