//! The client's half of the protocol: no sockets, no threads, no clock.
//!
//! Bytes go in by [`Link::handle_message`] and come out by [`Link::poll_transmit`]; the time is a
//! parameter everywhere, as the duration since program start. So a test runs it under virtual
//! time, and a browser can drive it. `proto/PROTOCOL.md` specifies what is said.

mod adopt;
mod claims;
mod config;
mod event;
mod flights;
mod gate;
mod pages;
mod receive;
mod session;
mod transmit;

#[cfg(test)]
pub(crate) mod tests;

pub use config::LinkConfig;
pub use event::{Event, LinkError, LinkStats};

use claims::Claims;
use config::Backoff;
use escarp_proto::geometry::PageId;
use escarp_proto::manifest::Manifest;
use escarp_proto::view::{View, ViewError};
use escarp_proto::wire::{Scope, SessionLimits, Want};
use event::{Events, tame};
use flights::Flights;
use gate::Gate;
use pages::{Held, Misses};
use session::{Credit, KeepAlive, NEEDS_NOTHING, Views};
use std::collections::{BTreeSet, HashSet};
use std::sync::Arc;
use std::time::Duration;

/// Where a link stands. All times are since program start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinkState {
    /// Not connected; the next attempt is due then.
    Waiting {
        /// When to connect.
        retry_at: Duration,
    },
    /// The driver was told to connect, and has not reported yet.
    Connecting,
    /// Connected; Welcome is awaited.
    Greeting {
        /// When the connection stood.
        since: Duration,
    },
    /// A session is open.
    Open {
        /// When Welcome came.
        since: Duration,
    },
    /// The server refused for good. The link does not connect any more.
    Refused,
}

/// The Ping behind the Haves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Barrier {
    None,
    Due,
    Sent(u64),
}

/// The client's end of a session, and of those that follow when the connection is lost.
///
/// # Order of calls
///
/// The driver, which owns the socket, calls in each turn:
///
/// 1. for what happened since: [`on_connected`](Self::on_connected),
///    [`handle_message`](Self::handle_message) for each message, or
///    [`on_disconnected`](Self::on_disconnected);
/// 2. [`handle_timeout`](Self::handle_timeout), after the messages, lest a server be taken for
///    dead whose answer was waiting;
/// 3. if [`has_socket`](Self::has_socket) is false, it closes the socket that it may have: the link
///    gave up the session;
/// 4. [`poll_connect`](Self::poll_connect); if true, it starts to connect, and reports the outcome
///    by step 1;
/// 5. [`poll_transmit`](Self::poll_transmit) until it is `None` or the socket takes no more. What
///    is not taken is not lost, and may be overtaken by what is more urgent.
///
/// Nothing need happen before [`next_timeout`](Self::next_timeout), unless a message comes.
///
/// The program calls in each frame: [`poll_event`](Self::poll_event) until it is `None`, then
/// [`evict`](Self::evict) for what it dropped, [`set_wants`](Self::set_wants) and
/// [`set_view`](Self::set_view).
///
/// # What it promises
///
/// A chunk is delivered only if its page was wanted, or the server pushes, and its first part is
/// the one that comes next, with the revision of those before. The link remembers what it delivered until it is
/// evicted, and never asks for it twice, not in the next session either. Whatever the server
/// sends, the memory taken is bounded by [`LinkConfig`] and what the program wants and keeps.
#[derive(Debug)]
pub struct Link {
    config: LinkConfig,
    state: LinkState,
    backoff: Backoff,
    trouble: Option<String>,
    manifest: Option<Arc<Manifest>>,
    limits: SessionLimits,
    held: Held,
    flights: Flights,
    misses: Misses,
    views: Views,
    credit: Credit,
    keep_alive: KeepAlive,
    hello_due: bool,
    claims: Claims,
    barrier: Barrier,
    /// The manifest has changed, and the barrier will show which pages are the same.
    confirming: bool,
    /// Whether the server of this session was asked to push, does, and whether that is of use.
    push_asked: bool,
    push_agreed: bool,
    push_wanted: bool,
    gate: Gate,
    /// Wishes that wait at the gate.
    deferred: Vec<Want>,
    /// When the server became idle, if it is.
    idle_at: Option<Duration>,
    /// When the last chunk came, or the session was opened.
    chunk_at: Duration,
    events: Events,
    stats: LinkStats,
}

impl Link {
    /// A link that wants to connect at once.
    pub fn new(config: LinkConfig) -> Link {
        Link {
            state: LinkState::Waiting {
                retry_at: Duration::ZERO,
            },
            backoff: Backoff::new(&config),
            trouble: None,
            manifest: None,
            limits: SessionLimits {
                wanted_pages: u32::MAX,
                views_per_second: u32::MAX,
                held_pages: u32::MAX,
            },
            held: Held::default(),
            flights: Flights::default(),
            misses: Misses::default(),
            views: Views::new(config.view_interval),
            credit: Credit::new(&config),
            keep_alive: KeepAlive::new(&config),
            hello_due: false,
            claims: Claims::default(),
            barrier: Barrier::None,
            confirming: false,
            push_asked: false,
            push_agreed: false,
            push_wanted: config.push,
            gate: Gate::default(),
            deferred: Vec::new(),
            idle_at: None,
            chunk_at: Duration::ZERO,
            events: Events::default(),
            stats: LinkStats::default(),
            config,
        }
    }

    /// Whether the driver shall start to connect now. True once; the driver then reports by
    /// [`on_connected`](Self::on_connected) or [`on_disconnected`](Self::on_disconnected).
    pub fn poll_connect(&mut self, now: Duration) -> bool {
        let due = matches!(self.state, LinkState::Waiting { retry_at } if retry_at <= now);
        if due {
            self.state = LinkState::Connecting;
        }
        due
    }

    /// The connection stands: Hello goes out, and at once behind it what is held from earlier
    /// sessions, by Have, and the view.
    pub fn on_connected(&mut self, now: Duration) {
        if self.state == LinkState::Refused {
            return;
        }
        self.state = LinkState::Greeting { since: now };
        self.credit = Credit::new(&self.config);
        self.hello_due = true;
        self.claim_all();
    }

    /// A server that knows nothing of the pages is told.
    fn claim_all(&mut self) {
        self.claims.forget_pages();
        let haves = self.held.announce_all();
        let due = !haves.is_empty() || self.confirming;
        haves.into_iter().for_each(|have| self.claims.have(have));
        self.barrier = match due {
            true => Barrier::Due,
            false => Barrier::None,
        };
    }

    /// The server takes other parts of a page to be here than are. One message says what is: after
    /// the first of two it would push what the second says is here.
    fn claim_anew(&mut self, page: u64) {
        match self.held.announce(page) {
            Some(have) => self.claims.have(have),
            None => self.claims.evict(page),
        }
    }

    /// The connection was lost or did not come about. The pages in flight are asked for again in
    /// the next session; nothing delivered is lost.
    pub fn on_disconnected(&mut self, now: Duration, why: &str) {
        match self.state {
            // The link gave up this connection itself, and knows better why.
            LinkState::Waiting { .. } | LinkState::Refused => return,
            LinkState::Open { since } => self.backoff.session_lived(now.saturating_sub(since)),
            LinkState::Connecting | LinkState::Greeting { .. } => {}
        }
        let retry_at = now + self.backoff.next();
        let text = tame(why);
        self.forget_session();
        self.state = LinkState::Waiting { retry_at };
        self.trouble = Some(text.clone());
        self.stats.disconnects += 1;
        self.events
            .push_latest(Event::Disconnected { text, retry_at });
    }

    /// Gives up a session whose server is silent. Call it after the messages that have come.
    pub fn handle_timeout(&mut self, now: Duration) {
        self.misses.expire(now);
        if self.is_open() {
            self.keep_alive.watch(now);
            self.open_gate(now);
            self.ask_again(now);
        }
        match self.state {
            LinkState::Greeting { since } if now >= since + self.config.welcome_timeout => {
                let why = format!("no Welcome within {:?}", self.config.welcome_timeout);
                self.on_disconnected(now, &why);
            }
            LinkState::Open { .. } if self.keep_alive.dead_at().is_some_and(|at| at <= now) => {
                let why = format!("the server is silent for {:?}", self.config.silence_timeout);
                self.on_disconnected(now, &why);
            }
            _ => {}
        }
    }

    /// The next event, oldest first. Take them as soon as there is use for them: the link asks for
    /// no more pages than can wait here, and the server may send no more than a window of
    /// [`LinkConfig::credit_window_bytes`] beyond what was taken.
    pub fn poll_event(&mut self) -> Option<Event> {
        let event = self.events.pop()?;
        self.credit.taken(event.page_bytes());
        Some(event)
    }

    /// The whole wish list of the mesh tree, each page once, most urgent first. The server hears
    /// only what changed: new pages up to the limit, changed parts or class, a priority that more
    /// than doubled or halved, and Cancel for what is no longer listed.
    ///
    /// Pages that were missed in this session stay out; busy ones come again after
    /// [`LinkConfig::busy_delay`]. Works without a connection as well.
    pub fn set_wants(&mut self, wants: &[Want], now: Duration) {
        self.misses.expire(now);
        let places = match self.holds_back(!wants.is_empty(), now) {
            true => {
                self.deferred.clear();
                self.deferred.extend_from_slice(wants);
                0
            }
            false => {
                self.deferred.clear();
                self.places()
            }
        };
        self.flights.update(wants, places, &self.held, &self.misses);
    }

    /// Whether what is lacking may be on its way unasked.
    fn holds_back(&mut self, any: bool, now: Duration) -> bool {
        let round_trip = self.keep_alive.round_trip();
        self.is_pushing() && self.gate.holds_back(any, round_trip, now)
    }

    /// Wishes that have waited long enough are let through.
    fn open_gate(&mut self, now: Duration) {
        if !self.deferred.is_empty() && !self.holds_back(true, now) {
            let wants = std::mem::take(&mut self.deferred);
            self.set_wants(&wants, now);
        }
    }

    /// Asks again for what the server has swallowed.
    fn ask_again(&mut self, now: Duration) {
        if self.swallowed_at().is_none_or(|at| now < at) {
            return;
        }
        let (quiet, patience) = self.quiet();
        for page in self.flights.ask_again(quiet, patience, now) {
            self.stats.asked_again += 1;
            self.claims.note_stray(page);
        }
    }

    /// Whether the server of this session sends what a View needs unasked.
    pub fn is_pushing(&self) -> bool {
        self.push_agreed && self.push_wanted
    }

    /// Whether pushed pages are of use from now on; not more than
    /// [`LinkConfig::push`] allows. If not, the next server is not asked to, and to the one of this
    /// session, if it was, goes a view that needs nothing in place of the newest.
    pub fn set_push(&mut self, wanted: bool) {
        self.push_wanted = wanted && self.config.push;
    }

    /// Whether parts of a page were delivered, and neither evicted since nor found stale.
    pub fn holds(&self, page: PageId) -> bool {
        self.held.has(page.key())
    }

    /// The revision of a page that it [holds](Self::holds).
    pub fn revision(&self, page: PageId) -> Option<u32> {
        self.held.revision(page.key())
    }

    /// Places for pages: what is not yet taken by the caller occupies one, too.
    fn places(&self) -> usize {
        let allowed = usize::try_from(self.limits.wanted_pages).unwrap_or(usize::MAX);
        let places = self.config.max_in_flight_pages.min(allowed).max(1);
        places.saturating_sub(self.events.pages())
    }

    /// As [`set_view_in`](Self::set_view_in) for a mesh that keeps the tolerance all around.
    ///
    /// # Errors
    /// A view that [`View::check`] refuses, which is not sent.
    pub fn set_view(&mut self, view: &View, now: Duration) -> Result<(), ViewError> {
        self.set_view_in(view, Scope::All, now)
    }

    /// The view that the mesh is tested by. Sent if it changed, at most as often as
    /// [`LinkConfig::view_interval`] and the server allow; the newest wins.
    ///
    /// # Errors
    /// A view that [`View::check`] refuses, which is not sent.
    pub fn set_view_in(
        &mut self,
        view: &View,
        scope: Scope,
        now: Duration,
    ) -> Result<(), ViewError> {
        view.check()?;
        let (view, scope) = match self.push_agreed && !self.push_wanted {
            true => (&NEEDS_NOTHING, Scope::InView),
            false => (view, scope),
        };
        if self.views.set(view, scope) {
            self.gate.on_view(now);
        }
        Ok(())
    }

    /// The caller dropped these pages: the server is told, and they may be wanted from the first
    /// part again. Chunks of theirs that are not yet taken, or in flight, are dropped.
    pub fn evict(&mut self, pages: &[PageId]) {
        let keys: BTreeSet<u64> = pages.iter().map(|page| page.key()).collect();
        let dropped = self.events.forget_pages(|page| keys.contains(&page));
        self.credit.taken(dropped);
        for page in keys {
            self.flights.cancel(page);
            let told = matches!(
                self.state,
                LinkState::Greeting { .. } | LinkState::Open { .. }
            );
            if self.held.remove(page) && told {
                self.claims.evict(page);
            }
        }
    }

    /// The caller has no use for parts of these pages that it was given: as
    /// [`evict`](Self::evict), but the server is told no sooner than the page is wanted, lest it
    /// push it again.
    pub fn discard(&mut self, pages: &[PageId]) {
        let keys: HashSet<u64> = pages.iter().map(|page| page.key()).collect();
        let dropped = self.events.forget_pages(|page| keys.contains(&page));
        self.credit.taken(dropped);
        for page in keys {
            self.flights.cancel(page);
            if self.held.remove(page) {
                self.claims.note_stray(page);
            }
        }
    }

    /// The caller gives a page up, as its bytes are wrong: it is evicted, and not asked for again
    /// in this session. A page that is only [evicted](Self::evict) may be wanted once more.
    pub fn reject(&mut self, page: PageId) {
        self.discard(&[page]);
        self.misses.lose(page.key());
    }

    /// Where the link stands.
    pub const fn state(&self) -> LinkState {
        self.state
    }

    /// Whether a session is open.
    pub const fn is_open(&self) -> bool {
        matches!(self.state, LinkState::Open { .. })
    }

    /// Whether the driver shall have a socket, or be at work on one.
    pub const fn has_socket(&self) -> bool {
        !matches!(self.state, LinkState::Waiting { .. } | LinkState::Refused)
    }

    /// Why the last connection ended, for people.
    pub fn trouble(&self) -> Option<&str> {
        self.trouble.as_deref()
    }

    /// The manifest of the newest session.
    pub const fn manifest(&self) -> Option<&Arc<Manifest>> {
        self.manifest.as_ref()
    }

    /// Number of the newest View sent, 0 if none. An Idle with this number answers it.
    pub fn view_sequence(&self) -> u32 {
        self.views.sequence()
    }

    /// Whether the newest view is not sent yet.
    pub fn view_pending(&self) -> bool {
        self.view_at().is_some()
    }

    /// Figures.
    pub fn stats(&self) -> LinkStats {
        LinkStats {
            in_flight_pages: self.flights.len(),
            waiting_events: self.events.pages(),
            held_pages: self.held.len(),
            round_trip_ms: self.keep_alive.round_trip_ms(),
            ..self.stats
        }
    }

    /// Ends the session for good.
    fn refuse(&mut self, why: String) {
        self.forget_session();
        self.state = LinkState::Refused;
        self.trouble = Some(why);
        self.stats.disconnects += 1;
    }

    fn forget_session(&mut self) {
        self.flights.forget_session();
        self.misses.clear();
        self.views.forget_session();
        self.claims.clear();
        self.barrier = Barrier::None;
        self.push_agreed = false;
        self.gate = Gate::default();
        self.idle_at = None;
    }
}
