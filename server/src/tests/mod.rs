//! The server over real loopback sockets, on a fake dataset.

pub(crate) mod fake;

mod heights;
mod http;
mod openapi;
mod sessions;

use crate::{Catalog, Limits, PageSource, serve};
use escarp_proto::wire::{ClientMessage, Hello, ServerMessage};
use fake::FakeSource;
use futures_util::{SinkExt, StreamExt};
use serde_json::Value;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream};

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

/// A server of this process, on a free port.
struct Server {
    address: SocketAddr,
    source: Arc<FakeSource>,
    catalog: Arc<Catalog>,
    shutdown: oneshot::Sender<()>,
    task: JoinHandle<io::Result<()>>,
}

impl Server {
    async fn start(limits: Limits) -> Server {
        let source = Arc::new(FakeSource::new());
        let catalog = Catalog::default();
        catalog.add("fake", source.clone()).unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (shutdown, told) = oneshot::channel();
        let catalog = Arc::new(catalog);
        let serving = serve(listener, catalog.clone(), limits, async {
            let _ = told.await;
        });
        Server {
            address,
            source,
            catalog,
            shutdown,
            task: tokio::spawn(serving),
        }
    }

    async fn connect(&self) -> Socket {
        let url = format!("ws://{}/session", self.address);
        tokio_tungstenite::connect_async(url).await.unwrap().0
    }

    /// A session after Welcome.
    async fn open(&self, credit_bytes: u64) -> Socket {
        let mut socket = self.connect().await;
        say(&mut socket, ClientMessage::Hello(hello(credit_bytes))).await;
        assert!(matches!(
            hear(&mut socket).await,
            Some(ServerMessage::Welcome(_))
        ));
        socket
    }

    /// Tells the server to go down, and waits until it has.
    async fn stop(self) {
        self.shutdown.send(()).unwrap();
        self.task.await.unwrap().unwrap();
    }
}

/// An answer, read without a library, so that its bytes are what the server sent.
struct Answer {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Answer {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap()
    }

    fn header(&self, name: &str) -> Option<&str> {
        let mut lines = self.head.lines().filter_map(|line| line.split_once(": "));
        let line = lines.find(|(key, _)| key.eq_ignore_ascii_case(name));
        line.map(|(_, value)| value)
    }
}

/// Sends one request on a connection of its own: the first line without the version, lines of
/// header beyond Host, each with its end, and a body.
async fn ask(address: SocketAddr, what: &str, headers: &str, body: &str) -> Answer {
    let mut stream = TcpStream::connect(address).await.unwrap();
    let named = headers.to_ascii_lowercase().starts_with("host:");
    let host = if named {
        String::new()
    } else {
        format!("Host: {address}\r\n")
    };
    let text = format!("{what} HTTP/1.1\r\n{host}Connection: close\r\n{headers}\r\n{body}");
    stream.write_all(text.as_bytes()).await.unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).await.unwrap();
    let end = bytes.windows(4).position(|four| four == b"\r\n\r\n");
    let end = end.unwrap();
    let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
    Answer {
        status: head[9..12].parse().unwrap(),
        head,
        body: bytes[end + 4..].to_vec(),
    }
}

fn hello(credit_bytes: u64) -> Hello {
    Hello {
        oldest: escarp_proto::wire::PROTOCOL,
        newest: escarp_proto::wire::PROTOCOL,
        capabilities: 0,
        codecs: 1,
        dataset: String::new(),
        credit_bytes,
        token: None,
    }
}

async fn say(socket: &mut Socket, message: ClientMessage) {
    socket
        .send(Message::binary(message.encode()))
        .await
        .unwrap();
}

/// The next message; `None` when the session is over, in whatever way.
async fn hear(socket: &mut Socket) -> Option<ServerMessage> {
    loop {
        match socket.next().await {
            Some(Ok(Message::Binary(bytes))) => {
                return Some(ServerMessage::decode(&bytes).unwrap());
            }
            Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
            Some(Ok(Message::Close(_)) | Err(_)) | None => return None,
            Some(Ok(other)) => panic!("{other:?}"),
        }
    }
}
