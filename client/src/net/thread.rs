//! The network's thread: one attempt to connect after the other, as it is told.

use super::failure;
use super::tls::{Wire, secured};
use super::{Url, Waker};
use escarp_proto::wire::{MAX_CLIENT_MESSAGE, MAX_SERVER_MESSAGE};
use futures_util::{Sink, SinkExt, Stream, StreamExt};
use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, mpsc, watch};
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::tungstenite::{Bytes, Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async_with_config};

/// Counts attempts to connect, so that what belongs to an old one is known.
pub(super) type Attempt = u64;

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
    Connected,
    Message(Bytes),
    /// It could not be connected, or was lost: why.
    Ended(String),
}

/// What the thread works with.
pub(super) struct Worker {
    pub(super) url: Url,
    pub(super) wanted: watch::Receiver<Option<Attempt>>,
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
                let wanted = *self.wanted.borrow_and_update();
                let Some(attempt) = wanted else { break };
                match self.attempt(attempt).await {
                    Ok(()) => break,
                    Err(Superseded) if self.wanted.has_changed().is_err() => return,
                    Err(Superseded) => {}
                }
            }
        }
    }

    /// From connecting to the end of the session, which it reports.
    async fn attempt(&mut self, attempt: Attempt) -> Result<(), Superseded> {
        let mut wanted = self.wanted.clone();
        let connected = tokio::select! {
            connected = connect(&self.url) => connected,
            _ = wanted.changed() => return Err(Superseded),
        };
        let why = match connected {
            Ok(socket) => self.session(attempt, socket, &mut wanted).await?,
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
        attempt: Attempt,
        socket: WebSocketStream<Box<dyn Wire>>,
        wanted: &mut watch::Receiver<Option<Attempt>>,
    ) -> Result<String, Superseded> {
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
                why = write(attempt, &mut self.outgoing, &mut sink) => {
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

async fn connect(url: &Url) -> Result<WebSocketStream<Box<dyn Wire>>, String> {
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
        let socket = client_async_with_config(url.session(), stream, Some(limits())).await;
        socket
            .map(|(socket, _)| socket)
            .map_err(|error| failure::no_session(url, &error))
    };
    timeout(CONNECT_TIMEOUT, connecting)
        .await
        .unwrap_or_else(|_| Err(failure::no_answer(url, CONNECT_TIMEOUT)))
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
        if self.report(Report::small(News::Connected)).await.is_none() {
            return String::new();
        }
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
    outgoing: &mut mpsc::Receiver<(Attempt, Vec<u8>)>,
    sink: &mut (impl Sink<Message, Error = Error> + Unpin),
) -> String {
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
