//! Server and client in one process, over loopback: convergence, names, wrong addresses, and
//! servers that go and come back.

use escarp_client::app::headless::Driver;
use escarp_client::app::{StepStats, TerrainClient};
use escarp_client::mesh::{MeshTree, PageMesh};
use escarp_client::remote::RemoteTerrain;
use escarp_proto::view::View;
use escarp_server::PageSource;
use escarp_tests::host::{Host, MEMORY, PATIENCE, Watched};
use escarp_tests::measure::{check_cracks, measure, triangles};
use escarp_tests::terrain::{TempDataset, cliff, hills, holed_hills};
use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::Arc;
use std::time::Duration;

const NAP: Duration = Duration::from_millis(5);

/// A low view over the south of a terrain.
fn view(data: &TempDataset, error_px: f32) -> View {
    let extent = data.dataset.manifest().extent_m();
    let middle = extent.map(|[low, high]| (low + high) / 2.0);
    View {
        eye_m: [middle[0], extent[1][0] - 100.0, extent[2][1] + 150.0],
        direction: [0.1, 0.9, -0.3],
        velocity_m_s: [0.0; 3],
        fov_y: 1.1,
        viewport_px: [1280, 720],
        max_screen_error_px: error_px,
    }
}

/// Steps until a condition holds of the client and its figures.
fn step_until(
    driver: &mut Driver,
    view: &View,
    what: &str,
    done: impl Fn(&Driver, &StepStats) -> bool,
) -> StepStats {
    let until = driver.now() + PATIENCE;
    loop {
        let now = driver.now();
        let stats = driver.client.step(view, now);
        if done(driver, &stats) {
            return stats;
        }
        assert!(now < until, "not within {PATIENCE:?}: {what}; {}", driver.client.status());
        driver.nap(NAP);
    }
}

fn settle(driver: &mut Driver, view: &View) -> StepStats {
    let stats = step_until(driver, view, "settled", |driver, _| driver.client.is_settled());
    assert!(stats.converged && stats.bound_px <= f64::from(view.max_screen_error_px), "{stats:?}");
    stats
}

fn tree(driver: &Driver) -> &MeshTree {
    driver.client.terrain().expect("a terrain").tree()
}

/// A tree with the same pages, fed from the dataset without a network.
fn same_pages(data: &TempDataset, theirs: &MeshTree) -> MeshTree {
    let manifest = data.dataset.manifest();
    let mut tree = MeshTree::new(manifest.grid_levels, manifest.georef.clone());
    let mut pages: Vec<_> = theirs.pages().map(|page| (page.id(), page.parts())).collect();
    pages.sort_by_key(|(id, _)| id.key());
    for (id, parts) in pages {
        let finest = data.dataset.grid().is_finest(id);
        // Pages without a record are linked by the tree itself.
        if let Some(record) = data.dataset.record(id).expect("sound") {
            let header = escarp_proto::page::RecordHeader::read(id, finest, record.bytes);
            let bytes = header.expect("a header").part_bytes(0, parts).expect("parts");
            let page = escarp_proto::page::Page::decode(id, finest, parts, &record.bytes[bytes]);
            tree.link(page.expect("it decodes")).expect("it fits");
        }
    }
    tree
}

#[test]
fn a_client_converges_and_its_mesh_is_that_of_a_tree_without_a_network() {
    let terrains: [(&str, fn(u32, u32) -> f64); 3] =
        [("hills", hills), ("holes", holed_hills), ("cliff", cliff)];
    for (name, heights) in terrains {
        let data = TempDataset::of(230, 190, heights);
        let host = Host::of("moon", data.open());
        for error_px in [1.0, 2.0, 8.0] {
            let view = view(&data, error_px);
            let mut driver = host.client("moon");
            let manifest = driver.connect(PATIENCE).expect("a session");
            assert_eq!(&*manifest, data.dataset.manifest());
            let stats = settle(&mut driver, &view);
            let tree = tree(&driver);
            let mut local = same_pages(&data, tree);
            let excess = local.update(&view).excess;
            assert_eq!(tree.flags(), local.flags(), "{name} {error_px} px");
            assert_eq!(stats.bound_px, excess * f64::from(error_px), "{name} {error_px} px");
            check_cracks(tree, data.dataset.grid().cells_per_side())
                .unwrap_or_else(|why| panic!("{name} {error_px} px: {why}"));
            let found = measure(tree, &data, &view, false);
            assert!(found.samples > 0 && found.largest <= 1.0 + 1e-9, "{name}: {found:?}");
            assert_eq!((found.left_out, found.covered), (0, 0), "{name} {error_px} px");
        }
    }
}

#[test]
fn while_pages_are_on_their_way_there_is_no_crack_and_the_stated_bound_holds() {
    let data = TempDataset::of(230, 190, hills);
    let cells = data.dataset.grid().cells_per_side();
    let source = Watched::new(data.open(), Duration::from_millis(3));
    let host = Host::start(&[("moon", source)]);
    let view = view(&data, 1.0);
    let mut driver = host.client("moon");
    step_until(&mut driver, &view, "settled", |driver, stats| {
        let Some(terrain) = driver.client.terrain() else {
            return false;
        };
        check_cracks(terrain.tree(), cells).unwrap_or_else(|why| panic!("{why}"));
        if stats.bound_px.is_finite() {
            let found = measure(terrain.tree(), &data, &view, true);
            assert!(found.largest <= stats.bound_px.max(1.0) + 1e-9, "{found:?} {stats:?}");
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
    assert!(none.contains("names no dataset") && none.contains("mars, moon"), "{none}");
    let wrong = host.client("venus").connect(PATIENCE).unwrap_err().to_string();
    assert!(wrong.contains("no dataset \"venus\"") && wrong.contains("mars, moon"), "{wrong}");
    host.client("mars").connect(PATIENCE).expect("it has this one");
}

fn failure(port: u16) -> String {
    let url = format!("http://127.0.0.1:{port}/moon").parse().expect("an address");
    let mut driver = Driver::new(RemoteTerrain::open(url, MEMORY));
    let error = driver.connect(PATIENCE).expect_err("no Escarp server").to_string();
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
    assert!(error.contains("no server listens") && error.contains("escarp-server"), "{error}");
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
        (b"HTTP/1.1 404 Not Found\r\ncontent-length: 0\r\n\r\n", "no Escarp server"),
        (b"HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\nhi", "plain web server"),
        (b"\x00\xff\x13garbage without end of line", "no Escarp server"),
        (b"", "closed the connection"),
    ];
    for (answer, words) in answers {
        let error = failure(answering(answer));
        assert!(error.contains(words), "{}: {error}", answer.escape_ascii());
    }
}

/// The meshes of a client: page, triangles and place.
fn picture(client: &impl TerrainClient) -> Vec<String> {
    let mut picture = Vec::new();
    client.visit_pages(&mut |mesh: &PageMesh| picture.push(format!("{mesh:?}")));
    picture.sort();
    picture
}

/// The triangles of a client's mesh, in an order of their own.
fn surface(driver: &Driver) -> Vec<[(u32, u32, i32); 3]> {
    let mut corners: Vec<_> = triangles(tree(driver)).iter().map(|t| t.corners).collect();
    corners.sort_unstable();
    corners
}

#[test]
fn a_server_that_crashes_and_comes_back_leaves_the_picture_and_sends_no_page_twice() {
    let data = TempDataset::of(230, 190, hills);
    let source = Watched::new(data.open(), Duration::ZERO);
    let hosted: [(&str, Arc<dyn PageSource>); 1] = [("moon", source.clone())];
    let host = Host::start(&hosted);
    let port = host.address().port();
    let (near, far) = (view(&data, 1.0), view(&data, 8.0));
    let mut driver = host.client("moon");
    let before = settle(&mut driver, &far);
    let (kept, mesh) = (picture(&driver.client), surface(&driver));
    assert!(!source.take_asked().is_empty());
    drop(host);
    let gone = |driver: &Driver, _: &StepStats| driver.client.status().contains("trying again");
    let stats = step_until(&mut driver, &far, "the loss is noticed", gone);
    assert!(stats.converged && stats.pages_resident == before.pages_resident, "{stats:?}");
    assert!(picture(&driver.client) == kept, "the picture changed without a server");
    // What is looked at goes on to be followed, as far as the pages go.
    let now = driver.now();
    assert!(driver.client.step(&near, now).bound_px.is_finite());
    let cells = data.dataset.grid().cells_per_side();
    check_cracks(tree(&driver), cells).unwrap_or_else(|why| panic!("{why}"));
    let now = driver.now();
    driver.client.step(&far, now);
    let host = Host::start_on(port, &hosted);
    let back = |driver: &Driver, _: &StepStats| driver.client.status() == "connected";
    step_until(&mut driver, &far, "connected again", back);
    let again = settle(&mut driver, &far);
    assert!(surface(&driver) == mesh, "the mesh changed with the new session");
    // Only the greeting came anew: no page, and none was looked up.
    let greeting = data.dataset.manifest_json().len() as u64 + 1000;
    assert!(again.bytes_received - before.bytes_received < greeting, "{before:?} {again:?}");
    let asked = source.take_asked();
    let resident = |page| tree(&driver).page(page).is_some_and(|page| page.has_slots());
    let twice: Vec<_> = asked.iter().filter(|page| resident(**page)).collect();
    assert!(twice.is_empty(), "sent again: {twice:?}");
    settle(&mut driver, &near);
    assert_eq!(driver.client.rejected_pages(), 0);
    host.stop();
}

#[test]
fn a_server_stopped_in_mid_flight_is_found_again_and_the_rest_arrives() {
    let data = TempDataset::of(230, 190, hills);
    let source = Watched::new(data.open(), Duration::from_millis(4));
    let hosted: [(&str, Arc<dyn PageSource>); 1] = [("moon", source)];
    let view = view(&data, 1.0);
    let mut host = Host::start(&hosted);
    let port = host.address().port();
    let mut driver = host.client("moon");
    for round in 0..3 {
        let resident = driver.client.terrain().map_or(0, |terrain| terrain.tree().resident());
        step_until(&mut driver, &view, "pages in flight", |driver, stats| {
            let more = stats.pages_resident as usize >= resident + 5;
            more && (stats.pages_in_flight > 0 || driver.client.is_settled())
        });
        // In turn told, and not told.
        if round % 2 == 0 { host.stop() } else { drop(host) }
        step_until(&mut driver, &view, "the loss is noticed", |driver, _| {
            driver.client.status() != "connected"
        });
        host = Host::start_on(port, &hosted);
    }
    settle(&mut driver, &view);
    let mut local = same_pages(&data, tree(&driver));
    local.update(&view);
    assert_eq!(tree(&driver).flags(), local.flags());
    assert_eq!(driver.client.rejected_pages(), 0);
}
