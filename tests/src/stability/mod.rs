//! Stiff and extreme cases, and the numerics of every formula that meets the GPU: each a row of a
//! case, what must hold, what was measured, and a verdict.
//!
//! In reading order: rows and groups here, their [rendering](render), the [stage] on which a mesh
//! is examined, one file for each group of cases, and the [numerics].

use std::fmt::{self, Display};
use std::panic::{AssertUnwindSafe, catch_unwind};

pub mod render;

mod stage;

mod deep;
mod eyes;
mod input;
mod memory;
mod motion;
mod real;
mod scales;
mod shapes;

pub mod numerics;

/// What came of a case.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Verdict {
    /// What must hold does.
    Holds,
    /// It holds up to a limit that lies in the nature of things, which is stated.
    Bounded(String),
    /// It does not.
    Fails(String),
}

impl Verdict {
    /// `holds`, `bounded` or `fails`.
    pub const fn name(&self) -> &'static str {
        match self {
            Verdict::Holds => "holds",
            Verdict::Bounded(_) => "bounded",
            Verdict::Fails(_) => "fails",
        }
    }

    /// Whether it fails.
    pub const fn is_failure(&self) -> bool {
        matches!(self, Verdict::Fails(_))
    }

    /// [`Holds`](Self::Holds), or a failure that says why.
    pub fn of(holds: bool, otherwise: impl FnOnce() -> String) -> Verdict {
        if holds {
            Verdict::Holds
        } else {
            Verdict::Fails(otherwise())
        }
    }
}

impl Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Verdict::Holds => f.write_str("holds"),
            Verdict::Bounded(by) => write!(f, "bounded by {by}"),
            Verdict::Fails(why) => write!(f, "fails: {why}"),
        }
    }
}

/// What a case came to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outcome {
    /// What was measured, in words and figures.
    pub measured: String,
    /// Whether what must hold does.
    pub verdict: Verdict,
}

impl Outcome {
    /// What was measured, and whether it is as it must be.
    pub fn of(holds: bool, measured: impl Into<String>) -> Outcome {
        let measured = measured.into();
        let verdict = Verdict::of(holds, || "see what was measured".into());
        Outcome { measured, verdict }
    }
}

/// A case: how it is put to the test, and what must hold.
pub struct Case {
    /// In a few words.
    pub name: String,
    /// What must hold.
    pub invariant: String,
    /// Why it is known not to, until that is mended.
    pub known: Option<&'static str>,
    check: Box<dyn Fn() -> Outcome + Send + Sync>,
}

impl Case {
    /// A case that must hold.
    pub fn new(
        name: impl Into<String>,
        invariant: impl Into<String>,
        check: impl Fn() -> Outcome + Send + Sync + 'static,
    ) -> Case {
        Case {
            name: name.into(),
            invariant: invariant.into(),
            known: None,
            check: Box::new(check),
        }
    }

    /// A case that is known to fail.
    pub fn known_to_fail(mut self, why: &'static str) -> Case {
        self.known = Some(why);
        self
    }

    /// Puts it to the test. A panic is a failure.
    pub fn row(&self, group: &'static str) -> Row {
        let outcome = catch_unwind(AssertUnwindSafe(&self.check)).unwrap_or_else(|panic| {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
            Outcome {
                measured: "a panic".into(),
                verdict: Verdict::Fails(text.unwrap_or("it panics").into()),
            }
        });
        Row {
            group,
            case: self.name.clone(),
            invariant: self.invariant.clone(),
            measured: outcome.measured,
            verdict: outcome.verdict,
            known: self.known,
        }
    }
}

/// A row of the table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Row {
    /// Heading that it stands under.
    pub group: &'static str,
    /// The case.
    pub case: String,
    /// What must hold.
    pub invariant: String,
    /// What was measured.
    pub measured: String,
    /// What came of it.
    pub verdict: Verdict,
    /// Why it is known to fail, if it is.
    pub known: Option<&'static str>,
}

impl Row {
    /// Whether it came out as expected: a known failure fails, everything else does not.
    pub fn is_expected(&self) -> bool {
        self.verdict.is_failure() == self.known.is_some()
    }
}

/// Cases under one heading.
pub struct Group {
    /// The heading.
    pub name: &'static str,
    /// Its cases.
    pub cases: fn() -> Vec<Case>,
}

/// All groups, in the order of the table.
pub const GROUPS: &[Group] = &[
    Group {
        name: "Shapes of the ground",
        cases: shapes::cases,
    },
    Group {
        name: "The promise on real ground",
        cases: real::cases,
    },
    Group {
        name: "Scales and coordinates",
        cases: scales::cases,
    },
    Group {
        name: "Eyes and views",
        cases: eyes::cases,
    },
    Group {
        name: "Input that is no number, or out of range",
        cases: input::cases,
    },
    Group {
        name: "Motion",
        cases: motion::cases,
    },
    Group {
        name: "Leaps",
        cases: motion::leaps,
    },
    Group {
        name: "Memory and missing pages",
        cases: memory::cases,
    },
    Group {
        name: "Depth of the grid",
        cases: deep::cases,
    },
    Group {
        name: "Numerics: single against double precision and exact integers",
        cases: numerics::cases,
    },
    Group {
        name: "Numerics: conditioning",
        cases: numerics::conditioning_cases,
    },
];

/// How many cases there are.
pub fn cases() -> u64 {
    let cases = GROUPS.iter().map(|group| (group.cases)().len() as u64);
    cases.sum()
}

/// Runs all cases, and says before each which it is.
pub fn run(progress: &dyn Fn(&str)) -> Vec<Row> {
    let mut rows = Vec::new();
    for group in GROUPS {
        for case in (group.cases)() {
            progress(&format!("{}: {}", group.name, case.name));
            rows.push(case.row(group.name));
        }
    }
    rows
}
