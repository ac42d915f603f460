//! Sessions over WebSocket: who may open one, and how they end.

mod drive;
mod early;
mod outgoing;
mod tally;
mod turns;

use crate::access::{Caller, too_many};
use crate::http::{App, Problem};
use crate::limits::{Limits, SOCKET_MESSAGE_BYTES};
use crate::metrics::{Refusal, Share};
use crate::session::Session;
use axum::extract::ws::{WebSocketUpgrade, rejection::WebSocketUpgradeRejection};
use axum::extract::{Extension, RawQuery, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use escarp_proto::wire::{EARLY_HEADER, MAX_SERVER_MESSAGE};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::sync::{Semaphore, watch};
use tracing::Instrument;

/// Bytes that a socket reads at a time. The default, 128 KiB a session, is for bigger messages.
const READ_BUFFER_BYTES: usize = 8 << 10;

/// When to try again after a session was refused for want of a place.
const RETRY: Duration = Duration::from_secs(5);

/// How far the server is from its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Phase {
    /// New sessions are welcome.
    Serving,
    /// Sessions are told to go.
    Draining,
    /// Whatever is left is dropped.
    Stopped,
}

/// The places for sessions.
#[derive(Clone)]
pub(crate) struct Sessions {
    limits: Arc<Limits>,
    places: Arc<Semaphore>,
    /// Turns for what takes long: one a processor.
    turns: Arc<Semaphore>,
    phase: watch::Receiver<Phase>,
    opened: Arc<AtomicU64>,
}

impl Sessions {
    pub(crate) fn new(limits: Arc<Limits>, phase: watch::Receiver<Phase>) -> Sessions {
        Sessions {
            places: Arc::new(Semaphore::new(places(&limits) as usize)),
            turns: Arc::new(Semaphore::new(turns::at_a_time())),
            limits,
            phase,
            opened: Arc::default(),
        }
    }

    /// Waits until there is no session.
    pub(crate) async fn ended(&self) {
        // The semaphore is never closed; all places free means that nobody is left.
        let _ = self.places.acquire_many(places(&self.limits)).await;
    }
}

/// Sessions allowed, within what a semaphore can count.
fn places(limits: &Limits) -> u32 {
    u32::try_from(limits.sessions)
        .unwrap_or(u32::MAX)
        .min(u32::MAX >> 4)
}

/// `/session`: opens a session, if there is a place.
pub(crate) async fn upgrade(
    State(app): State<App>,
    Extension(caller): Extension<Caller>,
    RawQuery(query): RawQuery,
    upgrade: Result<WebSocketUpgrade, WebSocketUpgradeRejection>,
) -> Response {
    let upgrade = match upgrade {
        Ok(upgrade) => upgrade,
        Err(rejection) => {
            let text = format!("/session takes WebSocket connections only: {rejection}");
            return Problem::plain(rejection.status(), text).into_response();
        }
    };
    let early = match early::messages(query.as_deref()) {
        Ok(early) => early,
        Err(text) => return Problem::plain(StatusCode::BAD_REQUEST, text).into_response(),
    };
    let taken = early.len();
    let (sessions, metrics) = (app.sessions, app.gate.metrics.clone());
    if !caller.may_connect() {
        metrics.session_refused(Refusal::Origin);
        let text = "web pages of this origin may not open sessions";
        return Problem::plain(StatusCode::FORBIDDEN, text).into_response();
    }
    let Ok(held) = app.gate.session(&caller) else {
        metrics.session_refused(Refusal::Address);
        return too_many(RETRY);
    };
    let serving = *sessions.phase.borrow() == Phase::Serving;
    let Some(place) = sessions
        .places
        .clone()
        .try_acquire_owned()
        .ok()
        .filter(|_| serving)
    else {
        metrics.session_refused(if serving {
            Refusal::Full
        } else {
            Refusal::Draining
        });
        return busy(&sessions.limits);
    };
    let id = sessions.opened.fetch_add(1, Ordering::Relaxed);
    let client = caller.address.map(tracing::field::display);
    let span = tracing::info_span!("session", session = id, client);
    let session = Session::new(app.catalog, sessions.limits.as_ref().clone()).for_caller(caller);
    let mut response = bounded(upgrade).on_upgrade(move |socket| {
        let driven = async move {
            metrics.sessions.inc();
            let open = Share::one(&metrics.sessions_open);
            let Sessions {
                limits,
                phase,
                turns,
                ..
            } = sessions;
            let drive = drive::drive(socket, session, early, &limits, phase, turns, &metrics);
            let reason = drive.await;
            metrics.session_over(reason.as_ref());
            drop((place, held, open));
        };
        driven.instrument(span)
    });
    let headers = response.headers_mut();
    headers.insert(EARLY_HEADER, HeaderValue::from(taken));
    response
}

/// The library's own bounds are 64 MiB for a message, and none for what waits to be written.
fn bounded(upgrade: WebSocketUpgrade) -> WebSocketUpgrade {
    upgrade
        .read_buffer_size(READ_BUFFER_BYTES)
        .max_message_size(SOCKET_MESSAGE_BYTES)
        .max_frame_size(SOCKET_MESSAGE_BYTES)
        .write_buffer_size(0)
        .max_write_buffer_size(MAX_SERVER_MESSAGE + READ_BUFFER_BYTES)
}

fn busy(limits: &Limits) -> Response {
    let error = format!(
        "all {} sessions are taken; try again later",
        limits.sessions
    );
    let problem = Problem::plain(StatusCode::SERVICE_UNAVAILABLE, error);
    (
        [(header::RETRY_AFTER, RETRY.as_secs().to_string())],
        problem,
    )
        .into_response()
}
