//! What is told of a running server: metrics, health, logs.

use super::*;

#[test]
fn metrics_count_what_happens_and_may_have_an_address_of_their_own() {
    let desk = Desk::new();
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let watchers = free.local_addr().unwrap().to_string();
    drop(free);
    let served = Served::start(&desk, &["--metrics-listen", &watchers]);
    assert_eq!(status(&served.get("/metrics", "")), "404");
    let before = samples(&get(&watchers, "/metrics", ""));
    assert_eq!(before["escarp_dataset_generation{dataset=\"demo\"}"], 1.0);
    for _ in 0..3 {
        assert_eq!(status(&served.get("/demo/manifest", "")), "200");
    }
    session(served.url(), None, None).expect("a session");
    // Data at hand is counted apart from the router's routes.
    let answered = |samples: &BTreeMap<String, f64>| -> f64 {
        let counted = |name: &str| {
            name.starts_with("escarp_http_requests_total{") && name.contains("status=\"200\"")
        };
        samples
            .iter()
            .filter(|(name, _)| counted(name))
            .map(|(_, value)| value)
            .sum()
    };
    wait(
        || samples(&get(&watchers, "/metrics", ""))["escarp_sessions_open"] == 0.0,
        || "the session stays open".into(),
    );
    let after = samples(&get(&watchers, "/metrics", ""));
    assert_eq!(answered(&after) - answered(&before), 3.0);
    assert_eq!(
        after["escarp_sessions_total"] - before["escarp_sessions_total"],
        1.0
    );
    for (name, value) in before.iter().filter(|(name, _)| name.contains("_total")) {
        assert!(after[name] >= *value, "{name} fell");
    }
    for name in [
        "process_resident_memory_bytes",
        "process_open_fds",
        "process_start_time_seconds",
    ] {
        assert!(
            after.contains_key(name) || cfg!(not(target_os = "linux")),
            "{name}"
        );
    }
    let health = |url: &str| run("escarp-server", &["health", url]);
    let well = health(&format!("http://{watchers}/readyz")).ok();
    assert!(well.contains("\"ready\":true"), "{well}");
    let ill = health(&format!("http://{watchers}/nothing"));
    assert!(ill.code == Some(1) && ill.err.contains("404"), "{ill:?}");
    let other = health("ftp://localhost/readyz");
    assert!(
        other.code == Some(1) && other.err.contains("neither http:// nor https://"),
        "{other:?}"
    );
    assert_eq!(served.server.end("TERM").code(), Some(0));
    let gone = health(&format!("http://{watchers}/readyz"));
    assert!(gone.code == Some(1), "{gone:?}");
}

#[test]
fn requests_have_names_and_what_peers_say_cannot_forge_a_line_of_the_log() {
    use escarp_proto::wire::{ClientMessage, ErrorCode, PeerError};
    use futures_util::SinkExt;
    let desk = Desk::new();
    let served = Served::start(&desk, &["--log-format", "json"]);
    let named = served.get("/datasets", "x-request-id: my-request.7\r\n");
    assert_eq!(header(&named, "x-request-id"), Some("my-request.7"));
    let odd = served.get("/datasets", "x-request-id: two words\r\n");
    let made = header(&odd, "x-request-id").expect("a name");
    assert!(!made.contains(' ') && made != header(&served.get("/", ""), "x-request-id").unwrap());

    let forged = "bye\nFORGED \u{1b}[31mred\u{7}";
    let error = PeerError::new(ErrorCode::Internal, forged);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    runtime.block_on(async {
        let url = format!("ws://{}/session", served.address());
        let (mut socket, _) = tokio_tungstenite::connect_async(url)
            .await
            .expect("a session");
        let bytes = ClientMessage::Error(error).encode();
        socket
            .send(tokio_tungstenite::tungstenite::Message::binary(bytes))
            .await
            .expect("sent");
    });
    served.says("FORGED");
    let log = served.log();
    assert!(!log.contains('\u{1b}') && !log.contains('\u{7}'), "{log}");
    for line in log.lines() {
        let line: serde_json::Value =
            serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"));
        assert!(
            line["level"].is_string() && line["timestamp"].is_string(),
            "{line}"
        );
    }
    let session = log
        .lines()
        .find(|line| line.contains("FORGED"))
        .expect("the session's line");
    assert!(
        session.contains("\"session\":0") && session.contains("closed"),
        "{session}"
    );
}
