//! A server that is not to be trusted: it speaks the protocol, and says what a test makes it say.

use crate::host::MEMORY;
use escarp_client::app::headless::Driver;
use escarp_client::net::Url;
use escarp_client::remote::RemoteTerrain;
use escarp_proto::geometry::PageId;
use escarp_proto::page::RecordHeader;
use escarp_proto::wire::{
    Chunk, ClientMessage, PROTOCOL, ServerMessage, SessionLimits, Want, Welcome,
};
use escarp_tiles::dataset::Dataset;
use futures_util::{SinkExt, StreamExt};
use std::sync::Arc;
use tokio::net::{TcpListener, TcpStream};
use tokio::runtime::{Builder, Runtime};
use tokio_tungstenite::tungstenite::Message;

/// What is sent in place of a true chunk: whole messages, as bytes. An empty one ends the session
/// with half a frame.
pub type Lie = dyn Fn(Chunk) -> Vec<Vec<u8>> + Send + Sync;

/// What is said to a client's message, Hello included: whole messages, as bytes.
pub type Speech = dyn Fn(&Dataset, ClientMessage) -> Vec<Vec<u8>> + Send + Sync;

/// A server of one dataset that lies.
pub struct Liar {
    port: u16,
    runtime: Option<Runtime>,
}

impl Liar {
    /// Starts it on a port that the system chooses.
    ///
    /// # Panics
    /// If it does not start.
    pub fn start(dataset: Dataset, lie: Box<Lie>) -> Liar {
        Liar::speaking(
            dataset,
            Box::new(move |dataset, message| answer(dataset, message, &lie)),
        )
    }

    /// Starts one that says what it likes to whatever it hears.
    ///
    /// # Panics
    /// If it does not start.
    pub fn speaking(dataset: Dataset, speech: Box<Speech>) -> Liar {
        let runtime = Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build();
        let runtime = runtime.expect("a runtime");
        let listener = runtime
            .block_on(TcpListener::bind("127.0.0.1:0"))
            .expect("a port");
        let port = listener.local_addr().expect("an address").port();
        let (dataset, speech) = (Arc::new(dataset), Arc::<Speech>::from(speech));
        runtime.spawn(async move {
            while let Ok((stream, _)) = listener.accept().await {
                tokio::spawn(session(stream, dataset.clone(), Arc::clone(&speech)));
            }
        });
        Liar {
            port,
            runtime: Some(runtime),
        }
    }

    /// The address of its dataset.
    ///
    /// # Panics
    /// If there is no address for it.
    pub fn url(&self) -> Url {
        let url = format!("http://127.0.0.1:{}/moon", self.port).parse();
        url.expect("an address")
    }

    /// A client of its dataset.
    ///
    /// # Panics
    /// If there is no address for it.
    pub fn client(&self) -> Driver {
        let url = format!("http://127.0.0.1:{}/moon", self.port).parse();
        Driver::new(RemoteTerrain::open(url.expect("an address"), MEMORY))
    }
}

impl Drop for Liar {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

/// The truth about all but chunks, which are lied about.
fn answer(dataset: &Dataset, message: ClientMessage, lie: &Lie) -> Vec<Vec<u8>> {
    match message {
        ClientMessage::Hello(_) => vec![welcome(dataset, 0).encode()],
        ClientMessage::Ping(number) => vec![ServerMessage::Pong(number).encode()],
        ClientMessage::Want(wants) => {
            let chunks = wants.iter().filter_map(|want| chunk(dataset, want));
            chunks.flat_map(lie).collect()
        }
        _ => vec![],
    }
}

/// One client's session. Ends without a word when the client, or the lie, does.
async fn session(stream: TcpStream, dataset: Arc<Dataset>, speech: Arc<Speech>) {
    let Ok(mut socket) = tokio_tungstenite::accept_async(stream).await else {
        return;
    };
    while let Some(Ok(message)) = socket.next().await {
        let Message::Binary(bytes) = message else {
            continue;
        };
        let Ok(message) = ClientMessage::decode(&bytes) else {
            continue;
        };
        for answer in speech(&dataset, message) {
            if answer.is_empty() {
                return half_a_frame(socket.into_inner()).await;
            }
            if socket.send(Message::binary(answer)).await.is_err() {
                return;
            }
        }
    }
}

/// A frame's head that promises more than follows.
async fn half_a_frame(stream: TcpStream) {
    // Final binary frame, not masked, 1000 bytes long, of which 3 come.
    let half = [0x82, 126, 0x03, 0xe8, 1, 2, 3];
    let _ = stream.writable().await;
    let _ = stream.try_write(&half);
}

/// The truth about a wish.
pub fn chunk(dataset: &Dataset, want: &Want) -> Option<Chunk> {
    let page = PageId::from_key(want.page)?;
    let record = dataset.record(page).ok()??;
    let header = RecordHeader::read(page, dataset.grid().is_finest(page), record.bytes).ok()?;
    let bytes = header.part_bytes(want.first_part, want.last_part)?;
    Some(Chunk {
        page: want.page,
        revision: record.revision,
        first_part: want.first_part,
        last_part: want.last_part,
        bytes: record.bytes[bytes].to_vec(),
    })
}

/// A greeting with these capabilities.
pub fn welcome(dataset: &Dataset, capabilities: u64) -> ServerMessage {
    ServerMessage::Welcome(Welcome {
        version: PROTOCOL,
        capabilities,
        manifest: dataset.manifest_json().to_vec(),
        limits: SessionLimits {
            wanted_pages: 1024,
            views_per_second: 20,
            held_pages: 4096,
        },
    })
}
