//! What is wanted comes, as it lies on disk, or is missed with a reason.

use super::*;
use crate::tests::fake::Kind;
use escarp_proto::page::{RecordHeader, revision};
use escarp_proto::wire::{MissReason, PAGES_FRAME};

fn wants(pages: &[PageId]) -> ClientMessage {
    ClientMessage::Want(
        pages
            .iter()
            .map(|&page| want(page, Class::InView, 1.0))
            .collect(),
    )
}

#[test]
fn a_whole_record_comes_with_its_header_and_its_revision() {
    let mut peer = Peer::open(1 << 20);
    let page = PageId::new(4, 3, 9).unwrap();
    peer.say(wants(&[page]));
    let record = SOURCE.stored(page);
    let chunk = Chunk {
        page: page.key(),
        revision: revision(page, &record),
        first_part: 0,
        last_part: 5,
        bytes: record,
    };
    assert_eq!(peer.hear(), Some(ServerMessage::Pages(vec![chunk])));
    assert_eq!(peer.hear(), Some(ServerMessage::Idle { view_sequence: 0 }));
    assert_eq!(peer.hear(), None);
}

#[test]
fn parts_are_cut_where_the_header_says_and_clipped_to_the_last() {
    for (page, last) in [(PageId::ROOT, 5), (PageId::new(8, 1, 5).unwrap(), 4)] {
        let record = SOURCE.stored(page);
        let header = RecordHeader::read(page, last == 4, &record).unwrap();
        for first_part in 0..=last {
            for last_part in first_part..=9 {
                let mut peer = Peer::open(1 << 20);
                let wish = Want {
                    first_part,
                    last_part,
                    ..want(page, Class::InView, 1.0)
                };
                peer.say(ClientMessage::Want(vec![wish]));
                let chunk = &peer.harvest().chunks[0];
                let parts = header.part_bytes(first_part, last_part.min(last)).unwrap();
                assert_eq!(
                    (chunk.first_part, chunk.last_part),
                    (first_part, last_part.min(last))
                );
                assert_eq!(chunk.bytes, &record[parts]);
            }
        }
    }
}

#[test]
fn what_cannot_come_is_missed_with_its_reason() {
    let miss_of = |wish: Want| {
        let mut peer = Peer::open(1 << 20);
        peer.say(ClientMessage::Want(vec![wish]));
        let harvest = peer.harvest();
        assert_eq!((harvest.misses.len(), harvest.chunks.len()), (1, 0));
        assert_eq!(
            (harvest.misses[0].page, harvest.idles.len()),
            (wish.page, 1)
        );
        harvest.misses[0].reason
    };
    let page = |x| PageId::new(4, x, 2).unwrap();
    let at = |x| want(page(x), Class::InView, 1.0);
    assert_eq!(FakeSource::kind(page(13)), Kind::NotStored);
    assert_eq!(miss_of(at(13)), MissReason::NotFound);
    assert_eq!(miss_of(at(14)), MissReason::Damaged);
    assert_eq!(miss_of(at(15)), MissReason::Damaged);
    let too_deep = PageId::new(12, 0, 0).unwrap();
    assert_eq!(
        miss_of(want(too_deep, Class::InView, 1.0)),
        MissReason::NotFound
    );
    let no_page = Want {
        page: u64::MAX,
        ..at(0)
    };
    assert_eq!(miss_of(no_page), MissReason::NotFound);
    let parts = |first_part, last_part| Want {
        first_part,
        last_part,
        ..at(0)
    };
    assert_eq!(miss_of(parts(3, 2)), MissReason::NotFound);
    assert_eq!(miss_of(parts(6, 6)), MissReason::NotFound);
    assert_eq!(miss_of(parts(255, 255)), MissReason::NotFound);
}

#[test]
fn frames_are_full_but_never_too_long() {
    let mut peer = Peer::open(u64::MAX);
    let pages = stored_pages();
    peer.say(wants(&pages));
    let mut frames = Vec::new();
    while let Some(bytes) = peer.session.poll_message() {
        frames.push(bytes);
    }
    let idle = frames.pop().unwrap();
    assert_eq!(
        ServerMessage::decode(&idle),
        Ok(ServerMessage::Idle { view_sequence: 0 })
    );
    assert!(frames.iter().all(|frame| frame.len() <= PAGES_FRAME));
    let longest = pages
        .iter()
        .map(|&page| SOURCE.stored(page).len())
        .max()
        .unwrap();
    let (_, full) = frames.split_last().unwrap();
    let mut sent = 0;
    for frame in full {
        let Ok(ServerMessage::Pages(chunks)) = ServerMessage::decode(frame) else {
            panic!("no pages")
        };
        // The estimate of a chunk's length is up to 10 bytes too long.
        let fullest = frame.len() + 10 * chunks.len() + longest + 20;
        assert!(fullest > crate::session::chunk::frame_bytes(sent));
        sent += chunks
            .iter()
            .map(|chunk| chunk.bytes.len() as u64)
            .sum::<u64>();
    }
    assert!(sent > PAGES_FRAME as u64);
}

#[test]
fn a_cancel_takes_effect_between_frames() {
    let mut peer = Peer::open(u64::MAX);
    let pages = stored_pages();
    peer.say(wants(&pages));
    let Some(ServerMessage::Pages(first)) = peer.hear() else {
        panic!("no pages")
    };
    peer.say(ClientMessage::Cancel(
        pages.iter().map(|page| page.key()).collect(),
    ));
    assert!(first.len() < pages.len());
    assert_eq!(peer.hear(), Some(ServerMessage::Idle { view_sequence: 0 }));
    assert_eq!(peer.hear(), None);
}

#[test]
fn more_pages_than_allowed_are_busy_but_a_page_may_be_wanted_again() {
    let limits = Limits {
        wanted_pages: 2,
        ..Limits::default()
    };
    let mut peer = Peer::open_with(0, limits);
    let pages = &stored_pages()[..3];
    peer.say(wants(pages));
    peer.say(wants(&pages[..2]));
    let busy = Miss {
        page: pages[2].key(),
        reason: MissReason::Busy,
    };
    assert_eq!(peer.hear_all(), [ServerMessage::Miss(busy)]);
    peer.say(ClientMessage::Cancel(vec![pages[0].key()]));
    peer.say(wants(&pages[2..]));
    peer.say(ClientMessage::Credit {
        total_bytes: 1 << 20,
    });
    let sent: Vec<_> = peer
        .harvest()
        .chunks
        .iter()
        .map(|chunk| chunk.page)
        .collect();
    assert_eq!(sent, [pages[1].key(), pages[2].key()]);
}

#[test]
fn a_wish_again_replaces_the_older_one() {
    let mut peer = Peer::open(0);
    let page = stored_pages()[0];
    peer.say(wants(&[page]));
    let newer = Want {
        last_part: 2,
        ..want(page, Class::Ring, 1.0)
    };
    peer.say(ClientMessage::Want(vec![newer]));
    peer.say(ClientMessage::Credit {
        total_bytes: 1 << 20,
    });
    let harvest = peer.harvest();
    assert_eq!(harvest.chunks.len(), 1);
    assert_eq!(harvest.chunks[0].last_part, 2);
}

#[test]
fn credit_is_used_to_its_last_byte_and_not_beyond() {
    let page = stored_pages()[0];
    let length = SOURCE.stored(page).len() as u64;
    let mut peer = Peer::open(length - 1);
    peer.say(wants(&[page]));
    assert_eq!(peer.hear(), None);
    peer.say(ClientMessage::Credit {
        total_bytes: length,
    });
    assert_eq!(peer.harvest().chunks.len(), 1);
}

#[test]
fn the_model_of_the_cache_follows_what_is_sent_had_and_evicted() {
    let mut peer = Peer::open(1 << 20);
    let (sent, had) = (stored_pages()[0], stored_pages()[1]);
    peer.say(wants(&[sent]));
    peer.hear_all();
    peer.say(ClientMessage::Have(vec![have(had, 3)]));
    assert_eq!(peer.hear(), Some(ServerMessage::Stale(Vec::new())));
    assert_eq!(peer.session.client_has(sent), Some(5));
    assert_eq!(peer.session.client_has(had), Some(3));
    peer.say(ClientMessage::Evict(vec![sent.key(), had.key()]));
    assert_eq!(
        (peer.session.client_has(sent), peer.session.client_has(had)),
        (None, None)
    );
    assert_eq!(peer.session.close_reason(), None);
}

#[test]
fn parts_that_do_not_join_on_are_not_counted_as_had() {
    let mut peer = Peer::open(1 << 20);
    let page = stored_pages()[0];
    let part = |first_part, last_part| {
        ClientMessage::Want(vec![Want {
            first_part,
            last_part,
            ..want(page, Class::InView, 1.0)
        }])
    };
    let mut last_part_after = |message| {
        peer.say(message);
        peer.hear_all();
        peer.session.client_has(page)
    };
    assert_eq!(last_part_after(part(3, 4)), None);
    assert_eq!(last_part_after(part(0, 2)), Some(2));
    assert_eq!(last_part_after(part(4, 5)), Some(2));
    assert_eq!(last_part_after(part(3, 5)), Some(5));
}
