//! The three programs as a user runs them: files, output, pictures, signals.

use escarp_tests::programs::{Desk, ServerProcess, run};
use serde_json::Value;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

#[test]
fn a_dem_is_made_built_described_and_verified() {
    let desk = Desk::new();
    let (tif, out) = (desk.name("demo.tif"), desk.name("demo.escarp"));
    run(
        "escarp-tiles",
        &["sample", "-o", &tif, "--size", "300", "--seed", "3"],
    )
    .ok();
    let built = run("escarp-tiles", &["build", &tif, "-o", &out, "--jobs", "1"]).ok();
    assert!(built.contains("300 x 300 samples"), "{built}");
    let info = json(&run("escarp-tiles", &["info", &out, "--json"]).ok());
    assert_eq!(info["name"], "demo");
    assert_eq!(info["manifest"]["samples"], serde_json::json!([300, 300]));
    assert_eq!(info["manifest"]["sources"], serde_json::json!(["demo.tif"]));
    let text = run("escarp-tiles", &["info", &out]).ok();
    assert!(
        text.contains("300 x 300") && text.contains("demo.tif"),
        "{text}"
    );
    let verify = ["verify", &out, "--full", "--json", "--against", &tif];
    let report = json(&run("escarp-tiles", &verify).ok());
    assert_eq!(report["bounds"]["broken"], serde_json::json!([]));
    assert_eq!(report["against"]["samples"], 90_000);
    assert_eq!(report["against"]["missing"], 0);
    let largest_m = report["against"]["largest_difference_m"]
        .as_f64()
        .expect("a number");
    assert!(largest_m <= report["storage_error_m"].as_f64().expect("a number"));
    // The same again, with as many threads as it likes: the same bytes, once it may.
    let again = run("escarp-tiles", &["build", &tif, "-o", &out]);
    assert!(
        again.code == Some(1) && again.err.contains("--overwrite"),
        "{again:?}"
    );
    let other = desk.name("other.escarp");
    run("escarp-tiles", &["build", &tif, "-o", &other, "--json"]).ok();
    let segment = |folder: &str| std::fs::read(Path::new(folder).join("seg-1-0")).unwrap();
    assert!(segment(&out) == segment(&other), "two builds differ");
}

#[test]
fn verifying_against_another_dem_fails() {
    let desk = Desk::new();
    let out = desk.dataset().to_str().expect("UTF-8").to_owned();
    let other = desk.name("other.tif");
    run(
        "escarp-tiles",
        &["sample", "-o", &other, "--size", "300", "--seed", "4"],
    )
    .ok();
    let verified = run("escarp-tiles", &["verify", &out, "--against", &other]);
    assert_eq!(verified.code, Some(1), "{verified:?}");
}

/// One HTTP request, and all that is answered.
fn get(url: &str, path: &str) -> String {
    let host = url
        .strip_prefix("http://")
        .and_then(|rest| rest.split('/').next());
    let host = host.expect("an address");
    let mut stream = TcpStream::connect(host).expect("the server listens");
    write!(
        stream,
        "GET {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n"
    )
    .unwrap();
    let mut answer = String::new();
    stream
        .read_to_string(&mut answer)
        .expect("an answer in UTF-8");
    answer
}

const FLIGHT: &str = r#"{"size": [160, 90], "fps": 10, "error_px": 2, "keys": [
    {"t": 0, "eye": [501500, 5198000, 4000], "look": [501500, 5201500, 1000]},
    {"t": 1, "eye": [501500, 5199500, 2500], "look": [501500, 5201500, 1000]}]}"#;

#[test]
fn a_dataset_is_served_drawn_and_flown_and_the_server_ends_on_sigterm() {
    let desk = Desk::new();
    let server = ServerProcess::start(&[&desk.dataset()]);
    let url = server.urls[0].clone();
    assert!(
        url.starts_with("http://127.0.0.1:") && url.ends_with("/demo"),
        "{url}"
    );
    assert!(get(&url, "/healthz").starts_with("HTTP/1.1 200"));
    assert!(get(&url, "/datasets").contains("demo"));

    let picture = desk.name("demo.png");
    let said = run(
        "escarp-client",
        &["snapshot", &url, "-o", &picture, "--size", "160x90"],
    )
    .ok();
    assert!(
        said.contains("triangles") && said.contains("demo.png"),
        "{said}"
    );
    let image = image::open(&picture).expect("a picture").to_rgb8();
    assert_eq!(image.dimensions(), (160, 90));
    assert!(
        image.pixels().any(|pixel| pixel != image.get_pixel(0, 0)),
        "one colour"
    );

    let (path, frames) = (desk.name("flight.json"), desk.name("frames"));
    std::fs::write(&path, FLIGHT).unwrap();
    let fly = [
        "fly", &url, "--path", &path, "-o", &frames, "--every", "5", "--settle",
    ];
    let lines = run("escarp-client", &fly).ok();
    let lines: Vec<Value> = lines.lines().map(json).collect();
    assert!(lines.len() >= 10, "{} frames", lines.len());
    for line in &lines {
        for field in ["time_s", "triangles", "bytes", "bound_px", "update_ms"] {
            assert!(line[field].is_number(), "{field} in {line}");
        }
        for field in ["pages_wanted", "pages_in_flight", "pages_resident"] {
            assert!(line[field].is_u64(), "{field} in {line}");
        }
        assert_eq!(line["eye_m"].as_array().map(Vec::len), Some(3), "{line}");
        assert!(line["bound_px"].as_f64() <= Some(2.0), "{line}");
    }
    assert!(std::fs::read_dir(&frames).expect("the folder").count() >= 3);

    let wrong = run(
        "escarp-client",
        &["snapshot", &format!("{url}x"), "-o", &picture],
    );
    assert!(
        wrong.code == Some(1) && wrong.err.contains("demo"),
        "{wrong:?}"
    );
    let bare = url.trim_end_matches("demo");
    run(
        "escarp-client",
        &["snapshot", bare, "-o", &picture, "--size", "16x9"],
    )
    .ok();

    assert_eq!(server.end("TERM").code(), Some(0));
    let gone = run("escarp-client", &["snapshot", &url, "-o", &picture]);
    assert!(
        gone.code == Some(1) && gone.err.contains("no server listens"),
        "{gone:?}"
    );
}

#[test]
fn several_datasets_get_an_address_each_and_an_interrupt_ends_the_server() {
    let desk = Desk::new();
    let one = desk.dataset();
    let two = desk.path("second one.escarp");
    std::fs::create_dir(&two).unwrap();
    for name in escarp_tests::files::files(&one) {
        std::fs::copy(one.join(&name), two.join(&name)).unwrap();
    }
    let server = ServerProcess::start(&[&two, &one]);
    assert!(server.urls[0].ends_with("/demo"), "{:?}", server.urls);
    assert!(
        server.urls[1].ends_with("/second%20one"),
        "{:?}",
        server.urls
    );
    let picture = desk.name("two.png");
    let size = ["--size", "16x9"];
    run(
        "escarp-client",
        &[&["snapshot", &server.urls[1], "-o", &picture][..], &size].concat(),
    )
    .ok();
    let bare = server.urls[0].trim_end_matches("demo");
    let both = run("escarp-client", &["snapshot", bare, "-o", &picture]);
    assert!(
        both.code == Some(1) && both.err.contains("demo, second one"),
        "{both:?}"
    );
    assert_eq!(server.end("INT").code(), Some(0));
}
