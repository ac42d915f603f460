//! The network's thread: one attempt to connect after the other, as it is told.

use super::failure;
use super::tls::{Wire, secured};
use super::{Url, Waker};
use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use escarp_proto::wire::{
    EARLY_FIELD, EARLY_HEADER, MAX_CLIENT_MESSAGE, MAX_SERVER_MESSAGE, early_value,
};
use futures_util::{Sink, SinkExt, Stream, StreamExt};
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, watch};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::handshake::client::Request;
use tokio_tungstenite::tungstenite::http::{HeaderValue, header::AUTHORIZATION};
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{Bytes, Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async_with_config};

/// Counts attempts to connect, so that what belongs to an old one is known.
pub(super) type Attempt = u64;

/// An attempt to connect, and what is said first in it.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    pub(super) attempt: Attempt,
    pub(super) early: Arc<[Vec<u8>]>,
}

/// How long name resolution, TCP and the WebSocket handshake may take together.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// How long a close frame may take; it is a courtesy.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(100);
/// How long is read on after writing failed.
const LAST_WORDS_TIMEOUT: Duration = Duration::from_secs(1);
/// Bytes received and not yet taken by the program. At least the longest message.
const RECEIVED_BYTES: usize = 2 * MAX_SERVER_MESSAGE;

const _: () = assert!(RECEIVED_BYTES >= MAX_SERVER_MESSAGE);

/// News from the socket, and the room that it takes until it is dropped.
#[derive(Debug)]
pub(super) struct Report {
    pub(super) news: News,
    _room: Option<OwnedSemaphorePermit>,
}

/// What happened to the socket.
#[derive(Debug)]
pub(super) enum News {
    Message(Bytes),
    /// It could not be connected, or was lost: why.
    Ended(String),
}

/// What the thread works with.
pub(super) struct Worker {
    pub(super) url: Url,
    pub(super) wanted: watch::Receiver<Option<Plan>>,
    pub(super) outgoing: mpsc::Receiver<(Attempt, Vec<u8>)>,
    pub(super) reports: mpsc::Sender<(Attempt, Report)>,
    pub(super) waker: Waker,
}

/// The owner dropped the connection, or wants another attempt.
struct Superseded;

impl Worker {
    /// Works until the connection is dropped.
    pub(super) fn run(mut self) {
        // Without a runtime the thread ends, which drive() reports.
        let Ok(runtime) = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
        else {
            return;
        };
        runtime.block_on(self.work());
        // A name that is being resolved cannot be stopped: leave it behind.
        runtime.shutdown_background();
    }

    async fn work(&mut self) {
        while self.wanted.changed().await.is_ok() {
            // Another value may come while the attempt is made: that ends it, and is seen here.
            loop {
                let wanted = self.wanted.borrow_and_update().clone();
                let Some(plan) = wanted else { break };
                match self.attempt(plan).await {
                    Ok(()) => break,
                    Err(Superseded) if self.wanted.has_changed().is_err() => return,
                    Err(Superseded) => {}
                }
            }
        }
    }

    /// From connecting to the end of the session, which it reports.
    async fn attempt(&mut self, plan: Plan) -> Result<(), Superseded> {
        let attempt = plan.attempt;
        let mut wanted = self.wanted.clone();
        let connected = tokio::select! {
            connected = connect(&self.url, &plan.early) => connected,
            _ = wanted.changed() => return Err(Superseded),
        };
        let why = match connected {
            Ok(socket) => self.session(&plan, socket, &mut wanted).await?,
            Err(why) => why,
        };
        let ended = self
            .reports
            .send((attempt, Report::small(News::Ended(why))));
        tokio::select! {
            _ = ended => (self.waker)(),
            _ = wanted.changed() => return Err(Superseded),
        }
        Ok(())
    }

    /// Why the session ended.
    async fn session(
        &mut self,
        plan: &Plan,
        (socket, taken): Connected,
        wanted: &mut watch::Receiver<Option<Plan>>,
    ) -> Result<String, Superseded> {
        let attempt = plan.attempt;
        let early = plan.early.get(taken..).unwrap_or_default();
        let (mut sink, stream) = socket.split();
        let inbox = Inbox {
            attempt,
            reports: &self.reports,
            waker: &self.waker,
            room: Arc::new(Semaphore::new(RECEIVED_BYTES)),
        };
        let talk = async {
            let mut reading = pin!(inbox.fill(stream));
            // Both directions at once: a server that does not read must not keep us from reading.
            tokio::select! {
                why = &mut reading => why,
                // What it said last, such as why it closes, may still be unread.
                why = write(attempt, early, &mut self.outgoing, &mut sink) => {
                    timeout(LAST_WORDS_TIMEOUT, reading).await.unwrap_or(why)
                }
            }
        };
        let end = tokio::select! {
            why = talk => Ok(why),
            _ = wanted.changed() => Err(Superseded),
        };
        if end.is_err() {
            let _ = timeout(CLOSE_TIMEOUT, sink.close()).await;
        }
        end
    }
}

impl Report {
    fn small(news: News) -> Report {
        Report { news, _room: None }
    }
}

/// A socket, and how many of the first messages the server took with the handshake.
type Connected = (WebSocketStream<Box<dyn Wire>>, usize);

async fn connect(url: &Url, early: &[Vec<u8>]) -> Result<Connected, String> {
    let connecting = async {
        let stream = TcpStream::connect((url.host(), url.port()))
            .await
            .map_err(|error| failure::no_connection(url, &error))?;
        // Cancel and Credit are small and must not wait for each other.
        stream
            .set_nodelay(true)
            .map_err(|error| failure::no_connection(url, &error))?;
        let stream: Box<dyn Wire> = match url.is_secure() {
            true => Box::new(secured(url, stream).await?),
            false => Box::new(stream),
        };
        let request = request(url, early).map_err(|error| failure::no_session(url, &error))?;
        let (socket, answer) = client_async_with_config(request, stream, Some(limits()))
            .await
            .map_err(|error| failure::no_session(url, &error))?;
        let taken = answer.headers().get(EARLY_HEADER);
        let taken = taken.and_then(|taken| taken.to_str().ok()?.parse().ok());
        Ok((socket, taken.unwrap_or(0)))
    };
    timeout(CONNECT_TIMEOUT, connecting)
        .await
        .unwrap_or_else(|_| Err(failure::no_answer(url, CONNECT_TIMEOUT)))
}

/// The handshake, with the first messages and the proof of access.
fn request(url: &Url, early: &[Vec<u8>]) -> Result<Request, Error> {
    let value = early_value(early).filter(|value| !value.is_empty());
    let address = match value {
        Some(value) => {
            let value = URL_SAFE_NO_PAD.encode(value);
            format!("{}?{EARLY_FIELD}={value}", url.session())
        }
        None => url.session(),
    };
    let mut request = address.into_client_request()?;
    if let Some(token) = url.credentials().token() {
        let proof = HeaderValue::try_from(format!("Bearer {token}"))?;
        request.headers_mut().insert(AUTHORIZATION, proof);
    }
    Ok(request)
}

/// Messages are written at once, and wait in the channel rather than in a buffer.
fn limits() -> WebSocketConfig {
    WebSocketConfig::default()
        .max_message_size(Some(MAX_SERVER_MESSAGE))
        .max_frame_size(Some(MAX_SERVER_MESSAGE))
        .write_buffer_size(0)
        .max_write_buffer_size(4 * MAX_CLIENT_MESSAGE)
}

/// Where messages from the socket go.
struct Inbox<'a> {
    attempt: Attempt,
    reports: &'a mpsc::Sender<(Attempt, Report)>,
    waker: &'a Waker,
    room: Arc<Semaphore>,
}

impl Inbox<'_> {
    /// Reads until the end, and says why it is one.
    async fn fill(self, mut stream: impl Stream<Item = Result<Message, Error>> + Unpin) -> String {
        loop {
            let bytes = match stream.next().await {
                Some(Ok(Message::Binary(bytes))) => bytes,
                Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => continue,
                Some(Ok(Message::Text(_))) => return failure::TEXT.into(),
                Some(Ok(Message::Close(frame))) => return failure::closed(frame),
                Some(Err(error)) => return failure::lost(&error),
                None => return failure::closed(None),
            };
            if self.message(bytes).await.is_none() {
                // Nobody listens: the connection is being dropped.
                return String::new();
            }
        }
    }

    /// Waits for room before it reads on, so that the socket holds the server back.
    async fn message(&self, bytes: Bytes) -> Option<()> {
        let size = u32::try_from(bytes.len()).ok()?;
        let room = Arc::clone(&self.room).acquire_many_owned(size).await.ok()?;
        let news = News::Message(bytes);
        self.report(Report {
            news,
            _room: Some(room),
        })
        .await
    }

    async fn report(&self, report: Report) -> Option<()> {
        self.reports.send((self.attempt, report)).await.ok()?;
        (self.waker)();
        Some(())
    }
}

/// Writes what belongs to this attempt until the socket fails, and says why.
async fn write(
    attempt: Attempt,
    early: &[Vec<u8>],
    outgoing: &mut mpsc::Receiver<(Attempt, Vec<u8>)>,
    sink: &mut (impl Sink<Message, Error = Error> + Unpin),
) -> String {
    for bytes in early {
        if let Err(error) = sink.send(Message::binary(bytes.clone())).await {
            return failure::lost(&error);
        }
    }
    while let Some((of, bytes)) = outgoing.recv().await {
        if of != attempt {
            continue;
        }
        if let Err(error) = sink.send(Message::binary(bytes)).await {
            return failure::lost(&error);
        }
    }
    String::new()
}
