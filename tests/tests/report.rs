//! `escarp-report` on a small dataset: its files, and what its numbers must hold.

use escarp_tests::programs::{Desk, run};
use serde_json::Value;
use std::path::Path;

/// Rounding of a ratio.
const SLACK: f64 = 1.0 + 1e-9;

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn list<'a>(value: &'a Value, name: &str) -> &'a Vec<Value> {
    let list = value[name].as_array();
    list.unwrap_or_else(|| panic!("no list {name} in {value}"))
}

fn float(value: &Value, name: &str) -> f64 {
    let number = value[name].as_f64();
    number.unwrap_or_else(|| panic!("no number {name} in {value}"))
}

/// The numbers of a run that every mesher's must hold.
fn check_run(run: &Value, frames: usize) {
    let error = &run["error"];
    let [rms, p999, max] = ["rms_px", "p999_px", "max_px"].map(|name| float(error, name));
    assert!(rms <= max && p999 <= max && max > 0.0, "{error}");
    let asked = float(run, "error_px");
    let over = float(error, "max_over_asked");
    assert!((over * asked - max).abs() <= 1e-9 * max, "{error}");
    assert!(float(error, "max_over_stated") <= over * SLACK, "{error}");
    assert_eq!(
        float(error, "share_above_asked") > 0.0,
        over > SLACK,
        "{error}"
    );
    assert_eq!(
        float(error, "compared"),
        float(error, "in_view"),
        "every sample, once"
    );
    assert!(float(error, "compared") > 10_000.0 && float(error, "frames") >= 3.0);
    assert_eq!(float(error, "crooked_edges"), 0.0, "{error}");
    let cdf = list(error, "ratio_cdf");
    let rises = |pair: &[Value]| pair[0][1].as_f64() <= pair[1][1].as_f64();
    assert!(cdf.windows(2).all(rises), "{cdf:?}");
    assert_eq!(cdf.last().unwrap()[1].as_f64(), Some(1.0));

    let rows = list(run, "frames");
    assert_eq!(rows.len(), frames);
    let bytes: f64 = rows.iter().map(|row| float(row, "bytes")).sum();
    assert_eq!(bytes, float(run, "bytes"));
    let most = rows.iter().map(|row| float(row, "triangles"));
    assert_eq!(most.fold(0.0, f64::max), float(run, "triangles_max"));
    let resident = &run["resident"];
    let times = ["median_ms", "p99_ms", "max_ms"].map(|name| float(resident, name));
    assert!(times[0] <= times[1] && times[1] <= times[2], "{resident}");
}

/// Those of a mesher that keeps its tolerance.
fn check_promise(run: &Value) {
    let error = &run["error"];
    assert_eq!(run["keeps_tolerance"], true);
    assert!(float(error, "max_over_asked") <= SLACK, "{error}");
    assert_eq!(float(error, "share_above_stated"), 0.0);
    assert_eq!(float(error, "left_out"), 0.0, "{error}");
    assert_eq!(float(error, "covered"), 0.0, "{error}");
    assert!(float(run, "excess_max") <= SLACK);
}

fn check_json(report: &Value, meshers: &[&str], tolerances: &[f64], frames: usize) {
    let runs = list(report, "runs");
    assert_eq!(runs.len(), meshers.len() * tolerances.len());
    assert_eq!(list(report, "skipped"), &Vec::<Value>::new());
    for (i, run) in runs.iter().enumerate() {
        assert_eq!(run["mesher"], meshers[i / tolerances.len()]);
        assert_eq!(float(run, "error_px"), tolerances[i % tolerances.len()]);
        check_run(run, frames);
        if run["mesher"] != "distance" {
            check_promise(run);
        }
    }
    let triangles: Vec<f64> = runs
        .iter()
        .map(|run| float(run, "triangles_mean"))
        .collect();
    for own in triangles.chunks(tolerances.len()) {
        assert!(own.windows(2).all(|pair| pair[0] > pair[1]), "{own:?}");
    }
    let pops = &list(report, "pops")[0];
    let reference = float(report, "reference_px");
    // Where a vertex comes or goes the old triangle and the new ones are both within the bound.
    assert!(float(pops, "max_px") <= 2.0 * reference * SLACK, "{pops}");
    let shares = list(pops, "histogram")
        .iter()
        .map(|row| row[1].as_f64().unwrap());
    assert!((shares.sum::<f64>() - 1.0).abs() < 1e-9);
    for out in list(report, "leave_out") {
        let falls = |names: &[&str]| {
            let values: Vec<f64> = names.iter().map(|name| float(out, name)).collect();
            assert!(
                values.windows(2).all(|pair| pair[0] >= pair[1]),
                "{names:?}: {values:?}"
            );
        };
        falls(&["dataset_bytes", "received_bytes", "used_bytes"]);
        falls(&["dataset_pages", "received_pages"]);
        falls(&["drawn_pages", "seen_pages"]);
        falls(&[
            "full_triangles",
            "triangles",
            "sent_triangles",
            "seen_triangles",
        ]);
        assert!(float(out, "used_bytes") > 0.0 && float(out, "seen_triangles") > 0.0);
    }
    let cold = &list(report, "cold_starts")[0];
    assert!(float(cold, "max_over_stated") <= SLACK, "{cold}");
    let moments = list(cold, "moments");
    let last = moments.last().unwrap();
    assert!(
        float(last, "measured_px") <= reference * SLACK
            && float(last, "bound_px") <= reference * SLACK
    );
    // Two round trips to connect and two more to hear of the first page, at 2 x 50 ms each.
    assert!(
        float(cold, "first_bound_s") >= 0.4
            && float(cold, "converged_s") >= float(cold, "first_bound_s")
    );
    let bytes: Vec<f64> = moments
        .iter()
        .map(|moment| float(moment, "bytes"))
        .collect();
    assert!(bytes.windows(2).all(|pair| pair[0] <= pair[1]), "{bytes:?}");
}

/// A page that needs nothing but itself: no script, and no address but of its own files.
fn check_html(html: &str) {
    assert!(html.starts_with("<!doctype html>") && html.trim_end().ends_with("</html>"));
    let without_names = html.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
    for outside in [
        "http:", "https:", "//", "<script", "<link", "src=", "url(", "@import", "<img",
    ] {
        assert!(!without_names.contains(outside), "{outside}");
    }
    let links = without_names.split("href=\"").skip(1);
    for link in links.map(|rest| rest.split('"').next().unwrap_or_default()) {
        assert!(
            link.starts_with('#') || link.ends_with("report.json") || link.ends_with("report.html"),
            "{link}"
        );
    }
}

/// Pictures in which something is drawn.
fn check_plots(folder: &Path) {
    let names = std::fs::read_dir(folder).expect("a folder of plots");
    let mut names: Vec<String> = names
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    assert!(
        names.len() >= 24 && names.len().is_multiple_of(2),
        "{names:?}"
    );
    for name in names {
        let path = folder.join(&name);
        if name.ends_with(".svg") {
            let svg = read(&path);
            assert!(
                svg.starts_with("<svg") && svg.contains("<path") && svg.contains("<text"),
                "{name}"
            );
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{name}");
            continue;
        }
        let image = image::open(&path).expect("a PNG").to_rgb8();
        let mut colours: Vec<[u8; 3]> = image.pixels().map(|pixel| pixel.0).collect();
        colours.sort_unstable();
        colours.dedup();
        assert!(
            image.width() >= 1000 && colours.len() > 20,
            "{name}: {} colours",
            colours.len()
        );
        assert!(
            colours.contains(&[0x00, 0x72, 0xb2]),
            "{name} has nothing in the first colour"
        );
    }
}

fn check_report(folder: &Path, meshers: &[&str], tolerances: &[f64]) {
    let json: Value = serde_json::from_str(&read(&folder.join("report.json"))).expect("JSON");
    let plan = &json["plan"];
    let frames = (float(plan, "windows") * float(plan, "window_frames")) as usize;
    check_json(&json, meshers, tolerances, frames);
    let html = read(&folder.join("report.html"));
    check_html(&html);
    assert!(meshers.iter().all(|mesher| html.contains(mesher)));
    let lines = |name: &str| read(&folder.join(name)).lines().count();
    let runs = meshers.len() * tolerances.len();
    assert_eq!(lines("runs.csv"), 1 + runs);
    assert_eq!(lines("frames.csv"), 1 + runs * frames);
    // Where nothing jumps, that is the one line.
    for (name, least) in [("ratios.csv", 9), ("pops.csv", 2), ("cold-starts.csv", 4)] {
        assert!(lines(name) >= least, "{name}");
    }
    check_plots(&folder.join("plots"));
}

#[test]
fn a_report_has_all_its_files_and_its_numbers_hold_what_is_promised() {
    let desk = Desk::new();
    let dataset = desk.dataset();
    let dataset = dataset.to_str().unwrap();
    let meshers = ["quadtree", "quadtree+morph", "distance"];
    let tolerances = [2.0, 8.0];
    let out = desk.name("report");
    let said = run(
        "escarp-report",
        &[
            dataset,
            "--quick",
            "-o",
            &out,
            "--meshers",
            "quadtree,quadtree+morph,distance",
            "--error-px",
            "8,2",
        ],
    )
    .ok();
    assert_eq!(said.matches("| quadtree ").count(), 2, "{said}");
    check_report(Path::new(&out), &meshers, &tolerances);
    let json: Value = serde_json::from_str(&read(&Path::new(&out).join("report.json"))).unwrap();
    let jumps: Vec<f64> = list(&json, "pops")
        .iter()
        .map(|pops| float(pops, "max_px"))
        .collect();
    assert!(
        jumps[0] > 0.1 && jumps[1] < 0.1 * jumps[0],
        "morph takes the jumps away: {jumps:?}"
    );
}

#[test]
fn reports_of_several_datasets_have_folders_of_their_own_and_an_index() {
    let desk = Desk::new();
    let dataset = desk.dataset();
    let dataset = dataset.to_str().unwrap();
    let out = desk.name("reports");
    let arguments = [
        dataset,
        dataset,
        "--quick",
        "-o",
        &out,
        "--meshers",
        "quadtree",
        "--error-px",
        "4",
    ];
    run("escarp-report", &arguments).ok();
    let index = read(&desk.path("reports").join("index.html"));
    check_html(&index);
    for name in ["demo", "demo-2"] {
        assert!(
            index.contains(&format!("href=\"{name}/report.html\"")),
            "{index}"
        );
        check_report(&desk.path("reports").join(name), &["quadtree"], &[4.0]);
    }
}

#[test]
fn bad_input_is_named_before_anything_is_measured() {
    let desk = Desk::new();
    let dataset = desk.dataset();
    let dataset = dataset.to_str().unwrap();
    let (out, flight) = (desk.name("out"), desk.name("flight.json"));
    std::fs::write(&flight, "{\"keys\":[]}").unwrap();
    std::fs::write(desk.path("taken"), "a file").unwrap();
    let taken = desk.name("taken");
    let missing = desk.name("missing.escarp");
    let long = vec!["1"; 33].join(",");
    for (code, words, arguments) in [
        (1, "missing.escarp", vec![missing.as_str(), "-o", &out]),
        (1, "cannot make the folder", vec![dataset, "-o", &taken]),
        (
            1,
            "number of keys is 0",
            vec![dataset, "-o", &out, "--path", &flight],
        ),
        (
            1,
            "cannot read",
            vec![dataset, "-o", &out, "--path", &missing],
        ),
        (
            2,
            "allowed are 0.05 to 1024 px",
            vec![dataset, "-o", &out, "--error-px", "0"],
        ),
        (
            2,
            "allowed are 0.05 to 1024 px",
            vec![dataset, "-o", &out, "--error-px", "NaN"],
        ),
        (
            2,
            "33 tolerances, allowed are 32",
            vec![dataset, "-o", &out, "--error-px", &long],
        ),
        (
            2,
            "is no mesher; there are: quadtree",
            vec![dataset, "-o", &out, "--meshers", "rome"],
        ),
        (
            2,
            "is no line",
            vec![dataset, "-o", &out, "--lines", "fast"],
        ),
        (2, "DATASET", vec!["-o", &out]),
        (2, "--output", vec![dataset]),
    ] {
        let ran = run("escarp-report", &arguments);
        assert_eq!(ran.code, Some(code), "{ran:?}");
        assert!(ran.err.contains(words), "{words:?} is not in {:?}", ran.err);
        assert!(!Path::new(&out).join("report.html").exists());
    }
}
