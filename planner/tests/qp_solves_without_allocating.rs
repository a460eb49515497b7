//! Once the memory of the structured back end fits the number of target rows, a solve allocates nothing.

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering};
use upswing_config::{Config, QpBackend};
use upswing_model::Workspace;
use upswing_planner::offline::problem;
use upswing_planner::qp::{Options, Solver, Status};
use upswing_planner::replan::Planner;
use upswing_trajectory::N;

struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: all calls go to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::SeqCst);
        // SAFETY: the caller's promise is the one that the system's allocator asks for.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The only test of this file: another thread would be counted, too.
#[test]
fn after_the_first_one() {
    let planner = Planner::new(Config::embedded().expect("embedded settings")).expect("a database");
    let qp = |entry: usize| {
        let (reference, start) =
            (&planner.entries()[entry].trajectory, planner.entries()[entry + 1].trajectory.x[0]);
        planner.qp(&problem(planner.config(), start), reference, reference, &mut Workspace::default())
    };
    let (first, second) = (qp(40), qp(41));
    let mut solver = Solver::new(QpBackend::Structured, N);
    let options = Options::new(1e-9);
    let before = ALLOCATIONS.load(Ordering::SeqCst);
    assert_eq!(solver.solve(&first, &options), Status::Solved);
    let counted = ALLOCATIONS.load(Ordering::SeqCst);
    assert!(counted > before, "the counter counts");
    assert_eq!(solver.solve(&second, &options), Status::Solved);
    assert_eq!(solver.solve_again(&second, &options), Status::Solved);
    assert_eq!(ALLOCATIONS.load(Ordering::SeqCst), counted);
}
