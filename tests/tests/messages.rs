//! What the programs say to wrong arguments and unfit files: messages and exit codes.

use escarp_tests::inputs::{Registered, Stored, write_png, write_tiff};
use escarp_tests::programs::{Desk, Ran, run};

#[test]
fn wrong_usage_ends_with_2_and_help_with_0() {
    let calls: [(&str, &[&str]); 12] = [
        ("escarp-tiles", &[]),
        ("escarp-tiles", &["build"]),
        ("escarp-tiles", &["build", "a.tif"]),
        (
            "escarp-tiles",
            &["build", "a.tif", "-o", "b", "--lossless", "--quantum", "1"],
        ),
        ("escarp-tiles", &["sample", "-o", "a.tif", "--size", "many"]),
        ("escarp-server", &[]),
        ("escarp-server", &["--what"]),
        ("escarp-client", &["snapshot"]),
        (
            "escarp-client",
            &["snapshot", "http://127.0.0.1:1/a/b", "-o", "c.png"],
        ),
        (
            "escarp-client",
            &["snapshot", "ftp://127.0.0.1/a", "-o", "c.png"],
        ),
        (
            "escarp-client",
            &["snapshot", "127.0.0.1:1/a", "-o", "c.png", "--size", "0x9"],
        ),
        (
            "escarp-client",
            &["snapshot", "127.0.0.1:1/a", "-o", "c.png", "--eye", "1,2"],
        ),
    ];
    for (name, arguments) in calls {
        let ran = run(name, arguments);
        assert_eq!(ran.code, Some(2), "{name} {arguments:?}: {ran:?}");
        assert!(
            !ran.err.is_empty() && ran.out.is_empty(),
            "{name} {arguments:?}: {ran:?}"
        );
    }
    for name in ["escarp-tiles", "escarp-server", "escarp-client"] {
        let help = run(name, &["--help"]).ok();
        assert!(
            help.contains("Examples:") && help.contains("Exit codes:"),
            "{name}: {help}"
        );
    }
}

/// Builds of a file that is not as it should be: exit code 1, no dataset, one message that names
/// the file and says all of these words.
fn refused(desk: &Desk, file: &str, words: &[&str]) {
    let out = desk.name("refused.escarp");
    let ran: Ran = run("escarp-tiles", &["build", &desk.name(file), "-o", &out]);
    assert_eq!(ran.code, Some(1), "{file}: {ran:?}");
    assert!(
        ran.err.contains(&desk.name(file)),
        "{file} is not named: {ran:?}"
    );
    for word in words {
        assert!(ran.err.contains(word), "{file}: no {word:?} in {ran:?}");
    }
    assert!(
        ran.err.starts_with("error: ") && !ran.err.contains("panicked"),
        "{ran:?}"
    );
    assert_eq!(
        run("escarp-tiles", &["info", &out]).code,
        Some(1),
        "{file} made a dataset"
    );
}

#[test]
fn inputs_that_cannot_be_used_are_named_with_what_to_do() {
    let desk = Desk::new();
    std::fs::write(desk.path("letter.tif"), "Dear Sir or Madam").unwrap();
    refused(&desk, "letter.tif", &["not a DEM", "Dear Sir", "GeoTIFF"]);
    refused(&desk, "missing.tif", &["open"]);
    write_png(&desk.path("map.png"), [40, 30], |column, row| {
        f64::from(column + row)
    });
    refused(&desk, "map.png", &["no georeference", "--spacing"]);
    std::fs::write(desk.path("map.hgt"), vec![0; 2 * 1201 * 1201]).unwrap();
    refused(&desk, "map.hgt", &["N36W115.hgt"]);
    std::fs::write(desk.path("N10E020.hgt"), vec![0; 2 * 1201 * 1200]).unwrap();
    refused(&desk, "N10E020.hgt", &["1201 x 1201"]);

    let heights = |column, row| f64::from(column * row);
    write_tiff(
        &desk.path("whole.tif"),
        [90, 70],
        Registered::Cell,
        Stored::F32,
        heights,
    );
    let whole = std::fs::read(desk.path("whole.tif")).unwrap();
    for part in [1, 2, 7, 9] {
        let name = format!("cut-{part}.tif");
        std::fs::write(desk.path(&name), &whole[..whole.len() * part / 10]).unwrap();
        refused(&desk, &name, &[]);
    }
    let nan = |_, _| f64::NAN;
    write_tiff(
        &desk.path("nan.tif"),
        [90, 70],
        Registered::Cell,
        Stored::F32,
        nan,
    );
    refused(&desk, "nan.tif", &["no sample has data"]);
    let large = |column, _| if column == 31 { 1e30 } else { 1.0 };
    write_tiff(
        &desk.path("large.tif"),
        [90, 70],
        Registered::Cell,
        Stored::F32,
        large,
    );
    refused(&desk, "large.tif", &["31"]);
}

#[test]
fn what_is_no_dataset_is_not_hosted() {
    let desk = Desk::new();
    let (none, empty) = (desk.name("none.escarp"), desk.name("empty.escarp"));
    std::fs::create_dir(&empty).unwrap();
    for (folder, words) in [(&none, "no such folder"), (&empty, "build it again")] {
        let ran = run("escarp-server", &[folder, "--listen", "127.0.0.1:0"]);
        assert_eq!(ran.code, Some(1), "{ran:?}");
        assert!(
            ran.err.contains(&**folder) && ran.err.contains(words),
            "{ran:?}"
        );
    }
    let dataset = desk.name("demo.escarp");
    desk.dataset();
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let ran = run("escarp-server", &[&dataset, "--listen", &address]);
    assert!(ran.code == Some(1) && ran.err.contains(&address), "{ran:?}");
    assert!(ran.err.contains("--listen"), "{ran:?}");
    let ran = run(
        "escarp-server",
        &[&dataset, &dataset, "--listen", "127.0.0.1:0"],
    );
    assert!(
        ran.code == Some(2) && ran.err.contains("two datasets"),
        "{ran:?}"
    );
}
