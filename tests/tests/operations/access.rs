//! Tokens, origins, names of the server, and limits for one address.

use super::*;

#[test]
fn a_dataset_with_a_token_is_hidden_from_all_others_and_tokens_change_live() {
    let desk = Desk::new();
    let (settings, tokens) = (desk.path("escarp.toml"), desk.path("tokens"));
    fs::write(
        &settings,
        "[[access]]\ndatasets = \"de*\"\ntoken_file = \"tokens\"\n",
    )
    .unwrap();
    fs::write(&tokens, format!("{TOKEN}\n")).unwrap();
    let served = Served::start(&desk, &["--config", settings.to_str().unwrap()]);
    let bearer = |token: &str| format!("authorization: Bearer {token}\r\n");
    let (right, wrong) = (bearer(TOKEN), bearer("another-token-entirely"));
    for path in ["/", "/datasets", "/nothing", "/metrics", "/no/such/thing"] {
        let answer = served.get(path, "");
        assert!(!answer.contains("demo"), "{path}: {answer}");
    }
    assert!(served.get("/datasets", &right).contains("\"demo\""));
    for path in [
        "/demo",
        "/demo/manifest",
        "/demo/page/0/0/0",
        "/%64emo/manifest",
        "/de-is-not-there",
    ] {
        let answer = served.get(path, "");
        assert_eq!(status(&answer), "401", "{path}: {answer}");
        assert_eq!(
            header(&answer, "www-authenticate"),
            Some("Bearer realm=\"escarp\"")
        );
        assert_eq!(status(&served.get(path, &wrong)), "403", "{path}");
    }
    assert_eq!(status(&served.get("/de-is-not-there", &right)), "404");
    let page = served.get("/demo/page/0/0/0", &right);
    assert_eq!(status(&page), "200");
    let caching = header(&page, "cache-control").expect("it says who may keep it");
    assert!(
        caching.contains("private") && !caching.contains("public"),
        "{caching}"
    );
    // A token in the address is none.
    assert_eq!(
        status(&served.get(&format!("/demo?token={TOKEN}"), "")),
        "401"
    );
    let refused = |token| session(served.url(), token, None).unwrap_err();
    assert!(refused(None).contains("needs a token"), "{}", refused(None));
    assert!(refused(Some("another-token-entirely")).contains("does not open"));
    session(served.url(), Some(TOKEN), None).expect("a session");
    let bare = served.url().trim_end_matches("demo");
    assert!(session(bare, None, None).is_err());

    fs::write(&tokens, "another-token-entirely\n").unwrap();
    served.server.tell("HUP");
    served.says("rules of access, origins and hosts read again");
    wait(
        || status(&served.get("/demo", &wrong)) == "200",
        || "the new token is not taken".into(),
    );
    assert_eq!(status(&served.get("/demo", &right)), "403");
    fs::write(&tokens, "short\n").unwrap();
    served.server.tell("HUP");
    served.says("tokens:1: a token of 5 bytes");
    assert_eq!(status(&served.get("/demo", &wrong)), "200");
    let log = served.log();
    assert!(
        !log.contains(TOKEN) && !log.contains("another-token"),
        "{log}"
    );
}

#[test]
fn web_pages_may_use_what_their_origin_is_allowed() {
    let desk = Desk::new();
    let served = Served::start(&desk, &["--origin", "https://map.example"]);
    let origin = |origin: &str| format!("origin: {origin}\r\n");
    let allowed = served.get("/demo/manifest", &origin("https://map.example"));
    assert_eq!(
        header(&allowed, "access-control-allow-origin"),
        Some("https://map.example")
    );
    let other = served.get("/demo/manifest", &origin("https://else.example"));
    assert_eq!(header(&other, "access-control-allow-origin"), None);
    let upgrade = "upgrade: websocket\r\nsec-websocket-version: 13\r\n\
                   sec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n";
    let open = |origin: String| {
        let mut stream = TcpStream::connect(served.address()).unwrap();
        let host = served.address();
        let text = format!(
            "GET /session HTTP/1.1\r\nhost: {host}\r\nconnection: upgrade\r\n{upgrade}{origin}\r\n"
        );
        stream.write_all(text.as_bytes()).unwrap();
        let mut head = [0; 12];
        stream.read_exact(&mut head).unwrap();
        String::from_utf8_lossy(&head[9..]).into_owned()
    };
    assert_eq!(open(origin("https://else.example")), "403");
    assert_eq!(open(origin("https://map.example")), "101");
    assert_eq!(open(origin(&format!("http://{}", served.address()))), "101");
    assert_eq!(open(String::new()), "101");
}

#[test]
fn a_name_that_was_led_to_this_machine_is_no_name_of_the_server() {
    let desk = Desk::new();
    let ask = |served: &Served, path: &str, host: &str| {
        let mut stream = TcpStream::connect(served.address()).unwrap();
        let text = format!("GET {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n");
        stream.write_all(text.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        status(&answer).to_owned()
    };
    let served = Served::start(&desk, &[]);
    for path in [
        "/",
        "/demo",
        "/demo/manifest",
        "/session",
        "/metrics",
        "/healthz",
    ] {
        assert_eq!(ask(&served, path, "evil.example"), "421", "{path}");
        assert_eq!(ask(&served, path, "evil.example:8787"), "421", "{path}");
    }
    for host in ["localhost:1", "127.0.0.1", "[::1]:80"] {
        assert_eq!(ask(&served, "/demo/manifest", host), "200", "{host}");
    }
    let named = Served::start(&desk, &["--host", "map.example"]);
    assert_eq!(ask(&named, "/demo/manifest", "map.example:80"), "200");
    assert_eq!(ask(&named, "/demo/manifest", "evil.example"), "421");
    let proxied = Served::start(&desk, &["--trusted-proxy", "127.0.0.1"]);
    assert_eq!(ask(&proxied, "/demo/manifest", "any.example"), "200");
}

#[test]
fn one_address_cannot_take_everything_and_a_trusted_proxy_is_told_apart() {
    let desk = Desk::new();
    let limits = [
        "--limit-loopback=true",
        "--trusted-proxy",
        "127.0.0.1",
        "--limit",
        "requests_per_second_per_address=1",
        "--limit",
        "request_burst_per_address=5",
        "--limit",
        "sessions_per_address=1",
    ];
    let served = Served::start(&desk, &limits);
    let from = |ip: &str| format!("x-forwarded-for: {ip}\r\n");
    let answers: Vec<_> = (0..8)
        .map(|_| served.get("/datasets", &from("192.0.2.1")))
        .collect();
    let refused = answers
        .iter()
        .find(|answer| status(answer) == "429")
        .expect("a refusal");
    let after: u64 = header(refused, "retry-after")
        .expect("when to come")
        .parse()
        .expect("seconds");
    assert!((1..=2).contains(&after));
    assert!(
        answers
            .iter()
            .filter(|answer| status(answer) == "200")
            .count()
            >= 5
    );
    assert_eq!(status(&served.get("/datasets", &from("192.0.2.2"))), "200");
    // Those who ask how the server is are always answered.
    for _ in 0..20 {
        assert_eq!(status(&served.get("/healthz", &from("192.0.2.1"))), "200");
    }
    let metrics = samples(&served.get("/metrics", &from("192.0.2.3")));
    assert!(metrics["escarp_limited_total{what=\"request\"}"] >= 1.0);
}
