//! Messages of either peer, and manifests.

use escarp_proto::manifest::Manifest;
use escarp_proto::wire::{ClientMessage, ServerMessage};
use escarp_tiles::crs::extent;

/// A message from either peer: what is understood can be said again, and is then the same.
pub fn wire(data: &[u8]) {
    if let Ok(message) = ClientMessage::decode(data) {
        let again = message.encode();
        let read = ClientMessage::decode(&again).expect("own message");
        assert_eq!(read.encode(), again);
    }
    if let Ok(message) = ServerMessage::decode(data) {
        let again = message.encode();
        let read = ServerMessage::decode(&again).expect("own message");
        assert_eq!(read.encode(), again);
    }
    if let Ok(manifest) = Manifest::from_json(data) {
        understood(&manifest);
    }
}

/// A manifest that was taken: everything that is derived from it is sound.
fn understood(manifest: &Manifest) {
    let again = Manifest::from_json(&manifest.to_json()).expect("own manifest");
    assert_eq!(&again, manifest);
    for [lowest, highest] in manifest.extent_m() {
        assert!(
            lowest.is_finite() && lowest <= highest,
            "{lowest}..={highest}"
        );
    }
    extent::placement_of(manifest);
    extent::of(manifest);
    extent::suggestion(manifest);
}
