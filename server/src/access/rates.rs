//! What one address may have at a time, and how often it may ask.
//!
//! Requests are counted by a bucket that fills at a rate and overflows at a burst (a token bucket;
//! Turner, "New directions in communications", 1986). The table of addresses is bounded: those
//! that have nothing open and a full bucket are forgotten, and while too many do not, newcomers
//! share one place in it.

use super::Address;
use crate::limits::Limits;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Addresses that are told apart at a time: about 5 MiB.
const MAX_ADDRESSES: usize = 1 << 16;
/// How often a full table is looked through for addresses to forget.
const SWEEP_INTERVAL: Duration = Duration::from_secs(1);

/// The limits, and who has what.
#[derive(Debug)]
pub struct Rates {
    /// 0: any number.
    connections: usize,
    sessions: usize,
    requests_per_second: f64,
    burst: f64,
    table: Mutex<Table>,
}

#[derive(Debug)]
struct Table {
    most: usize,
    entries: HashMap<Address, Entry>,
    /// Of all that found no place.
    others: Entry,
    swept: Option<Duration>,
}

/// What an address has.
#[derive(Debug, Clone, Copy, Default)]
struct Entry {
    connections: usize,
    sessions: usize,
    /// Requests made, less what the rate gave back.
    spent: f64,
    at: Duration,
}

/// What can be held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Connection,
    Session,
}

/// A connection or session that counts for an address until it is dropped.
#[derive(Debug)]
pub struct Place {
    rates: Arc<Rates>,
    address: Address,
    kind: Kind,
    shared: bool,
}

impl Rates {
    /// With nothing held by anybody.
    pub fn new(limits: &Limits) -> Rates {
        Rates::with_room(limits, MAX_ADDRESSES)
    }

    fn with_room(limits: &Limits, most: usize) -> Rates {
        let rate = f64::from(limits.requests_per_second_per_address);
        let table = Table {
            most,
            entries: HashMap::new(),
            others: Entry::default(),
            swept: None,
        };
        Rates {
            connections: limits.connections_per_address,
            sessions: limits.sessions_per_address,
            requests_per_second: rate,
            burst: f64::from(limits.request_burst_per_address).max(1.0),
            table: Mutex::new(table),
        }
    }

    /// A place for a connection, unless the address has too many. Times never fall.
    pub fn connection(self: &Arc<Self>, address: Address, now: Duration) -> Option<Place> {
        self.place(address, Kind::Connection, now)
    }

    /// A place for a session, unless the address has too many.
    pub fn session(self: &Arc<Self>, address: Address, now: Duration) -> Option<Place> {
        self.place(address, Kind::Session, now)
    }

    fn place(self: &Arc<Self>, address: Address, kind: Kind, now: Duration) -> Option<Place> {
        let most = match kind {
            Kind::Connection => self.connections,
            Kind::Session => self.sessions,
        };
        let mut table = self.table();
        let (entry, shared) = table.entry(address, now, self);
        let held = entry.held(kind);
        if most > 0 && *held >= most {
            return None;
        }
        *held += 1;
        drop(table);
        Some(Place {
            rates: self.clone(),
            address,
            kind,
            shared,
        })
    }

    /// Counts a request.
    ///
    /// # Errors
    /// How long to wait, if there were too many.
    pub fn request(&self, address: Address, now: Duration) -> Result<(), Duration> {
        if self.requests_per_second == 0.0 {
            return Ok(());
        }
        let mut table = self.table();
        let (entry, _) = table.entry(address, now, self);
        entry.settle(now, self.requests_per_second);
        if entry.spent + 1.0 > self.burst {
            let wait = (entry.spent + 1.0 - self.burst) / self.requests_per_second;
            return Err(Duration::from_secs_f64(wait));
        }
        entry.spent += 1.0;
        Ok(())
    }

    fn table(&self) -> MutexGuard<'_, Table> {
        // Counts stay right, whatever happened to one who held the lock.
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Table {
    /// The entry of an address, and whether it is shared with others.
    fn entry(&mut self, address: Address, now: Duration, rates: &Rates) -> (&mut Entry, bool) {
        let full = self.entries.len() >= self.most && !self.entries.contains_key(&address);
        if full && self.swept.is_none_or(|at| now >= at + SWEEP_INTERVAL) {
            self.swept = Some(now);
            self.entries.retain(|_, entry| entry.matters(now, rates));
        }
        if full && self.entries.len() >= self.most {
            return (&mut self.others, true);
        }
        (self.entries.entry(address).or_default(), false)
    }
}

impl Entry {
    fn held(&mut self, kind: Kind) -> &mut usize {
        match kind {
            Kind::Connection => &mut self.connections,
            Kind::Session => &mut self.sessions,
        }
    }

    /// Gives back what the rate has earned since the last time.
    fn settle(&mut self, now: Duration, requests_per_second: f64) {
        let earned = now.saturating_sub(self.at).as_secs_f64() * requests_per_second;
        self.spent = (self.spent - earned).max(0.0);
        self.at = self.at.max(now);
    }

    /// Whether forgetting it would change what is allowed.
    fn matters(&mut self, now: Duration, rates: &Rates) -> bool {
        self.settle(now, rates.requests_per_second);
        self.connections > 0 || self.sessions > 0 || self.spent > 0.0
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut table = self.rates.table();
        let entry = match self.shared {
            true => Some(&mut table.others),
            false => table.entries.get_mut(&self.address),
        };
        if let Some(entry) = entry {
            let held = entry.held(self.kind);
            *held = held.saturating_sub(1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::net::Ipv4Addr;

    fn rates(most: usize) -> Arc<Rates> {
        let limits = Limits {
            connections_per_address: 2,
            sessions_per_address: 1,
            requests_per_second_per_address: 10,
            request_burst_per_address: 5,
            ..Limits::default()
        };
        Arc::new(Rates::with_room(&limits, most))
    }

    fn address(number: u32) -> Address {
        Address::V4(Ipv4Addr::from_bits(number))
    }

    const START: Duration = Duration::ZERO;

    #[test]
    fn places_are_given_back_when_they_are_dropped() {
        let rates = rates(8);
        let held = [0, 1].map(|_| rates.connection(address(1), START).unwrap());
        assert!(rates.connection(address(1), START).is_none());
        assert!(rates.connection(address(2), START).is_some());
        assert!(rates.session(address(1), START).is_some());
        drop(held);
        assert!(rates.connection(address(1), START).is_some());
    }

    #[test]
    fn whoever_has_spent_the_burst_is_told_when_to_come_again() {
        let rates = rates(8);
        for _ in 0..5 {
            assert_eq!(rates.request(address(1), START), Ok(()));
        }
        let wait = rates.request(address(1), START).unwrap_err();
        assert_eq!(wait, Duration::from_millis(100));
        assert_eq!(rates.request(address(2), START), Ok(()));
        assert_eq!(rates.request(address(1), START + wait), Ok(()));
        assert!(rates.request(address(1), START + wait).is_err());
    }

    #[test]
    fn when_the_table_is_full_newcomers_share_and_the_idle_are_forgotten() {
        let rates = rates(2);
        let held = [1, 2].map(|number| rates.connection(address(number), START).unwrap());
        // The third and fourth address share a place, within the same limits.
        let shared = [3, 4].map(|number| rates.connection(address(number), START).unwrap());
        assert!(rates.connection(address(5), START).is_none());
        assert_eq!(rates.table().entries.len(), 2);
        drop(held);
        let later = START + 2 * SWEEP_INTERVAL;
        assert!(rates.connection(address(5), later).is_some());
        assert_eq!(rates.table().entries.len(), 1);
        drop(shared);
        assert_eq!(rates.table().others.connections, 0);
    }

    proptest! {
        #[test]
        fn over_any_time_no_more_than_the_burst_and_the_rate_pass(
            gaps in proptest::collection::vec(0u64..300, 1..200),
        ) {
            let rates = rates(8);
            let (mut now, mut passed) = (START, 0u32);
            for gap in gaps {
                now += Duration::from_millis(gap);
                passed += u32::from(rates.request(address(1), now).is_ok());
                prop_assert!(f64::from(passed) <= 5.0 + 10.0 * now.as_secs_f64() + 1e-6);
            }
        }
    }
}
