//! What goes before what, and what is refused with which words.

use super::*;
use std::fs;
use tempfile::TempDir;

/// A folder with a file of settings.
struct Desk {
    folder: TempDir,
}

impl Desk {
    fn new(text: &str) -> Desk {
        let desk = Desk {
            folder: tempfile::tempdir().unwrap(),
        };
        fs::write(desk.file(), text).unwrap();
        desk
    }

    fn file(&self) -> PathBuf {
        self.folder.path().join("escarp.toml")
    }

    fn flags(&self) -> Flags {
        Flags {
            config: Some(self.file()),
            ..Flags::default()
        }
    }

    fn read(&self) -> Result<Config, ConfigError> {
        with(&self.flags(), &[])
    }

    /// What is said about the file, without the folder's name.
    fn refused(&self) -> String {
        let folder = self.folder.path().join("");
        let said = self.read().unwrap_err().to_string();
        said.replace(&folder.display().to_string(), "")
    }
}

fn with(flags: &Flags, variables: &[(&str, &str)]) -> Result<Config, ConfigError> {
    let owned = |(name, value): &(&str, &str)| (name.to_string(), value.to_string());
    Config::of(flags, |_| Source::Flag, variables.iter().map(owned))
}

#[test]
fn flags_go_before_the_environment_that_before_the_file_and_it_before_defaults() {
    let desk = Desk::new(
        "listen = \"[::]:1\"\n[limits]\nsessions = 3\nconnections = 4\nwanted_pages = 50\n",
    );
    let file = |line| Source::File(desk.file(), line);
    let mut flags = desk.flags();
    flags.limit = vec!["sessions=7".into()];
    let variables = [
        ("ESCARP_LIMIT_SESSIONS", "5"),
        ("ESCARP_LIMIT_CONNECTIONS", "6"),
        ("HOME", "/"),
    ];
    let config = with(&flags, &variables).unwrap();
    assert_eq!(config.limits.sessions, 7);
    assert_eq!(config.limits.connections, 6);
    assert_eq!(config.limits.wanted_pages, 50);
    assert_eq!(config.limits.held_pages, Limits::default().held_pages);
    assert_eq!(
        (config.listen.value.as_str(), &config.listen.source),
        ("[::]:1", &file(1))
    );
    let sources: BTreeMap<_, _> = config
        .lines()
        .into_iter()
        .map(|line| (line.name, line.source))
        .collect();
    assert_eq!(sources["limits.sessions"], Source::Flag);
    assert_eq!(sources["limits.connections"], Source::Environment);
    assert_eq!(sources["limits.wanted_pages"], file(5));
    assert_eq!(sources["limits.held_pages"], Source::Default);
    flags.listen = Some("h:2".into());
    assert_eq!(with(&flags, &[]).unwrap().listen.value, "h:2");
}

#[test]
fn folders_come_from_the_command_line_or_the_environment_and_those_of_a_file_lie_beside_it() {
    let desk =
        Desk::new("datasets = [\"a.escarp\", \"/b.escarp\"]\ntls_cert = \"c\"\ntls_key = \"/k\"\n");
    let config = desk.read().unwrap();
    let beside = desk.folder.path();
    assert_eq!(
        config.datasets.value,
        [beside.join("a.escarp"), "/b.escarp".into()]
    );
    assert_eq!(
        config.tls(),
        Some((beside.join("c").as_path(), Path::new("/k")))
    );
    let variables = [("ESCARP_DATASETS", "x.escarp:/y.escarp")];
    let config = with(&desk.flags(), &variables).unwrap();
    assert_eq!(
        config.datasets.value,
        [PathBuf::from("x.escarp"), "/y.escarp".into()]
    );
    let flags = Flags {
        datasets: vec!["odd:name.escarp".into()],
        ..desk.flags()
    };
    let config = with(&flags, &variables).unwrap();
    assert_eq!(config.datasets.value, [PathBuf::from("odd:name.escarp")]);
}

#[test]
fn what_is_printed_can_be_read_and_means_the_same() {
    let desk = Desk::new(
        "origins = [\"https://a.example\"]\ntrusted_proxies = [\"::1\"]\nlog_format = \"json\"\n\
         drain_delay_s = 2.5\nlimit_loopback = true\ndatasets = [\"/a \\\"b\\\".escarp\"]\n\
         [limits]\nhello_timeout_s = 0.5\n[[access]]\ndatasets = \"x\"\norigins = [\"*\"]\n",
    );
    let config = desk.read().unwrap();
    let again = Desk::new(&config.print()).read().unwrap();
    assert_eq!(config.changes(&again), [""; 0]);
    assert_eq!(config.limits, again.limits);
    assert_eq!(config.access(), again.access());
    assert!(config.print().contains(":8"), "{}", config.print());
}

#[test]
fn the_example_is_right_and_shows_every_setting_with_its_default() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/escarp-server.toml");
    let flags = |path: &Path| Flags {
        config: Some(path.into()),
        ..Flags::default()
    };
    let example = with(&flags(&path), &[]).unwrap();
    assert_eq!(
        example.changes(&with(&Flags::default(), &[]).unwrap()),
        [""; 0]
    );
    for line in example.lines() {
        let from_file = matches!(line.source, Source::File(..));
        assert!(
            from_file || line.value.is_none(),
            "{} is not in the example",
            line.name
        );
    }
    // What is commented out holds as well, once the comment is taken away.
    let text = fs::read_to_string(&path).unwrap();
    let desk = Desk::new(&uncommented(&text));
    fs::write(
        desk.folder.path().join("survey.tokens"),
        "# one\n0123456789abcdef\n",
    )
    .unwrap();
    let whole = desk.read().unwrap();
    assert!(whole.tls().is_some() && whole.metrics_listen.value.is_some());
    let rule = &whole.rules[0].value;
    assert_eq!(rule.tokens.as_ref().unwrap().len(), 2);
    assert!(rule.origins.is_some());
}

/// Takes the comment from lines that are settings.
fn uncommented(text: &str) -> String {
    let setting = |line: &str| {
        let bare = line.strip_prefix("# ").unwrap_or(line);
        let name = bare.split(' ').next().unwrap_or("");
        let plain = name
            .bytes()
            .all(|byte| byte.is_ascii_lowercase() || byte == b'_');
        let is = bare.starts_with("[[") || plain && bare[name.len()..].starts_with(" = ");
        if is { bare.to_owned() } else { line.to_owned() }
    };
    text.lines().map(|line| setting(line) + "\n").collect()
}

#[test]
fn what_cannot_be_is_told_with_file_line_and_what_is_allowed() {
    let refused = |text: &str| Desk::new(text).refused();
    let typo = refused("\nlissen = \"x\"\n");
    assert!(
        typo.starts_with("escarp.toml: TOML parse error at line 2, column 1"),
        "{typo}"
    );
    assert!(
        typo.contains("unknown field `lissen`, expected one of `datasets`, `watch`"),
        "{typo}"
    );
    let kind = refused("listen = 3\n");
    assert!(
        kind.contains("line 1") && kind.contains("expected a string"),
        "{kind}"
    );
    assert_eq!(
        refused("[limits]\nsessions = 0\n"),
        "escarp.toml:2: sessions is 0; allowed are whole numbers from 1 to 1000000"
    );
    assert_eq!(
        refused("[limits]\nsessions = \"many\"\n"),
        "escarp.toml:2: sessions is a string; allowed is a number"
    );
    let unknown = refused("[limits]\n\nsession = 1\n");
    assert!(
        unknown
            .starts_with("escarp.toml:3: there is no limit \"session\"; there are connections, "),
        "{unknown}"
    );
    assert_eq!(
        refused("tls_cert = \"c\"\n"),
        "tls_cert (escarp.toml:1): without tls_key; give both"
    );
    assert_eq!(
        refused("drain_delay_s = -1\n"),
        "drain_delay_s (escarp.toml:1): -1; allowed are seconds from 0 to 3600"
    );
    let origin = refused("origins = [\"map.example\"]\n");
    assert!(
        origin.starts_with("origins (escarp.toml:1): the origin \"map.example\"; allowed are"),
        "{origin}"
    );
    let host = refused("hosts = [\"map.example:80\"]\n");
    assert!(
        host.starts_with("hosts (escarp.toml:1): the host \"map.example:80\"; allowed are"),
        "{host}"
    );
    assert_eq!(
        refused("listen = \"here\"\n"),
        "listen (escarp.toml:1): \"here\"; allowed is HOST:PORT, such as 127.0.0.1:8787 or \
         [::]:8787"
    );
    assert_eq!(
        refused("metrics_listen = \":99999\"\n").split(';').next(),
        Some("metrics_listen (escarp.toml:1): \":99999\"")
    );
    assert_eq!(
        refused("listen = \"[::]:80\"\nmetrics_listen = \"[::]:80\"\n"),
        "metrics_listen (escarp.toml:2): [::]:80, which is that of `listen`, too; give another one"
    );
    let proxy = refused("trusted_proxies = [\"10.0.0.0/99\"]\n");
    assert!(
        proxy.starts_with("trusted_proxies (escarp.toml:1): the proxy \"10.0.0.0/99\""),
        "{proxy}"
    );
    let short = refused("[[access]]\ndatasets = \"x\"\ntokens = [\"secret\"]\n");
    assert_eq!(
        short,
        "escarp.toml:1: a token of 6 bytes; allowed are 16 to 1024"
    );
    let missing = refused("[[access]]\ndatasets = \"x\"\ntoken_file = \"no\"\n");
    assert!(missing.starts_with("no: "), "{missing}");
    assert!(refused("[limits]\nping_interval_s = 60\n").contains("idle_timeout_s must be longer"));
}

#[test]
fn flags_and_variables_that_cannot_be_are_told_by_name() {
    let flag = |text: &str| {
        let flags = Flags {
            limit: vec![text.into()],
            ..Flags::default()
        };
        with(&flags, &[]).unwrap_err().to_string()
    };
    assert_eq!(
        flag("sessions"),
        "--limit: \"sessions\" is not NAME=VALUE with a number"
    );
    assert!(flag("sesions=4").starts_with("--limit: there is no limit \"sesions\"; there are"));
    let variable = |name, value| {
        with(&Flags::default(), &[(name, value)])
            .unwrap_err()
            .to_string()
    };
    assert_eq!(
        variable("ESCARP_LIMIT_SESSIONS", "x"),
        "ESCARP_LIMIT_SESSIONS: \"x\" is no number"
    );
    assert!(
        variable("ESCARP_LIMIT_SESSION", "1")
            .starts_with("ESCARP_LIMIT_SESSION: there is no limit")
    );
    let flags = Flags {
        config: Some("/no/such/file.toml".into()),
        ..Flags::default()
    };
    let missing = with(&flags, &[]).unwrap_err().to_string();
    assert!(missing.starts_with("/no/such/file.toml: "), "{missing}");
}

#[test]
fn where_only_this_machine_can_connect_it_is_addressed_by_its_own_names_alone() {
    let hosts = |text: &str| Desk::new(text).read().unwrap().hosts().unwrap();
    for local in ["", "listen = \"[::1]:1\"\n", "listen = \"localhost:1\"\n"] {
        assert_eq!(hosts(local), Hosts::local(), "{local}");
    }
    for open in [
        "listen = \"[::]:1\"\n",
        "listen = \"terrain.example:1\"\n",
        "trusted_proxies = [\"::1\"]\n",
        "hosts = [\"*\"]\n",
    ] {
        assert_eq!(hosts(open), Hosts::Any, "{open}");
    }
    let named = Hosts::parse(&["a.example"]).unwrap();
    assert_eq!(hosts("hosts = [\"a.example\"]\n"), named);
}

#[test]
fn tokens_are_not_shown() {
    let secret = "a-secret-of-some-length";
    let desk = Desk::new(&format!(
        "[[access]]\ndatasets = \"x\"\ntokens = [\"{secret}\"]\n"
    ));
    let config = desk.read().unwrap();
    assert!(config.access().unwrap().allows("x", Some(secret)));
    assert!(!config.print().contains(secret) && !format!("{config:?}").contains(secret));
}
