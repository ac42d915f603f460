//! Who may compute, and when: a few at a time, off the async threads, and only while somebody
//! waits for the answer.

use super::Problem;
use crate::heights::{HeightError, HeightLimits};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::sync::Semaphore;

/// Places for those who compute, and for those who wait.
pub(crate) struct Gates {
    requests: Arc<Semaphore>,
    images: Arc<Semaphore>,
    waiting: Arc<Semaphore>,
}

/// A request that gets no answer.
pub(crate) struct Refused(Box<Problem>);

impl From<Problem> for Refused {
    fn from(problem: Problem) -> Refused {
        Refused(Box::new(problem))
    }
}

impl From<HeightError> for Refused {
    fn from(error: HeightError) -> Refused {
        let (status, allowed) = match &error {
            HeightError::Usage { found, allowed } => {
                let problem = Problem {
                    allowed: vec![allowed.clone()],
                    ..Problem::plain(StatusCode::BAD_REQUEST, found)
                };
                return problem.into();
            }
            HeightError::TooMuch { what, most } => (
                StatusCode::UNPROCESSABLE_ENTITY,
                vec![
                    format!("{most} {what}"),
                    "fewer points, a smaller radius or size, a larger error= or resolution=".into(),
                ],
            ),
            HeightError::Page { .. } => {
                tracing::warn!(%error, "heights not given");
                (StatusCode::INTERNAL_SERVER_ERROR, Vec::new())
            }
            // Nobody is there to read it.
            HeightError::Cancelled => (StatusCode::SERVICE_UNAVAILABLE, Vec::new()),
        };
        let problem = Problem {
            allowed,
            ..Problem::plain(status, error.to_string())
        };
        problem.into()
    }
}

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        if self.0.status == StatusCode::SERVICE_UNAVAILABLE {
            return ([(header::RETRY_AFTER, "5")], *self.0).into_response();
        }
        self.0.into_response()
    }
}

/// Set when the client goes away: its request's future is dropped then.
struct CancelOnDrop(Arc<AtomicBool>);

impl Drop for CancelOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Gates {
    pub(crate) fn new(limits: &HeightLimits) -> Gates {
        let places = |count: usize| Arc::new(Semaphore::new(count.min(Semaphore::MAX_PERMITS)));
        Gates {
            requests: places(limits.requests),
            images: places(limits.images),
            waiting: places(limits.waiting),
        }
    }

    /// Computes an answer in its turn.
    pub(super) async fn request<T: Send + 'static>(
        &self,
        compute: impl FnOnce(&AtomicBool) -> Result<T, HeightError> + Send + 'static,
    ) -> Result<T, Refused> {
        self.compute(&self.requests, compute).await
    }

    /// As [`request`](Self::request), for what takes long.
    pub(crate) async fn image<T: Send + 'static>(
        &self,
        compute: impl FnOnce(&AtomicBool) -> Result<T, HeightError> + Send + 'static,
    ) -> Result<T, Refused> {
        self.compute(&self.images, compute).await
    }

    async fn compute<T: Send + 'static>(
        &self,
        places: &Arc<Semaphore>,
        compute: impl FnOnce(&AtomicBool) -> Result<T, HeightError> + Send + 'static,
    ) -> Result<T, Refused> {
        let waiting = self.waiting.clone().try_acquire_owned();
        let waiting = waiting.map_err(|_| {
            let error = "too many requests for heights wait already; try again later";
            Problem::plain(StatusCode::SERVICE_UNAVAILABLE, error)
        })?;
        let closed = |error: String| Problem::plain(StatusCode::INTERNAL_SERVER_ERROR, error);
        let place = places.clone().acquire_owned().await;
        let place = place.map_err(|error| closed(error.to_string()))?;
        drop(waiting);
        let cancel = CancelOnDrop(Arc::default());
        let cancelled = cancel.0.clone();
        let computed = tokio::task::spawn_blocking(move || {
            // The place is free when the work is done, not when the client is gone.
            let _place = place;
            compute(&cancelled)
        });
        let computed = computed.await;
        drop(cancel);
        Ok(computed.map_err(|error| closed(error.to_string()))??)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[tokio::test]
    async fn work_ends_when_nobody_waits_and_leaves_its_place() {
        let gates = Gates::new(&HeightLimits::default());
        let (told, hears) = std::sync::mpsc::channel();
        let endless = gates.image(move |cancelled| {
            while !cancelled.load(Ordering::Relaxed) {
                std::thread::yield_now();
            }
            let _ = told.send(());
            Err::<(), _>(HeightError::Cancelled)
        });
        // The client is gone after a while.
        assert!(
            tokio::time::timeout(Duration::from_millis(20), endless)
                .await
                .is_err()
        );
        let next = gates.image(move |_| Ok(hears.recv().is_ok()));
        assert!(next.await.is_ok_and(|ended| ended));
    }

    #[tokio::test]
    async fn more_than_may_wait_are_told_to_come_again() {
        let limits = HeightLimits {
            waiting: 0,
            ..HeightLimits::default()
        };
        let refused = Gates::new(&limits).request(|_| Ok(())).await;
        let response = refused.map(|()| Json(())).into_response();
        assert_eq!(response.status(), StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(response.headers()[header::RETRY_AFTER], "5");
    }

    use axum::response::Json;
}
