//! The limits by name, so that a configuration can set them, each with its range.

use super::Limits;
use std::time::Duration;

/// One limit.
pub struct Entry {
    /// As in a configuration; `_s` at the end says that it is in seconds.
    pub name: &'static str,
    /// Smallest and largest value.
    pub range: [f64; 2],
    get: fn(&Limits) -> f64,
    set: fn(&mut Limits, f64),
}

impl Entry {
    /// The limit of a name.
    pub fn named(name: &str) -> Option<&'static Entry> {
        ENTRIES.iter().find(|entry| entry.name == name)
    }

    /// The value that is set.
    pub fn get(&self, limits: &Limits) -> f64 {
        (self.get)(limits)
    }

    /// Sets a value.
    ///
    /// # Errors
    /// What is allowed, if this is not.
    pub fn set(&self, limits: &mut Limits, value: f64) -> Result<(), String> {
        let [least, most] = self.range;
        let whole = self.is_time() || value.fract() == 0.0;
        if !(least..=most).contains(&value) || !whole {
            let kind = if self.is_time() {
                "seconds"
            } else {
                "whole numbers"
            };
            let name = self.name;
            return Err(format!(
                "{name} is {value}; allowed are {kind} from {least} to {most}"
            ));
        }
        (self.set)(limits, value);
        Ok(())
    }

    fn is_time(&self) -> bool {
        self.name.ends_with("_s")
    }
}

macro_rules! count {
    ($field:ident, $least:literal, $most:literal) => {
        Entry {
            name: stringify!($field),
            range: [$least as f64, $most as f64],
            get: |limits| limits.$field as f64,
            set: |limits, value| limits.$field = value as _,
        }
    };
}

macro_rules! height {
    ($field:ident, $least:literal, $most:literal) => {
        Entry {
            name: concat!("heights_", stringify!($field)),
            range: [$least as f64, $most as f64],
            get: |limits| limits.heights.$field as f64,
            set: |limits, value| limits.heights.$field = value as _,
        }
    };
}

macro_rules! seconds {
    ($field:ident, $least:literal, $most:literal) => {
        Entry {
            name: concat!(stringify!($field), "_s"),
            range: [$least as f64, $most as f64],
            get: |limits| limits.$field.as_secs_f64(),
            set: |limits, value| limits.$field = Duration::from_secs_f64(value),
        }
    };
}

/// All limits, in the order of [`Limits`]. The largest values are those that a machine of 2026 can
/// be asked for.
pub static ENTRIES: &[Entry] = &[
    count!(connections, 1, 1_000_000),
    count!(sessions, 1, 1_000_000),
    count!(connections_per_address, 0, 1_000_000),
    count!(sessions_per_address, 0, 1_000_000),
    count!(requests_per_second_per_address, 0, 1_000_000),
    count!(request_burst_per_address, 1, 1_000_000),
    count!(kept_bytes, 0, 1_000_000_000_000_u64),
    count!(wanted_pages, 16, 1_000_000),
    count!(views_per_second, 1, 1000),
    count!(queued_replies, 16, 1_000_000),
    count!(held_pages, 0, 1_000_000),
    count!(pushed_pages, 0, 100_000),
    seconds!(look_ahead, 0, 2),
    seconds!(hello_timeout, 0.1, 600),
    seconds!(ping_interval, 0.1, 3600),
    seconds!(idle_timeout, 0.2, 86400),
    seconds!(send_timeout, 0.1, 3600),
    seconds!(close_timeout, 0.01, 60),
    seconds!(drain_timeout, 0.01, 3600),
    height!(batch_points, 1, 1_000_000),
    height!(profile_samples, 2, 1_000_000),
    height!(pages, 16, 100_000_000),
    height!(sight_steps, 1000, 100_000_000_000_u64),
    height!(viewshed_steps, 1000, 100_000_000_000_u64),
    height!(viewshed_side_px, 1, 16_384),
    height!(window_samples, 1024, 1_073_741_824),
    height!(overview_side_px, 16, 16_384),
    height!(requests, 1, 1000),
    height!(images, 1, 1000),
    height!(waiting, 0, 100_000),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_limit_can_be_configured() {
        let shown = format!("{:#?}", Limits::default());
        let fields = shown.lines().filter_map(|line| line.strip_prefix("    "));
        let fields: Vec<_> = fields
            .filter_map(|line| line.split_once(": ").map(|(name, _)| name))
            .filter(|name| *name != "heights")
            .map(|name| match name.strip_prefix("    ") {
                Some(nested) => format!("heights_{nested}"),
                None => name.to_owned(),
            })
            .collect();
        let names: Vec<_> = ENTRIES
            .iter()
            .map(|entry| {
                entry
                    .name
                    .strip_suffix("_s")
                    .unwrap_or(entry.name)
                    .to_owned()
            })
            .collect();
        assert_eq!(
            names, fields,
            "add it to ENTRIES, and to docs/escarp-server.toml"
        );
    }

    #[test]
    fn defaults_are_in_their_ranges_and_what_is_set_is_what_is_got() {
        for entry in ENTRIES {
            let mut limits = Limits::default();
            let value = entry.get(&limits);
            assert_eq!(entry.set(&mut limits, value), Ok(()), "{}", entry.name);
            assert_eq!(limits, Limits::default());
            for end in entry.range {
                entry.set(&mut limits, end).unwrap();
                assert!((entry.get(&limits) - end).abs() < 1e-6, "{}", entry.name);
            }
            for wrong in [
                entry.range[0] - 1.0,
                entry.range[1] + 1.0,
                f64::NAN,
                f64::INFINITY,
            ] {
                assert!(
                    entry.set(&mut limits, wrong).is_err(),
                    "{} {wrong}",
                    entry.name
                );
            }
        }
    }

    #[test]
    fn a_value_out_of_range_is_told_with_what_is_allowed() {
        let set = |name, value| {
            let mut limits = Limits::default();
            Entry::named(name)
                .unwrap()
                .set(&mut limits, value)
                .unwrap_err()
        };
        assert_eq!(
            set("sessions", 0.0),
            "sessions is 0; allowed are whole numbers from 1 to 1000000"
        );
        assert_eq!(
            set("sessions", 1.5),
            "sessions is 1.5; allowed are whole numbers from 1 to 1000000"
        );
        assert_eq!(
            set("hello_timeout_s", 1e9),
            "hello_timeout_s is 1000000000; allowed are seconds from 0.1 to 600"
        );
    }
}
