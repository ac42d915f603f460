//! The program's exit codes, and what it says on its way out.

use std::process::{Command, Output};

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_escarp-server"))
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn without_a_dataset_the_usage_is_shown() {
    let output = run(&[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .contains("NAME.escarp")
    );
}

#[test]
fn what_is_no_dataset_is_named_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let unfinished = folder.path().to_str().unwrap();
    let missing = folder.path().join("no.escarp");
    for path in [unfinished, missing.to_str().unwrap(), file!()] {
        let output = run(&[path]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.starts_with(&format!("error: {path}: ")), "{said}");
        assert!(said.contains("build"), "{said}");
        assert!(output.stdout.is_empty());
    }
}
