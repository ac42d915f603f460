//! The text holds to the rules of the format (OpenMetrics 1.0, section 4), and says what happened.

use super::*;
use std::collections::BTreeSet;

/// Checks the format line by line, and gives the samples: name with labels, value.
pub(crate) fn samples(text: &str) -> BTreeMap<String, f64> {
    let mut found = BTreeMap::new();
    let (mut families, mut current) = (BTreeSet::new(), String::new());
    let body = text.strip_suffix("# EOF\n").expect("an end");
    for line in body.lines() {
        if let Some(help) = line.strip_prefix("# HELP ") {
            current = help.split(' ').next().expect("a name").to_owned();
            assert!(families.insert(current.clone()), "{current} comes twice");
        } else if let Some(kind) = line.strip_prefix("# TYPE ") {
            let (name, kind) = kind.split_once(' ').expect("name and type");
            assert_eq!(name, current, "TYPE follows its HELP");
            assert!(
                ["counter", "gauge", "histogram", "info"].contains(&kind),
                "{line}"
            );
        } else {
            let (name, value) = line.rsplit_once(' ').expect("name and value");
            assert!(name.starts_with(&current), "{line} stands under {current}");
            let value = value.parse().unwrap_or_else(|_| panic!("{line}"));
            let again = found.insert(name.to_owned(), value);
            assert!(again.is_none(), "{name} comes twice");
        }
    }
    found
}

fn moon(dataset: &str) -> [Stand; 1] {
    [Stand {
        dataset: dataset.into(),
        generation: 3,
        pages: 5,
    }]
}

#[test]
fn the_text_keeps_the_rules_of_the_format_and_counters_rise() {
    let metrics = Metrics::new();
    let moon = moon("moon");
    let before = samples(&metrics.render(&moon).unwrap());
    assert_eq!(before["escarp_sessions_total"], 0.0);
    assert_eq!(before["escarp_dataset_generation{dataset=\"moon\"}"], 3.0);
    metrics.sessions.inc();
    metrics.session_refused(Refusal::Full);
    metrics.session_ended(Ended::Lost);
    metrics.limited(Limited::Request);
    metrics.tls_failed(TlsFailure::NotTls);
    metrics.selection_seconds.observe(0.001);
    let took = Duration::from_micros(50);
    metrics.request_answered(Some("/{name}/manifest"), 200, 70, took);
    metrics.request_answered(Some("/{name}/manifest"), 200, 30, took);
    metrics.request_answered(None, 404, 10, took);
    let after = samples(&metrics.render(&moon).unwrap());
    let is = |name: &str, value: f64| assert_eq!(after.get(name), Some(&value), "{name}");
    is("escarp_sessions_total", 1.0);
    is("escarp_sessions_refused_total{reason=\"full\"}", 1.0);
    is("escarp_sessions_ended_total{reason=\"lost\"}", 1.0);
    is("escarp_limited_total{what=\"request\"}", 1.0);
    is("escarp_tls_failures_total{reason=\"not_tls\"}", 1.0);
    is("escarp_selection_seconds_count", 1.0);
    is(
        "escarp_http_requests_total{route=\"/{name}/manifest\",status=\"200\"}",
        2.0,
    );
    is(
        "escarp_http_requests_total{route=\"none\",status=\"404\"}",
        1.0,
    );
    is(
        "escarp_http_response_bytes_total{route=\"/{name}/manifest\"}",
        100.0,
    );
    for (name, value) in before.iter().filter(|(name, _)| name.contains("_total")) {
        assert!(after[name] >= *value, "{name} fell");
    }
}

#[test]
fn a_name_with_quotes_and_backslashes_is_one_label() {
    let text = Metrics::new().render(&moon("a\"b\\c")).unwrap();
    let line = "escarp_dataset_generation{dataset=\"a\\\"b\\\\c\"} 3";
    assert!(text.lines().any(|found| found == line), "{text}");
}

#[test]
fn shares_sum_up_and_leave_nothing_behind() {
    let gauge = Gauge::default();
    let (mut one, mut other) = (Share::of(&gauge), Share::one(&gauge));
    one.set(5);
    other.set(7);
    one.set(2);
    assert_eq!(gauge.get(), 9);
    drop((one, other));
    assert_eq!(gauge.get(), 0);
}

#[cfg(target_os = "linux")]
#[test]
fn the_process_is_described() {
    let found = samples(&Metrics::new().render(&moon("moon")).unwrap());
    assert!(found["process_resident_memory_bytes"] > 1e6);
    assert!(found["process_open_fds"] >= 3.0);
    assert!(found["process_max_fds"] >= found["process_open_fds"]);
}
