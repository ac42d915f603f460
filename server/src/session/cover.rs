//! For which views the newest selection holds, so that they need none of their own.
//!
//! A selection is made for wherever the eye may be in a little while: the box around its way. While
//! it is in there, and nothing else of the view has changed that counts, what was selected is
//! enough.

use escarp_proto::select::Eyes;
use escarp_proto::view::View;
use escarp_proto::wire::Scope;
use std::time::Duration;

/// How far ahead the eye's way is selected for while all that it needs is sent in time,
const WAY_S: f64 = 0.5;
/// and while it is not: what comes first should be of the place where the eye is by then.
const SHORT_WAY_S: f64 = 0.2;
/// A selection is made anew so long before the eye leaves what the last one holds for, so that no
/// view waits for it.
pub(super) const LEAD_S: f64 = 0.1;
/// How far beside the way the eye may come, as a share of it: ways are bent.
const BESIDE: f64 = 0.25;
/// Once the client has evicted pages, a selection holds for so long: they may be needed again.
const AFTER_EVICTION: Duration = Duration::from_millis(250);
/// Cosine of how far the eye may turn while there is still an order to be kept: 3 degrees.
const TURN: f64 = 0.9986;
/// Tolerances that are so much wider than the one selected for get an order of their own.
const WIDER: f64 = 1.1;

/// What a selection was made for.
#[derive(Debug, Clone)]
pub(super) struct Cover {
    view: View,
    scope: Scope,
    eyes: Eyes,
    until: Duration,
}

impl Cover {
    pub(super) fn new(view: &View, scope: Scope, eyes: Eyes) -> Cover {
        Cover {
            view: *view,
            scope,
            eyes,
            until: Duration::MAX,
        }
    }

    /// Whether a view needs nothing else. `in_order`: what waits to be sent has to be in the order
    /// of its need.
    pub(super) fn holds(&self, view: &View, scope: Scope, in_order: bool, now: Duration) -> bool {
        let is_enough = now < self.until
            && self.eyes.hold(view.eye_m)
            && view.threshold() <= self.view.threshold();
        let sees_the_same = View {
            eye_m: view.eye_m,
            velocity_m_s: view.velocity_m_s,
            max_screen_error_px: view.max_screen_error_px,
            ..self.view
        } == *view;
        is_enough
            && match self.scope {
                // What cannot be seen was left out.
                Scope::InView => scope == Scope::InView && sees_the_same,
                Scope::All => scope == Scope::All && (!in_order || self.orders_as(view)),
            }
    }

    /// Whether what is most urgent is about the same.
    fn orders_as(&self, view: &View) -> bool {
        let same_picture =
            (self.view.fov_y, self.view.viewport_px) == (view.fov_y, view.viewport_px);
        same_picture
            && self.view.threshold() <= WIDER * view.threshold()
            && cosine(self.view.direction, view.direction) >= TURN
    }

    /// The client has evicted pages.
    pub(super) fn evicted(&mut self, now: Duration) {
        self.until = self.until.min(now + AFTER_EVICTION);
    }
}

/// Where the eye may be until the next selection. `keeps_up`: all that is needed in view is sent.
pub(super) fn way(view: &View, keeps_up: bool) -> Eyes {
    let seconds = if keeps_up { WAY_S } else { SHORT_WAY_S };
    stretch(view.eye_m, view.eye_after(seconds))
}

/// Where that ends while the server keeps up.
pub(super) fn end(view: &View) -> [f64; 3] {
    view.eye_after(WAY_S)
}

/// From one place to another, and around.
pub(super) fn stretch(a_m: [f64; 3], b_m: [f64; 3]) -> Eyes {
    let length_m = (0..3).map(|i| (b_m[i] - a_m[i]).abs()).fold(0.0, f64::max);
    Eyes::between(a_m, b_m, BESIDE * length_m)
}

fn cosine(a: [f32; 3], b: [f32; 3]) -> f64 {
    let dot = |a: [f32; 3], b: [f32; 3]| -> f64 {
        (0..3).map(|i| f64::from(a[i]) * f64::from(b[i])).sum()
    };
    dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Duration = Duration::ZERO;

    fn view() -> View {
        View {
            eye_m: [10.0, 20.0, 30.0],
            direction: [0.0, 1.0, 0.0],
            velocity_m_s: [100.0, 0.0, 0.0],
            fov_y: 1.0,
            viewport_px: [640, 480],
            max_screen_error_px: 2.0,
        }
    }

    fn cover(scope: Scope) -> Cover {
        Cover::new(&view(), scope, way(&view(), true))
    }

    #[test]
    fn a_selection_holds_on_the_way_and_somewhat_beside_it_and_no_farther() {
        let cover = cover(Scope::All);
        let at = |x_m: f64, y_m: f64| View {
            eye_m: [x_m, y_m, 30.0],
            ..view()
        };
        for (x_m, y_m, expected) in [
            (10.0, 20.0, true),
            (60.0, 20.0, true),
            (40.0, 32.0, true),
            (73.0, 20.0, false),
            (40.0, 33.0, false),
            (-3.0, 20.0, false),
        ] {
            let holds = cover.holds(&at(x_m, y_m), Scope::All, true, NOW);
            assert_eq!(holds, expected, "{x_m}, {y_m}");
        }
        assert!(way(&view(), false).hold([34.0, 20.0, 30.0]));
        assert!(!way(&view(), false).hold([36.0, 20.0, 30.0]));
    }

    #[test]
    fn an_eye_at_rest_is_selected_for_where_it_is() {
        let rest = View {
            velocity_m_s: [0.0; 3],
            ..view()
        };
        assert_eq!(way(&rest, true), Eyes::at(rest.eye_m));
        assert!(Cover::new(&rest, Scope::All, way(&rest, true)).holds(
            &rest,
            Scope::All,
            true,
            NOW
        ));
    }

    #[test]
    fn what_is_narrower_is_not_held_and_what_is_wider_while_nothing_waits() {
        let cover = cover(Scope::All);
        let with = |px| View {
            max_screen_error_px: px,
            ..view()
        };
        let holds = |px, in_order| cover.holds(&with(px), Scope::All, in_order, NOW);
        assert!(!holds(1.9, false) && !holds(1.9, true));
        assert!(holds(2.1, true) && holds(8.0, false) && !holds(8.0, true));
    }

    #[test]
    fn turning_changes_the_order_of_what_waits_and_what_is_left_out_of_a_picture() {
        let turned = |x: f32| View {
            direction: [x, 1.0, 0.0],
            ..view()
        };
        let all = cover(Scope::All);
        assert!(all.holds(&turned(1.0), Scope::All, false, NOW));
        assert!(!all.holds(&turned(1.0), Scope::All, true, NOW));
        assert!(all.holds(&turned(0.04), Scope::All, true, NOW));
        let seen = cover(Scope::InView);
        assert!(seen.holds(&view(), Scope::InView, false, NOW));
        assert!(!seen.holds(&turned(0.04), Scope::InView, false, NOW));
        assert!(!seen.holds(&view(), Scope::All, false, NOW));
        assert!(!all.holds(&view(), Scope::InView, false, NOW));
    }

    #[test]
    fn what_was_evicted_is_looked_for_again_soon() {
        let mut cover = cover(Scope::All);
        cover.evicted(NOW);
        cover.evicted(AFTER_EVICTION / 2);
        let holds = |at| cover.holds(&view(), Scope::All, false, at);
        assert!(holds(AFTER_EVICTION / 2) && !holds(AFTER_EVICTION));
    }
}
