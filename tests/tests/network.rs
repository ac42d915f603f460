//! Server and client in one process, over loopback: convergence, names, wrong addresses.

use escarp_client::app::headless::Driver;
use escarp_client::remote::RemoteTerrain;
use escarp_server::PageSource;
use escarp_tests::drive::{same_pages, settle, step_until, tree, view_over};
use escarp_tests::host::{Host, MEMORY, PATIENCE, Watched};
use escarp_tests::measure::{check_cracks, measure};
use escarp_tests::terrain::{Heights, TempDataset, cliff, hills, holed_hills};
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
