//! Many sessions from one process: idle ones, flying ones that read from a [`Script`], and greedy
//! ones.

use super::process::Delays;
use super::script::Script;
use super::talk::Talk;
use anyhow::{Context, Result};
use escarp_client::net::Url;
use escarp_proto::geometry::{GridLevels, PageId};
use escarp_proto::wire::{Class, ClientMessage, MAX_LIST, Scope, ServerMessage, Want};
use std::collections::HashSet;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::watch;
use tokio::time::{MissedTickBehavior, interval};

/// Time between two Pings of a session that flies.
const PING: Duration = Duration::from_secs(1);
/// Time between two Pings of one that does not.
const IDLE_PING: Duration = Duration::from_secs(10);
/// Time between two teleports of a greedy session.
const TELEPORT: Duration = Duration::from_millis(100);

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// Sessions open, and catch up.
    Warming,
    /// Delays count.
    Measured,
    /// Sessions end.
    Over,
}

/// What a session found.
#[derive(Debug, Clone, Default)]
pub struct Found {
    /// From a View, and the Want with it, to the first chunk for them.
    pub chunks: Delays,
    /// From Ping to Pong.
    pub pongs: Delays,
    /// Page bytes that came while delays counted.
    pub bytes: u64,
    /// Views that needed pages, and got none before the next one that did.
    pub unanswered: u64,
    /// From a View that needed pages to Idle: all that it needs is here.
    pub settled: Delays,
    /// Views that needed pages, all of which had come before.
    pub early: u64,
    /// Views that needed pages, and did not have all of them before the next one that did.
    pub unsettled: u64,
}

impl Found {
    /// Adds what another found.
    pub fn join(&mut self, other: Found) {
        self.chunks.join(other.chunks);
        self.pongs.join(other.pongs);
        self.bytes += other.bytes;
        self.unanswered += other.unanswered;
        self.settled.join(other.settled);
        self.early += other.early;
        self.unsettled += other.unsettled;
    }
}

/// What all sessions of a run share.
#[derive(Debug, Clone)]
pub struct Run {
    /// The dataset's address.
    pub url: Url,
    /// What those that fly say.
    pub scripts: Arc<Vec<Script>>,
    /// Whether the server sends unasked.
    pub push: bool,
    /// Lines of a script a second.
    pub lines_a_second: f64,
    /// How far it is.
    pub phase: watch::Receiver<Phase>,
}

impl Run {
    fn is_measured(&self) -> bool {
        *self.phase.borrow() == Phase::Measured
    }

    /// Whether sessions are to end.
    pub fn is_over(&self) -> bool {
        *self.phase.borrow() == Phase::Over
    }
}

/// A session that looks nowhere.
///
/// # Errors
/// If it is lost.
pub async fn idle(run: Run) -> Result<Found> {
    let mut talk = Talk::open(&run.url, run.push).await?;
    let mut pings = Pings::new(IDLE_PING);
    let mut phase = run.phase.clone();
    let mut found = Found::default();
    while !run.is_over() {
        tokio::select! {
            _ = phase.changed() => {}
            () = pings.due() => talk.say(&pings.next()).await?,
            message = talk.hear() => pings.hear(&message?, &run, &mut found),
        }
    }
    Ok(found)
}

/// A session that flies: the `number`-th, which begins at another place than the others.
///
/// # Errors
/// If it is lost.
pub async fn flying(run: Run, number: usize) -> Result<Found> {
    let mut talk = Talk::open(&run.url, run.push).await?;
    let script = &run.scripts[number % run.scripts.len()];
    let mut pilot = Pilot {
        line: number / run.scripts.len() * 7,
        sequence: 0,
        awaited: None,
        found: Found::default(),
    };
    let mut pings = Pings::new(PING);
    let mut lines = interval(Duration::from_secs_f64(1.0 / run.lines_a_second));
    lines.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut phase = run.phase.clone();
    while !run.is_over() {
        tokio::select! {
            _ = phase.changed() => {}
            _ = lines.tick() => pilot.say(&mut talk, script, &run).await?,
            () = pings.due() => talk.say(&pings.next()).await?,
            message = talk.hear() => {
                let message = message?;
                pings.hear(&message, &run, &mut pilot.found);
                pilot.hear(&message, &run);
                talk.grant().await?;
            }
        }
    }
    talk.close().await?;
    Ok(pilot.found)
}

/// What a flying session is about.
struct Pilot {
    line: usize,
    sequence: u32,
    awaited: Option<Awaited>,
    found: Found,
}

/// A View that needs pages.
struct Awaited {
    pages: HashSet<u64>,
    number: u32,
    since: Instant,
    /// One of them has come.
    begun: bool,
}

impl Pilot {
    async fn say(&mut self, talk: &mut Talk, script: &Script, run: &Run) -> Result<()> {
        let line = script.line(self.line);
        self.line += 1;
        self.sequence += 1;
        let now = Instant::now();
        talk.say(&ClientMessage::View {
            sequence: self.sequence,
            view: line.view,
            scope: Scope::All,
        })
        .await?;
        if line.wants.is_empty() {
            return Ok(());
        }
        if !run.push {
            for wants in line.wants.chunks(MAX_LIST / 2) {
                talk.say(&ClientMessage::Want(wants.to_vec())).await?;
            }
        }
        let awaited = Awaited {
            pages: line.wants.iter().map(|want| want.page).collect(),
            number: self.sequence,
            since: now,
            begun: false,
        };
        if let Some(before) = self.awaited.replace(awaited)
            && run.is_measured()
        {
            self.found.unsettled += 1;
            self.found.unanswered += u64::from(!before.begun);
        }
        Ok(())
    }

    fn hear(&mut self, message: &ServerMessage, run: &Run) {
        match message {
            ServerMessage::Pages(chunks) => {
                if run.is_measured() {
                    self.found.bytes += chunks.iter().map(|c| c.bytes.len() as u64).sum::<u64>();
                }
                if let Some(awaited) = &mut self.awaited
                    && !awaited.begun
                    && chunks.iter().any(|c| awaited.pages.contains(&c.page))
                {
                    awaited.begun = true;
                    if run.is_measured() {
                        self.found.chunks.add(awaited.ms());
                    }
                }
            }
            // All that the view needs is here.
            ServerMessage::Idle { view_sequence } => {
                let settled = |awaited: &mut Awaited| awaited.number <= *view_sequence;
                if let Some(awaited) = self.awaited.take_if(settled)
                    && run.is_measured()
                {
                    self.found.settled.add(awaited.ms());
                    self.found.early += u64::from(!awaited.begun);
                }
            }
            _ => {}
        }
    }
}

impl Awaited {
    /// Since it was said, milliseconds.
    fn ms(&self) -> f64 {
        self.since.elapsed().as_secs_f64() * 1e3
    }
}

/// A session that wants as much as it may, from another place ten times a second.
///
/// # Errors
/// If it is lost.
pub async fn greedy(run: Run, levels: GridLevels) -> Result<Found> {
    let mut talk = Talk::open(&run.url, run.push).await?;
    talk.say(&ClientMessage::Credit {
        total_bytes: u64::MAX,
    })
    .await?;
    let mut found = Found::default();
    let mut teleports = interval(TELEPORT);
    teleports.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (mut sequence, mut random) = (0, 1u64);
    let mut phase = run.phase.clone();
    while !run.is_over() {
        tokio::select! {
            _ = phase.changed() => {}
            _ = teleports.tick() => {
                sequence += 1;
                let script = &run.scripts[sequence as usize % run.scripts.len()];
                let view = script.line(sequence as usize * 31).view;
                talk.say(&ClientMessage::View { sequence, view, scope: Scope::All }).await?;
                talk.say(&ClientMessage::Want(many(levels, &mut random))).await?;
            }
            message = talk.hear() => {
                if let ServerMessage::Pages(chunks) = message? && run.is_measured() {
                    found.bytes += chunks.iter().map(|c| c.bytes.len() as u64).sum::<u64>();
                }
            }
        }
    }
    Ok(found)
}

/// As many pages as a message may hold, from anywhere, each in full and of the first class.
fn many(levels: GridLevels, random: &mut u64) -> Vec<Want> {
    let mut next = |below: u64| {
        *random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (*random >> 33) % below.max(1)
    };
    let finest = levels.finest_page_level();
    let mut want = || {
        let side = 1u64 << finest;
        let page = PageId::new(finest, next(side) as u32, next(side) as u32)?;
        Some(Want {
            page: page.key(),
            first_part: 0,
            last_part: u8::MAX,
            class: Class::Blocker,
            priority: f32::MAX,
        })
    };
    (0..MAX_LIST).filter_map(|_| want()).collect()
}

/// Pings, one at a time.
struct Pings {
    ticks: tokio::time::Interval,
    sent: Option<Instant>,
    count: u64,
}

impl Pings {
    fn new(every: Duration) -> Pings {
        let mut ticks = interval(every);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Pings {
            ticks,
            sent: None,
            count: 0,
        }
    }

    async fn due(&mut self) {
        self.ticks.tick().await;
    }

    fn next(&mut self) -> ClientMessage {
        self.count += 1;
        self.sent = Some(Instant::now());
        ClientMessage::Ping(self.count)
    }

    fn hear(&mut self, message: &ServerMessage, run: &Run, found: &mut Found) {
        if let ServerMessage::Pong(number) = message
            && *number == self.count
            && let Some(sent) = self.sent.take()
            && run.is_measured()
        {
            found.pongs.add(sent.elapsed().as_secs_f64() * 1e3);
        }
    }
}

/// The dataset's name and server.
///
/// # Errors
/// If it is no address.
pub fn parse(url: &str) -> Result<Url> {
    url.parse()
        .with_context(|| format!("{url:?} is no address"))
}
