//! The live page answers only requests addressed to an IP address or to localhost, accepts operator's requests only with
//! its token, never from another site, and offers them only on this machine.

mod common;

use common::Place;
use proptest::prelude::*;
use serde_json::Value;
use std::io::{Read, Write};
use std::net::TcpStream;
use upswing_view::web::{RequestHead, Token, check};

/// Status and body of the answer to a request with these headers.
fn ask(begun: &Value, line: &str, headers: &[(&str, &str)]) -> (u16, String) {
    let url = begun["url"].as_str().expect("a url");
    let address = url.trim_start_matches("http://").trim_end_matches('/');
    let mut stream = TcpStream::connect(address).expect("it listens");
    let host = if headers.iter().any(|(name, _)| *name == "Host") {
        String::new()
    } else {
        format!("Host: {address}\r\n")
    };
    let headers: String = headers.iter().map(|(name, value)| format!("{name}: {value}\r\n")).collect();
    let request = format!("{line} HTTP/1.1\r\n{host}{headers}Connection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).expect("sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("text");
    let status = answer.split(' ').nth(1).and_then(|s| s.parse().ok()).unwrap_or_else(|| panic!("{answer}"));
    (status, answer)
}

#[test]
fn over_http() {
    let place = Place::new();
    let (running, begun) = place.begin(&["monitor", "--web", "127.0.0.1:0", "--allow-control", "--json"]);
    let token = format!("Bearer {}", begun["token"].as_str().expect("a token"));
    let origin = begun["url"].as_str().expect("a url").trim_end_matches('/');
    let (status, page) = ask(&begun, "GET /", &[]);
    assert!(status == 200 && page.contains("Content-Security-Policy: default-src 'none'"), "{page}");
    assert!(!page.contains(begun["token"].as_str().expect("a token")), "the page itself tells the token");
    for line in ["GET /?from=bookmark", "HEAD /", "HEAD /events", "HEAD /events/?x"] {
        let (status, answer) = ask(&begun, line, &[]);
        let body = answer.split_once("\r\n\r\n").expect("a head").1;
        assert!(status == 200 && body.is_empty() == line.starts_with("HEAD"), "{line}: {answer}");
    }
    let post = "POST /request/enable";
    for (line, headers, expected) in [
        ("GET /", vec![("Host", "rebound.example")], 403),
        ("GET /events", vec![("Host", "localhost.rebound.example:80")], 403),
        ("GET /no", vec![], 404),
        ("PUT /", vec![], 405),
        ("OPTIONS /request/enable", vec![("Origin", "http://other.example")], 405),
        (post, vec![], 401),
        (post, vec![("Authorization", "Bearer 0123456789abcdef0123456789abcdef")], 401),
        (post, vec![("Authorization", &token), ("Origin", "http://other.example")], 403),
        (post, vec![("Authorization", &token), ("Origin", "null")], 403),
        (post, vec![("Authorization", &token), ("Host", "rebound.example")], 403),
        (post, vec![("Authorization", &token), ("Authorization", &token)], 401),
        ("POST /request/fly", vec![("Authorization", &token)], 404),
        (post, vec![("Authorization", &token), ("Content-Length", "99999999999999")], 413),
        // Heard, but nobody is there to obey.
        (post, vec![("Authorization", &token)], 409),
        (post, vec![("Authorization", &token), ("Origin", origin)], 409),
        ("POST /request/enable/?x", vec![("Authorization", &token)], 409),
    ] {
        let (status, answer) = ask(&begun, line, &headers);
        assert_eq!(status, expected, "{line} {headers:?}: {answer}");
    }
    assert!(running.end().success());
}

#[test]
fn read_only_unless_asked_for() {
    let place = Place::new();
    let (running, begun) = place.begin(&["monitor", "--web", "127.0.0.1:0", "--json"]);
    assert_eq!(begun["token"], Value::Null);
    let (status, answer) = ask(&begun, "POST /request/enable", &[("Authorization", "Bearer x")]);
    assert!(status == 403 && answer.contains("read-only"), "{answer}");
    drop(running);
    let far = place.command(&["monitor", "--web", "0.0.0.0:0", "--allow-control"]).output().expect("it runs");
    let stderr = String::from_utf8_lossy(&far.stderr);
    assert!(far.status.code() == Some(2) && stderr.contains("127.0.0.1"), "{stderr}");
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(2000) })]

    #[test]
    fn nobody_guesses(
        host in prop::option::of("[a-z0-9.:\\[\\]]{0,20}|localhost:80|127.0.0.1:80"),
        origin in prop::option::of("[ -~]{0,20}|http://localhost:80"),
        authorization in prop::option::of("(Bearer )?[0-9a-f]{0,33}"),
    ) {
        let token = Token::new().expect("random numbers");
        let head = RequestHead {
            get: false,
            post: true,
            host: host.as_deref(),
            origin: origin.as_deref(),
            authorization: authorization.as_deref(),
        };
        prop_assert!(check(&head, Some(&token)).is_err());
        let own = format!("Bearer {}", token.text());
        let head = RequestHead { authorization: Some(&own), ..head };
        let from_here = origin.is_none() || origin == host.as_ref().map(|h| format!("http://{h}"));
        let name = host.as_deref().unwrap_or("").trim_end_matches(":80");
        let by_number = name == "localhost" || host.as_deref().is_some_and(|h| {
            h.parse::<std::net::IpAddr>().is_ok() || h.parse::<std::net::SocketAddr>().is_ok()
        });
        let by_name = host.as_deref().is_some_and(|h| h.split(':').next() == Some("localhost") && h.matches(':').count() < 2);
        prop_assert_eq!(check(&head, Some(&token)).is_ok(), from_here && (by_number || by_name));
    }
}
