//! Certificates, keys, and who believes them.

use super::*;

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
    let health = |ca: &Path| {
        let url = format!("https://{}/readyz", served.address());
        run(
            "escarp-server",
            &["health", &url, "--ca", ca.to_str().unwrap()],
        )
    };
    let well = health(&one).ok();
    assert!(well.contains("\"ready\":true"), "{well}");
    let ill = health(&two);
    assert!(
        ill.code == Some(1) && ill.err.contains("certificate"),
        "{ill:?}"
    );
    let empty = health(&desk.path("one.key"));
    assert!(
        empty.code == Some(1) && empty.err.contains("no certificates in PEM"),
        "{empty:?}"
    );
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
        let ran = check(&desk, &["--tls-cert", &cert, "--tls-key", &key]);
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
    let right = check(&desk, &["--tls-cert", &cert, "--tls-key", &key]);
    assert_eq!(right.ok(), "the settings are right; datasets: 1\n");
}
