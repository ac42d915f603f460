//! What is sent unasked: the needs of the newest view, less what the client has.
//!
//! Needs are cut into pieces, so that what is coarse everywhere goes before what is fine anywhere:
//! a piece ends where what is left of a page's error is an [`EIGHTH`] of what it was. A page never
//! goes before the one above it.

use super::held::Held;
use super::queue::Wish;
use escarp_proto::geometry::PageId;
use escarp_proto::select::Need;
use escarp_proto::wire::Class;
use foldhash::fast::RandomState;
use std::cmp::Ordering;
use std::collections::HashMap;

/// Finer pieces would cost more in what a chunk takes beside its parts, some 20 bytes, than they
/// bring forward.
const EIGHTH: f32 = 0.125;

/// Parts of a page to be sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    pub page: PageId,
    /// The first part that the client lacked when the piece was cut.
    pub first_part: u8,
    pub last_part: u8,
    pub class: Class,
    /// How many times over the tolerance the page is without it.
    pub excess: f32,
}

impl Piece {
    pub(super) fn wish(&self) -> Wish {
        Wish {
            page: self.page,
            first_part: self.first_part,
            last_part: self.last_part,
        }
    }
}

/// Where a piece stands in the order.
#[derive(Debug, Clone, Copy)]
struct Rank {
    class: Class,
    excess: f32,
}

impl Rank {
    const FIRST: Rank = Rank {
        class: Class::Blocker,
        excess: f32::INFINITY,
    };

    /// Not before another.
    fn after(self, other: Rank) -> Rank {
        Rank {
            class: self.class.max(other.class),
            excess: match self.class < other.class {
                true => other.excess,
                false if self.class == other.class => self.excess.min(other.excess),
                false => self.excess,
            },
        }
    }
}

/// What became of the pieces before, and of the needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Replaced {
    /// Pieces of before.
    pub dropped: usize,
    /// There was room for all.
    pub is_all: bool,
}

/// Pieces that wait, for now and for what lies ahead.
#[derive(Debug, Default)]
pub(super) struct Pushes {
    /// Most urgent last.
    now: Vec<Piece>,
    /// Most urgent last.
    ahead: Vec<Piece>,
}

impl Pushes {
    /// Replaces all that waits by what these needs lack, as far as there is room for pieces.
    pub(super) fn replace(&mut self, needs: &[Need], held: &Held, room: usize) -> Replaced {
        let dropped = self.now.len() + self.ahead.len();
        // What something in view waits for mends at least as much as that: it needs no class of
        // its own, which would bring fine things forward before coarse ones.
        self.now = cut(needs, held, |class| Some(class.max(Class::InView)));
        self.ahead = Vec::new();
        let is_all = keep_most_urgent(&mut self.now, room);
        Replaced { dropped, is_all }
    }

    /// Replaces what lies ahead: of these needs, what will be in view.
    pub(super) fn replace_ahead(&mut self, needs: &[Need], held: &Held, room: usize) {
        let in_view = |class| (class <= Class::InView).then_some(Class::Predicted);
        self.ahead = cut(needs, held, in_view);
        keep_most_urgent(&mut self.ahead, room);
    }

    /// The most urgent piece. What lies ahead goes before the ring, if it may go at all.
    pub(super) fn first(&self, ahead: bool) -> Option<&Piece> {
        let now = self.now.last();
        match now {
            Some(piece) if piece.class <= Class::InView => now,
            _ => self.ahead.last().filter(|_| ahead).or(now),
        }
    }

    /// Takes the piece that [`first`](Self::first) returned out.
    pub(super) fn remove_first(&mut self, class: Class) {
        match class {
            Class::Predicted => self.ahead.pop(),
            _ => self.now.pop(),
        };
    }

    /// Whether nothing waits but what lies ahead.
    pub(super) fn is_done(&self) -> bool {
        self.now.is_empty()
    }

    /// Whether nothing waits that is needed for the picture.
    pub(super) fn shows_all(&self) -> bool {
        self.now
            .last()
            .is_none_or(|piece| piece.class > Class::InView)
    }

    pub(super) fn len(&self) -> usize {
        self.now.len() + self.ahead.len()
    }

    pub(super) fn clear(&mut self) {
        *self = Pushes::default();
    }
}

/// Keeps so many pieces, the last ones. Whether that is all.
fn keep_most_urgent(pieces: &mut Vec<Piece>, room: usize) -> bool {
    let left_out = pieces.len().saturating_sub(room);
    pieces.drain(..left_out);
    pieces.shrink_to_fit();
    left_out == 0
}

/// Cuts what the client lacks of these needs into pieces, most urgent last. `class_of` gives
/// another class to a need, or none to one that is left out.
fn cut(needs: &[Need], held: &Held, class_of: impl Fn(Class) -> Option<Class>) -> Vec<Piece> {
    let mut pieces = Vec::new();
    // Of pages of which the client lacks something, and of those below them.
    let mut ranks: HashMap<PageId, Rank, RandomState> = HashMap::default();
    // A selection lists parents first.
    for need in needs {
        let Some(class) = class_of(need.class) else {
            continue;
        };
        let mut part = held.next_part(need.page);
        if part > need.last_part && ranks.is_empty() {
            continue;
        }
        let above = need.page.parent().and_then(|(page, _)| ranks.get(&page));
        if part > need.last_part && above.is_none() {
            continue;
        }
        let mut rank = above.copied().unwrap_or(Rank::FIRST);
        while part <= need.last_part {
            let excess = excess_at(need, part);
            rank = Rank { class, excess }.after(rank);
            // The header alone shows nothing, and a client refuses it.
            let end = (part.max(1) + 1..=need.last_part)
                .find(|&next| {
                    let rest = excess_at(need, next);
                    rest < excess && rest <= EIGHTH * excess
                })
                .unwrap_or(need.last_part + 1);
            pieces.push(Piece {
                page: need.page,
                first_part: part,
                last_part: end - 1,
                class: rank.class,
                excess: rank.excess,
            });
            part = end;
        }
        ranks.insert(need.page, rank);
    }
    pieces.sort_unstable_by(|a, b| compare(b, a));
    pieces
}

/// How many times over the tolerance a page is with the parts before this one.
fn excess_at(need: &Need, part: u8) -> f32 {
    let parts = usize::from(part.saturating_sub(1));
    need.excess.get(parts).copied().unwrap_or(0.0)
}

/// Most urgent first.
fn compare(a: &Piece, b: &Piece) -> Ordering {
    let key = |piece: &Piece| (piece.page.key(), piece.first_part);
    a.class
        .cmp(&b.class)
        .then(b.excess.total_cmp(&a.excess))
        .then(key(a).cmp(&key(b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use escarp_proto::geometry::Slot;
    use escarp_proto::page::SLOT_PART;
    use escarp_proto::select::PART_COUNTS;
    use proptest::prelude::*;
    use std::collections::HashSet;

    fn need(page: PageId, class: Class, excess: f32, last_part: u8) -> Need {
        let mut left = excess;
        Need {
            page,
            last_part,
            class,
            excess: std::array::from_fn(|parts| {
                let now = left;
                left /= 2.0;
                if parts < last_part.into() { now } else { 0.0 }
            }),
            guessed: false,
        }
    }

    /// The root, some of its children, some of theirs: parents first.
    fn needs() -> impl Strategy<Value = Vec<Need>> {
        let one = (0..64u8, 0..64u8, 0..4u8, 0.1..1e4f32, 1..=SLOT_PART);
        prop::collection::vec(one, 0..60).prop_map(|list| {
            let classes = [Class::Blocker, Class::InView, Class::Ring, Class::Ring];
            let mut pages: Vec<Need> = vec![need(PageId::ROOT, Class::InView, 1e4, SLOT_PART)];
            let mut seen = HashSet::from([PageId::ROOT]);
            for (slot, below, class, excess, last) in list {
                let child = PageId::ROOT.child(Slot::from_index(slot)).unwrap();
                for page in [child, child.child(Slot::from_index(below)).unwrap()] {
                    if seen.insert(page) {
                        pages.push(need(page, classes[usize::from(class)], excess, last));
                    }
                }
            }
            pages.sort_by_key(|need| need.page.key());
            pages
        })
    }

    fn drained(pushes: &mut Pushes, ahead: bool) -> Vec<Piece> {
        let mut pieces = Vec::new();
        while let Some(&piece) = pushes.first(ahead) {
            pushes.remove_first(piece.class);
            pieces.push(piece);
        }
        pieces
    }

    proptest! {
        #[test]
        fn every_part_that_is_lacked_comes_once_in_order_and_after_the_page_above(
            needs in needs(),
            held in prop::collection::vec((0..60usize, 0..=SLOT_PART), 0..10),
        ) {
            let mut model = Held::new(usize::MAX);
            for (index, last) in held {
                if let Some(need) = needs.get(index) {
                    model.insert(need.page, last);
                }
            }
            let mut pushes = Pushes::default();
            pushes.replace(&needs, &model, usize::MAX);
            for piece in drained(&mut pushes, true) {
                prop_assert_eq!(piece.first_part, model.next_part(piece.page));
                if let Some((above, _)) = piece.page.parent() {
                    let of_parent = needs.iter().find(|need| need.page == above);
                    let due = of_parent.map_or(0, |need| need.last_part + 1);
                    prop_assert!(model.next_part(above) >= due, "{} before {above}", piece.page);
                }
                model.sent(piece.page, piece.first_part, piece.last_part);
            }
            for need in &needs {
                prop_assert!(model.next_part(need.page) > need.last_part);
            }
        }

        #[test]
        fn pieces_go_by_class_and_then_by_what_they_mend(needs in needs()) {
            let mut pushes = Pushes::default();
            pushes.replace(&needs, &Held::new(usize::MAX), usize::MAX);
            for pair in drained(&mut pushes, true).windows(2) {
                let [a, b] = pair else { unreachable!() };
                prop_assert!(a.class < b.class || a.class == b.class && a.excess >= b.excess);
            }
        }
    }

    #[test]
    fn what_is_coarse_everywhere_goes_before_what_is_fine_anywhere() {
        let child = |slot| PageId::ROOT.child(Slot::from_index(slot)).unwrap();
        let needs = [
            need(PageId::ROOT, Class::InView, 1e4, SLOT_PART),
            need(child(0), Class::InView, 64.0, 5),
            need(child(1), Class::InView, 60.0, 5),
        ];
        let mut pushes = Pushes::default();
        pushes.replace(&needs, &Held::new(9), usize::MAX);
        let order: Vec<_> = drained(&mut pushes, false)
            .iter()
            .map(|piece| (piece.page, piece.first_part, piece.last_part))
            .collect();
        assert_eq!(
            order[order.len() - 4..],
            [
                (child(0), 0, 3),
                (child(1), 0, 3),
                (child(0), 4, 5),
                (child(1), 4, 5)
            ]
        );
    }

    #[test]
    fn what_lies_ahead_goes_before_the_ring_and_only_if_it_may() {
        let child = |slot| PageId::ROOT.child(Slot::from_index(slot)).unwrap();
        let now = [
            need(PageId::ROOT, Class::InView, 8.0, 1),
            need(child(0), Class::Ring, 4.0, 1),
        ];
        let later = [
            need(child(1), Class::InView, 2.0, 1),
            need(child(2), Class::Ring, 2.0, 1),
        ];
        let held = Held::new(9);
        let classes = |ahead| {
            let mut pushes = Pushes::default();
            pushes.replace(&now, &held, usize::MAX);
            pushes.replace_ahead(&later, &held, usize::MAX);
            let pieces = drained(&mut pushes, ahead);
            (
                pieces.iter().map(|piece| piece.class).collect::<Vec<_>>(),
                pushes.len(),
            )
        };
        let all = vec![Class::InView, Class::Predicted, Class::Ring];
        assert_eq!(classes(true), (all, 0));
        assert_eq!(classes(false), (vec![Class::InView, Class::Ring], 1));
    }

    #[test]
    fn no_piece_is_a_header_alone_or_cut_where_nothing_is_mended() {
        for excess in [f32::INFINITY, 0.0, 1e-30, 3.0] {
            let all = Need {
                excess: [excess; PART_COUNTS],
                ..need(PageId::ROOT, Class::InView, 1.0, SLOT_PART)
            };
            let mut pushes = Pushes::default();
            pushes.replace(&[all], &Held::new(9), usize::MAX);
            let pieces = drained(&mut pushes, false);
            assert_eq!(pieces.len(), 1, "{excess}: {pieces:?}");
            assert_eq!((pieces[0].first_part, pieces[0].last_part), (0, SLOT_PART));
        }
        let falling = need(PageId::ROOT, Class::InView, f32::INFINITY, SLOT_PART);
        let mut pushes = Pushes::default();
        pushes.replace(&[falling], &Held::new(9), usize::MAX);
        assert!(
            drained(&mut pushes, false)
                .iter()
                .all(|piece| piece.last_part > 0)
        );
    }

    #[test]
    fn where_there_is_no_room_the_least_urgent_pieces_are_left_out() {
        let child = |slot| PageId::ROOT.child(Slot::from_index(slot)).unwrap();
        let needs: Vec<Need> = (0..9)
            .map(|slot| need(child(slot), Class::InView, f32::from(slot) + 1.0, 1))
            .collect();
        let mut pushes = Pushes::default();
        let replaced = pushes.replace(&needs, &Held::new(99), 4);
        assert!(!replaced.is_all);
        let kept: Vec<_> = drained(&mut pushes, false)
            .iter()
            .map(|piece| piece.page)
            .collect();
        assert_eq!(kept, [8, 7, 6, 5].map(child));
    }

    #[test]
    fn there_is_a_count_for_every_part() {
        assert_eq!(PART_COUNTS, usize::from(SLOT_PART) + 1);
    }
}
