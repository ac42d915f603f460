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
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
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
