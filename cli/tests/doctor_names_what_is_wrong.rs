//! Each check of the doctor fires, with a remedy, on a host that fails it, and none fires on a suitable host.

mod common;

use common::json;
use std::path::Path;
use upswing::commands::doctor::Grade;
use upswing::commands::doctor::host::Host;

const GROUP: &str = "sys/fs/cgroup/cpu/service/cpu.rt_runtime_us";

/// Files of a host that is as it should be for a thread on CPU 3.
const FIT: [(&str, &str); 8] = [
    ("proc/sys/kernel/osrelease", "6.12-rt\n"),
    ("sys/kernel/realtime", "1\n"),
    ("proc/sys/kernel/sched_rt_runtime_us", "950000\n"),
    ("proc/sys/kernel/sched_rt_period_us", "1000000\n"),
    ("proc/self/cgroup", "5:cpu,cpuacct:/service\n0::/service\n"),
    (GROUP, "950000\n"),
    ("sys/devices/system/cpu/cpu3/cpufreq/scaling_governor", "performance\n"),
    ("sys/devices/system/cpu/isolated", "0,2-3\n"),
];

/// The findings that are not good, on a fit host with one file changed.
fn complaints(change: Option<(&str, &str)>, cpu: Option<usize>) -> Vec<(&'static str, Grade, String)> {
    let root = tempfile::tempdir().expect("a folder");
    let changed = FIT.into_iter().filter(|(path, _)| change.is_none_or(|(other, _)| other != *path));
    for (path, text) in changed.chain(change) {
        let path = root.path().join(path);
        std::fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        std::fs::write(path, text).expect("written");
    }
    let findings = Host::at(root.path()).findings(cpu);
    assert!(findings.iter().all(|f| f.fix.is_empty() == (f.grade == Grade::Good)), "{findings:?}");
    findings.into_iter().filter(|f| f.grade != Grade::Good).map(|f| (f.what, f.grade, f.found)).collect()
}

#[test]
fn a_fit_host_is_fit() {
    assert_eq!(complaints(None, Some(3)), []);
    // A machine without any of the files has nothing that limits it, but no PREEMPT_RT and no CPU to spare.
    let bare = Host::at(Path::new("/nowhere")).findings(Some(0));
    let wrong: Vec<_> = bare.iter().filter(|f| f.grade != Grade::Good).map(|f| f.what).collect();
    assert_eq!(wrong, ["kernel", "CPU of its own"]);
}

#[test]
fn each_file_matters() {
    for (path, text, what, grade) in [
        ("sys/kernel/realtime", "0", "kernel", Grade::Advice),
        ("proc/sys/kernel/sched_rt_runtime_us", "0", "real-time throttling", Grade::Bad),
        ("proc/sys/kernel/sched_rt_runtime_us", "100000", "real-time throttling", Grade::Advice),
        (GROUP, "0", "control group", Grade::Bad),
        (
            "sys/devices/system/cpu/cpu3/cpufreq/scaling_governor",
            "powersave",
            "frequency governor",
            Grade::Advice,
        ),
        ("sys/devices/system/cpu/isolated", "0,4-7", "CPU of its own", Grade::Advice),
    ] {
        let got = complaints(Some((path, text)), Some(3));
        assert!(matches!(got.as_slice(), [(w, g, _)] if *w == what && *g == grade), "{path}: {got:?}");
    }
    let got = complaints(None, None);
    assert!(matches!(got.as_slice(), [("CPU of its own", Grade::Advice, _)]), "{got:?}");
}

#[test]
fn the_report_has_findings_and_a_histogram() {
    let domain = format!("doctor-{}", std::process::id());
    let (code, report) = json(&["doctor", "--seconds", "0.2", "--domain", &domain]);
    assert_eq!(code, Some(i32::from(report["verdict"] == "bad")), "{report}");
    let of = |v: &serde_json::Value| v.as_array().expect("an array").clone();
    assert!(of(&report["findings"]).len() >= 8, "{report}");
    let counted: u64 = of(&report["histogram"]).iter().map(|pair| pair[1].as_u64().expect("a count")).sum();
    assert_eq!(report["wake_us"]["count"].as_u64(), Some(counted));
    assert!(counted > 0, "{report}");
}
