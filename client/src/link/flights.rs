//! The pages in flight: the difference between the mesh tree's wish list and what the server was
//! asked for.
//!
//! The tree wishes for everything that it lacks, in each frame; the server hears of changes only.
//! A page in flight stays so while it is wished for, however far down the list; places that come
//! free go to the most urgent others. So no page is cancelled and asked for again because ranks
//! swap, and a new blocker waits no longer than until the next page arrives.

use super::pages::{Held, Misses};
use escarp_proto::wire::{Chunk, Want};
use std::cmp::Ordering;
use std::collections::HashMap;
use std::time::Duration;

/// A page is given up when chunks that do not continue it came more often than this: no race with
/// a cancel explains that.
const MOST_HEALED: u32 = 8;
/// A page that does not come is asked for again after a time that doubles so often.
const MOST_DOUBLED: u32 = 6;
/// A priority is told again only if it grew or fell by more than this.
const PRIORITY_STEP: f32 = 2.0;

/// See the module.
#[derive(Debug, Default)]
pub(super) struct Flights {
    flights: HashMap<u64, Flight>,
    /// Pages that the server was asked for in this session, and is to forget.
    cancels: Vec<u64>,
    /// Counts wish lists; a flight with an older count is no longer wished for.
    round: u64,
    /// Whether a flight may be untold.
    any_untold: bool,
}

#[derive(Debug)]
struct Flight {
    /// As the server knows it, or is about to.
    asked: Want,
    /// The part that must come next.
    next_part: u8,
    /// The last wish list that had it.
    round: u64,
    /// When the server of this session was asked for it, or last sent something of it.
    told_at: Option<Duration>,
    /// Whether `asked` is still to be told.
    untold: bool,
    /// How often a chunk came that made it be asked for again.
    healed: u32,
    /// How often nothing came, and made it be asked for again.
    swallowed: u32,
}

/// What becomes of a chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// It was asked for, and continues what is here.
    Taken,
    /// Of a page that was not asked for.
    Unasked,
    /// Not what comes next.
    Stray,
    /// It does not belong to the parts that are here, or never is what was asked for.
    Unusable,
}

impl Flights {
    pub(super) fn len(&self) -> usize {
        self.flights.len()
    }

    /// Compares with a wish list, most urgent first, and fills up to `places` pages.
    pub(super) fn update(&mut self, wants: &[Want], places: usize, held: &Held, misses: &Misses) {
        self.round += 1;
        self.keep_wanted(wants, held);
        self.cancel_unwanted();
        self.fill(wants, places, held, misses);
    }

    /// Marks the flights that are wished for. Lists keep their order from frame to frame, so that
    /// all flights are found near the front.
    fn keep_wanted(&mut self, wants: &[Want], held: &Held) {
        let mut unseen = self.flights.len();
        for want in wants {
            if unseen == 0 {
                break;
            }
            let Some(flight) = self.flights.get_mut(&want.page) else {
                continue;
            };
            if flight.round == self.round {
                continue;
            }
            let Some(missing) = held.missing(want) else {
                continue;
            };
            flight.round = self.round;
            unseen -= 1;
            self.any_untold |= flight.adopt(sane(missing));
        }
    }

    fn cancel_unwanted(&mut self) {
        let before = self.cancels.len();
        let (round, cancels) = (self.round, &mut self.cancels);
        self.flights.retain(|&page, flight| {
            let keep = flight.round == round;
            if !keep && flight.told_at.is_some() {
                cancels.push(page);
            }
            keep
        });
        // In an order, so that runs repeat.
        cancels[before..].sort_unstable();
    }

    fn fill(&mut self, wants: &[Want], places: usize, held: &Held, misses: &Misses) {
        let mut free = places.saturating_sub(self.flights.len());
        for want in wants {
            if free == 0 {
                break;
            }
            if self.flights.contains_key(&want.page) || misses.blocks(want.page) {
                continue;
            }
            let Some(missing) = held.missing(want) else {
                continue;
            };
            self.flights
                .insert(want.page, Flight::new(sane(missing), self.round));
            self.any_untold = true;
            free -= 1;
        }
    }

    /// Judges a chunk, and notes what of the page is here now. Safe on untrusted input.
    pub(super) fn take(&mut self, chunk: &Chunk, held: &mut Held, now: Duration) -> Verdict {
        let Some(flight) = self.flights.get_mut(&chunk.page) else {
            return Verdict::Unasked;
        };
        let fits = chunk.first_part == flight.next_part
            && (chunk.first_part..=held.last_part(chunk.page)).contains(&chunk.last_part)
            && held.has_room(chunk);
        if !fits {
            self.any_untold |= flight.heal(chunk);
            return match flight.healed > MOST_HEALED {
                true => Verdict::Unusable,
                false => Verdict::Stray,
            };
        }
        if flight.next_part > 0 && !held.joins(chunk.page, chunk.revision) {
            // What is here is of another generation, and will be found stale.
            return match held.is_announced(chunk.page) {
                true => Verdict::Stray,
                false => Verdict::Unusable,
            };
        }
        flight.next_part = chunk.last_part + 1;
        flight.told_at = flight.told_at.map(|_| now);
        if chunk.last_part >= flight.asked.last_part {
            self.flights.remove(&chunk.page);
        }
        held.add(chunk);
        Verdict::Taken
    }

    /// Takes a page out, as the server does not send it. Whether it was in flight.
    pub(super) fn miss(&mut self, page: u64) -> bool {
        self.flights.remove(&page).is_some()
    }

    /// Takes a page out, as the caller does not want it.
    pub(super) fn cancel(&mut self, page: u64) {
        if self
            .flights
            .remove(&page)
            .is_some_and(|flight| flight.told_at.is_some())
        {
            self.cancels.push(page);
        }
    }

    /// A new server knows of no flight.
    pub(super) fn forget_session(&mut self) {
        self.cancels.clear();
        for flight in self.flights.values_mut() {
            flight.restart();
        }
        self.any_untold = !self.flights.is_empty();
    }

    pub(super) fn clear(&mut self) {
        self.flights.clear();
        self.cancels.clear();
    }

    /// Takes all out that the server was not asked for yet: what was to be asked.
    pub(super) fn take_untold(&mut self) -> Vec<Want> {
        let mut wants = Vec::new();
        self.flights.retain(|_, flight| {
            let keep = flight.told_at.is_some();
            if !keep {
                wants.push(flight.to_tell());
            }
            keep
        });
        wants.sort_unstable_by(urgency);
        wants
    }

    /// When the first flight has been left unanswered for so long by a server that has done nothing
    /// since `quiet`.
    pub(super) fn swallowed_at(&self, quiet: Duration, patience: Duration) -> Option<Duration> {
        let flights = self.flights.values();
        flights
            .filter_map(|flight| flight.swallowed_at(quiet, patience))
            .min()
    }

    /// The pages that were left unanswered until now: they are asked for again.
    pub(super) fn ask_again(
        &mut self,
        quiet: Duration,
        patience: Duration,
        now: Duration,
    ) -> Vec<u64> {
        let mut again = Vec::new();
        for (&page, flight) in &mut self.flights {
            if flight
                .swallowed_at(quiet, patience)
                .is_some_and(|at| at <= now)
            {
                flight.swallowed = (flight.swallowed + 1).min(MOST_DOUBLED);
                flight.untold = true;
                again.push(page);
            }
        }
        self.any_untold |= !again.is_empty();
        again.sort_unstable();
        again
    }

    /// Pages of which the server is about to be told, by key.
    pub(super) fn untold(&self) -> Vec<u64> {
        let untold = self.flights.iter().filter(|(_, flight)| flight.untold);
        let pages = untold.filter(|_| self.any_untold).map(|(&page, _)| page);
        let mut pages: Vec<u64> = pages.collect();
        pages.sort_unstable();
        pages
    }

    /// Up to `most` pages to cancel. They go before wants, which may have the same page anew.
    pub(super) fn poll_cancels(&mut self, most: usize) -> Option<Vec<u64>> {
        let from = self.cancels.len().saturating_sub(most);
        (!self.cancels.is_empty()).then(|| self.cancels.split_off(from))
    }

    /// Up to `most` wants that the server must hear of, most urgent first.
    pub(super) fn poll_wants(&mut self, most: usize, now: Duration) -> Option<Vec<Want>> {
        if !self.any_untold {
            return None;
        }
        let untold = self.flights.values().filter(|flight| flight.untold);
        let mut wants: Vec<Want> = untold.map(Flight::to_tell).collect();
        wants.sort_unstable_by(urgency);
        self.any_untold = wants.len() > most;
        wants.truncate(most);
        for want in &wants {
            if let Some(flight) = self.flights.get_mut(&want.page) {
                flight.told(now);
            }
        }
        (!wants.is_empty()).then_some(wants)
    }
}

impl Flight {
    fn new(asked: Want, round: u64) -> Flight {
        Flight {
            asked,
            next_part: asked.first_part,
            round,
            told_at: None,
            untold: true,
            healed: 0,
            swallowed: 0,
        }
    }

    /// Takes over a newer wish for the page. Whether the server must hear of it.
    fn adopt(&mut self, newer: Want) -> bool {
        let asked = &self.asked;
        let ratio = asked.priority * PRIORITY_STEP < newer.priority
            || newer.priority * PRIORITY_STEP < asked.priority;
        let matters = ratio
            || asked.class != newer.class
            || asked.last_part != newer.last_part
            || self.next_part != newer.first_part;
        if matters || self.untold {
            self.next_part = newer.first_part;
            self.asked = newer;
            self.untold = true;
        }
        matters
    }

    /// A chunk that does not continue the page: asks again if it shows that the server believes
    /// other parts to be here than are. A mere repetition needs no answer.
    fn heal(&mut self, chunk: &Chunk) -> bool {
        let repeated = chunk.last_part < self.next_part;
        self.untold |= !repeated;
        self.healed += u32::from(!repeated);
        !repeated
    }

    fn restart(&mut self) {
        self.told_at = None;
        self.untold = true;
    }

    fn told(&mut self, now: Duration) {
        self.told_at = Some(now);
        self.untold = false;
    }

    /// When it is to be asked for again: later each time, as a line may be slower than it seems.
    fn swallowed_at(&self, quiet: Duration, patience: Duration) -> Option<Duration> {
        let told = self.told_at.filter(|_| !self.untold)?;
        Some(told.max(quiet) + patience * (1 << self.swallowed))
    }

    fn to_tell(&self) -> Want {
        Want {
            first_part: self.next_part,
            ..self.asked
        }
    }
}

/// A priority that is no number would never compare as told.
fn sane(want: Want) -> Want {
    Want {
        priority: want.priority.max(0.0),
        ..want
    }
}

/// Most urgent first; pages by key where that is equal, so that runs repeat.
fn urgency(a: &Want, b: &Want) -> Ordering {
    let priority = || b.priority.total_cmp(&a.priority);
    a.class
        .cmp(&b.class)
        .then_with(priority)
        .then_with(|| a.page.cmp(&b.page))
}
