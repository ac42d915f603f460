//! Manifests, pages and packs: addresses, validators, ranges, caching (RFC 9110, RFC 9111).

use super::*;
use crate::PageSource;

const IMMUTABLE: &str = "public, max-age=31536000, immutable";

/// The addresses of a source's pages, packs and manifest, with what must come from them.
fn contents(server: &Server) -> Vec<(String, String, Vec<u8>)> {
    let source = &server.source;
    let page = PageId::new(4, 3, 9).unwrap();
    let record = source.stored(page);
    let revision = format!("{:08x}", revision(page, &record));
    let pack = source.pack(page).unwrap().unwrap();
    let id = source.generation_id();
    vec![
        ("page/4/3/9".into(), revision, record),
        (
            "pack/4/3/9".into(),
            format!("{:08x}", pack.checksum),
            pack.bytes.to_vec(),
        ),
        (
            "manifest".into(),
            format!("{:08x}", id.checksum),
            source.manifest_json().to_vec(),
        ),
    ]
}

#[tokio::test]
async fn contents_have_an_immutable_address_and_one_that_is_asked_for_again() {
    let server = Server::start(Limits::default()).await;
    let id = server.source.generation_id();
    for (path, tag, bytes) in contents(&server) {
        for (base, caching) in [
            (format!("/fake/{id}"), IMMUTABLE),
            ("/fake".into(), "no-cache"),
        ] {
            let path = format!("{base}/{path}");
            let tag = format!("\"{tag}\"");
            for method in ["GET", "HEAD"] {
                let answer = request(&server, method, &path, "").await;
                assert_eq!(answer.status, 200, "{path}");
                assert_eq!(answer.header("etag"), Some(tag.as_str()));
                assert_eq!(answer.header("cache-control"), Some(caching));
                assert_eq!(answer.header("accept-ranges"), Some("bytes"));
                assert_eq!(answer.header("content-encoding"), None);
                assert_eq!(answer.header("vary"), None);
                assert!(answer.header("date").is_some());
                let length = bytes.len().to_string();
                assert_eq!(answer.header("content-length"), Some(length.as_str()));
                let body = if method == "GET" { &bytes[..] } else { &[] };
                assert_eq!(answer.body, body);
                let known = format!("Range: bytes=0-3\r\nIf-None-Match: \"0\", W/{tag}\r\n");
                let answer = request(&server, method, &path, &known).await;
                assert_eq!((answer.status, answer.body.len()), (304, 0), "{path}");
                assert_eq!(answer.header("etag"), Some(tag.as_str()));
                assert_eq!(answer.header("cache-control"), Some(caching));
                assert_eq!(answer.header("content-range"), None);
            }
        }
    }
    server.stop().await;
}

#[tokio::test]
async fn a_part_of_a_content_says_which_it_is() {
    let server = Server::start(Limits::default()).await;
    let id = server.source.generation_id();
    for (path, tag, bytes) in contents(&server) {
        let path = format!("/fake/{id}/{path}");
        let ask = async |headers: String| request(&server, "GET", &path, &headers).await;
        let length = bytes.len();
        for (asked, part) in [("3-7", 3..8), ("5-", 5..length), ("-4", length - 4..length)] {
            for condition in [String::new(), format!("If-Range: \"{tag}\"\r\n")] {
                let answer = ask(format!("Range: bytes={asked}\r\n{condition}")).await;
                assert_eq!(
                    (answer.status, &answer.body[..]),
                    (206, &bytes[part.clone()])
                );
                let range = format!("bytes {}-{}/{length}", part.start, part.end - 1);
                assert_eq!(answer.header("content-range"), Some(range.as_str()));
                assert_eq!(answer.header("etag"), Some(format!("\"{tag}\"").as_str()));
                assert_eq!(answer.header("cache-control"), Some(IMMUTABLE));
            }
        }
        let other = ask("Range: bytes=3-7\r\nIf-Range: \"0\"\r\n".into()).await;
        assert_eq!((other.status, other.body.len()), (200, length));
        let two = ask("Range: bytes=0-1,4-5\r\n".into()).await;
        assert_eq!((two.status, two.body.len()), (200, length));
        let beyond = ask(format!("Range: bytes={length}-\r\n")).await;
        assert_eq!(beyond.status, 416);
        let range = format!("bytes */{length}");
        assert_eq!(beyond.header("content-range"), Some(range.as_str()));
        assert!(beyond.json()["error"].is_string());
        let changed = ask("If-Match: \"0\"\r\n".into()).await;
        assert_eq!(changed.status, 412);
        assert_eq!(changed.header("cache-control"), Some("no-store"));
    }
    server.stop().await;
}

#[tokio::test]
async fn what_is_current_is_said_for_a_moment_and_leads_to_the_contents() {
    let server = Server::start(Limits::default()).await;
    let id = server.source.generation_id();
    let answer = get(&server, "/fake/current").await;
    assert_eq!(
        answer.header("cache-control"),
        Some("public, max-age=5, must-revalidate")
    );
    let tag = format!("\"{id}\"");
    assert_eq!(answer.header("etag"), Some(tag.as_str()));
    let current = answer.json();
    assert_eq!(current["id"], id.to_string());
    assert_eq!(current["generation"], 3);
    let manifest = get(&server, current["manifest"].as_str().unwrap()).await;
    assert_eq!(manifest.body, server.source.manifest_json());
    let page = current["page"].as_str().unwrap();
    let page = page
        .replace("{level}", "4")
        .replace("{x}", "3")
        .replace("{y}", "9");
    assert_eq!(get(&server, &page).await.status, 200);
    let known = format!("If-None-Match: {tag}\r\n");
    assert_eq!(
        request(&server, "GET", "/fake/current", &known)
            .await
            .status,
        304
    );
    server.stop().await;
}

#[tokio::test]
async fn a_new_generation_takes_over_and_the_old_addresses_are_gone() {
    let server = Server::start(Limits::default()).await;
    let old = server.source.generation_id();
    let newer = Arc::new(FakeSource::of_generation(4));
    let new = newer.generation_id();
    server.catalog.get("fake").unwrap().publish(newer);
    assert_eq!(
        get(&server, "/fake/current").await.json()["id"],
        new.to_string()
    );
    for (path, tag, bytes) in contents(&server).into_iter().take(2) {
        let answer = get(&server, &format!("/fake/{new}/{path}")).await;
        assert_eq!((answer.status, &answer.body), (200, &bytes));
        // What did not change is not sent again.
        let known = format!("If-None-Match: \"{tag}\"\r\n");
        let answer = request(&server, "GET", &format!("/fake/{path}"), &known).await;
        assert_eq!(answer.status, 304);
        let (rebuilt, later) = ("4-00000000", "5-00000000");
        let table = [
            (old.to_string(), 410),
            (rebuilt.into(), 410),
            (later.into(), 404),
            ("x".into(), 404),
        ];
        for (id, status) in table {
            let answer = get(&server, &format!("/fake/{id}/{path}")).await;
            assert_eq!(answer.status, status, "{id}");
            assert_eq!(answer.header("cache-control"), Some("no-store"));
            assert_eq!(answer.json()["current"]["id"], new.to_string());
        }
    }
    server.catalog.remove("fake").unwrap();
    assert_eq!(get(&server, "/fake/current").await.status, 404);
    assert_eq!(
        get(&server, &format!("/fake/{new}/page/4/3/9"))
            .await
            .status,
        404
    );
    server.stop().await;
}

#[tokio::test]
async fn what_is_not_stored_is_so_for_ever_but_damage_is_not() {
    let server = Server::start(Limits::default()).await;
    let id = server.source.generation_id();
    let table = [
        (format!("/fake/{id}/page/4/13/0"), 404, IMMUTABLE),
        ("/fake/page/4/13/0".into(), 404, "no-cache"),
        (format!("/fake/{id}/page/4/16/0"), 404, "no-store"),
        (format!("/fake/{id}/page/4/14/0"), 500, "no-store"),
        (format!("/fake/{id}/nothing"), 404, "no-store"),
    ];
    for (path, status, caching) in table {
        let answer = get(&server, &path).await;
        assert_eq!(answer.status, status, "{path}");
        assert_eq!(answer.header("cache-control"), Some(caching), "{path}");
        assert!(answer.json()["error"].is_string());
    }
    let damaged = get(&server, "/fake/page/4/14/0").await;
    assert!(
        !damaged.head.contains("seg-") && !damaged.json()["error"].to_string().contains("seg-")
    );
    server.stop().await;
}

#[tokio::test]
async fn pages_of_other_sites_may_read_everything_but_only_read() {
    let server = Server::start(Limits::default()).await;
    let id = server.source.generation_id();
    let paths = [
        "/fake/page/4/3/9".to_owned(),
        format!("/fake/{id}/pack/4/3/9"),
        "/fake/current".into(),
        "/datasets".into(),
        "/nothing/at/all".into(),
        format!("/fake/{id}/page/4/14/0"),
    ];
    for path in &paths {
        let origin = "Origin: https://example.org\r\n";
        let answer = request(&server, "GET", path, origin).await;
        assert_eq!(
            answer.header("access-control-allow-origin"),
            Some("*"),
            "{path}"
        );
        let seen = answer.header("access-control-expose-headers").unwrap();
        assert!(seen.contains("ETag") && seen.contains("Content-Range"));
        let asked = "Origin: https://example.org\r\nAccess-Control-Request-Method: GET\r\n\
                     Access-Control-Request-Headers: range,if-none-match,authorization\r\n";
        let answer = request(&server, "OPTIONS", path, asked).await;
        assert_eq!((answer.status, answer.body.len()), (204, 0), "{path}");
        assert_eq!(answer.header("access-control-allow-origin"), Some("*"));
        assert_eq!(answer.header("allow"), Some("GET, HEAD, OPTIONS"));
        let allowed = answer.header("access-control-allow-headers").unwrap();
        for name in ["Range", "If-None-Match", "Authorization"] {
            assert!(allowed.contains(name));
        }
        assert!(answer.header("access-control-max-age").is_some());
    }
    for method in ["POST", "PUT", "DELETE", "PATCH"] {
        let answer = request(&server, method, &paths[0], "Content-Length: 0\r\n").await;
        assert_eq!(answer.status, 405);
        assert_eq!(answer.header("allow"), Some("GET, HEAD, OPTIONS"));
        assert!(answer.json()["error"].is_string());
    }
    server.stop().await;
}

#[tokio::test]
async fn nothing_is_compressed_once_more() {
    let server = Server::start(Limits::default()).await;
    for path in [
        "/fake/page/4/3/9",
        "/fake/current",
        "/datasets",
        "/fake/manifest",
    ] {
        let headers = "Accept-Encoding: gzip, br, zstd\r\n";
        let answer = request(&server, "GET", path, headers).await;
        assert_eq!(answer.header("content-encoding"), None);
    }
    server.stop().await;
}

#[tokio::test]
async fn many_requests_go_over_one_connection() {
    let server = Server::start(Limits::default()).await;
    let record = server.source.stored(PageId::new(4, 3, 9).unwrap());
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    for _ in 0..3 {
        // All at once: they are answered in their order.
        let one = "GET /fake/page/4/3/9 HTTP/1.1\r\nHost: x\r\n\r\n";
        stream.write_all(one.repeat(20).as_bytes()).await.unwrap();
        let mut bytes = Vec::new();
        let ends = |bytes: &[u8]| bytes.windows(record.len()).filter(|w| *w == record).count();
        while ends(&bytes) < 20 {
            assert!(stream.read_buf(&mut bytes).await.unwrap() > 0);
        }
        assert!(bytes.ends_with(&record));
    }
    server.stop().await;
}
