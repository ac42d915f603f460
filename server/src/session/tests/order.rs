//! The order of sending against a naive oracle.

use super::*;
use proptest::prelude::*;

#[derive(Debug, Clone)]
enum Step {
    Want(Want),
    Cancel(u64),
}

fn class() -> impl Strategy<Value = Class> {
    prop_oneof![
        Just(Class::Blocker),
        Just(Class::InView),
        Just(Class::Predicted),
        Just(Class::Ring)
    ]
}

fn priority() -> impl Strategy<Value = f32> {
    prop_oneof![
        Just(f32::NAN),
        Just(f32::INFINITY),
        Just(f32::NEG_INFINITY),
        Just(0.0),
        Just(-0.0),
        -2f32..2.0,
        any::<f32>(),
    ]
}

fn step() -> impl Strategy<Value = Step> {
    let page = (0u32..13, 0u32..2).prop_map(|(x, y)| PageId::new(4, x, y).unwrap());
    let wish = (page.clone(), class(), priority())
        .prop_map(|(page, class, priority)| Step::Want(want(page, class, priority)));
    prop_oneof![4 => wish, 1 => page.prop_map(|page| Step::Cancel(page.key()))]
}

/// Keeps a plain list, newest last, and sorts it at the end. The sort is stable.
fn oracle(steps: &[Step]) -> Vec<u64> {
    let mut wishes: Vec<Want> = Vec::new();
    for step in steps {
        match step {
            Step::Want(want) => {
                wishes.retain(|wish| wish.page != want.page);
                wishes.push(*want);
            }
            Step::Cancel(page) => wishes.retain(|wish| wish.page != *page),
        }
    }
    let number = |wish: &Want| {
        if wish.priority.is_nan() {
            0.0
        } else {
            wish.priority
        }
    };
    wishes.sort_by(|a, b| {
        let larger_first = number(b).partial_cmp(&number(a)).unwrap();
        a.class.cmp(&b.class).then(larger_first)
    });
    wishes.iter().map(|wish| wish.page).collect()
}

proptest! {
    #[test]
    fn pages_come_in_the_order_of_class_priority_and_arrival(
        steps in proptest::collection::vec(step(), 0..60),
    ) {
        let mut peer = Peer::open(0);
        for step in &steps {
            peer.say(match step {
                Step::Want(want) => ClientMessage::Want(vec![*want]),
                Step::Cancel(page) => ClientMessage::Cancel(vec![*page]),
            });
        }
        peer.say(ClientMessage::Credit { total_bytes: u64::MAX });
        let order = oracle(&steps);
        let mut left = order.as_slice();
        for message in peer.hear_all() {
            let ServerMessage::Pages(chunks) = message else { continue };
            let sent: Vec<u64> = chunks.iter().map(|chunk| chunk.page).collect();
            prop_assert!(sent.len() <= left.len());
            let (now, later) = left.split_at(sent.len());
            // Within a message they come by key.
            let mut now = now.to_vec();
            now.sort_unstable();
            prop_assert_eq!(sent, now);
            left = later;
        }
        prop_assert!(left.is_empty());
    }
}
