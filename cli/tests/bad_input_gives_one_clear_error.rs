//! Wrong input on the command line or in a settings folder gives one line on stderr that names what is wrong, and
//! exit code 2.

mod common;

use common::upswing;
use std::path::Path;

/// Runs `upswing` and expects exit code 2 and one error line with all of `parts`.
fn refused(args: &[&str], parts: &[&str]) {
    let output = upswing(args);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{args:?}: {stderr}");
    assert!(output.stdout.is_empty(), "{args:?} printed on stdout");
    let errors: Vec<_> = stderr.lines().filter(|l| l.starts_with("error:")).collect();
    assert_eq!(errors.len(), 1, "{args:?}: {stderr}");
    for part in parts {
        assert!(stderr.contains(part), "{args:?}: expected `{part}` in: {stderr}");
    }
}

/// A copy of the settings with one file changed.
fn settings(change: impl FnOnce(&Path)) -> tempfile::TempDir {
    let dir = tempfile::tempdir().expect("a folder");
    let copy = dir.path().join("config");
    upswing_planner::export(
        &upswing_config::Config::embedded().expect("embedded settings"),
        &copy,
        Default::default(),
    )
    .expect("settings are exported");
    change(&copy);
    dir
}

fn with_settings(change: impl FnOnce(&Path), command: &[&str], parts: &[&str]) {
    let dir = settings(change);
    let path = dir.path().join("config");
    let mut args = command.to_vec();
    args.extend(["--system", path.to_str().expect("a plain path")]);
    refused(&args, parts);
}

#[test]
fn targets() {
    refused(
        &["request", "move", "--to", "joint_3=1"],
        &["--to", "`joint_1`, `joint_2`, `joint_4`", "`joint_3`"],
    );
    refused(&["request", "fly", "--to", "joint_1=1"], &["unknown manoeuvre `fly`", "`swing-up`"]);
    refused(&["request", "stop", "--to", "joint_1=1"], &["--to", "`stop` has no target"]);
    refused(&["request", "move", "--to", "joint_1"], &["joint_1=30", "`joint_1`"]);
    refused(&["request", &"n".repeat(33)], &["no name of a manoeuvre", "32 bytes"]);
    let start = ["--start", "0,-15,0,-95,0,10,0", "--manoeuvre"];
    for command in ["plan", "optimize"] {
        let with = |more: &[&str], parts: &[&str]| refused(&[&[command], &start[..], more].concat(), parts);
        with(&["fly"], &["unknown manoeuvre `fly`"]);
        with(&["swing-up", "--to", "joint_1=1"], &["joints none", "`joint_1`"]);
        with(&["move", "--to", "joint_1=200"], &["--to", "`joint_1`", "expected -1", "got 200.000 deg"]);
        with(&["move", "--to", "joint_1=1", "joint_1=2"], &["--to", "`joint_1` twice"]);
    }
    let leaning = ["plan", "--start", "0,-15,0,-95,0,20,0", "--manoeuvre", "carry"];
    refused(&leaning, &["--start", "cannot stand"]);
    with_settings(
        |d| std::fs::remove_file(d.join("move.bin")).expect("removed"),
        &["db", "info", "--manoeuvre", "move"],
        &["no database of `move`", "db build --manoeuvre move"],
    );
    refused(&["db", "build", "--manoeuvre", "swing-down"], &["`swing-up`", "backwards"]);
}

#[test]
fn plans_of_others() {
    let dir = tempfile::tempdir().expect("a folder");
    let file = dir.path().join("plans.json");
    let name = file.to_str().expect("a plain path");
    let run = ["montecarlo", "closed-loop", "--system", "cart-pole", "--samples", "1", "--plans"];
    let with = |text: &str, parts: &[&str]| {
        std::fs::write(&file, text).expect("written");
        refused(&[&run[..], &[name]].concat(), &[&[name], parts].concat());
    };
    refused(&[&run[..], &["no-such.json"]].concat(), &["no-such.json", "No such file"]);
    with("not JSON", &["plan 0", "expected JSON documents", "`upswing plan --json`"]);
    with(r#"null {"t_f": 1}"#, &["plan 1", "missing field `u`"]);
    with("", &["expected a plan for each of 1 starts", "got 0"]);
    with(r#"{"t_f": 1, "u": [[0]]}"#, &["plan 0: expected rows `x`"]);
    with(r#"{"t_f": 1, "u": [[0]], "x": [[0, 0, 0, 0]]}"#, &["plan 0: expected", "knots", "got 1 and 1"]);
    let rows = |row: &str, count: usize| format!("[{}]", vec![row; count].join(", "));
    let plan = |t_f: &str, x: &str, u: &str, more: &str| {
        format!(r#"{{"t_f": {t_f}, "x": {}, "u": {}{more}}}"#, rows(x, 101), rows(u, 101))
    };
    with(&plan("-1", "[0, 0, 0, 0]", "[0]", ""), &["`t_f`: expected above 0", "got -1"]);
    with(&plan("1", "[0, 0, 0]", "[0]", ""), &["`x`, knot 0: expected 4 finite numbers"]);
    with(&plan("1", "[0, 0, 0, 0]", "[0, 1]", ""), &["`u`, knot 0: expected 1 finite numbers"]);
    with(
        &plan("1", "[0, 0, 0, 0]", "[0]", r#", "joints": ["a", "b"]"#),
        &["expected the joints cart, ", "got a, b"],
    );
    with(&plan("1", "[0, 0, 0, 0]", "[0]", r#", "t": [0, 1]"#), &["`t`: expected uniform times"]);
}

#[test]
fn benchmarks() {
    let dir = tempfile::tempdir().expect("a folder");
    let file = dir.path().join("benchmark.json");
    let name = file.to_str().expect("a plain path");
    refused(&["bench", "score", name], &[name, "No such file"]);
    std::fs::write(&file, "{}").expect("written");
    refused(&["bench", "score", name], &[name, "missing field", "`upswing bench export`"]);
    refused(&["bench", "export", name], &["FILE", "exists already", "--force"]);
    let export = ["bench", "export", name, "--force", "--system", "cart-pole", "--samples", "1"];
    refused(&[&export[..], &["--condition", "no-such"]].concat(), &["no-such"]);
    assert!(upswing(&export).status.success());
    refused(&["bench", "score", name, "--system", "furuta"], &["--system: expected cart-pole", "got furuta"]);
    let text = std::fs::read_to_string(&file).expect("read");
    let changed = |from: &str, to: &str, parts: &[&str]| {
        assert_eq!(text.matches(from).count(), 1, "{from}");
        std::fs::write(&file, text.replace(from, to)).expect("written");
        refused(&["bench", "score", name], parts);
    };
    changed(
        r#""seed": 0"#,
        r#""seed": 1"#,
        &[name, "expected start 0 of seed 1", "export the benchmark anew"],
    );
    changed(r#""system": "cart-pole""#, r#""system": "furuta""#, &[name, "expected the model", "of furuta"]);
    changed(r#""system": "cart-pole""#, r#""system": "no-such""#, &[name, "no-such"]);
}

#[test]
fn starts() {
    for command in ["demo", "plan", "optimize"] {
        refused(
            &[command, "--start", "0,-150,0,-95,0,10,0"],
            &["`joint_2`", "-120.000 to 120.000 deg", "-150.000"],
        );
        refused(&[command, "--start", "0,nan,0,-95,0,10,0"], &["`joint_2`", "NaN"]);
        refused(
            &[command, "--start", "0,-15,0,-95,0,10"],
            &["expected 7", "joint_1 in deg,joint_2 in deg", "got 6"],
        );
        refused(&[command, "--start", "0,-15,x,-95,0,10,0"], &["deg", "0,-15,0,-95,0,10,0", "`x`"]);
        refused(
            &[command, "--start", "0,0,0,-10,0,0,0"],
            &["`pendulum_2` is -80.0 deg", "-45.0 to 45.0 deg"],
        );
    }
    let plan = ["plan", "--start", "0,-15,0,-95,0,10,0", "--reference"];
    refused(&[&plan[..], &["0,-150,0,-95,0,10,0"]].concat(), &["--reference", "`joint_2`", "-150.000"]);
    refused(&[&plan[..], &["0,-15"]].concat(), &["--reference", "expected 7", "got 2"]);
}

#[test]
fn durations_and_clocks() {
    for (command, option, range) in [
        (&["demo"][..], "--seconds", "from 2 to 600"),
        (&["soak"], "--seconds", "from 1 to 604800"),
        (&["soak"], "--kills", "from 0 to 1"),
        (&["doctor"], "--seconds", "from 0 to 86400"),
        (&["record", "/nonexistent/run.mcap"], "--seconds", "from 0.001 to 604800"),
        (&["metrics", "--file", "a.prom"], "--every", "from 0.1 to 3600"),
        (&["montecarlo", "closed-loop"], "--seconds", "from 2 to 600"),
        (&["montecarlo", "robustness", "--over", "push"], "--seconds", "from 2 to 600"),
    ] {
        for value in ["nan", "inf", "-1e-9", "604801", "soon"] {
            let value = format!("{option}={value}");
            refused(&[command, &[&value]].concat(), &[option, range]);
        }
    }
    refused(&["demo", "--clock", "sundial"], &["sundial", "wall, paced, lockstep"]);
    refused(&["plan", "--start", "0,-15,0,-95,0,10,0", "--iterations", "0"], &["--iterations"]);
}

#[test]
fn scenarios_and_disturbances() {
    refused(&["demo", "--scenario", "moon"], &["`moon`", "second-arm", "ends in .toml"]);
    refused(&["plant", "--scenario", "no/moon.toml"], &["no/moon.toml: cannot be read"]);
    refused(&["disturb", "fault", "rust"], &["rust", "encoder-stuck"]);
    refused(
        &["disturb", "fault", "encoder-nan"],
        &["joint: expected one of joint_1", "pendulum_2, got none"],
    );
    refused(&["disturb", "fault", "encoder-nan", "--joint", "9"], &["pendulum_2, got `9`"]);
    refused(&["disturb", "fault", "arm-torque", "--joint", "pendulum_1"], &["joint_7, got `pendulum_1`"]);
    refused(&["disturb", "fault", "stale-time", "--joint", "joint_1"], &["expected none for this kind"]);
    refused(
        &["disturb", "fault", "delay-measurement", "--amount", "0.5"],
        &["whole number of cycles", "0.5"],
    );
    refused(&["disturb", "push", "--impulse", "1,2"], &["expected 3 numbers", "got 2"]);
    refused(&["disturb", "push", "--impulse", "1,2,inf"], &["three finite numbers", "inf"]);
    refused(&["disturb", "push", "--impulse", "-1,2,3", "--cycles", "0"], &["cycles: expected 1 or more"]);
}

#[test]
fn databases() {
    let start = ["plan", "--start", "0,-15,0,-95,0,10,0"];
    let database = |dir: &Path| dir.join("swing-up.bin");
    with_settings(
        |d| {
            let bytes = std::fs::read(database(d)).expect("read");
            std::fs::write(database(d), &bytes[..bytes.len() / 2]).expect("written");
        },
        &start,
        &["swing-up.bin", "truncated"],
    );
    with_settings(
        |d| std::fs::write(database(d), b"not a database").expect("written"),
        &["db", "info"],
        &["swing-up.bin", "not an upswing database"],
    );
}

#[test]
fn settings_files() {
    with_settings(
        |d| {
            let file = d.join("daemon.toml");
            let text = std::fs::read_to_string(&file).expect("read");
            std::fs::write(&file, text.replace("period_us", "perod_us")).expect("written");
        },
        &["config", "check"],
        &["daemon.toml", "perod_us"],
    );
    refused(&["demo", "--system", "/nonexistent"], &["/nonexistent"]);
}

#[test]
fn files_and_entries() {
    refused(&["db", "info", "/nonexistent/database.bin"], &["/nonexistent/database.bin"]);
    refused(&["db", "export", "--entry", "100000"], &["--entry", "100000"]);
}

#[test]
fn monte_carlo_runs() {
    for command in ["replan", "closed-loop"] {
        refused(&["montecarlo", command, "--samples", "0"], &["--samples", "0"]);
        refused(&["montecarlo", command, "--seed", "one"], &["--seed", "one"]);
        refused(&["montecarlo", command, "--threads", "0"], &["--threads", "0"]);
        refused(&["montecarlo", command, "--samples", "5", "--only", "1"], &["--samples", "--only"]);
        refused(&["montecarlo", command, "--grid", "fine"], &["--grid", "fine"]);
        refused(&["montecarlo", command, "--database", "/nonexistent/db.bin"], &["/nonexistent/db.bin"]);
    }
    refused(&["montecarlo", "closed-loop", "--condition", "nominal,storm"], &["storm"]);
    refused(&["montecarlo", "closed-loop", "--picture", "a.svg"], &["--only"]);
    let two =
        ["montecarlo", "closed-loop", "--only", "0", "--picture", "a.svg", "--condition", "nominal,push"];
    refused(&two, &["--picture", "one --condition", "2"]);
    refused(&["montecarlo", "replan", "--iterations", "0"], &["--iterations", "0"]);
}

#[test]
fn recordings() {
    let dir = tempfile::tempdir().expect("a folder");
    let file = dir.path().join("run.mcap");
    std::fs::write(&file, "no recording").expect("written");
    let file = file.to_str().expect("a plain path");
    refused(&["report", file], &["run.mcap", "expected an MCAP recording"]);
    refused(&["report", "/nonexistent/run.mcap"], &["/nonexistent/run.mcap"]);
    refused(&["report", file, "--from", "3", "--to", "2"], &["--from", "3 to 2"]);
    refused(&["export", file, "--csv", "a.csv", "--every", "0"], &["--every", "0"]);
    refused(&["demo", "--record", file], &["run.mcap", "not overwritten"]);
    refused(&["man", file], &["run.mcap"]);
    refused(&["completions", "dos"], &["dos", "bash"]);
}

#[test]
fn commands() {
    refused(&["swing"], &["swing"]);
    refused(&["status", "--domain", "no spaces"], &["domain"]);
}

#[test]
fn negative_numbers_after_an_option() {
    let (from, whole) = ("expected a number from ", "expected a whole number from ");
    for (command, option, expected) in [
        (&["demo"][..], "--seconds", from),
        (&["soak"], "--kills", from),
        (&["soak"], "--seed", whole),
        (&["doctor"], "--seconds", from),
        (&["record", "run.mcap"], "--seconds", from),
        (&["report", "run.mcap"], "--from", from),
        (&["export", "run.mcap", "--csv", "a.csv"], "--every", whole),
        (&["export", "run.mcap", "--csv", "a.csv"], "--to", from),
        (&["metrics", "--file", "a.prom"], "--every", from),
        (&["optimize", "--start", "0,-15,0,-95,0,10,0"], "--budget", from),
        (&["plan", "--start", "0,-15,0,-95,0,10,0"], "--iterations", whole),
        (&["model", "bound"], "--samples", whole),
        (&["model", "bound"], "--seed", whole),
        (&["db", "export"], "--entry", whole),
        (&["disturb", "push", "--impulse", "0,0,1"], "--cycles", whole),
        (&["disturb", "push", "--impulse", "0,0,1"], "--from", whole),
        (&["montecarlo", "closed-loop"], "--samples", whole),
        (&["montecarlo", "closed-loop"], "--only", whole),
        (&["montecarlo", "closed-loop"], "--threads", whole),
        (&["montecarlo", "replan"], "--seed", whole),
    ] {
        refused(&[command, &[option, "-1"]].concat(), &["'-1'", option, expected]);
    }
}
