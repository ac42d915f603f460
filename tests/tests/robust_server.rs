//! What may befall a running server, as a process: signals, too few open files, broken segments,
//! and clients that come and go. It lives, says so in its log, and clients go on.

use escarp_client::app::TerrainClient;
use escarp_client::app::headless::Driver;
use escarp_client::remote::RemoteTerrain;
use escarp_proto::view::View;
use escarp_proto::wire::ClientMessage;
use escarp_tests::drive::{settle, step_until, tree};
use escarp_tests::host::{MEMORY, PATIENCE};
use escarp_tests::measure::check_cracks;
use escarp_tests::programs::{Desk, ServerProcess};
use escarp_tests::raw::{RawSocket, hello, message};
use escarp_tests::terrain::hash;
use escarp_tiles::dataset::Dataset;
use std::fs::{self, OpenOptions};
use std::net::{SocketAddr, TcpStream};
use std::path::Path;
use std::time::{Duration, Instant};

/// A server of a small dataset, and its folder.
fn served(desk: &Desk) -> (ServerProcess, std::path::PathBuf) {
    let dataset = desk.dataset();
    (ServerProcess::start(&[&dataset]), dataset)
}

fn client(server: &ServerProcess) -> Driver {
    let url = server.urls[0].parse().expect("an address");
    Driver::new(RemoteTerrain::open(url, MEMORY))
}

/// A view down on the middle of a dataset.
fn view(dataset: &Path, error_px: f32) -> View {
    let dataset = Dataset::open(dataset).expect("a dataset");
    let [x, y, z] = dataset.manifest().extent_m();
    let middle = |[low, high]: [f64; 2]| (low + high) / 2.0;
    View {
        eye_m: [middle(x), y[0], z[1] + (x[1] - x[0]) / 4.0],
        direction: [0.1, 0.9, -0.6],
        velocity_m_s: [0.0; 3],
        fov_y: 1.2,
        viewport_px: [1280, 720],
        max_screen_error_px: error_px,
    }
}

fn cells(dataset: &Path) -> u32 {
    let dataset = Dataset::open(dataset).expect("a dataset");
    dataset.grid().cells_per_side()
}

/// Steps until some pages, but not all, are here.
fn step_into_flight(driver: &mut Driver, view: &View) {
    step_until(driver, view, "pages in flight", |driver, stats| {
        stats.pages_resident > 2 || driver.client.is_settled()
    });
}

#[test]
fn a_server_told_to_end_in_mid_flight_tells_its_sessions_and_exits_with_0() {
    let desk = Desk::new();
    let (server, dataset) = served(&desk);
    let near = view(&dataset, 0.5);
    let mut flying: Vec<Driver> = (0..3).map(|_| client(&server)).collect();
    for driver in &mut flying {
        step_into_flight(driver, &near);
    }
    // A client that does not read is no reason to stay.
    let mut deaf = RawSocket::open(server.address()).expect("a session");
    deaf.send(&message(&ClientMessage::Ping(1)))
        .expect("it listens");
    let status = server.end("TERM");
    assert_eq!(status.code(), Some(0));
    for driver in &mut flying {
        step_until(driver, &near, "the end is noticed", |driver, _| {
            driver.client.status().contains("trying again")
        });
        let status = driver.client.status();
        assert!(status.contains("going down"), "{status}");
        check_cracks(tree(driver), cells(&dataset)).unwrap_or_else(|why| panic!("{why}"));
    }
}

#[test]
fn after_a_kill_and_a_restart_clients_go_on_without_downloading_anything_again() {
    let desk = Desk::new();
    let (server, dataset) = served(&desk);
    let port = server.address().port();
    let far = view(&dataset, 4.0);
    let mut drivers: Vec<Driver> = (0..3).map(|_| client(&server)).collect();
    let before: Vec<u64> = drivers
        .iter_mut()
        .map(|driver| {
            settle(driver, &far);
            driver.client.link().stats().page_bytes
        })
        .collect();
    server.end("KILL");
    for driver in &mut drivers {
        step_until(driver, &far, "the loss is noticed", |driver, _| {
            !driver.client.is_connected()
        });
    }
    let server = ServerProcess::start_on(port, &[&dataset]);
    for (driver, before) in drivers.iter_mut().zip(before) {
        step_until(driver, &far, "connected again", |driver, _| {
            driver.client.is_connected()
        });
        settle(driver, &far);
        let stats = driver.client.link().stats();
        assert_eq!((stats.page_bytes, stats.sessions), (before, 2), "{stats:?}");
        // The rest is no more than what a client without a break downloads.
        settle(driver, &view(&dataset, 1.0));
    }
    let mut fresh = client(&server);
    settle(&mut fresh, &far);
    settle(&mut fresh, &view(&dataset, 1.0));
    let whole = fresh.client.link().stats().page_bytes;
    for driver in &drivers {
        let bytes = driver.client.link().stats().page_bytes;
        assert!(bytes <= whole + whole / 20, "{bytes} bytes, not {whole}");
    }
}

/// Connections that are held open.
fn crowd(address: SocketAddr, most: usize) -> Vec<TcpStream> {
    let connect = |_| TcpStream::connect_timeout(&address, Duration::from_secs(2)).ok();
    (0..most).map_while(connect).collect()
}

#[test]
fn a_server_out_of_open_files_lives_and_takes_clients_again_when_there_are_some() {
    let desk = Desk::new();
    let dataset = desk.dataset();
    let mut server = ServerProcess::start_with_files(48, &[&dataset]);
    let address = server.address();
    let far = view(&dataset, 2.0);
    let mut driver = client(&server);
    step_into_flight(&mut driver, &far);
    let crowded = crowd(address, 150);
    assert!(crowded.len() > 48, "{} connections", crowded.len());
    // Who was there before is served as ever.
    settle(&mut driver, &far);
    let began = Instant::now();
    while !server.log().contains("cannot be accepted") {
        assert!(began.elapsed() < PATIENCE, "it says nothing");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert!(server.lives(), "{}", server.log());
    drop(crowded);
    let mut late = client(&server);
    settle(&mut late, &far);
    settle(&mut driver, &view(&dataset, 1.0));
    assert!(server.lives() && !server.log().contains("panicked"));
}

/// The largest segment of a dataset.
fn segment(dataset: &Path) -> std::path::PathBuf {
    let files = fs::read_dir(dataset).expect("a folder");
    let files = files.map(|entry| entry.expect("an entry").path());
    let is_segment = |path: &std::path::PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with("seg-")
    };
    let size = |path: &std::path::PathBuf| fs::metadata(path).map_or(0, |data| data.len());
    files
        .filter(is_segment)
        .max_by_key(size)
        .expect("a segment")
}

/// Flies while a segment is broken: the server lives, and no mesh has a crack.
fn fly_over_broken(breaks: impl Fn(&Path, &[u8])) {
    let desk = Desk::new();
    let (mut server, dataset) = served(&desk);
    let (far, near) = (view(&dataset, 8.0), view(&dataset, 0.5));
    let mut driver = client(&server);
    settle(&mut driver, &far);
    let path = segment(&dataset);
    let sound = fs::read(&path).expect("a segment");
    breaks(&path, &sound);
    step_until(&mut driver, &near, "all that can be had", |driver, _| {
        driver.client.is_settled()
    });
    check_cracks(tree(&driver), cells_of(&driver)).unwrap_or_else(|why| panic!("{why}"));
    let (lost, reasons) = driver.client.lost_pages();
    assert!(lost > 0 && !reasons.is_empty(), "nothing was broken");
    assert!(server.lives(), "{}", server.log());
    // In place, as a restored backup would be.
    fs::write(&path, &sound).expect("it can be written");
    let mut fresh = client(&server);
    settle(&mut fresh, &near);
    assert!(server.lives() && !server.log().contains("panicked"));
}

fn cells_of(driver: &Driver) -> u32 {
    let manifest = driver.client.manifest().expect("a manifest");
    manifest.grid_levels.cells_per_side()
}

#[test]
fn a_segment_cut_short_under_a_running_server_costs_its_pages_and_nothing_else() {
    fly_over_broken(|path, _| {
        let file = OpenOptions::new().write(true).open(path).expect("a file");
        file.set_len(100).expect("it is cut");
    });
}

#[test]
fn a_segment_written_over_under_a_running_server_costs_its_pages_and_nothing_else() {
    fly_over_broken(|path, sound| {
        let noise: Vec<u8> = (0..sound.len() as u32).map(|i| hash(i, 5) as u8).collect();
        fs::write(path, noise).expect("it is replaced");
    });
}

/// What a process takes: resident memory, KiB, and open files.
fn taken(process: u32) -> Option<(u64, usize)> {
    let status = fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:"))?;
    let resident = line.trim().trim_end_matches("kB").trim().parse().ok()?;
    let files = fs::read_dir(format!("/proc/{process}/fd")).ok()?.count();
    Some((resident, files))
}

/// Resident memory may grow by this after the warm-up, KiB: allocators keep what they once had.
const GROWTH_KIB: u64 = 8 << 10;

/// Clients that come, look, and go for a while, in order or not.
fn come_and_go(server: &ServerProcess, dataset: &Path, time: Duration) -> u32 {
    let began = Instant::now();
    let mut clients = 0;
    while began.elapsed() < time {
        clients += 1;
        let mut driver = client(server);
        match clients % 4 {
            0 => drop(crowd(server.address(), 20)),
            1 => {
                let mut socket = RawSocket::open(server.address()).expect("a session");
                let _ = socket.send(&message(&hello(1 << 20)));
            }
            2 => step_into_flight(&mut driver, &view(dataset, 1.0)),
            _ => {
                settle(&mut driver, &view(dataset, 4.0));
            }
        }
    }
    clients
}

#[test]
fn clients_that_come_and_go_leave_no_memory_no_files_and_no_word_in_the_log() {
    let desk = Desk::new();
    let (server, dataset) = served(&desk);
    if taken(server.id()).is_none() {
        println!("skipped: there is no /proc here");
        return;
    }
    // ESCARP_SOAK: seconds, for a longer one.
    let seconds = std::env::var("ESCARP_SOAK").ok();
    let seconds = seconds.map_or(15, |text| text.parse().expect("ESCARP_SOAK is a number"));
    let soak = Duration::from_secs(seconds);
    come_and_go(&server, &dataset, soak / 3);
    let (warm, _) = taken(server.id()).expect("it lives");
    let clients = come_and_go(&server, &dataset, soak - soak / 3);
    let (resident, _) = taken(server.id()).expect("it lives");
    println!("{clients} clients: {warm} KiB, then {resident} KiB");
    assert!(clients > 4, "{clients} clients are no crowd");
    assert!(
        resident <= warm + GROWTH_KIB,
        "{clients} clients: {warm} KiB grew to {resident} KiB"
    );
    // Files go with the last sessions, which end a little later than their clients.
    let fresh = Desk::new();
    let (other, _) = served(&fresh);
    let (_, at_first) = taken(other.id()).expect("it lives");
    let until = Instant::now();
    loop {
        let (_, files) = taken(server.id()).expect("it lives");
        if files <= at_first {
            break;
        }
        assert!(until.elapsed() < PATIENCE, "{files} files, not {at_first}");
        std::thread::sleep(Duration::from_millis(100));
    }
    assert_eq!(server.log(), "", "the log is not clean");
    assert_eq!(server.end("TERM").code(), Some(0));
}
