//! The overview of a database counts every record once, and its worst certificate bounds that of every entry.

use upswing_config::Config;
use upswing_planner::database::{DatabaseFile, DatabaseOverview};

#[test]
fn of_the_shipped_database() {
    let config = Config::embedded().expect("embedded settings");
    let file = DatabaseFile::of(&config, 0).expect("a file").expect("the shipped database");
    let database = file.load().expect("a database");
    let overview = DatabaseOverview::of(&database, &config.model).expect("whole");
    assert_eq!(overview.entries, database.entries());
    assert_eq!(overview.entries + overview.rejected + overview.failed, database.len());
    assert!(overview.joints.len() >= 2);
    for joint in &overview.joints {
        assert!(joint.positions.is_sorted());
        assert_eq!(joint.entries.iter().sum::<usize>(), overview.entries, "joint {}", joint.joint);
    }
    let sums: Vec<usize> = overview.map.iter().map(|row| row.iter().sum()).collect();
    assert_eq!(sums, overview.joints[overview.joints.len() - 2].entries);
    let worst = overview.worst;
    for entry in (0..database.entries()).map(|entry| database.entry(entry).expect("whole")) {
        let c = &entry.certificate;
        assert!(worst.cost >= c.cost && worst.defect >= c.defect && worst.end_error >= c.end_error);
        assert!(
            worst.margin_q <= c.margin_q
                && worst.margin_qd <= c.margin_qd
                && worst.margin_tau <= c.margin_tau
        );
        assert!(overview.t_f.0 <= entry.trajectory.t_f && entry.trajectory.t_f <= overview.t_f.1);
    }
}
