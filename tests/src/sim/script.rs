//! What a seed decides: who there is, and what happens to them.

use super::ground::GENERATIONS;
use super::pipe::Line;
use super::random::Random;
use escarp_client::link::LinkConfig;
use escarp_client::mesh::{MeshOptions, MesherKind};
use escarp_client::remote::ClientOptions;
use escarp_server::Limits;
use std::time::Duration;

/// Memory for pages where it shall not matter, bytes.
const AMPLE_BYTES: usize = 64 << 20;
/// Datasets to choose from.
pub(super) const GROUNDS: u64 = 4;

/// All that a run depends on.
#[derive(Debug, Clone)]
pub struct Script {
    /// The seed that it is from; lines draw their jitter and losses from it, too.
    pub seed: u64,
    /// Which dataset.
    pub ground: usize,
    /// The generation that is published first.
    pub generation: usize,
    /// What the server allows.
    pub limits: Limits,
    /// The clients.
    pub clients: Vec<Setup>,
    /// What happens, and when.
    pub acts: Vec<(Duration, Act)>,
    /// From then on nothing happens any more.
    pub peace: Duration,
}

/// A client.
#[derive(Debug, Clone)]
pub struct Setup {
    /// When it comes.
    pub comes: Duration,
    /// Its line at first.
    pub line: Line,
    /// Time between two frames.
    pub frame: Duration,
    /// How it works.
    pub options: ClientOptions,
    /// How its link works.
    pub config: LinkConfig,
    /// Where it looks at first.
    pub gaze: Gaze,
    /// Its tolerance at first, pixels.
    pub error_px: f32,
}

/// Where a client looks, in shares of the dataset's extent, and metres above its top.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gaze {
    /// East and north.
    pub eye: [f64; 2],
    /// Up.
    pub above_m: f64,
    /// What is in the middle of the picture, east and north.
    pub at: [f64; 2],
    /// Shares of the extent a second.
    pub velocity: [f64; 2],
}

/// Something that happens.
#[derive(Debug, Clone, PartialEq)]
pub enum Act {
    /// A client looks elsewhere, and flies on from there.
    Gaze(usize, Gaze),
    /// A client takes another tolerance, pixels.
    Tolerance(usize, f32),
    /// A client meshes in another way.
    Mesh(usize, MeshOptions),
    /// A client's program does nothing for a while; its connection lives on.
    Pause(usize, Duration),
    /// A client's machine sleeps, and so does its clock, or not.
    Suspend(usize, Duration, bool),
    /// A client's clock jumps ahead.
    Jump(usize, Duration),
    /// A client reads no more than so many bytes a second for a while.
    Slow(usize, f64, Duration),
    /// A client's line becomes another one.
    Line(usize, Line),
    /// A client's connection is cut after so many bytes, up or down.
    Cut(usize, Cut),
    /// A client is killed, and started anew after a while, with nothing.
    Kill(usize, Duration),
    /// The next generation is published.
    Publish,
    /// The server goes down for a while, and tells its sessions, or not.
    Restart(bool, Duration),
}

/// How a connection is cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cut {
    /// Bytes that still pass from the client.
    pub up: Option<u64>,
    /// Bytes that still pass to the client.
    pub down: Option<u64>,
    /// Whether nobody is told.
    pub silently: bool,
}

impl Script {
    /// What a seed decides.
    pub fn of(seed: u64) -> Script {
        let mut random = Random::new(seed, 0);
        let generation = random.below(GENERATIONS as u64 - 1) as usize;
        let clients: Vec<Setup> = (0..random.pick(&[1, 1, 1, 2, 2, 3]))
            .map(|number| setup(&mut random, number))
            .collect();
        let mut now = Duration::ZERO;
        let acts: Vec<(Duration, Act)> = (0..2 + random.below(12))
            .map(|_| {
                now += random.time_ms(20.0, 4000.0);
                (now, act(&mut random, clients.len()))
            })
            .collect();
        Script {
            seed,
            ground: random.below(GROUNDS) as usize,
            generation,
            limits: limits(&mut random),
            clients,
            peace: acts
                .iter()
                .map(|(at, act)| *at + act.lasts())
                .max()
                .unwrap_or(now)
                + random.time_ms(20.0, 4000.0),
            acts,
        }
    }

    /// The same with only these acts, by their numbers.
    pub fn with_acts(mut self, keep: &[usize]) -> Script {
        let mut number = 0..;
        self.acts
            .retain(|_| number.next().is_some_and(|number| keep.contains(&number)));
        self
    }
}

impl Act {
    /// How long it goes on.
    fn lasts(&self) -> Duration {
        match *self {
            Act::Pause(_, time)
            | Act::Suspend(_, time, _)
            | Act::Slow(_, _, time)
            | Act::Kill(_, time)
            | Act::Restart(_, time) => time,
            _ => Duration::ZERO,
        }
    }
}

fn limits(random: &mut Random) -> Limits {
    Limits {
        wanted_pages: random.pick(&[2048, 2048, 40, 5]),
        views_per_second: random.pick(&[20, 20, 5, 60]),
        queued_replies: random.pick(&[1024, 8]),
        held_pages: random.pick(&[4096, 4096, 4096, 30]),
        pushed_pages: random.pick(&[2048, 2048, 2048, 10, 0]),
        ..Limits::default()
    }
}

fn setup(random: &mut Random, number: u64) -> Setup {
    let comes = match number {
        0 => Duration::ZERO,
        _ => random.time_ms(1.0, 5000.0),
    };
    let push = random.chance(0.75);
    Setup {
        comes,
        line: line(random),
        frame: random.time_ms(16.0, 250.0),
        options: ClientOptions {
            memory_cap_bytes: match random.chance(0.3) {
                true => random.magnitude(6e4, 2e6) as usize,
                false => AMPLE_BYTES,
            },
            mesh: mesh(random),
            push,
            ..ClientOptions::default()
        },
        config: LinkConfig {
            credit_window_bytes: random.magnitude(1e3, 1e6) as u64,
            max_in_flight_pages: random.pick(&[1, 8, 1024, 1024]),
            jitter_seed: random.number(),
            push,
            ..LinkConfig::new("ground")
        },
        gaze: gaze(random),
        error_px: error_px(random),
    }
}

fn error_px(random: &mut Random) -> f32 {
    random.magnitude(1.0, 32.0) as f32
}

fn mesh(random: &mut Random) -> MeshOptions {
    let mesher = random.pick(&[
        MesherKind::Quadtree,
        MesherKind::Quadtree,
        MesherKind::Quadtree,
        MesherKind::Roam,
    ]);
    MeshOptions {
        mesher,
        cull: mesher == MesherKind::Quadtree && random.chance(0.2),
        ..MeshOptions::default()
    }
}

fn line(random: &mut Random) -> Line {
    Line {
        bytes_per_s: random.magnitude(3e3, 1e7),
        delay: random.time_ms(0.1, 400.0),
        jitter: random.time_ms(0.1, 100.0),
        loss: random.pick(&[0.0, 0.0, 0.01, 0.1, 0.3]),
        buffer: random.magnitude(2e3, 5e5) as usize,
    }
}

fn gaze(random: &mut Random) -> Gaze {
    let place = |random: &mut Random| [random.between(-0.2, 1.2), random.between(-0.2, 1.2)];
    let speed = random.pick(&[0.0, 0.0, 0.1, 1.0]);
    let velocity = place(random).map(|share| (share - 0.5) * speed);
    Gaze {
        eye: place(random),
        above_m: random.magnitude(5.0, 1500.0),
        at: place(random),
        velocity,
    }
}

fn act(random: &mut Random, clients: usize) -> Act {
    let client = random.below(clients as u64) as usize;
    match random.below(26) {
        0..=5 => Act::Gaze(client, gaze(random)),
        6..=7 => Act::Tolerance(client, error_px(random)),
        8 => Act::Mesh(client, mesh(random)),
        9 => Act::Pause(client, random.time_ms(100.0, 80_000.0)),
        10 => {
            let asleep = random.time_ms(100.0, 80_000.0);
            Act::Suspend(client, asleep, random.chance(0.5))
        }
        11 => Act::Jump(client, random.time_ms(1e3, 1e7)),
        12 => {
            let bytes_per_s = random.magnitude(1.0, 1e4);
            Act::Slow(client, bytes_per_s, random.time_ms(100.0, 40_000.0))
        }
        13..=14 => Act::Line(client, line(random)),
        15..=18 => Act::Cut(client, cut(random)),
        19 => Act::Kill(client, random.time_ms(1.0, 2000.0)),
        20..=23 => Act::Publish,
        _ => Act::Restart(random.chance(0.5), random.time_ms(1.0, 5000.0)),
    }
}

fn cut(random: &mut Random) -> Cut {
    let up = random.magnitude(1.0, 2e3) as u64 - 1;
    let down = random.magnitude(1.0, 1e5) as u64 - 1;
    let (one, other) = random.pick(&[(true, false), (false, true), (true, true)]);
    Cut {
        up: one.then_some(up),
        down: other.then_some(down),
        silently: random.chance(0.3),
    }
}
