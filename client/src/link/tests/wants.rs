//! The difference between wish lists and what is in flight.

use super::*;
use crate::link::transmit::ITEMS_A_MESSAGE;
use proptest::prelude::*;
use std::collections::BTreeSet;

fn small(max_in_flight_pages: usize) -> Link {
    open_link(LinkConfig {
        max_in_flight_pages,
        ..LinkConfig::new("moon")
    })
}

/// Wants in order, and cancelled pages in order of key.
fn difference(link: &mut Link) -> (Vec<Want>, BTreeSet<u64>) {
    let (mut asked, mut cancelled) = (Vec::new(), BTreeSet::new());
    for message in said(link, ms(1)) {
        match message {
            ClientMessage::Want(wants) => asked.extend(wants),
            ClientMessage::Cancel(pages) => {
                assert!(asked.is_empty(), "Cancel goes before Want");
                cancelled.extend(pages);
            }
            ClientMessage::Credit { .. } => {}
            other => panic!("{other:?}"),
        }
    }
    (asked, cancelled)
}

/// The same by the plainest rules: what is in flight is a list of what the server was told.
#[derive(Default)]
struct Oracle {
    in_flight: Vec<Want>,
    parts: BTreeMap<u64, u8>,
}

impl Oracle {
    fn update(&mut self, list: &[Want], places: usize) -> (Vec<Want>, BTreeSet<u64>) {
        let list: Vec<Want> = list.iter().filter_map(|want| self.lacking(want)).collect();
        let of = |page: u64| list.iter().find(|want| want.page == page);
        let dropped = self.in_flight.iter().filter(|old| of(old.page).is_none());
        let cancelled = dropped.map(|old| old.page).collect();
        self.in_flight.retain(|old| of(old.page).is_some());
        let mut told = Vec::new();
        for old in &mut self.in_flight {
            let Some(new) = of(old.page) else { continue };
            let matters = new.class != old.class
                || new.priority > 2.0 * old.priority
                || old.priority > 2.0 * new.priority
                || new.last_part != old.last_part;
            if matters {
                *old = *new;
                told.push(*new);
            }
        }
        for new in &list {
            let known = self.in_flight.iter().any(|old| old.page == new.page);
            if !known && self.in_flight.len() < places {
                self.in_flight.push(*new);
                told.push(*new);
            }
        }
        told.sort_by(|a, b| {
            let by_priority = b.priority.total_cmp(&a.priority);
            a.class
                .cmp(&b.class)
                .then(by_priority)
                .then(a.page.cmp(&b.page))
        });
        (told, cancelled)
    }

    fn lacking(&self, want: &Want) -> Option<Want> {
        let first_part = self.parts.get(&want.page).copied().unwrap_or(0);
        (first_part <= want.last_part).then_some(Want {
            first_part,
            ..*want
        })
    }

    /// A chunk up to this part comes of a page in flight.
    fn deliver(&mut self, page: u64, last: u8) {
        self.parts.insert(page, last + 1);
        self.in_flight
            .retain(|old| old.page != page || old.last_part > last);
        for old in self.in_flight.iter_mut().filter(|old| old.page == page) {
            old.first_part = last + 1;
        }
    }
}

fn class() -> impl Strategy<Value = Class> {
    prop_oneof![Just(Class::Blocker), Just(Class::InView), Just(Class::Ring)]
}

fn wish_list() -> impl Strategy<Value = Vec<Want>> {
    let wish = (0u32..24, class(), 0.5f32..9.0, 0u8..6);
    prop::collection::vec(wish, 0..30).prop_map(|wishes| {
        let mut seen = BTreeSet::new();
        let mut list: Vec<Want> = wishes
            .into_iter()
            .filter(|(number, ..)| seen.insert(*number))
            .map(|(number, class, priority, last_part)| Want {
                last_part,
                ..want(number, class, priority)
            })
            .collect();
        list.sort_by(|a, b| {
            a.class
                .cmp(&b.class)
                .then(b.priority.total_cmp(&a.priority))
        });
        list
    })
}

proptest! {
    #[test]
    fn the_difference_is_that_of_a_naive_oracle(
        frames in prop::collection::vec((wish_list(), prop::collection::vec((any::<prop::sample::Index>(), 0u8..6), 0..5)), 1..20),
        places in 1usize..12,
    ) {
        let mut link = small(places);
        let mut oracle = Oracle::default();
        for (list, deliveries) in frames {
            link.set_wants(&list, ms(1));
            prop_assert_eq!(difference(&mut link), oracle.update(&list, places));
            prop_assert_eq!(link.stats().in_flight_pages, oracle.in_flight.len());
            for (which, last) in deliveries {
                if oracle.in_flight.is_empty() { break; }
                let flight = oracle.in_flight[which.index(oracle.in_flight.len())];
                let last = last.clamp(flight.first_part, flight.last_part);
                let chunk = Chunk { page: flight.page, ..chunk(0, flight.first_part, last) };
                tell(&mut link, &ServerMessage::Pages(vec![chunk.clone()]), ms(1));
                prop_assert_eq!(events(&mut link), [Event::Chunk(chunk)]);
                oracle.deliver(flight.page, last);
            }
        }
        prop_assert_eq!(link.stats().dropped_chunks, 0);
    }
}

#[test]
fn long_lists_are_cut_into_messages_that_decode() {
    let mut link = open_link(LinkConfig {
        max_in_flight_pages: usize::MAX,
        ..LinkConfig::new("moon")
    });
    let far = PageId::new(24, (1 << 24) - 1, (1 << 24) - 1).unwrap().key();
    let list: Vec<Want> = (0..4000)
        .map(|i| Want {
            page: far - 4 * i,
            ..want(0, Class::Ring, 1.0)
        })
        .collect();
    link.set_wants(&list, ms(0));
    let messages = said(&mut link, ms(0));
    assert_eq!(messages.len(), 4000_usize.div_ceil(ITEMS_A_MESSAGE));
    link.set_wants(&[], ms(0));
    let messages = said(&mut link, ms(0));
    assert_eq!(messages.len(), 4000_usize.div_ceil(ITEMS_A_MESSAGE));
    assert!(
        messages
            .iter()
            .all(|message| matches!(message, ClientMessage::Cancel(_)))
    );
}

#[test]
fn a_list_that_does_not_change_says_nothing() {
    let mut link = small(16);
    let mut list = wants(0..100);
    list[0].priority = f32::INFINITY;
    list[1].priority = f32::NAN;
    list[2].priority = 0.0;
    link.set_wants(&list, ms(0));
    assert_eq!(difference(&mut link).0.len(), 16);
    link.set_wants(&list, ms(0));
    assert_eq!(difference(&mut link), (vec![], BTreeSet::new()));
}

#[test]
fn parts_not_yet_linked_into_the_tree_are_not_asked_for_again() {
    let mut link = small(16);
    let list = wants([1]);
    link.set_wants(&list, ms(0));
    said(&mut link, ms(0));
    tell(
        &mut link,
        &ServerMessage::Pages(vec![chunk(1, 0, 5)]),
        ms(0),
    );
    link.set_wants(&list, ms(0));
    assert_eq!(difference(&mut link), (vec![], BTreeSet::new()));
    link.evict(&[page(1)]);
    assert_eq!(events(&mut link), [], "an evicted page's chunk is dropped");
    link.set_wants(&list, ms(0));
    let evict = ClientMessage::Evict(vec![page(1).key()]);
    assert_eq!(said(&mut link, ms(0)), [evict, ClientMessage::Want(list)]);
}

#[test]
fn a_wish_for_more_parts_than_the_finest_pages_have_is_fulfilled() {
    let mut link = small(16);
    let key = PageId::new(12, 5, 5).unwrap().key();
    let wish = Want {
        page: key,
        ..want(0, Class::InView, 1.0)
    };
    link.set_wants(&[wish], ms(0));
    let asked = Want {
        last_part: 4,
        ..wish
    };
    assert_eq!(difference(&mut link).0, [asked]);
    let whole = Chunk {
        page: key,
        ..chunk(0, 0, 4)
    };
    tell(&mut link, &ServerMessage::Pages(vec![whole]), ms(0));
    assert_eq!(link.stats().in_flight_pages, 0);
    link.set_wants(&[wish], ms(0));
    assert_eq!(difference(&mut link), (vec![], BTreeSet::new()));
}

#[test]
fn a_page_rejected_by_the_caller_is_not_asked_for_again_in_this_session() {
    let mut link = small(16);
    link.set_wants(&wants([1]), ms(0));
    said(&mut link, ms(0));
    tell(
        &mut link,
        &ServerMessage::Pages(vec![chunk(1, 0, 5)]),
        ms(0),
    );
    events(&mut link);
    link.reject(page(1));
    link.set_wants(&wants([1]), ms(0));
    assert_eq!(said(&mut link, ms(0)), []);
}

#[test]
fn a_chunk_that_crosses_a_cancel_is_dropped_and_one_that_crosses_a_new_want_is_taken() {
    let mut link = small(16);
    link.set_wants(&wants([1, 2]), ms(0));
    said(&mut link, ms(0));
    link.set_wants(&[], ms(0));
    said(&mut link, ms(0));
    link.set_wants(&wants([2]), ms(0));
    let chunks = vec![chunk(1, 0, 5), chunk(2, 0, 5), chunk(2, 0, 5)];
    tell(&mut link, &ServerMessage::Pages(chunks), ms(0));
    assert_eq!(events(&mut link), [Event::Chunk(chunk(2, 0, 5))]);
    assert_eq!(link.stats().dropped_chunks, 2);
}
