//! The HTTP addresses.

mod at_once;
mod data;

use super::*;
use escarp_proto::geometry::PageId;
use escarp_proto::page::revision;

async fn request(server: &Server, method: &str, path: &str, headers: &str) -> Answer {
    ask(server.address, &format!("{method} {path}"), headers, "").await
}

async fn get(server: &Server, path: &str) -> Answer {
    request(server, "GET", path, "").await
}

#[tokio::test]
async fn health_and_the_front_page_say_what_is_here() {
    let server = Server::start(Limits::default()).await;
    assert_eq!(get(&server, "/healthz").await.body, b"ok\n");
    let front = String::from_utf8(get(&server, "/").await.body).unwrap();
    assert!(front.contains(&format!("http://{}/fake", server.address)));
    server.stop().await;
}

#[tokio::test]
async fn the_list_of_datasets_tells_where_and_how_large() {
    let server = Server::start(Limits::default()).await;
    let list = get(&server, "/datasets").await.json();
    let fake = &list["datasets"][0];
    assert_eq!(fake["name"], "fake");
    assert_eq!(
        fake["session_url"],
        format!("ws://{}/session", server.address)
    );
    assert_eq!(fake["samples"], serde_json::json!([4097, 4001]));
    assert_eq!(fake["extent_m"][0], serde_json::json!([0.0, 4096.0 * 30.0]));
    assert_eq!(
        fake["native"]["corners"][2],
        serde_json::json!([122880.0, 120000.0])
    );
    assert_eq!(
        (&fake["levels"], &fake["bytes"]),
        (&12.into(), &1024.into())
    );
    assert_eq!(&get(&server, "/fake").await.json(), fake);
    server.stop().await;
}

#[tokio::test]
async fn the_manifest_comes_byte_for_byte() {
    let server = Server::start(Limits::default()).await;
    let answer = get(&server, "/fake/manifest").await;
    assert_eq!(answer.header("content-type"), Some("application/json"));
    assert_eq!(answer.body, server.source.manifest_json());
    server.stop().await;
}

#[tokio::test]
async fn a_page_comes_whole_and_only_if_the_client_does_not_have_it() {
    let server = Server::start(Limits::default()).await;
    let page = PageId::new(4, 3, 9).unwrap();
    let record = server.source.stored(page);
    let tag = format!("\"{:08x}\"", revision(page, &record));
    let answer = get(&server, "/fake/page/4/3/9").await;
    assert_eq!((answer.status, &answer.body), (200, &record));
    assert_eq!(
        answer.header("content-type"),
        Some("application/octet-stream")
    );
    assert_eq!(answer.header("etag"), Some(tag.as_str()));
    let path = "/fake/page/4/3/9";
    for known in [tag.clone(), format!("\"0\", W/{tag}"), "*".into()] {
        let header = format!("If-None-Match: {known}\r\n");
        let answer = request(&server, "GET", path, &header).await;
        assert_eq!((answer.status, answer.body.len()), (304, 0));
        assert_eq!(answer.header("etag"), Some(tag.as_str()));
    }
    let other = request(&server, "GET", path, "If-None-Match: \"0\"\r\n").await;
    assert_eq!(other.status, 200);
    let head = request(&server, "HEAD", path, "").await;
    assert_eq!((head.status, head.body.len()), (200, 0));
    assert_eq!(
        head.header("content-length"),
        Some(record.len().to_string().as_str())
    );
    server.stop().await;
}

#[tokio::test]
async fn what_is_not_here_is_said_with_what_is() {
    let server = Server::start(Limits::default()).await;
    for path in [
        "/mars/manifest",
        "/mars",
        "/mars/page/0/0/0",
        "/fake/nothing",
        "/a/b/c/d/e/f",
    ] {
        let answer = get(&server, path).await;
        assert_eq!(answer.status, 404, "{path}");
        assert_eq!(
            answer.json()["datasets"],
            serde_json::json!(["fake"]),
            "{path}"
        );
    }
    let bad = [
        "3/0/0",
        "4/16/0",
        "4/0/16",
        "12/0/0",
        "-1/0/0",
        "4/x/0",
        "999/0/0",
        "4/0/4294967296",
    ];
    for page in bad {
        let answer = get(&server, &format!("/fake/page/{page}")).await;
        assert_eq!(answer.status, 404, "{page}");
        assert_eq!(answer.json()["allowed"][0], "level: 0, 4, 8", "{page}");
    }
    let answer = get(&server, "/fake/page/4/13/0").await;
    assert_eq!(answer.status, 404);
    assert!(
        answer.json()["error"]
            .as_str()
            .unwrap()
            .contains("no record is stored")
    );
    assert_eq!(get(&server, "/fake/page/4/14/0").await.status, 500);
    server.stop().await;
}

#[tokio::test]
async fn other_methods_and_plain_requests_for_sessions_are_refused_with_reasons() {
    let server = Server::start(Limits::default()).await;
    let answer = request(&server, "POST", "/datasets", "Content-Length: 0\r\n").await;
    assert_eq!(
        (answer.status, answer.header("allow")),
        (405, Some("GET, HEAD, OPTIONS"))
    );
    let answer = get(&server, "/session").await;
    assert!((400..500).contains(&answer.status));
    assert!(
        answer.json()["error"]
            .as_str()
            .unwrap()
            .contains("WebSocket")
    );
    server.stop().await;
}

#[tokio::test]
async fn what_may_change_is_to_be_asked_for_again() {
    let server = Server::start(Limits::default()).await;
    for path in ["/", "/datasets", "/fake"] {
        let answer = get(&server, path).await;
        assert_eq!(answer.header("cache-control"), Some("no-cache"), "{path}");
        assert!(answer.header("vary").is_some(), "{path}");
    }
    server.stop().await;
}

#[tokio::test]
async fn a_name_that_is_no_text_is_not_there_as_any_other() {
    let server = Server::start(Limits::default()).await;
    for path in [
        "/%ff",
        "/%ff/current",
        "/%ff/manifest",
        "/fake/page/%fe/0/0",
        "/%C3%28/heights",
    ] {
        let answer = get(&server, path).await;
        assert_eq!(answer.status, 404, "{path}");
        assert_eq!(answer.header("content-type"), Some("application/json"));
        let error = answer.json()["error"].to_string();
        assert!(error.contains("there is no "), "{error}");
    }
    server.stop().await;
}

#[tokio::test]
async fn a_header_without_end_is_cut_off() {
    let server = Server::start(Limits::default()).await;
    let mut stream = TcpStream::connect(server.address).await.unwrap();
    let _ = stream.write_all(&[b'G'; 1 << 20]).await;
    let mut answer = Vec::new();
    // A reset is as good as an answer.
    let _ = stream.read_to_end(&mut answer).await;
    assert_eq!(get(&server, "/healthz").await.status, 200);
    server.stop().await;
}
