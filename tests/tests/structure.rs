//! The direction in which the crates depend on each other, and what each of them may name.

use escarp_tests::programs::workspace;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Crates that open sockets, or run asynchronous code.
const NETWORK: [&str; 14] = [
    "async-io",
    "async-std",
    "axum",
    "futures-core",
    "futures-util",
    "hyper",
    "hyper-util",
    "mio",
    "polling",
    "smol",
    "socket2",
    "tokio",
    "tokio-tungstenite",
    "tungstenite",
];

/// Sources of the programs.
const SOURCES: [&str; 5] = [
    "client/src",
    "server/src",
    "tiles/src",
    "dataset/src",
    "proto/src",
];

/// The packages and what each depends on, of the kinds that end up in its library.
struct Packages {
    names: BTreeMap<String, String>,
    normal: BTreeMap<String, Vec<String>>,
    all: BTreeMap<String, Vec<String>>,
}

impl Packages {
    /// Asks cargo, for the machine at hand.
    fn read() -> Packages {
        let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
        let version = run(Command::new("rustc").arg("-vV"));
        let host = version
            .lines()
            .find_map(|line| line.strip_prefix("host: "))
            .expect("a host");
        let json = run(Command::new(cargo)
            .args([
                "metadata",
                "--format-version",
                "1",
                "--offline",
                "--filter-platform",
                host,
            ])
            .current_dir(workspace()));
        let json: Value = serde_json::from_str(&json).expect("JSON");
        let mut packages = Packages {
            names: BTreeMap::new(),
            normal: BTreeMap::new(),
            all: BTreeMap::new(),
        };
        for package in list(&json["packages"]) {
            packages
                .names
                .insert(text(&package["id"]), text(&package["name"]));
        }
        for node in list(&json["resolve"]["nodes"]) {
            let id = text(&node["id"]);
            let is_normal = |dependency: &&Value| {
                list(&dependency["dep_kinds"])
                    .iter()
                    .any(|kind| kind["kind"].is_null())
            };
            let dependencies = list(&node["deps"]);
            let ids = |dependency: &Value| text(&dependency["pkg"]);
            let normal = dependencies.iter().filter(is_normal).map(ids).collect();
            packages.normal.insert(id.clone(), normal);
            packages
                .all
                .insert(id, dependencies.iter().map(ids).collect());
        }
        packages
    }

    fn id(&self, name: &str) -> &String {
        let found = self.names.iter().find(|(_, its)| *its == name);
        found.unwrap_or_else(|| panic!("no package {name}")).0
    }

    /// All that a package is built with, itself left out.
    fn below(&self, name: &str) -> BTreeSet<&str> {
        let mut seen = BTreeSet::new();
        let mut next = vec![self.id(name)];
        while let Some(id) = next.pop() {
            for below in &self.normal[id] {
                if seen.insert(self.names[below].as_str()) {
                    next.push(below);
                }
            }
        }
        seen
    }

    /// The workspace's packages that one names in its manifest, for tests included.
    fn named(&self, name: &str) -> BTreeSet<&str> {
        let below = self.all[self.id(name)]
            .iter()
            .map(|id| self.names[id].as_str());
        below.filter(|name| name.starts_with("escarp-")).collect()
    }
}

fn run(command: &mut Command) -> String {
    let output = command.output().expect("the program runs");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8(output.stdout).expect("UTF-8")
}

fn list(value: &Value) -> &[Value] {
    value.as_array().expect("a list")
}

fn text(value: &Value) -> String {
    value.as_str().expect("a text").to_owned()
}

/// Rust files below a folder of the workspace, tests of its own left out.
fn sources(folder: &str) -> Vec<PathBuf> {
    let mut files = Vec::new();
    let mut next = vec![workspace().join(folder)];
    while let Some(path) = next.pop() {
        if path.is_file() {
            files.push(path);
            continue;
        }
        let entries = std::fs::read_dir(&path).unwrap_or_else(|e| panic!("{path:?}: {e}"));
        next.extend(entries.map(|entry| entry.unwrap().path()).filter(|path| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            (path.is_dir() || name.ends_with(".rs")) && name != "tests" && name != "tests.rs"
        }));
    }
    assert!(!files.is_empty(), "no sources in {folder}");
    files
}

/// Whether a file says a word outside of comments and of the tests at its end.
fn says(path: &Path, word: &str) -> bool {
    let source = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{path:?}: {e}"));
    let code = source
        .split("#[cfg(test)]\nmod tests {")
        .next()
        .unwrap_or_default();
    let lines = code
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"));
    lines.into_iter().any(|line| line.contains(word))
}

fn refuse(folder: &str, words: &[&str]) {
    for path in sources(folder) {
        for word in words {
            assert!(!says(&path, word), "{} says {word}", path.display());
        }
    }
}

#[test]
fn the_crates_depend_on_each_other_in_one_direction() {
    let packages = Packages::read();
    assert_eq!(packages.named("escarp-proto"), BTreeSet::new());
    assert_eq!(
        packages.named("escarp-dataset"),
        BTreeSet::from(["escarp-proto"])
    );
    // What writes a dataset's files is below both the build and `pull`; the build is not below
    // the client.
    for package in ["escarp-tiles", "escarp-client"] {
        assert_eq!(
            packages.named(package),
            BTreeSet::from(["escarp-dataset", "escarp-proto"])
        );
    }
    assert_eq!(
        packages.named("escarp-server"),
        BTreeSet::from(["escarp-proto", "escarp-tiles"])
    );
    let client = packages.below("escarp-client");
    assert!(!client.contains("escarp-tiles") && !client.contains("escarp-server"));
    assert!(
        client.contains("wgpu") && client.contains("escarp-proto"),
        "{client:?}"
    );
}

#[test]
fn the_server_and_the_tiles_are_built_without_graphics() {
    let packages = Packages::read();
    for package in [
        "escarp-server",
        "escarp-tiles",
        "escarp-dataset",
        "escarp-proto",
    ] {
        let below = packages.below(package);
        for name in [
            "wgpu",
            "wgpu-hal",
            "winit",
            "egui",
            "egui-wgpu",
            "egui-winit",
            "glam",
        ] {
            assert!(!below.contains(name), "{package} depends on {name}");
        }
    }
}

#[test]
fn the_protocol_and_the_tiles_are_built_without_sockets() {
    let packages = Packages::read();
    for package in ["escarp-proto", "escarp-dataset", "escarp-tiles"] {
        let below = packages.below(package);
        for name in NETWORK {
            assert!(!below.contains(name), "{package} depends on {name}");
        }
    }
    refuse(
        "proto/src",
        &["std::net", "std::thread", "async ", ".await"],
    );
    assert!(
        packages.below("escarp-server").contains("tokio"),
        "the check sees nothing"
    );
}

#[test]
fn graphics_are_named_under_one_folder_only() {
    let render = workspace().join("client/src/render");
    let mut inside = 0;
    for folder in SOURCES {
        for path in sources(folder) {
            if path.starts_with(&render) {
                inside += usize::from(says(&path, "wgpu"));
            } else {
                assert!(!says(&path, "wgpu"), "{} says wgpu", path.display());
            }
        }
    }
    assert!(inside > 0, "nothing says wgpu: the check sees nothing");
}

#[test]
fn the_core_of_the_client_has_no_sockets_threads_or_clock() {
    let words = [
        "std::net",
        "std::thread",
        "Instant",
        "SystemTime",
        "tokio",
        "tungstenite",
        "async ",
        ".await",
    ];
    for folder in [
        "client/src/mesh",
        "client/src/link",
        "client/src/terrain.rs",
        "client/src/lost.rs",
        "client/src/stages.rs",
        "client/src/governor",
    ] {
        refuse(folder, &words);
    }
    // The server's core likewise.
    refuse("server/src/session", &words[..5]);
}

#[test]
fn unsafe_code_is_at_the_one_place_that_maps_files() {
    for folder in SOURCES {
        for path in sources(folder) {
            let mapping = path.ends_with("dataset/src/map.rs");
            assert_eq!(says(&path, "unsafe {"), mapping, "{}", path.display());
        }
    }
}
