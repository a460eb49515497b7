//! The metrics are OpenMetrics for the official parser, and for the older text format of node_exporter's collector; the
//! dashboard asks for nothing else; the file is complete whenever it is read and gone in the end.

mod common;

use common::{Place, python, run};
use serde_json::Value;
use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;

/// What the specification asks for, in our own words: each sample belongs to the family before it, has its suffix and a
/// number, and the text ends.
fn check(text: &str) -> BTreeSet<String> {
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines.last(), Some(&"# EOF"));
    let (mut family, mut kind) = (String::new(), String::new());
    let mut names = BTreeSet::new();
    let mut families = BTreeSet::new();
    for line in &lines[..lines.len() - 1] {
        let words: Vec<&str> = line.splitn(4, ' ').collect();
        match words.as_slice() {
            ["#", "TYPE", name, of] => {
                assert!(families.insert((*name).to_owned()), "{name} comes twice");
                (family, kind) = ((*name).to_owned(), (*of).to_owned());
            }
            ["#", "UNIT", name, of] => {
                assert!(*name == family && name.ends_with(&format!("_{of}")), "{line}");
            }
            ["#", "HELP", name, text] => assert!(*name == family && !text.is_empty(), "{line}"),
            _ => {
                let (name, value) = line.rsplit_once(' ').expect("a value");
                let name = name.split('{').next().expect("a name");
                assert!(value.parse::<f64>().is_ok(), "{line}");
                let suffix = name.strip_prefix(&family).unwrap_or_else(|| panic!("{line} after {family}"));
                let expected: &[&str] = match kind.as_str() {
                    "counter" => &["_total"],
                    "summary" => &["", "_count"],
                    _ => &[""],
                };
                assert!(expected.contains(&suffix), "{kind} {line}");
                names.insert(name.to_owned());
            }
        }
    }
    names
}

#[test]
fn of_a_running_system() {
    let place = Place::with_system();
    let text = run(&mut place.command(&["metrics"])).unwrap_or_else(|e| panic!("{e}"));
    let names = check(&text);
    assert!(text.contains("upswing_mode{mode=\"hold\"} 1\n"), "{text}");
    assert!(text.contains("upswing_process_up{process=\"plant\"} 1\n"), "{text}");
    for name in ["upswing_cycles_total", "upswing_compute_seconds", "upswing_joint_torque_newton_meters"] {
        assert!(names.contains(name), "{name}");
    }
    let dashboard = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/grafana.json");
    let dashboard = std::fs::read_to_string(dashboard).expect("the dashboard");
    let json: Value = serde_json::from_str(&dashboard).expect("JSON");
    let queries: Vec<&str> = json["panels"]
        .as_array()
        .expect("panels")
        .iter()
        .flat_map(|panel| panel["targets"].as_array().expect("targets"))
        .map(|target| target["expr"].as_str().expect("a query"))
        .collect();
    let asked: BTreeSet<&str> = queries
        .iter()
        .flat_map(|query| query.split(|c: char| !c.is_ascii_alphanumeric() && c != '_'))
        .filter(|word| word.starts_with("upswing_"))
        .collect();
    assert!(asked.len() >= 10, "{asked:?}");
    for name in asked {
        assert!(names.contains(name), "the dashboard asks for {name}, which there is not");
    }
    let python = match python() {
        Ok(python) => python,
        Err(why) => return eprintln!("skipped: no Python with the packages needed: {why}"),
    };
    let dir = tempfile::tempdir().expect("a folder");
    let file = dir.path().join("upswing.prom");
    std::fs::write(&file, &text).expect("written");
    let script = "import sys; from prometheus_client.openmetrics import parser; from prometheus_client import parser as old
text = open(sys.argv[1]).read()
print(len(list(parser.text_string_to_metric_families(text))), len(list(old.text_string_to_metric_families(text))))";
    let read = run(Command::new(python).args(["-c", script]).arg(&file)).unwrap_or_else(|e| panic!("{e}"));
    let families = text.lines().filter(|l| l.starts_with("# TYPE")).count();
    assert!(read.starts_with(&format!("{families} ")), "{families} families, read: {read}");
}

#[test]
fn over_http_and_as_a_file() {
    let place = Place::new();
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("upswing.prom");
    let file = path.to_str().expect("a plain path");
    let args = ["metrics", "--listen", "127.0.0.1:0", "--file", file, "--every", "0.1", "--json"];
    let (running, begun) = place.begin(&args);
    let url = begun["url"].as_str().expect("a url");
    let address = url.trim_start_matches("http://").trim_end_matches("/metrics");
    let ask = |line: &str| {
        let mut stream = TcpStream::connect(address).expect("it listens");
        let request = format!("{line} HTTP/1.1\r\nHost: robot\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).expect("sent");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("text");
        let (head, body) = answer.split_once("\r\n\r\n").expect("head and body");
        (head.to_owned(), body.to_owned())
    };
    for path in ["/metrics/", "/metrics?name[]=upswing_mode", "/metrics/?x"] {
        check(&ask(&format!("GET {path}")).1);
    }
    let (head, body) = ask("HEAD /metrics");
    let length = head.split("Content-Length: ").nth(1).and_then(|rest| rest.lines().next());
    assert!(
        head.starts_with("HTTP/1.1 200") && length.is_some_and(|n| n != "0") && body.is_empty(),
        "{head}"
    );
    let (head, _) = ask("PUT /metrics");
    assert!(head.starts_with("HTTP/1.1 405") && head.contains("Allow: GET, HEAD"), "{head}");
    let (head, body) = ask("GET /metrics");
    assert!(head.contains("application/openmetrics-text; version=1.0.0; charset=utf-8"), "{head}");
    check(&body);
    assert!(body.contains("upswing_process_up{process=\"daemon\"} 0\n"), "{body}");
    // Renewed many times meanwhile, and never half of it.
    for _ in 0..200 {
        check(&std::fs::read_to_string(&path).expect("the file"));
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let others = std::fs::read_dir(dir.path()).expect("the folder").flatten();
    let others = others.filter(|f| f.file_name().to_string_lossy().ends_with(".prom")).count();
    assert_eq!(others, 1, "the collector would read a draft");
    assert!(running.end().success());
    assert!(!path.exists(), "a file that nobody renews");
}
