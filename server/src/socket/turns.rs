//! Turns of sessions at what takes long: as many at a time as there are processors, first come,
//! first served.

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use tokio::sync::{AcquireError, OwnedSemaphorePermit, Semaphore};

type Coming = Pin<Box<dyn Future<Output = Result<OwnedSemaphorePermit, AcquireError>> + Send>>;

/// How many may have their turn at a time.
pub(super) fn at_a_time() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// The turns of one session.
pub(super) struct Turns {
    all: Arc<Semaphore>,
    /// Its place in the queue.
    coming: Option<Coming>,
    turn: Option<OwnedSemaphorePermit>,
}

impl Turns {
    /// It does not wait yet.
    pub(super) fn new(all: Arc<Semaphore>) -> Turns {
        Turns {
            all,
            coming: None,
            turn: None,
        }
    }

    /// Whether it has its turn. If not, it waits from here on.
    pub(super) fn come(&mut self) -> bool {
        if self.turn.is_none() && self.coming.is_none() {
            match self.all.clone().try_acquire_owned() {
                Ok(turn) => self.turn = Some(turn),
                Err(_) => self.coming = Some(Box::pin(self.all.clone().acquire_owned())),
            }
        }
        self.turn.is_some()
    }

    /// Whether it waits.
    pub(super) fn is_waiting(&self) -> bool {
        self.coming.is_some()
    }

    /// Ready when it has its turn; never if it does not wait. May be dropped and called again: it
    /// keeps its place.
    pub(super) async fn wait(&mut self) {
        match &mut self.coming {
            // The semaphore is never closed.
            Some(coming) => self.turn = coming.await.ok(),
            None => std::future::pending().await,
        }
        self.coming = None;
    }

    /// Its turn is over, and it no longer waits.
    pub(super) fn leave(&mut self) {
        (self.turn, self.coming) = (None, None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;
    use tokio::time::timeout;

    const SOON: Duration = Duration::from_millis(20);

    #[tokio::test]
    async fn whoever_waits_keeps_its_place_and_has_its_turn_when_one_ends() {
        let all = Arc::new(Semaphore::new(1));
        let [mut a, mut b, mut c] = [(); 3].map(|()| Turns::new(all.clone()));
        assert!(a.come() && a.come() && !b.come());
        assert!(timeout(SOON, b.wait()).await.is_err() && b.is_waiting());
        assert!(!c.come());
        assert!(timeout(SOON, c.wait()).await.is_err());
        a.leave();
        assert!(!c.come() && timeout(SOON, c.wait()).await.is_err());
        b.wait().await;
        assert!(b.come() && !b.is_waiting());
        assert!(!a.come());
        drop(b);
        c.wait().await;
        assert!(c.come());
        c.leave();
        a.leave();
        assert!(c.come(), "nobody else waits");
    }
}
