//! Server and client in one process, over loopback: convergence, names, wrong addresses.

use escarp_client::app::TerrainClient;
use escarp_client::app::headless::Driver;
use escarp_client::mesh::{MeshOptions, MeshTree, MesherKind};
use escarp_client::remote::{ClientOptions, RemoteTerrain};
use escarp_client::stages::Budget;
use escarp_proto::view::View;
use escarp_server::PageSource;
use escarp_tests::drive::{same_pages, settle, step_until, tree, view_over};
use escarp_tests::host::{Host, MEMORY, PATIENCE, Watched};
use escarp_tests::measure::{check_cracks, measure};
use escarp_tests::terrain::{Heights, TempDataset, cliff, hills, holed_hills};
use std::cell::Cell;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::Arc;
use std::time::Duration;

#[test]
fn a_client_converges_and_its_mesh_is_that_of_a_tree_without_a_network() {
    let terrains: [(&str, Heights); 3] =
        [("hills", hills), ("holes", holed_hills), ("cliff", cliff)];
    for (name, heights) in terrains {
        let data = TempDataset::of(230, 190, heights);
        let host = Host::of("moon", data.open());
        for error_px in [1.0, 2.0, 8.0] {
            let view = view_over(&data, error_px);
            let mut driver = host.client("moon");
            let manifest = driver.connect(PATIENCE).expect("a session");
            assert_eq!(&*manifest, data.dataset.manifest());
            let stats = settle(&mut driver, &view);
            let tree = tree(&driver);
            let mut local = same_pages(&data, tree);
            let excess = local.update(&view).excess;
            assert_eq!(tree.flags(), local.flags(), "{name} {error_px} px");
            assert_eq!(
                stats.bound_px,
                excess * f64::from(error_px),
                "{name} {error_px} px"
            );
            check_cracks(tree, data.dataset.grid().cells_per_side())
                .unwrap_or_else(|why| panic!("{name} {error_px} px: {why}"));
            let found = measure(tree, &data, &view, false);
            assert!(
                found.samples > 0 && found.largest <= 1.0 + 1e-9,
                "{name}: {found:?}"
            );
            assert_eq!(
                (found.left_out, found.covered),
                (0, 0),
                "{name} {error_px} px"
            );
        }
    }
}

#[test]
fn while_pages_are_on_their_way_there_is_no_crack_and_the_stated_bound_holds() {
    let data = TempDataset::of(230, 190, hills);
    let cells = data.dataset.grid().cells_per_side();
    let source = Watched::new(data.open(), Duration::from_millis(3));
    let host = Host::start(&[("moon", source)]);
    let view = view_over(&data, 1.0);
    let mut driver = host.client("moon");
    step_until(&mut driver, &view, "settled", |driver, stats| {
        let Some(terrain) = driver.client.terrain() else {
            return false;
        };
        check_cracks(terrain.tree(), cells).unwrap_or_else(|why| panic!("{why}"));
        if stats.bound_px.is_finite() {
            let found = measure(terrain.tree(), &data, &view, true);
            assert!(
                found.largest <= stats.bound_px.max(1.0) + 1e-9,
                "{found:?} {stats:?}"
            );
        }
        driver.client.is_settled()
    });
    settle(&mut driver, &view);
}

/// A client of the dataset `moon` with options.
fn client_with(host: &Host, options: ClientOptions) -> Driver {
    Driver::new(RemoteTerrain::with_options(host.url("moon"), options))
}

#[test]
fn with_a_budget_of_triangles_the_tolerance_is_as_wide_as_it_must_be_and_its_bound_holds() {
    let data = TempDataset::of(300, 270, hills);
    let host = Host::of("moon", data.open());
    let view = view_over(&data, 0.5);
    let free = settle(&mut host.client("moon"), &view);
    for share in [2, 5, 30] {
        let budget = (free.triangles / share) as u32;
        let mut driver = client_with(
            &host,
            ClientOptions {
                mesh: MeshOptions {
                    max_triangles: Some(budget),
                    ..MeshOptions::default()
                },
                ..ClientOptions::default()
            },
        );
        let stats = step_until(&mut driver, &view, "settled", |driver, _| {
            driver.client.is_settled()
        });
        assert!(stats.converged && stats.steady, "{stats:?}");
        assert!(stats.triangles <= budget.into(), "{budget}: {stats:?}");
        assert!(
            stats.triangles >= u64::from(budget) / 2,
            "{budget}: {stats:?}"
        );
        assert!(stats.tolerance_px > 0.5, "{stats:?}");
        assert!(stats.bound_px <= f64::from(stats.tolerance_px), "{stats:?}");
        let mut used = view;
        used.max_screen_error_px = stats.tolerance_px;
        let found = measure(tree(&driver), &data, &used, false);
        assert!(
            found.samples > 0 && found.largest <= 1.0 + 1e-9,
            "{found:?}"
        );
    }
}

#[test]
fn with_no_time_for_more_than_a_page_a_frame_the_mesh_ends_the_same_without_a_crack() {
    let data = TempDataset::of(230, 190, hills);
    let cells = data.dataset.grid().cells_per_side();
    let host = Host::of("moon", data.open());
    let view = view_over(&data, 1.0);
    let mut whole = host.client("moon");
    settle(&mut whole, &view);
    let mut driver = client_with(
        &host,
        ClientOptions {
            frame_budget: Budget::Fixed(Duration::ZERO),
            ..ClientOptions::default()
        },
    );
    let resident = Cell::new(0);
    step_until(&mut driver, &view, "settled", |driver, stats| {
        if driver.client.terrain().is_some() {
            check_cracks(tree(driver), cells).unwrap_or_else(|why| panic!("{why}"));
            let stored = |tree: &MeshTree| {
                let ids = tree.pages().map(|page| page.id());
                ids.filter(|&id| data.dataset.record(id).expect("sound").is_some())
                    .count()
            };
            let now = stored(tree(driver));
            let before = resident.replace(now);
            assert!(now <= before + 1, "{now} after {before}: {stats:?}");
        }
        driver.client.is_settled()
    });
    assert_eq!(tree(&driver).flags(), tree(&whole).flags());
}

#[test]
fn another_mesher_needs_no_page_twice_and_the_first_one_comes_back_as_it_was() {
    let data = TempDataset::of(230, 190, hills);
    let source = Watched::new(data.open(), Duration::ZERO);
    let watched = source.clone();
    let host = Host::start(&[("moon", watched)]);
    let view = view_over(&data, 1.0);
    let mut driver = host.client("moon");
    let before = settle(&mut driver, &view);
    for &mesher in MesherKind::ALL {
        driver.client.set_mesh_options(MeshOptions {
            mesher,
            ..MeshOptions::default()
        });
        let stats = step_until(&mut driver, &view, "settled", |driver, _| {
            driver.client.is_settled()
        });
        assert!(
            stats.converged && stats.triangles > 0,
            "{mesher}: {stats:?}"
        );
        assert!(stats.pages_resident >= before.pages_resident, "{mesher}");
    }
    driver.client.set_mesh_options(MeshOptions::default());
    source.take_asked();
    settle(&mut driver, &view);
    assert_eq!(source.take_asked(), []);
}

#[test]
fn a_view_that_makes_no_sense_is_shown_as_the_nearest_that_does_with_a_note() {
    let data = TempDataset::of(130, 110, hills);
    let host = Host::of("moon", data.open());
    let mut driver = host.client("moon");
    let usual = view_over(&data, 2.0);
    settle(&mut driver, &usual);
    assert!(driver.client.notes().is_empty());
    for (field, view) in [
        (
            "eye",
            View {
                eye_m: [f64::NAN; 3],
                ..usual
            },
        ),
        (
            "eye",
            View {
                eye_m: [1e300, 0.0, 0.0],
                ..usual
            },
        ),
        (
            "direction",
            View {
                direction: [0.0; 3],
                ..usual
            },
        ),
        (
            "field of view",
            View {
                fov_y: f32::INFINITY,
                ..usual
            },
        ),
        (
            "viewport",
            View {
                viewport_px: [0, 9],
                ..usual
            },
        ),
        (
            "max_screen_error_px",
            View {
                max_screen_error_px: f32::NAN,
                ..usual
            },
        ),
    ] {
        let stats = step_until(&mut driver, &view, field, |driver, _| {
            driver.client.is_settled()
        });
        assert!(stats.converged, "{field}: {stats:?}");
        assert!(
            driver.client.notes()[0].contains(field),
            "{:?}",
            driver.client.notes()
        );
    }
    settle(&mut driver, &usual);
    assert!(driver.client.notes().is_empty());
}

#[test]
fn a_name_left_out_means_the_only_dataset() {
    let data = TempDataset::of(60, 50, hills);
    let host = Host::of("moon", data.open());
    let manifest = host.client("").connect(PATIENCE).expect("the only one");
    assert_eq!(&*manifest, data.dataset.manifest());
}

#[test]
fn without_a_name_or_with_a_wrong_one_the_datasets_are_listed() {
    let data = TempDataset::of(60, 50, hills);
    let source = |data: &TempDataset| -> Arc<dyn PageSource> { Arc::new(data.open()) };
    let host = Host::start(&[("moon", source(&data)), ("mars", source(&data))]);
    let none = host.client("").connect(PATIENCE).unwrap_err().to_string();
    assert!(
        none.contains("names no dataset") && none.contains("mars, moon"),
        "{none}"
    );
    let wrong = host
        .client("venus")
        .connect(PATIENCE)
        .unwrap_err()
        .to_string();
    assert!(
        wrong.contains("no dataset \"venus\"") && wrong.contains("mars, moon"),
        "{wrong}"
    );
    host.client("mars")
        .connect(PATIENCE)
        .expect("it has this one");
}

fn failure(port: u16) -> String {
    let url = format!("http://127.0.0.1:{port}/moon")
        .parse()
        .expect("an address");
    let mut driver = Driver::new(RemoteTerrain::open(url, MEMORY));
    let error = driver
        .connect(PATIENCE)
        .expect_err("no Escarp server")
        .to_string();
    assert!(error.contains(&format!("127.0.0.1:{port}")), "{error}");
    error
}

#[test]
fn a_port_where_nothing_listens_is_named() {
    let port = {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        listener.local_addr().unwrap().port()
    };
    let error = failure(port);
    assert!(
        error.contains("no server listens") && error.contains("escarp-server"),
        "{error}"
    );
}

/// A TCP server that gives every connection the same answer, until the end of the process.
fn answering(answer: &'static [u8]) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || {
        for mut stream in listener.incoming().map_while(Result::ok) {
            let _ = stream.read(&mut [0; 4096]);
            let _ = stream.write_all(answer);
        }
    });
    port
}

#[test]
fn what_is_no_escarp_server_is_told_apart() {
    let answers: [(&[u8], &str); 4] = [
        (
            b"HTTP/1.1 404 Not Found\r\ncontent-length: 0\r\n\r\n",
            "no Escarp server",
        ),
        (
            b"HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\nhi",
            "plain web server",
        ),
        (
            b"\x00\xff\x13garbage without end of line",
            "no Escarp server",
        ),
        (b"", "closed the connection"),
    ];
    for (answer, words) in answers {
        let error = failure(answering(answer));
        assert!(error.contains(words), "{}: {error}", answer.escape_ascii());
    }
}
