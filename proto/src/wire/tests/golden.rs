//! These bytes are the protocol: when one of them changes, [`PROTOCOL`] must.

use super::*;

const CLIENT: [&str; 9] = [
    "00 01 fb2c01 fd0000000000010000 01 04 6d6f6f6e fc00000100 01 01 74",
    "01 fbfb00 000000000000f03f 00000000000000c0 000000000000e03f 00000000 0000803f 00000000 \
     00000000 00000000 000080bf 0000803f fb0005 fa 00000040 00",
    "02 01 fd0e00000000000008 00 ff 03 0000c03f",
    "03 02 00 fc00000200",
    "04 fdffffffffffffffff",
    "05 01 02 efbeadde 05",
    "06 01 fbf401",
    "07 fbfb00",
    "08 06 02 c3a9",
];

const SERVER: [&str; 8] = [
    "00 01 01 02 7b7d fb0008 14 07",
    "01 01 00 efbeadde 10 03 aaffbb",
    "02 09 02",
    "03 02 02 7b7d",
    "04 05",
    "05 fbffff",
    "06 05 00",
    "07 02 08 fb5002",
];

fn bytes(hex: &str) -> Vec<u8> {
    let digits: Vec<char> = hex.chars().filter(|c| !c.is_whitespace()).collect();
    let byte = |pair: &[char]| u8::from_str_radix(&String::from_iter(pair), 16).unwrap();
    digits.chunks(2).map(byte).collect()
}

#[test]
fn each_message_has_its_bytes() {
    for (message, hex) in client_messages().iter().zip(CLIENT) {
        assert_eq!(message.encode(), bytes(hex), "{message:?}");
        assert_eq!(ClientMessage::decode(&bytes(hex)).as_ref(), Ok(message));
    }
    for (message, hex) in server_messages().iter().zip(SERVER) {
        assert_eq!(message.encode(), bytes(hex), "{message:?}");
        assert_eq!(ServerMessage::decode(&bytes(hex)).as_ref(), Ok(message));
    }
}

#[test]
fn enums_count_from_zero_in_the_order_of_the_specification() {
    let classes = [Class::Blocker, Class::InView, Class::Predicted, Class::Ring];
    for (number, class) in classes.into_iter().enumerate() {
        assert_eq!(encode(&class), [number as u8]);
    }
    for (number, scope) in [Scope::All, Scope::InView].into_iter().enumerate() {
        assert_eq!(encode(&scope), [number as u8]);
    }
    let reasons = [MissReason::NotFound, MissReason::Damaged, MissReason::Busy];
    for (number, reason) in reasons.into_iter().enumerate() {
        assert_eq!(encode(&reason), [number as u8]);
    }
    let codes = [
        ErrorCode::Version,
        ErrorCode::NoDataset,
        ErrorCode::Protocol,
        ErrorCode::Limit,
        ErrorCode::Denied,
        ErrorCode::ShuttingDown,
        ErrorCode::Internal,
    ];
    for (number, code) in codes.into_iter().enumerate() {
        assert_eq!(encode(&code), [number as u8]);
    }
}
