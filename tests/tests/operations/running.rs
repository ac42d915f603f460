//! Settings, descriptors, the way out, and systemd.

use super::*;
use std::sync::{Arc, Mutex};

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
    let wrong = check(&desk, &["--config", &settings]);
    assert_eq!(wrong.code, Some(2));
    assert!(
        wrong.err.contains("unknown field `drain`") && wrong.err.contains("line 1"),
        "{wrong:?}"
    );
}

#[test]
fn a_check_of_the_settings_finds_what_would_not_start() {
    let desk = Desk::new();
    let right = check(&desk, &["--listen", "192.0.2.1:80"]);
    assert_eq!(right.ok(), "the settings are right; datasets: 1\n");
    let alone = run("escarp-server", &["--check-config"]);
    assert!(
        alone.code == Some(2) && alone.err.contains("no dataset to host"),
        "{alone:?}"
    );
    let missing = desk.name("missing.escarp");
    // Another folder, and the same name.
    let twice = desk.name("other/demo.escarp");
    fs::create_dir(desk.path("other")).unwrap();
    std::os::unix::fs::symlink(dataset(&desk), &twice).unwrap();
    fs::create_dir(desk.path("broken.escarp")).unwrap();
    fs::write(desk.path("broken.escarp/CURRENT"), "rubbish").unwrap();
    let broken = desk.name("broken.escarp");
    for (arguments, code, text) in [
        (&[missing.as_str()][..], 1, "missing.escarp"),
        (&[broken.as_str()], 1, "broken.escarp"),
        (&[twice.as_str()], 2, "two datasets are named"),
        (&["--watch", "/no/such/folder"], 1, "/no/such/folder"),
        (&["--listen", "127.0.0.1"], 2, "allowed is HOST:PORT"),
        (&["--tls-cert", "c"], 2, "without tls_key"),
    ] {
        let wrong = check(&desk, arguments);
        assert!(
            wrong.code == Some(code) && wrong.err.contains(text),
            "{wrong:?}"
        );
    }
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
