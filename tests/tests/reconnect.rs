//! Servers that go and come back: the picture stays, and the client goes on where it was.

use escarp_client::app::headless::Driver;
use escarp_client::app::{StepStats, TerrainClient};
use escarp_client::mesh::PageMesh;
use escarp_proto::view::View;
use escarp_server::PageSource;
use escarp_tests::drive::{same_pages, settle, step_until, tree, view_over};
use escarp_tests::host::{Host, Watched};
use escarp_tests::measure::{check_cracks, triangles};
use escarp_tests::terrain::{TempDataset, hills};
use std::cell::Cell;
use std::sync::Arc;
use std::time::{Duration, Instant};

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

/// Settles, and waits for what a server lists beyond what the mesh turned out to need.
fn come_to_rest(driver: &mut Driver, view: &View) -> StepStats {
    settle(driver, view);
    let last = Cell::new((0, Instant::now()));
    step_until(driver, view, "at rest", |_, stats| {
        if stats.bytes_received != last.get().0 {
            last.set((stats.bytes_received, Instant::now()));
        }
        last.get().1.elapsed() > Duration::from_millis(300)
    })
}

#[test]
fn a_server_that_crashes_and_comes_back_leaves_the_picture_and_sends_no_page_twice() {
    let data = TempDataset::of(230, 190, hills);
    let source = Watched::new(data.open(), Duration::ZERO);
    let hosted: [(&str, Arc<dyn PageSource>); 1] = [("moon", source.clone())];
    let host = Host::start(&hosted);
    let port = host.address().port();
    let (near, far) = (view_over(&data, 1.0), view_over(&data, 8.0));
    let mut driver = host.client("moon");
    let before = come_to_rest(&mut driver, &far);
    let (kept, mesh) = (picture(&driver.client), surface(&driver));
    assert!(!source.take_asked().is_empty());
    drop(host);
    let gone = |driver: &Driver, _: &StepStats| driver.client.status().contains("trying again");
    let stats = step_until(&mut driver, &far, "the loss is noticed", gone);
    assert!(
        stats.converged && stats.pages_resident == before.pages_resident,
        "{stats:?}"
    );
    assert!(
        picture(&driver.client) == kept,
        "the picture changed without a server"
    );
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
    assert!(
        surface(&driver) == mesh,
        "the mesh changed with the new session"
    );
    // Only the greeting came anew, and no page; what the server reads to select is not sent.
    let greeting = data.dataset.manifest_json().len() as u64 + 1000;
    assert!(
        again.bytes_received - before.bytes_received < greeting,
        "{before:?} {again:?}"
    );
    settle(&mut driver, &near);
    assert_eq!(driver.client.lost_pages().0, 0);
    host.stop();
}

#[test]
fn a_server_stopped_in_mid_flight_is_found_again_and_the_rest_arrives() {
    let data = TempDataset::of(230, 190, hills);
    let source = Watched::new(data.open(), Duration::from_millis(4));
    let hosted: [(&str, Arc<dyn PageSource>); 1] = [("moon", source)];
    let view = view_over(&data, 1.0);
    let mut host = Host::start(&hosted);
    let port = host.address().port();
    let mut driver = host.client("moon");
    for round in 0..3 {
        let resident = driver
            .client
            .terrain()
            .map_or(0, |terrain| terrain.tree().resident());
        // Most come unasked, so none need be in flight by the client's own count.
        step_until(&mut driver, &view, "pages on their way", |driver, stats| {
            stats.pages_resident as usize >= resident + 5 || driver.client.is_settled()
        });
        assert!(
            !driver.client.is_settled() || round > 0,
            "all came before the server was stopped"
        );
        // In turn told, and not told.
        if round % 2 == 0 {
            host.stop()
        } else {
            drop(host)
        }
        step_until(&mut driver, &view, "the loss is noticed", |driver, _| {
            driver.client.status() != "connected"
        });
        host = Host::start_on(port, &hosted);
    }
    settle(&mut driver, &view);
    let mut local = same_pages(&data, tree(&driver));
    local.update(&view);
    assert_eq!(tree(&driver).flags(), local.flags());
    assert_eq!(driver.client.lost_pages().0, 0);
}
