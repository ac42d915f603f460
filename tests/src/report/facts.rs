//! What was measured, where, and when.

use escarp_tiles::dataset::Dataset;
use serde::Serialize;
use std::time::{SystemTime, UNIX_EPOCH};

/// A dataset in a few words.
#[derive(Debug, Clone, Serialize)]
pub struct DatasetFacts {
    /// Its name.
    pub name: String,
    /// Files that it was built from.
    pub sources: Vec<String>,
    /// Columns and rows.
    pub samples: [u32; 2],
    /// Samples with data.
    pub valid_samples: u64,
    /// Distance of samples, east and north, metres.
    pub sample_spacing_m: [f64; 2],
    /// Lowest and highest height, metres.
    pub heights_m: [f64; 2],
    /// Unit of height, metres.
    pub quantum_m: f64,
    /// On disk, bytes.
    pub bytes: u64,
    /// Pages with a record.
    pub pages: u64,
}

impl DatasetFacts {
    /// Of a dataset.
    pub fn of(dataset: &Dataset) -> DatasetFacts {
        let manifest = dataset.manifest();
        let heights = manifest.height_range.unwrap_or([0, 0]);
        DatasetFacts {
            name: dataset.name().into(),
            sources: manifest.sources.clone(),
            samples: manifest.samples,
            valid_samples: manifest.valid_samples,
            sample_spacing_m: manifest.georef.sample_spacing_m,
            heights_m: heights.map(|height| manifest.georef.world_z(height)),
            quantum_m: manifest.georef.quantum_m,
            bytes: dataset.total_bytes(),
            pages: manifest.pages,
        }
    }
}

/// Where and when.
#[derive(Debug, Clone, Serialize)]
pub struct Machine {
    /// The processor, as the system names it.
    pub processor: String,
    /// Threads that may run at once.
    pub threads: usize,
    /// Operating system and architecture.
    pub system: String,
    /// Day of the measurement, UTC.
    pub date: String,
    /// Version of the program.
    pub version: String,
}

impl Machine {
    /// This one, now.
    pub fn here() -> Machine {
        let cpuinfo = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let model = cpuinfo
            .lines()
            .find_map(|line| line.strip_prefix("model name"))
            .and_then(|rest| rest.split_once(':'));
        let seconds = SystemTime::now().duration_since(UNIX_EPOCH);
        Machine {
            processor: model.map_or("unknown", |(_, name)| name.trim()).into(),
            threads: std::thread::available_parallelism().map_or(1, usize::from),
            system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            date: date(seconds.map_or(0, |since| since.as_secs() / 86_400)),
            version: env!("CARGO_PKG_VERSION").into(),
        }
    }
}

/// A day in the Gregorian calendar, from days since 1970 (E. G. Richards, "Mapping Time", 1998).
fn date(days: u64) -> String {
    let f = days + 2_440_588 + 1401 + (4 * (days + 2_440_588) + 274_277) / 146_097 * 3 / 4 - 38;
    let e = 4 * f + 3;
    let h = 5 * (e % 1461 / 4) + 2;
    let (day, month) = (h % 153 / 5 + 1, (h / 153 + 2) % 12 + 1);
    let year = e / 1461 + (14 - month) / 12 - 4716;
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_become_dates() {
        assert_eq!(date(0), "1970-01-01");
        assert_eq!(date(11_016), "2000-02-29");
        assert_eq!(date(20_779), "2026-11-22");
    }
}
