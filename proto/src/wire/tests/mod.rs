//! The encoding, byte for byte, and what it refuses.

mod golden;
mod hostile;

use super::*;

/// A message of each kind from a client.
fn client_messages() -> Vec<ClientMessage> {
    vec![
        ClientMessage::Hello(Hello {
            oldest: 1,
            newest: 300,
            capabilities: 1 << 40,
            codecs: 1,
            dataset: "moon".into(),
            credit_bytes: 65536,
            token: Some("t".into()),
        }),
        ClientMessage::View {
            sequence: 251,
            view: View {
                eye_m: [1.0, -2.0, 0.5],
                direction: [0.0, 1.0, 0.0],
                velocity_m_s: [0.0, 0.0, -1.0],
                fov_y: 1.0,
                viewport_px: [1280, 250],
                max_screen_error_px: 2.0,
            },
            scope: Scope::All,
        },
        ClientMessage::Want(vec![Want {
            page: 4 << 56 | 7,
            first_part: 0,
            last_part: 255,
            class: Class::Ring,
            priority: 1.5,
        }]),
        ClientMessage::Cancel(vec![0, 65536]),
        ClientMessage::Credit {
            total_bytes: u64::MAX,
        },
        ClientMessage::Have(vec![Have {
            page: 1,
            revision: 0xdead_beef,
            parts: 5,
        }]),
        ClientMessage::Evict(vec![250]),
        ClientMessage::Ping(251),
        ClientMessage::Error(PeerError::new(ErrorCode::Internal, "é")),
    ]
}

/// A message of each kind from a server.
fn server_messages() -> Vec<ServerMessage> {
    vec![
        ServerMessage::Welcome(Welcome {
            version: 1,
            capabilities: 1,
            manifest: b"{}".to_vec(),
            limits: SessionLimits {
                wanted_pages: 2048,
                views_per_second: 20,
                held_pages: 7,
            },
        }),
        ServerMessage::Pages(vec![Chunk {
            page: 0,
            revision: 0xdead_beef,
            first_part: 0,
            last_part: 1,
            bytes: vec![0xaa, 0xff, 0xbb],
        }]),
        ServerMessage::Miss(Miss {
            page: 9,
            reason: MissReason::Busy,
        }),
        ServerMessage::GenChange {
            generation: 2,
            manifest: b"{}".to_vec(),
        },
        ServerMessage::Idle { view_sequence: 5 },
        ServerMessage::Pong(65535),
        ServerMessage::Error(PeerError::new(ErrorCode::ShuttingDown, "")),
        ServerMessage::Stale(vec![4, 300]),
    ]
}
