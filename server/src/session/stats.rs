//! Figures of a session, for metrics and its last line in the log.

/// Counts since the session began.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SessionStats {
    /// Bytes of parts that were wanted.
    pub wanted_bytes: u64,
    /// Bytes of parts that a view needs, sent unasked.
    pub pushed_bytes: u64,
    /// Bytes of parts sent for where the eye is going.
    pub predicted_bytes: u64,
    /// Bytes of parts that had been sent before, and were evicted meanwhile.
    pub repeated_bytes: u64,
    /// Pieces that a newer view, or a Cancel, took out of the queue.
    pub cancelled_pieces: u64,
    /// Times that a chunk waited for credit.
    pub credit_stalls: u64,
    /// Views looked at.
    pub views: u64,
    /// Selections made.
    pub selections: u64,
    /// Times that nothing was left to send.
    pub idles: u64,
    /// Wishes of the client and pieces of the server's own that wait, now.
    pub waiting: u64,
    /// Pages that the client has, now.
    pub held_pages: u64,
    /// Chunks sent.
    pub pieces: u64,
    /// The most urgent chunk waits for credit, now.
    pub is_stalled: bool,
}

impl SessionStats {
    /// Bytes of parts that were sent.
    pub fn sent_bytes(&self) -> u64 {
        self.wanted_bytes + self.pushed_bytes + self.predicted_bytes
    }

    /// Mean length of a chunk; 0 before the first.
    pub fn bytes_a_piece(&self) -> u64 {
        self.sent_bytes().checked_div(self.pieces).unwrap_or(0)
    }
}
