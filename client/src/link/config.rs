//! What a link is told once, and the waiting between attempts to connect.

use std::time::Duration;

/// What a link is told once.
#[derive(Debug, Clone)]
pub struct LinkConfig {
    /// Name of the dataset; empty means the only one that the server has.
    pub dataset: String,
    /// Proof of access, if the server asks for one.
    pub token: Option<String>,
    /// Whether the server may send what a View needs unasked, if it can. For a mesh that needs what
    /// the server's selection finds: the quadtree's.
    pub push: bool,
    /// Page bytes that the server may send ahead. At least two frames are granted.
    pub credit_window_bytes: u64,
    /// Pages asked for at a time, and not yet taken by [`poll_event`](super::Link::poll_event).
    pub max_in_flight_pages: usize,
    /// Least time between two Views.
    pub view_interval: Duration,
    /// Time between two Pings.
    pub ping_interval: Duration,
    /// How long Welcome may take. A large manifest on a slow line needs seconds.
    pub welcome_timeout: Duration,
    /// A server that is silent for so long after a Ping is taken for dead.
    pub silence_timeout: Duration,
    /// How long after a Busy the page is asked for again.
    pub busy_delay: Duration,
    /// Shortest wait before connecting again; it doubles with each failure.
    pub backoff_min: Duration,
    /// Longest wait before connecting again.
    pub backoff_max: Duration,
    /// Seed of the jitter that keeps many clients from coming back at once.
    pub jitter_seed: u64,
}

impl LinkConfig {
    /// The usual settings for a dataset, with a fixed seed: a program takes one that others have
    /// not, by [`seeded`](Self::seeded).
    pub fn new(dataset: impl Into<String>) -> LinkConfig {
        LinkConfig {
            dataset: dataset.into(),
            token: None,
            push: true,
            credit_window_bytes: 1 << 20,
            max_in_flight_pages: 1024,
            view_interval: Duration::from_millis(50),
            ping_interval: Duration::from_secs(5),
            welcome_timeout: Duration::from_secs(30),
            silence_timeout: Duration::from_secs(15),
            busy_delay: Duration::from_secs(1),
            backoff_min: Duration::from_millis(250),
            backoff_max: Duration::from_secs(15),
            jitter_seed: 0,
        }
    }

    /// The same with a seed of its own, so that clients which lose a server at one moment come back
    /// one after the other.
    #[must_use]
    pub fn seeded(self, jitter_seed: u64) -> LinkConfig {
        LinkConfig {
            jitter_seed,
            ..self
        }
    }
}

/// Exponential waiting: each failure in a row doubles it, up to a limit.
#[derive(Debug)]
pub(super) struct Backoff {
    least: Duration,
    most: Duration,
    failures: u32,
    random: u64,
}

impl Backoff {
    pub(super) fn new(config: &LinkConfig) -> Backoff {
        Backoff {
            least: config.backoff_min,
            most: config.backoff_max.max(config.backoff_min),
            failures: 0,
            random: config.jitter_seed,
        }
    }

    /// The next wait: between half of the current step and all of it.
    pub(super) fn next(&mut self) -> Duration {
        let step = self
            .least
            .saturating_mul(1 << self.failures.min(20))
            .min(self.most);
        self.failures = self.failures.saturating_add(1);
        step.mul_f64(0.5 + 0.5 * self.fraction())
    }

    /// A session that lived this long was no failure. A server that welcomes and drops us at once
    /// must not be asked without a pause.
    pub(super) fn session_lived(&mut self, lived: Duration) {
        if lived >= self.most {
            self.failures = 0;
        }
    }

    /// In `0..1`, by SplitMix64 (Steele, Lea, Flood: "Fast splittable pseudorandom number
    /// generators", 2014).
    fn fraction(&mut self) -> f64 {
        self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_up_to_the_limit_and_are_the_same_for_a_seed() {
        let config = LinkConfig::new("d");
        let waits = |n| {
            let mut backoff = Backoff::new(&config);
            (0..n).map(|_| backoff.next()).collect::<Vec<_>>()
        };
        assert_eq!(waits(100), waits(100));
        for (i, wait) in waits(100).into_iter().enumerate() {
            let step = (config.backoff_min * (1 << i.min(10))).min(config.backoff_max);
            assert!(wait >= step / 2 && wait <= step, "wait {i} is {wait:?}");
        }
    }

    #[test]
    fn with_seeds_of_their_own_a_thousand_clients_come_back_spread_over_half_the_wait() {
        let first = |seed| Backoff::new(&LinkConfig::new("d").seeded(seed)).next();
        let mut waits: Vec<Duration> = (0..1000).map(first).collect();
        waits.sort_unstable();
        let least = LinkConfig::new("d").backoff_min / 2;
        for (i, wait) in waits.into_iter().enumerate() {
            let even = least.mul_f64(1.0 + i as f64 / 1000.0);
            assert!(wait.abs_diff(even) < least / 10, "{i}: {wait:?}, {even:?}");
        }
    }

    #[test]
    fn a_long_session_starts_the_waiting_anew() {
        let config = LinkConfig::new("d");
        let mut backoff = Backoff::new(&config);
        for _ in 0..10 {
            backoff.next();
        }
        backoff.session_lived(config.backoff_max);
        assert!(backoff.next() <= config.backoff_min);
    }
}
