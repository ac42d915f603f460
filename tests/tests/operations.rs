//! The server as those who run it meet it: TLS, tokens, limits, settings, metrics, logs, signals.

use escarp_client::app::headless::Driver;
use escarp_client::net::{Credentials, Url};
use escarp_client::remote::RemoteTerrain;
use escarp_tests::host::{MEMORY, PATIENCE};
use escarp_tests::programs::{Desk, ServerProcess, program, run};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

const TOKEN: &str = "a-token-of-some-length";

/// A server and its log.
struct Served {
    server: ServerProcess,
}

impl Served {
    /// Hosts the desk's dataset.
    fn start(desk: &Desk, arguments: &[&str]) -> Served {
        let mut command = program("escarp-server");
        command.args(arguments).arg(desk.dataset());
        Served::of(command)
    }

    fn of(mut command: Command) -> Served {
        command
            .args(["--listen", "127.0.0.1:0"])
            .env("RUST_LOG", "info");
        Served {
            server: ServerProcess::of(command, 1),
        }
    }

    fn url(&self) -> &str {
        &self.server.urls[0]
    }

    /// Host and port.
    fn address(&self) -> &str {
        let rest = self.url().split("://").nth(1).expect("a scheme");
        rest.split('/').next().expect("a host")
    }

    fn log(&self) -> String {
        self.server.log()
    }

    /// Waits until the log says something.
    fn says(&self, text: &str) {
        wait(
            || self.log().contains(text),
            || format!("no {text:?} in {}", self.log()),
        );
    }

    /// One request, and all that is answered.
    fn get(&self, path: &str, headers: &str) -> String {
        get(self.address(), path, headers)
    }
}

fn wait(mut is: impl FnMut() -> bool, why: impl Fn() -> String) {
    let began = Instant::now();
    while !is() {
        assert!(began.elapsed() < PATIENCE, "{}", why());
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn get(address: &str, path: &str, headers: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("the server listens");
    let text =
        format!("GET {path} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n{headers}\r\n");
    stream.write_all(text.as_bytes()).unwrap();
    let mut answer = Vec::new();
    // A connection that is refused may be reset.
    let _ = stream.read_to_end(&mut answer);
    String::from_utf8_lossy(&answer).into_owned()
}

fn status(answer: &str) -> &str {
    answer.get(9..12).unwrap_or("")
}

fn header<'a>(answer: &'a str, name: &str) -> Option<&'a str> {
    let mut lines = answer.lines().map_while(|line| {
        line.split_once(": ")
            .or((!line.is_empty()).then_some((line, "")))
    });
    lines
        .find(|(found, _)| found.eq_ignore_ascii_case(name))
        .map(|(_, value)| value)
}

/// What a client is told: the dataset's name, or why not.
fn session(url: &str, token: Option<&str>, ca: Option<&Path>) -> Result<(), String> {
    let url: Url = url.parse().expect("an address");
    let token = token.map(str::to_owned);
    let credentials = Credentials::read(None, token, ca.map(Into::into)).expect("a token");
    let mut driver = Driver::new(RemoteTerrain::open(
        url.with_credentials(credentials),
        MEMORY,
    ));
    driver
        .connect(PATIENCE)
        .map(|_| ())
        .map_err(|why| why.to_string())
}

/// An authority and a certificate of it for localhost, in files of these names; false where there
/// is no openssl.
fn certify(desk: &Desk, name: &str) -> bool {
    let openssl = |arguments: &str| {
        let ran = Command::new("openssl")
            .args(arguments.split(' '))
            .current_dir(desk.path("."))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        ran.is_ok_and(|status| status.success())
    };
    let extensions = "basicConstraints=CA:FALSE\nsubjectAltName=DNS:localhost,IP:127.0.0.1\n";
    fs::write(desk.path("extensions"), extensions).unwrap();
    let ec = "-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes";
    let made = openssl(&format!(
        "req -x509 {ec} -days 2 -subj /CN={name} -keyout {name}.ca.key -out {name}.ca"
    )) && openssl(&format!(
        "req {ec} -subj /CN=localhost -keyout {name}.key -out {name}.csr"
    )) && openssl(&format!(
        "x509 -req -in {name}.csr -CA {name}.ca -CAkey {name}.ca.key -CAcreateserial -days 2 \
             -extfile extensions -out {name}.crt"
    ));
    if !made {
        println!("skipped: openssl did not make a certificate");
    }
    made
}

#[test]
fn over_tls_the_client_believes_its_authority_alone_and_a_new_certificate_is_taken_live() {
    let desk = Desk::new();
    if !certify(&desk, "one") || !certify(&desk, "two") {
        return;
    }
    let put = |name: &str| {
        for (from, to) in [("crt", "live.crt"), ("key", "live.key")] {
            fs::copy(desk.path(&format!("{name}.{from}")), desk.path(to)).unwrap();
        }
    };
    put("one");
    let (cert, key) = (desk.name("live.crt"), desk.name("live.key"));
    let served = Served::start(&desk, &["--tls-cert", &cert, "--tls-key", &key]);
    assert!(
        served.url().starts_with("https://127.0.0.1:"),
        "{}",
        served.url()
    );
    let [one, two] = ["one.ca", "two.ca"].map(|name| desk.path(name));
    session(served.url(), None, Some(&one)).expect("a session");
    let named = served.url().replace("127.0.0.1", "localhost");
    session(&named, None, Some(&one)).expect("a session by name");
    let stranger = session(served.url(), None, Some(&two)).unwrap_err();
    assert!(
        stranger.contains("no TLS with 127.0.0.1:") && stranger.contains("--ca"),
        "{stranger}"
    );
    let plain = session(&served.url().replace("https", "http"), None, None).unwrap_err();
    assert!(plain.contains("400"), "{plain}");
    let told = served.get("/healthz", "");
    assert!(
        told.starts_with("HTTP/1.1 400 ") && told.contains("use https or wss"),
        "{told}"
    );
    // Rubbish, and silence, end without a word.
    let mut rubbish = TcpStream::connect(served.address()).unwrap();
    rubbish
        .write_all(b"\x16\x03\x01\x00\x05hello and more")
        .unwrap();
    let mut answer = Vec::new();
    let _ = rubbish.read_to_end(&mut answer);
    assert!(!answer.starts_with(b"HTTP"));
    for version in ["-tls1_2", "-tls1_3"] {
        let text = s_client(served.address(), version);
        assert!(
            text.contains("ALPN protocol: http/1.1"),
            "{version}: {text}"
        );
    }
    put("two");
    served.server.tell("HUP");
    served.says("certificate read again");
    session(served.url(), None, Some(&two)).expect("a session");
    assert!(session(served.url(), None, Some(&one)).is_err());
    // A broken file changes nothing.
    fs::write(&key, "no key\n").unwrap();
    served.server.tell("HUP");
    served.says("the old certificate stays");
    session(served.url(), None, Some(&two)).expect("a session");
    assert_eq!(served.server.end("TERM").code(), Some(0));
}

fn s_client(address: &str, version: &str) -> String {
    let ran = Command::new("openssl")
        .args([
            "s_client", "-connect", address, "-alpn", "http/1.1", version,
        ])
        .stdin(Stdio::null())
        .output();
    String::from_utf8_lossy(&ran.expect("openssl").stdout).into_owned()
}

#[test]
fn what_cannot_be_a_certificate_or_a_key_is_told_with_what_was_found() {
    let desk = Desk::new();
    if !certify(&desk, "one") {
        return;
    }
    let refused = |cert: &str, key: &str| {
        let (cert, key) = (desk.name(cert), desk.name(key));
        let ran = run(
            "escarp-server",
            &["--tls-cert", &cert, "--tls-key", &key, "--check-config"],
        );
        assert_eq!(ran.code, Some(1), "{ran:?}");
        ran.err
    };
    let said = refused("one.key", "one.key");
    assert!(
        said.contains("one.key: no CERTIFICATE in it, but PRIVATE KEY"),
        "{said}"
    );
    let said = refused("one.crt", "one.crt");
    assert!(
        said.contains("one.crt: CERTIFICATE in it; exactly one PRIVATE KEY"),
        "{said}"
    );
    let said = refused("one.crt", "one.ca.key");
    assert!(
        said.contains("one.crt with ") && said.contains("one.ca.key: "),
        "{said}"
    );
    let said = refused("missing.crt", "one.key");
    assert!(said.contains("missing.crt: No such file"), "{said}");
    let (cert, key) = (desk.name("one.crt"), desk.name("one.key"));
    let right = run(
        "escarp-server",
        &["--tls-cert", &cert, "--tls-key", &key, "--check-config"],
    );
    assert_eq!(right.ok(), "the settings are right\n");
}

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
    served.says("rules of access and origins read again");
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

/// Checks the format (OpenMetrics 1.0) line by line, and gives the samples.
fn samples(answer: &str) -> BTreeMap<String, f64> {
    let (head, body) = answer.split_once("\r\n\r\n").expect("head and body");
    assert!(
        head.to_ascii_lowercase()
            .contains("content-type: application/openmetrics-text"),
        "{head}"
    );
    let mut found = BTreeMap::new();
    let (mut families, mut current) = (BTreeSet::new(), String::new());
    for line in body.strip_suffix("# EOF\n").expect("an end").lines() {
        if let Some(help) = line.strip_prefix("# HELP ") {
            current = help.split(' ').next().expect("a name").to_owned();
            assert!(families.insert(current.clone()), "{current} comes twice");
        } else if let Some(kind) = line.strip_prefix("# TYPE ") {
            assert_eq!(kind.split(' ').next(), Some(current.as_str()));
        } else {
            let (name, value) = line.rsplit_once(' ').expect("name and value");
            assert!(name.starts_with(&current), "{line} under {current}");
            let value = value.parse().unwrap_or_else(|_| panic!("{line}"));
            assert!(
                found.insert(name.to_owned(), value).is_none(),
                "{name} comes twice"
            );
        }
    }
    found
}

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
    let secure = health("https://localhost/readyz");
    assert!(
        secure.code == Some(1) && secure.err.contains("--metrics-listen"),
        "{secure:?}"
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

#[test]
fn on_its_way_out_the_server_says_so_first_and_goes_on_for_a_while() {
    let desk = Desk::new();
    let socket = desk.path("notify");
    let mut command = program("escarp-server");
    command
        .arg(desk.dataset())
        .args(["--drain-delay-s", "2"])
        .env("NOTIFY_SOCKET", &socket)
        .env("WATCHDOG_USEC", "100000");
    let systemd = std::os::unix::net::UnixDatagram::bind(&socket).expect("a socket");
    let heard = Arc::new(Mutex::new(Vec::new()));
    let hearing = heard.clone();
    // Ends with the test's process.
    std::thread::spawn(move || {
        let mut bytes = [0; 256];
        while let Ok(count) = systemd.recv(&mut bytes) {
            let state = String::from_utf8_lossy(&bytes[..count]).into_owned();
            hearing.lock().unwrap().push(state);
        }
    });
    let hear = |wanted: &str| {
        let has = || heard.lock().unwrap().iter().any(|state| state == wanted);
        wait(has, || {
            format!("no {wanted} in {:?}", heard.lock().unwrap())
        });
    };
    let served = Served::of(command);
    hear("READY=1");
    hear("WATCHDOG=1");
    assert_eq!(status(&served.get("/readyz", "")), "200");
    served.server.tell("TERM");
    wait(
        || status(&served.get("/readyz", "")) == "503",
        || "/readyz does not turn".into(),
    );
    let ready = served.get("/readyz", "");
    assert!(ready.contains("going down"), "{ready}");
    assert_eq!(status(&served.get("/datasets", "")), "200");
    session(served.url(), None, None).expect("a session until the end");
    hear("STOPPING=1");
    wait(
        || TcpStream::connect(served.address()).is_err(),
        || "it goes on".into(),
    );
    assert_eq!(served.server.end("CONT").code(), Some(0));
}

#[cfg(target_os = "linux")]
#[test]
fn the_server_takes_the_descriptors_it_may_need_and_without_them_it_waits_quietly() {
    let desk = Desk::new();
    let dataset = desk.dataset();
    let limited = |limits: &str| {
        let server = program("escarp-server");
        let program = server.get_program().to_str().expect("UTF-8").to_owned();
        let mut command = Command::new("sh");
        let script = format!("ulimit {limits} && exec \"$0\" \"$@\"");
        command
            .args(["-c", &script, &program])
            .arg(&dataset)
            .args(["--limit", "sessions=300"]);
        command
            .args(["--limit", "connections=400"])
            .stdin(Stdio::null());
        Served::of(command)
    };
    let raised = limited("-Sn 64");
    let found = samples(&raised.get("/metrics", ""));
    assert!(
        found["process_max_fds"] >= 700.0,
        "{}",
        found["process_max_fds"]
    );
    assert!(!raised.log().contains("too few file descriptors"));
    drop(raised);

    let starved = limited("-n 96");
    starved.says("too few file descriptors");
    let log = starved.log();
    assert!(
        log.contains("allowed=96") && log.contains("needed="),
        "{log}"
    );
    let crowd: Vec<_> = (0..160)
        .map(|_| TcpStream::connect(starved.address()).unwrap())
        .collect();
    starved.says("cannot be accepted");
    // Longer than several pauses between tries: the log stays at one line of it.
    std::thread::sleep(Duration::from_millis(700));
    let lines = |text: &str| {
        starved
            .log()
            .lines()
            .filter(|line| line.contains(text))
            .count()
    };
    assert_eq!(lines("cannot be accepted"), 1, "{}", starved.log());
    drop(crowd);
    wait(
        || status(&starved.get("/datasets", "")) == "200",
        || "it does not recover".into(),
    );
    let found = samples(&starved.get("/metrics", ""));
    let failures = found["escarp_accept_failures_total"];
    assert!(
        (1.0..1000.0).contains(&failures),
        "{failures} failures: it does not pause"
    );
}

#[test]
fn settings_are_shown_with_where_they_come_from_and_wrong_ones_end_with_usage() {
    let desk = Desk::new();
    let settings = desk.name("escarp.toml");
    fs::write(
        &settings,
        "drain_delay_s = 3\n[limits]\nwanted_pages = 99\n",
    )
    .unwrap();
    let mut command = program("escarp-server");
    let ran = command
        .args(["--config", &settings, "--print-config", "--listen", "h:1"])
        .env("ESCARP_LOG_FORMAT", "json")
        .env("ESCARP_LIMIT_SESSIONS", "7")
        .output()
        .expect("it runs");
    let text = String::from_utf8(ran.stdout).expect("UTF-8");
    for (setting, source) in [
        ("listen = \"h:1\"", "command line"),
        ("log_format = \"json\"", "environment"),
        ("drain_delay_s = 3", &format!("{settings}:1")),
        ("wanted_pages = 99", &format!("{settings}:3")),
        ("sessions = 7", "environment"),
        ("idle_timeout_s = 60", "default"),
    ] {
        let line = text.lines().find(|line| line.starts_with(setting));
        let line = line.unwrap_or_else(|| panic!("no {setting} in {text}"));
        assert!(line.ends_with(&format!("# {source}")), "{line}");
    }
    fs::write(&settings, "drain = 3\n").unwrap();
    let wrong = run("escarp-server", &["--config", &settings, "--check-config"]);
    assert_eq!(wrong.code, Some(2));
    assert!(
        wrong.err.contains("unknown field `drain`") && wrong.err.contains("line 1"),
        "{wrong:?}"
    );
}

#[test]
fn the_unit_is_one_that_systemd_understands() {
    let unit = escarp_tests::programs::workspace().join("docs/escarp-server.service");
    let text = fs::read_to_string(&unit).expect("the unit");
    // The program and its user need not be on this machine.
    let desk = Desk::new();
    let copy = desk.path("escarp-server.service");
    fs::write(
        &copy,
        text.replace("/usr/local/bin/escarp-server", "/bin/true"),
    )
    .unwrap();
    let ran = Command::new("systemd-analyze")
        .arg("verify")
        .arg(&copy)
        .output();
    let Ok(ran) = ran else {
        println!("skipped: systemd-analyze is not installed");
        return;
    };
    let said = String::from_utf8_lossy(&ran.stderr);
    let about: Vec<_> = said
        .lines()
        .filter(|line| line.contains("escarp-server.service"))
        .collect();
    assert!(about.is_empty(), "{said}");
}
