//! What is answered on the spot against what the router answers to the same.

use super::*;

/// Status, body, and the lines of the head that do not tell when or by what name.
fn told(answer: &Answer) -> (u16, Vec<String>, &[u8]) {
    let varying = ["date:", "x-request-id:"];
    let lines = answer.head.lines().map(str::to_ascii_lowercase);
    let mut lines: Vec<_> = lines
        .filter(|line| !varying.iter().any(|name| line.starts_with(name)))
        .collect();
    lines.sort();
    (answer.status, lines, &answer.body)
}

/// How many answers were given on the spot.
async fn at_once(server: &Server) -> f64 {
    let text = String::from_utf8(get(server, "/metrics").await.body).unwrap();
    let lines = text.lines();
    let counted = lines.filter(|line| {
        line.starts_with("escarp_http_requests_total{") && line.contains("route=\"at once\"")
    });
    let values = counted.filter_map(|line| line.rsplit(' ').next()?.parse::<f64>().ok());
    values.sum()
}

#[tokio::test]
async fn what_is_kept_is_answered_on_the_spot_as_the_router_answers_it() {
    let server = Server::start(Limits::default()).await;
    let id = server.source.generation_id();
    let page = PageId::new(4, 3, 9).unwrap();
    let tag = format!("\"{:08x}\"", revision(page, &server.source.stored(page)));
    let headers = [
        String::new(),
        "Range: bytes=2-5\r\n".into(),
        "Range: bytes=-3\r\n".into(),
        "Range: bytes=999999-\r\n".into(),
        format!("If-None-Match: {tag}\r\n"),
        format!("If-Match: {tag}\r\n"),
        "If-Match: \"00000000\"\r\n".into(),
        format!("If-Range: {tag}\r\nRange: bytes=0-0\r\n"),
        "Origin: https://map.example\r\n".into(),
        "Accept-Encoding: gzip\r\n".into(),
    ];
    for path in ["page/4/3/9", "pack/4/3/9", "manifest"] {
        for base in [format!("/fake/{id}"), "/fake".into()] {
            let path = format!("{base}/{path}");
            // Read by the first who asks.
            get(&server, &path).await;
            for (method, more) in ["GET", "HEAD"]
                .iter()
                .flat_map(|m| headers.iter().map(move |h| (m, h)))
            {
                let before = at_once(&server).await;
                let quick = request(&server, method, &path, more).await;
                assert_eq!(
                    at_once(&server).await,
                    before + 1.0,
                    "{method} {path} {more}"
                );
                let named = format!("X-Request-Id: me\r\n{more}");
                let slow = request(&server, method, &path, &named).await;
                assert_eq!(slow.header("x-request-id"), Some("me"));
                assert_eq!(told(&quick), told(&slow), "{method} {path} {more}");
            }
        }
    }
    server.stop().await;
}

#[tokio::test]
async fn nothing_is_answered_on_the_spot_of_a_generation_before() {
    let server = Server::start(Limits::default()).await;
    let old = server.source.generation_id();
    let before = get(&server, "/fake/page/4/3/9").await;
    let next = Arc::new(FakeSource::of_generation(4));
    server.catalog.get("fake").unwrap().publish(next.clone());
    assert_eq!(
        get(&server, &format!("/fake/{old}/page/4/3/9"))
            .await
            .status,
        410
    );
    let manifest = get(&server, "/fake/manifest").await;
    assert_eq!(manifest.body, next.manifest_json());
    assert_eq!(get(&server, "/fake/page/4/3/9").await.status, before.status);
    server.stop().await;
}
