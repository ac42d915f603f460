//! Every number that a peer could make grow, in one place.

mod table;

pub use table::{ENTRIES, Entry};

use crate::heights::HeightLimits;
use escarp_proto::wire::{MAX_LIST, PAGES_FRAME};
use std::time::Duration;

/// What the server allows. Each limit is checked before memory is taken; what a message may hold
/// is limited in `escarp_proto::wire`.
///
/// With the defaults a session holds at most about 350 KiB: wishes 170, replies 50, the model of
/// the client's cache 100, one frame and one message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Limits {
    /// HTTP connections at a time; one that opens a session counts as a session from there on.
    /// More wait in the system's backlog.
    pub connections: usize,
    /// Sessions at a time. More are refused with HTTP status 503.
    pub sessions: usize,
    /// HTTP connections of one address at a time, counted as above; 0: any number. More are closed
    /// at once.
    pub connections_per_address: usize,
    /// Sessions of one address at a time; 0: any number. More are refused with HTTP status 429.
    pub sessions_per_address: usize,
    /// HTTP requests a second of one address, in the long run; 0: any number. More are refused
    /// with HTTP status 429.
    pub requests_per_second_per_address: u32,
    /// HTTP requests of one address in a moment, beyond those a second.
    pub request_burst_per_address: u32,
    /// Memory for pages, packs and manifests that were asked for over HTTP, bytes; 0: none is kept.
    pub kept_bytes: u64,
    /// Pages that a session may want at a time. More are answered by Miss Busy.
    pub wanted_pages: usize,
    /// Views a second that a session looks at. Of more, the newest is kept until its turn.
    pub views_per_second: u32,
    /// Replies (Pong, Miss) that wait to be sent. While so many wait, no message is read; one
    /// message, or one frame's lookups, may add [`MAX_LIST`].
    pub queued_replies: usize,
    /// Pages of a client's that a session remembers. More are not pushed.
    pub held_pages: usize,
    /// Pieces of pages that a selection puts into the queue; the next one goes on where it ended.
    /// 0: nothing is sent unasked.
    pub pushed_pages: usize,
    /// How far ahead a moving eye's needs are looked for, at most 2 s; 0 is not at all.
    pub look_ahead: Duration,
    /// From connection to Hello, and from connection or last answer to the end of a request's
    /// header.
    pub hello_timeout: Duration,
    /// Without any byte from a client, its session is pinged this often.
    pub ping_interval: Duration,
    /// Without any byte from a client, its session ends. Longer than `ping_interval`.
    pub idle_timeout: Duration,
    /// A frame that the client does not take for so long ends its session.
    pub send_timeout: Duration,
    /// From a session's last message to the end of its connection, for the client to read it.
    pub close_timeout: Duration,
    /// From the signal to shut down to the end of whatever is still open.
    pub drain_timeout: Duration,
    /// What requests for heights may cost.
    pub heights: HeightLimits,
}

impl Default for Limits {
    fn default() -> Limits {
        Limits {
            connections: 2048,
            sessions: 1024,
            connections_per_address: 512,
            sessions_per_address: 256,
            requests_per_second_per_address: 1000,
            request_burst_per_address: 4000,
            kept_bytes: 64 << 20,
            wanted_pages: 2048,
            views_per_second: 20,
            queued_replies: 1024,
            held_pages: 14_336,
            pushed_pages: 2048,
            look_ahead: Duration::from_secs(1),
            hello_timeout: Duration::from_secs(10),
            ping_interval: Duration::from_secs(20),
            idle_timeout: Duration::from_secs(60),
            send_timeout: Duration::from_secs(30),
            close_timeout: Duration::from_secs(1),
            drain_timeout: Duration::from_secs(5),
            heights: HeightLimits::default(),
        }
    }
}

/// Records looked up for one frame: misses take no place in it, but time.
pub(crate) const LOOKUPS_PER_FRAME: usize = 256;
/// WebSocket messages of up to this many bytes are read, so that the session can say that they
/// are too long. Longer ones end the connection.
pub(crate) const SOCKET_MESSAGE_BYTES: usize = 2 * escarp_proto::wire::MAX_CLIENT_MESSAGE;
/// Bytes of a request's header.
pub(crate) const HEADER_BYTES: usize = 16 << 10;

const _: () = assert!(LOOKUPS_PER_FRAME <= MAX_LIST);
const _: () = assert!(PAGES_FRAME >= escarp_proto::page::MAX_RECORD_BYTES + 64);
