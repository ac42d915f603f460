//! Heights over HTTP, on a small dataset made of a function.

use super::*;
use crate::heights::tests::{Made, function};
use crate::serve::Serving;
use serde_json::json;
use tokio::sync::watch;

/// A server of datasets that were made for it.
pub(super) struct Hosting {
    pub(super) address: SocketAddr,
    shutdown: oneshot::Sender<()>,
    task: JoinHandle<io::Result<()>>,
}

impl Hosting {
    pub(super) async fn start(catalog: Catalog, limits: Limits) -> Hosting {
        Hosting::of(Serving::new(Arc::new(catalog), limits)).await
    }

    pub(super) async fn of(serving: Serving) -> Hosting {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (shutdown, told) = oneshot::channel();
        let rules = watch::channel(None).1;
        let serving = serving.run(listener, rules, async {
            let _ = told.await;
        });
        Hosting {
            address,
            shutdown,
            task: tokio::spawn(serving),
        }
    }

    pub(super) async fn stop(self) {
        self.shutdown.send(()).unwrap();
        self.task.await.unwrap().unwrap();
    }

    pub(super) async fn ask(&self, method: &str, path: &str, headers: &str, body: &str) -> Answer {
        let headers = format!("{headers}Content-Length: {}\r\n", body.len());
        super::ask(self.address, &format!("{method} {path}"), &headers, body).await
    }

    pub(super) async fn get(&self, path: &str) -> Answer {
        self.ask("GET", path, "", "").await
    }
}

/// 65 x 49 samples, 10 m apart east and 20 m north, of height 3 x + y (row from the south), with a
/// hole in the north-east.
pub(super) fn ramp() -> Made {
    Made::of(&mut function([65, 49], |x, row| match x > 50 && row < 10 {
        true => f64::NAN,
        false => f64::from(3 * x + 48 - row),
    }))
}

async fn hosting(limits: Limits) -> Hosting {
    let catalog = Catalog::default();
    let made = ramp();
    catalog.add("ramp", Arc::new(made.dataset)).unwrap();
    Hosting::start(catalog, limits).await
}

#[tokio::test]
async fn a_point_is_told_with_its_bound_its_source_and_what_it_is_above() {
    let server = hosting(Limits::default()).await;
    let answer = server.get("/ramp/heights?x=500100&y=4999040").await;
    assert_eq!(answer.status, 200);
    let expected = json!({
        "dataset": "ramp", "generation": 1,
        "vertical": "EGM96 height (EPSG:5773)", "crs": "EPSG:32632",
        "coordinates": "native", "interpolation": "triangles",
        "point": [500100.0, 4999040.0],
        "height_m": 30.0, "error_m": 0.0, // On a ramp coarse samples are exact.
        "spacing_m": [160.0, 320.0],
    });
    let found = answer.json();
    for (key, value) in expected.as_object().unwrap() {
        assert_eq!(&found[key], value, "{key}");
    }
    assert_eq!(found["accuracy"]["storage_m"], 0.0);
    assert!(found["accuracy"]["scale_percent"].as_f64().unwrap() < 0.1);
    for null in ["x=500600&y=4999980", "x=0&y=0"] {
        let found = server.get(&format!("/ramp/heights?{null}")).await;
        assert_eq!(found.status, 200);
        assert_eq!(found.json()["height_m"], Value::Null);
        assert_eq!(found.json()["error_m"], Value::Null);
    }
    server.stop().await;
}

#[tokio::test]
async fn a_batch_is_answered_as_it_was_asked_and_equals_its_points() {
    let server = hosting(Limits::default()).await;
    let csv = "lon,lat\n9.001,45.15\n9.002,45.148\n8.0,45.1\n";
    let json = r#"{"points": [[9.001, 45.15], [9.002, 45.148], [8.0, 45.1]]}"#;
    let path = "/ramp/heights?crs=lonlat";
    let as_json = server.ask("POST", path, "", json).await.json();
    let kind = "Content-Type: text/csv\r\n";
    let as_csv = server.ask("POST", path, kind, csv).await;
    assert_eq!(
        as_csv.header("content-type"),
        Some("text/csv; charset=utf-8")
    );
    let lines = String::from_utf8(as_csv.body).unwrap();
    let mut lines = lines.lines();
    assert_eq!(lines.next(), Some("x,y,height_m,error_m"));
    for (i, line) in lines.enumerate() {
        let height = as_json["heights_m"][i].as_f64();
        let point: Vec<&str> = line.split(',').collect();
        assert_eq!(point[2].parse().ok(), height);
        let alone = format!("/ramp/heights?lon={}&lat={}", point[0], point[1]);
        assert_eq!(server.get(&alone).await.json()["height_m"].as_f64(), height);
        assert_eq!(height.is_none(), i == 2);
    }
    server.stop().await;
}

#[tokio::test]
async fn a_profile_runs_along_its_polyline() {
    let server = hosting(Limits::default()).await;
    let path = "/ramp/profile?points=500000,4999040;500100,4999040;500100,4999240&samples=4";
    let found = server.get(path).await.json();
    assert_eq!(found["length_m"], 300.0);
    assert_eq!(found["distances_m"], json!([0.0, 100.0, 200.0, 300.0]));
    assert_eq!(found["heights_m"], json!([0.0, 30.0, 35.0, 40.0]));
    assert_eq!(found["points"][2], json!([500100.0, 4999140.0]));
    let body = r#"{"points": [[500000,4999040],[500100,4999040],[500100,4999240]]}"#;
    let posted = server
        .ask("POST", "/ramp/profile?samples=4", "", body)
        .await;
    assert_eq!(posted.json(), found);
    server.stop().await;
}

#[tokio::test]
async fn a_line_of_sight_says_whether_how_well_and_where() {
    let server = hosting(Limits::default()).await;
    let path = "/ramp/sight?observer=500000,4999040&target=500400,4999040&observer_height=10";
    let seen = server.get(path).await.json();
    assert_eq!(
        (&seen["visible"], &seen["certain"]),
        (&json!(true), &json!(true))
    );
    assert_eq!(seen["blocked_at"], Value::Null);
    assert_eq!(seen["target"]["ground_m"], 120.0);
    assert!(
        (seen["margin_m"].as_f64().unwrap() - 0.25).abs() < 1e-9,
        "{seen}"
    );
    assert!((seen["margin_at"]["distance_m"].as_f64().unwrap() - 390.0).abs() < 1e-6);
    let hidden = server
        .get(&format!("{path}&target_height=-20"))
        .await
        .json();
    assert_eq!(
        (&hidden["visible"], &hidden["certain"]),
        (&json!(false), &json!(true))
    );
    let met = hidden["blocked_at"]["distance_m"].as_f64().unwrap();
    assert!((met - 400.0 / 3.0).abs() < 1e-6, "{met}");
    server.stop().await;
}

#[tokio::test]
async fn a_viewshed_is_a_picture_with_three_values_and_clear_where_no_data_is() {
    let server = hosting(Limits::default()).await;
    let path = "/ramp/viewshed.png?observer=500320,4999500&radius=400&size=64";
    let answer = server.get(path).await;
    assert_eq!(answer.header("content-type"), Some("image/png"));
    assert_eq!(answer.header("escarp-ground-m"), Some("119"));
    assert_eq!(answer.header("escarp-spacing-m"), Some("10,20"));
    let corners = answer.header("escarp-corners").unwrap();
    let corners: Vec<f64> = corners.split(',').map(|v| v.parse().unwrap()).collect();
    for (found, expected) in corners
        .iter()
        .zip([499920.0, 4999100.0, 500720.0, 4999900.0])
    {
        assert!((found - expected).abs() < 1e-6);
    }
    let picture = image::load_from_memory(&answer.body)
        .unwrap()
        .into_luma_alpha8();
    assert_eq!(picture.dimensions(), (64, 64));
    assert_eq!(picture.get_pixel(0, 0).0, [0, 0]);
    // A plane is seen from above it everywhere.
    assert_eq!(picture.get_pixel(10, 40).0, [255, 255]);
    server.stop().await;
}

#[tokio::test]
async fn what_cannot_be_answered_is_refused_with_what_is_allowed() {
    let limits = Limits {
        heights: crate::heights::HeightLimits {
            batch_points: 2,
            viewshed_steps: 100,
            ..Default::default()
        },
        ..Limits::default()
    };
    let server = hosting(limits).await;
    let viewshed = "/ramp/viewshed.png?observer=500320,4999500";
    for (status, path) in [
        (404, "/mars/heights?x=1&y=2".into()),
        (400, "/ramp/heights".into()),
        (400, "/ramp/heights?x=1".into()),
        (400, "/ramp/heights?x=1&y=2&lon=3&lat=4".into()),
        (400, "/ramp/heights?x=1&y=two".into()),
        (400, "/ramp/heights?x=1&y=inf".into()),
        (400, "/ramp/heights?x=1&x=1&y=2".into()),
        (400, "/ramp/heights?x=1&y=2&colour=red".into()),
        (400, "/ramp/heights?x=1&y=2&error=-1".into()),
        (400, "/ramp/heights?x=1&y=2&error=1&resolution=1".into()),
        (400, "/ramp/profile".into()),
        (400, "/ramp/profile?points=1,2".into()),
        (400, "/ramp/profile?points=1,2;3,4&samples=1000000".into()),
        (400, "/ramp/profile?points=1,2;3,4&samples=-1".into()),
        (400, "/ramp/profile?points=1,2;3&crs=utm".into()),
        (400, "/ramp/sight?observer=500000,4999040".into()),
        (400, "/ramp/sight?observer=500000,4999040&target=0,0".into()),
        (
            400,
            "/ramp/sight?observer=500000,4999040&target=500600,4999980".into(),
        ),
        (400, format!("{viewshed}&radius=0")),
        (400, format!("{viewshed}&radius=100&size=100000")),
        (400, format!("{viewshed}&radius=100&curvature=maybe")),
        (422, format!("{viewshed}&radius=300&size=64")),
    ] {
        let answer = server.get(&path).await;
        assert_eq!(answer.status, status, "{path}");
        let problem = answer.json();
        assert!(!problem["error"].as_str().unwrap().is_empty());
        assert!(
            !problem["allowed"][0].as_str().unwrap().is_empty(),
            "{path}"
        );
    }
    for (status, body) in [
        (400, r#"{"points": [[1,2],[1,2],[1,2]]}"#.to_owned()),
        (400, "x".to_owned()),
        (413, " ".repeat(2000)),
    ] {
        let answer = server.ask("POST", "/ramp/heights", "", &body).await;
        assert_eq!(answer.status, status);
        assert!(answer.json()["allowed"][0].as_str().is_some());
    }
    // What says that it will be too long is refused before any of it comes.
    for path in ["/ramp/heights", "/ramp/profile"] {
        let long = "Content-Length: 1000000000000\r\n";
        let answer = super::ask(server.address, &format!("POST {path}"), long, "").await;
        assert_eq!(answer.status, 413);
        let error = answer.json()["error"].to_string();
        assert!(error.contains("1000000000000 bytes"), "{error}");
    }
    let answer = server.ask("PUT", "/ramp/heights", "", "").await;
    assert_eq!(
        (answer.status, answer.header("allow")),
        (405, Some("GET, HEAD, POST, OPTIONS"))
    );
    server.stop().await;
}

#[tokio::test]
async fn damaged_pages_are_named_and_end_nothing_else() {
    let server = Server::start(Limits::default()).await;
    let hosting = Hosting {
        address: server.address,
        shutdown: oneshot::channel().0,
        task: tokio::spawn(async { Ok(()) }),
    };
    // Cells of page 4/13/0 are stored nowhere, of 4/14/0 damaged, of 4/15/0 rubbish.
    for column in [13, 14, 15] {
        let x = (f64::from(column) + 0.5) * 256.0 * 30.0;
        let answer = hosting.get(&format!("/fake/heights?x={x}&y=100")).await;
        assert_eq!(answer.status, 500);
        let error = answer.json()["error"].as_str().unwrap().to_owned();
        assert!(error.contains(&format!("4/{column}/0")), "{error}");
    }
    assert_eq!(hosting.get("/fake/heights?x=10&y=10").await.status, 200);
    server.stop().await;
}
