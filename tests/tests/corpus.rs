//! Replays what fuzzing has found, and the seeds from which it starts.

#[path = "../fuzz/src/targets/mod.rs"]
mod targets;

use escarp_proto::wire::{ClientMessage, ServerMessage};
use escarp_tests::programs::workspace;
use std::collections::BTreeSet;
use std::fs;

/// Runs a target on every file of its corpus; a panic names the file.
fn replay(target: &str) {
    let folder = workspace().join("tests/fuzz/corpus").join(target);
    let mut files: Vec<_> = fs::read_dir(&folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.expect("an entry").path())
        .collect();
    files.sort();
    assert!(!files.is_empty(), "{}: no files", folder.display());
    for file in files {
        println!("{}", file.display());
        targets::run(target, &fs::read(&file).expect("a file"));
    }
}

#[test]
fn hostile_records_of_the_corpus_are_refused_or_consistent() {
    replay("page");
}

#[test]
fn pages_of_the_corpus_are_the_same_in_both_codecs_after_every_part() {
    replay("codec");
}

#[test]
fn hostile_messages_and_manifests_of_the_corpus_are_refused_or_understood() {
    replay("wire");
}

#[test]
fn hostile_sequences_of_messages_of_the_corpus_end_or_are_answered_within_bounds() {
    replay("session");
}

#[test]
fn every_kind_of_message_is_among_the_seeds() {
    let folder = workspace().join("tests/fuzz/corpus/wire");
    let mut kinds = [BTreeSet::new(), BTreeSet::new()];
    for file in fs::read_dir(folder).expect("the corpus") {
        let bytes = fs::read(file.expect("an entry").path()).expect("a file");
        if ClientMessage::decode(&bytes).is_ok() {
            kinds[0].insert(bytes[0]);
        }
        if ServerMessage::decode(&bytes).is_ok() {
            kinds[1].insert(bytes[0]);
        }
    }
    assert_eq!(kinds[0], (0..9).collect());
    assert_eq!(kinds[1], (0..8).collect());
}

#[test]
fn hostile_words_of_the_corpus_are_refused_or_understood() {
    replay("text");
}

#[test]
fn hostile_files_of_the_corpus_are_refused_or_read() {
    replay("dem");
}

#[test]
fn hostile_headers_of_the_corpus_are_refused_or_read() {
    replay("side");
}

#[test]
fn hostile_packed_files_of_the_corpus_are_refused_or_read() {
    replay("packed");
}

#[test]
fn hostile_outlines_of_the_corpus_are_refused_or_kept_to() {
    replay("region");
}

#[test]
fn hostile_datasets_of_the_corpus_are_refused_or_read() {
    replay("dataset");
}

#[test]
fn hostile_journals_of_the_corpus_are_refused_or_resumed() {
    replay("journal");
}

#[test]
fn every_target_is_replayed_and_can_be_fuzzed() {
    for (target, _) in targets::TARGETS {
        let own = include_str!("corpus.rs");
        assert!(own.contains(&format!("replay(\"{target}\")")), "{target}");
        let path = workspace().join(format!("tests/fuzz/fuzz_targets/{target}.rs"));
        let text = fs::read_to_string(&path).expect("a target");
        assert!(text.contains(&format!("run(\"{target}\"")), "{target}");
    }
}
