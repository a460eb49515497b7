//! Every fault of the plant in every mode of the daemon has the result in docs/faults.md, with the same bits in each run.
//! Torques stay within their limits throughout, and in Fault the brakes hold.

use upswing_config::FaultKind;
use upswing_ipc::Mode;
use upswing_tests::matrix::{FaultCase, PAGE, WATCHED, fault, line, mode, table};

const SECTION: &str = "In the plant";

/// Checks one column.
fn check(column: Mode) {
    let (columns, rows) = table(PAGE, SECTION);
    let index = columns.iter().position(|name| mode(name) == column).expect("a column of the mode");
    let before = FaultCase::idle(None).in_mode(column);
    let mut wrong = Vec::new();
    for row in rows {
        let fault = fault(&row.fault).and_then(|args| Ok(args.fault(&before.config.model)?));
        let fault = fault.unwrap_or_else(|e| panic!("{}: {e}", row.fault));
        let run = || {
            let mut case = before.clone();
            case.break_now(fault);
            case.run(WATCHED);
            (case.outcome(), *case.system.plant.position(), *case.system.plant.velocity())
        };
        let once = run();
        assert_eq!(run(), once, "{} in {column}: the same again", row.fault);
        if once.0 != row.outcomes[index] {
            wrong.push(format!("`{}`: {} (the page says: {})", row.fault, once.0, row.outcomes[index]));
        }
    }
    assert!(wrong.is_empty(), "outcomes in {column}:\n{}", wrong.join("\n"));
}

upswing_tests::in_each_mode!(check);

#[test]
fn the_table_is_complete_and_canonical() {
    let (columns, rows) = table(PAGE, SECTION);
    assert_eq!(columns.iter().map(|name| mode(name)).collect::<Vec<_>>(), Mode::ALL);
    let kinds: Vec<_> =
        rows.iter().map(|row| fault(&row.fault).unwrap_or_else(|e| panic!("{e}")).kind).collect();
    for kind in FaultKind::all() {
        assert!(kinds.contains(kind), "{kind:?} is missing");
    }
    for row in rows {
        let text = line(&row.fault, &row.outcomes);
        assert!(PAGE.lines().any(|line| line == text), "write the row as\n{text}");
    }
}
