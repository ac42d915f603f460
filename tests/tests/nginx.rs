//! A stock nginx in front of the server, with the configuration of `docs/nginx.conf`.

use escarp_client::app::headless::Driver;
use escarp_client::remote::RemoteTerrain;
use escarp_proto::geometry::PageId;
use escarp_server::{Catalog, Limits, PageSource};
use escarp_tests::drive::{settle, view_over};
use escarp_tests::host::{Host, MEMORY, PATIENCE};
use escarp_tests::nginx::Nginx;
use escarp_tests::terrain::{TempDataset, cliff, hills};
use flate2::read::GzDecoder;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::{Duration, Instant};

const CONFIG: &str = include_str!("../../docs/nginx.conf");

/// A server of one dataset, `moon`, and nginx before it.
struct Cached {
    data: TempDataset,
    catalog: Arc<Catalog>,
    nginx: Nginx,
    _host: Host,
}

impl Cached {
    fn start() -> Cached {
        let data = TempDataset::of(230, 190, hills);
        let catalog = Arc::new(Catalog::default());
        catalog.add("moon", Arc::new(data.open())).unwrap();
        let host = Host::of_catalog(0, catalog.clone(), Limits::default());
        let nginx = Nginx::start(&[], |port, folder| {
            let replaced = [
                ("127.0.0.1:8787", host.address().to_string()),
                ("listen 80;", format!("listen 127.0.0.1:{port};")),
                ("/var/cache/nginx", folder.display().to_string()),
            ];
            replaced
                .iter()
                .fold(CONFIG.to_owned(), |config, (from, to)| {
                    assert!(config.contains(from), "{from}");
                    config.replace(from, to)
                })
        });
        Cached {
            data,
            catalog,
            nginx,
            _host: host,
        }
    }

    fn ask(&self, path: &str, headers: &str) -> Answer {
        let mut stream = TcpStream::connect(("127.0.0.1", self.nginx.port())).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let text =
            format!("GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n{headers}\r\n");
        stream.write_all(text.as_bytes()).unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        let end = bytes
            .windows(4)
            .position(|four| four == b"\r\n\r\n")
            .unwrap();
        Answer {
            head: String::from_utf8(bytes[..end].to_vec()).unwrap(),
            body: bytes[end + 4..].to_vec(),
        }
    }

    /// The address of something of the current generation.
    fn address(&self, what: &str) -> String {
        let id = self.catalog.get("moon").unwrap().source().generation_id();
        format!("/moon/{id}/{what}")
    }
}

/// An answer with `Connection: close`.
struct Answer {
    head: String,
    body: Vec<u8>,
}

impl Answer {
    fn status(&self) -> u16 {
        self.head[9..12].parse().unwrap()
    }

    fn header(&self, name: &str) -> Option<&str> {
        let mut lines = self.head.lines().filter_map(|line| line.split_once(": "));
        let found = lines.find(|(key, _)| key.eq_ignore_ascii_case(name));
        found.map(|(_, value)| value)
    }

    /// Status, and whether it came from the cache.
    fn kept(&self) -> (u16, &str) {
        (self.status(), self.header("x-cache").unwrap_or("no cache"))
    }

    fn json(&self) -> serde_json::Value {
        serde_json::from_slice(&self.body).unwrap()
    }
}

#[test]
fn immutable_contents_are_fetched_once_and_then_come_from_the_cache() {
    if !Nginx::is_installed() {
        return;
    }
    let cached = Cached::start();
    let record = cached.data.dataset.record(PageId::ROOT).unwrap().unwrap();
    let pack = cached.data.dataset.pack(PageId::ROOT).unwrap().unwrap();
    for (what, bytes) in [("page/0/0/0", record.bytes), ("pack/0/0/0", &pack.bytes)] {
        let path = cached.address(what);
        let first = cached.ask(&path, "Accept-Encoding: gzip\r\n");
        assert_eq!(first.kept(), (200, "MISS"), "{}", first.head);
        assert_eq!(first.body, bytes);
        let tag = first.header("etag").unwrap().to_owned();
        for _ in 0..2 {
            // Not packed a second time.
            let again = cached.ask(&path, "Accept-Encoding: gzip\r\n");
            assert_eq!(again.kept(), (200, "HIT"));
            assert_eq!(
                (again.header("content-encoding"), &again.body[..]),
                (None, bytes)
            );
            assert_eq!(again.header("etag"), Some(tag.as_str()));
        }
        let known = cached.ask(&path, &format!("If-None-Match: {tag}\r\n"));
        assert_eq!((known.kept(), known.body.len()), ((304, "HIT"), 0));
        let part = cached.ask(&path, "Range: bytes=3-9\r\n");
        assert_eq!((part.kept(), &part.body[..]), ((206, "HIT"), &bytes[3..10]));
        let range = format!("bytes 3-9/{}", bytes.len());
        assert_eq!(part.header("content-range"), Some(range.as_str()));
        assert_eq!(part.header("access-control-allow-origin"), Some("*"));
    }
    // A part of what is not there yet.
    let path = cached.address("page/4/0/0");
    let part = cached.ask(&path, "Range: bytes=-5\r\n");
    assert_eq!(
        (part.kept(), part.body.len()),
        ((206, "MISS"), 5),
        "{}",
        part.head
    );
    assert_eq!(cached.ask(&path, "").kept(), (200, "HIT"));
    assert_eq!(cached.nginx.errors(), "");
}

#[test]
fn a_manifest_is_packed_once_for_those_who_can_unpack_it() {
    if !Nginx::is_installed() {
        return;
    }
    let cached = Cached::start();
    let path = cached.address("manifest");
    for _ in 0..2 {
        let packed = cached.ask(&path, "Accept-Encoding: gzip\r\n");
        assert_eq!(packed.header("content-encoding"), Some("gzip"));
        let tag = packed.header("etag").unwrap().to_owned();
        assert!(tag.starts_with("W/"), "{tag}");
        let known = cached.ask(&path, &format!("If-None-Match: {tag}\r\n"));
        assert_eq!(known.status(), 304);
        // nginx sends it in chunks; their frame is not unpacked here.
        assert!(packed.body.len() < cached.data.dataset.manifest_json().len());
        let start = packed
            .body
            .windows(2)
            .position(|two| two == [0x1f, 0x8b])
            .unwrap();
        let mut text = Vec::new();
        let _ = GzDecoder::new(&packed.body[start..]).read_to_end(&mut text);
        assert!(cached.data.dataset.manifest_json().starts_with(&text) && !text.is_empty());
    }
    let plain = cached.ask(&path, "");
    assert_eq!(plain.body, cached.data.dataset.manifest_json());
}

#[test]
fn a_new_generation_is_seen_when_current_is_asked_for_again_and_its_pages_hit() {
    if !Nginx::is_installed() {
        return;
    }
    let cached = Cached::start();
    let first = cached.ask("/moon/current", "");
    assert_eq!(first.kept(), (200, "MISS"));
    let old = cached.address("page/0/0/0");
    assert_eq!(cached.ask(&old, "").kept(), (200, "MISS"));
    let newer = TempDataset::of(230, 190, cliff);
    let hosted = cached.catalog.get("moon").unwrap();
    hosted.publish(Arc::new(newer.open()));
    let id = hosted.source().generation_id().to_string();
    let began = Instant::now();
    while cached.ask("/moon/current", "").json()["id"] != id {
        assert!(
            began.elapsed() < PATIENCE,
            "the old generation stays current"
        );
        std::thread::sleep(Duration::from_millis(100));
    }
    // What is kept is right for ever; what was not kept is gone.
    assert_eq!(cached.ask(&old, "").kept(), (200, "HIT"));
    let gone = cached.ask(&old.replace("page", "pack"), "");
    assert_eq!(gone.status(), 410);
    assert_eq!(gone.json()["current"]["id"], id);
    let new = cached.address("page/0/0/0");
    assert_eq!(cached.ask(&new, "").kept(), (200, "MISS"));
    assert_eq!(cached.ask(&new, "").kept(), (200, "HIT"));
    // The address without a generation is never kept.
    let record = newer.dataset.record(PageId::ROOT).unwrap().unwrap();
    for _ in 0..2 {
        let current = cached.ask("/moon/page/0/0/0", "");
        assert_eq!(
            (current.kept(), &current.body[..]),
            ((200, "MISS"), record.bytes)
        );
    }
}

#[test]
fn a_session_goes_through_it() {
    if !Nginx::is_installed() {
        return;
    }
    let cached = Cached::start();
    let url = format!("http://127.0.0.1:{}/moon", cached.nginx.port());
    let terrain = RemoteTerrain::open(url.parse().expect("an address"), MEMORY);
    let mut driver = Driver::new(terrain);
    let manifest = driver.connect(PATIENCE).expect("a session");
    assert_eq!(&*manifest, cached.data.dataset.manifest());
    let stats = settle(&mut driver, &view_over(&cached.data, 2.0));
    assert!(stats.triangles > 0 && stats.bound_px <= 2.0, "{stats:?}");
    assert_eq!(cached.nginx.errors(), "");
}
