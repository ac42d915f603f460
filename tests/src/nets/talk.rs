//! A session without a mesh: says what it is told to, and counts what comes.

use anyhow::{Context, Result, bail, ensure};
use escarp_client::net::Url;
use escarp_proto::page::Codec;
use escarp_proto::wire::{
    ClientMessage, Hello, MAX_SERVER_MESSAGE, PROTOCOL, ServerMessage, capability,
};
use futures_util::{SinkExt, StreamExt};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::WebSocketConfig;
use tokio_tungstenite::{WebSocketStream, client_async_with_config};

/// Page bytes that the server may send ahead: what the usual client grants at first.
const CREDIT: u64 = 1 << 20;

/// A session.
pub struct Talk {
    socket: WebSocketStream<TcpStream>,
    granted: u64,
    /// Page bytes that came.
    pub received: u64,
    /// Whether the server sends unasked.
    pub pushes: bool,
}

impl Talk {
    /// Opens a session, and asks for push or does not.
    ///
    /// # Errors
    /// If the server cannot be reached, or refuses.
    pub async fn open(url: &Url, push: bool) -> Result<Talk> {
        let stream = TcpStream::connect((url.host(), url.port())).await;
        let stream = stream.context("connecting")?;
        stream.set_nodelay(true)?;
        let config = WebSocketConfig::default()
            .read_buffer_size(16 << 10)
            .write_buffer_size(0)
            .max_write_buffer_size(1 << 20)
            .max_message_size(Some(MAX_SERVER_MESSAGE))
            .max_frame_size(Some(MAX_SERVER_MESSAGE));
        let opened = client_async_with_config(url.session(), stream, Some(config)).await;
        let (socket, _) = opened.context("opening a session")?;
        let mut talk = Talk {
            socket,
            granted: CREDIT,
            received: 0,
            pushes: false,
        };
        talk.say(&ClientMessage::Hello(Hello {
            oldest: PROTOCOL,
            newest: PROTOCOL,
            capabilities: if push { capability::PUSH } else { 0 },
            codecs: Codec::KNOWN,
            dataset: url.dataset().unwrap_or("").to_owned(),
            credit_bytes: CREDIT,
            token: None,
        }))
        .await?;
        match talk.hear().await? {
            ServerMessage::Welcome(welcome) => {
                talk.pushes = welcome.capabilities & capability::PUSH != 0;
            }
            other => bail!("instead of Welcome: {other:?}"),
        }
        ensure!(talk.pushes == push, "the server does not push");
        Ok(talk)
    }

    /// Says something.
    ///
    /// # Errors
    /// If the connection is lost.
    pub async fn say(&mut self, message: &ClientMessage) -> Result<()> {
        self.socket.send(Message::binary(message.encode())).await?;
        Ok(())
    }

    /// Waits for what the server says next. May be dropped and called again.
    ///
    /// # Errors
    /// If the connection is lost, or the server ends the session.
    pub async fn hear(&mut self) -> Result<ServerMessage> {
        loop {
            let message = self
                .socket
                .next()
                .await
                .context("the connection is closed")??;
            match message {
                Message::Binary(bytes) => match ServerMessage::decode(&bytes)? {
                    ServerMessage::Error(error) => bail!("the server says: {}", error.text),
                    message => return Ok(self.count(message)),
                },
                Message::Close(frame) => bail!("the server closed the connection: {frame:?}"),
                _ => {}
            }
        }
    }

    fn count(&mut self, message: ServerMessage) -> ServerMessage {
        if let ServerMessage::Pages(chunks) = &message {
            self.received += chunks.iter().map(|c| c.bytes.len() as u64).sum::<u64>();
        }
        message
    }

    /// Grants more credit if half of it is used.
    ///
    /// # Errors
    /// If the connection is lost.
    pub async fn grant(&mut self) -> Result<()> {
        if self.granted < self.received + CREDIT / 2 {
            self.granted = self.received + CREDIT;
            let total_bytes = self.granted;
            self.say(&ClientMessage::Credit { total_bytes }).await?;
        }
        Ok(())
    }

    /// Says good-bye.
    ///
    /// # Errors
    /// If the connection is lost.
    pub async fn close(&mut self) -> Result<()> {
        Ok(self.socket.close(None).await?)
    }
}
