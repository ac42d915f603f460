//! The variance tree of Turner's article ("Real-Time Dynamic Terrain Rendering with ROAM",
//! Gamasutra, 2000): the largest distance, in a triangle and all that it may be split into, of the
//! middle of a hypotenuse from where the heights of its ends put it.
//!
//! His trees are as deep as one likes, and below them everything is split; ours are as deep as
//! their page. What lies below a cell is not known as a variance, so there its bound takes the
//! place. It is no bound of what a mesh is off the surface by: deviations of one level are not
//! added to those of the next.

use super::super::place::PageSquare;
use super::item::{ITEMS, Item, Side};
use escarp_proto::geometry::{Edge, PAGE_SAMPLES, Slot};
use escarp_proto::page::{ChildSlot, Page, level_step};

/// Variances of a page's items, in half quanta.
#[derive(Debug)]
pub(super) struct Variances(Box<[u32]>);

/// A right triangle: where its right angle is, and the ends of its hypotenuse; column and row.
type Triangle = [(usize, usize); 3];

impl Variances {
    /// Of a page without holes, as far as it has arrived.
    pub(super) fn of(page: &Page) -> Variances {
        let item = |i| of_side(page, Item::from_index(i).side());
        Variances((0..ITEMS).map(item).collect())
    }

    /// In quanta.
    pub(super) fn get(&self, item: Item) -> f64 {
        f64::from(self.0[item.index()]) / 2.0
    }

    pub(super) fn memory_bytes(&self) -> usize {
        size_of_val(&*self.0)
    }
}

fn of_side(page: &Page, side: Side) -> u32 {
    let (Side::Edge(square, _) | Side::Quadrant(square, _)) = side;
    if square.level >= page.depth() {
        return 0;
    }
    match side {
        Side::Edge(square, edge) => {
            let [from, to] = square.ends(edge);
            variance(page, [square.centre(), from, to].map(place))
        }
        Side::Quadrant(square, quadrant) => {
            let child = square.child(quadrant);
            if child.level == page.depth() {
                return below(page, child);
            }
            let [se, ne] = child.ends(Edge::East).map(place);
            let [nw, sw] = child.ends(Edge::West).map(place);
            let halves = match quadrant.rises() {
                true => [[se, sw, ne], [nw, ne, sw]],
                false => [[sw, nw, se], [ne, se, nw]],
            };
            let [a, b] = halves.map(|half| variance(page, half));
            a.max(b)
        }
    }
}

/// Twice what is known of the surface below one of the finest cells that have arrived.
fn below(page: &Page, cell: PageSquare) -> u32 {
    let slot = Slot::at(usize::from(cell.column), usize::from(cell.row));
    match page.slot(slot) {
        ChildSlot::Full(error) | ChildSlot::Cut(error) => error.bound().saturating_mul(2),
        ChildSlot::Empty | ChildSlot::Mixed(_) => 0,
    }
}

fn place(sample: usize) -> (usize, usize) {
    (sample % PAGE_SAMPLES, sample / PAGE_SAMPLES)
}

/// The largest distance of a hypotenuse's middle in a triangle and all below it in the page.
fn variance(page: &Page, [apex, left, right]: Triangle) -> u32 {
    let step = level_step(page.depth());
    let middle = ((left.0 + right.0) / 2, (left.1 + right.1) / 2);
    let side = left.0.abs_diff(right.0).max(left.1.abs_diff(right.1));
    // Halved further, the middle would be no sample that has arrived.
    if side < 2 * step {
        return 0;
    }
    let height = |(x, y): (usize, usize)| i64::from(page.height(y * PAGE_SAMPLES + x));
    let own = (2 * height(middle) - height(left) - height(right)).unsigned_abs();
    let below = [[middle, apex, left], [middle, right, apex]].map(|below| variance(page, below));
    let own = u32::try_from(own).unwrap_or(u32::MAX);
    own.max(below[0]).max(below[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use escarp_proto::geometry::{PageId, Quadrant};
    use escarp_proto::page::PAGE_AREA;

    fn finest(height: impl Fn(i32, i32) -> i32) -> Variances {
        let samples: [Option<i32>; PAGE_AREA] = std::array::from_fn(|sample| {
            let (x, y) = place(sample);
            Some(height(x as i32, y as i32))
        });
        let id = PageId::new(4, 1, 2).expect("a page");
        Variances::of(&Page::new(id, &samples, None).expect("heights that are allowed"))
    }

    fn edge(level: u8, edge: Edge) -> Item {
        let square = PageSquare {
            level,
            ..PageSquare::ROOT
        };
        Item::edge(square, edge)
    }

    #[test]
    fn a_plane_has_none_and_a_parabola_that_of_its_longest_hypotenuse() {
        let plane = finest(|x, y| 3 * x - 5 * y + 7);
        assert!((0..ITEMS).all(|i| plane.get(Item::from_index(i)) == 0.0));
        // Over a length of 2 h, the middle of `3 x^2` is `3 h^2` off; the root's diagonals lie
        // across half of an edge triangle, and go as far along `x`.
        let parabola = finest(|x, _| 3 * x * x);
        for level in 0..4 {
            let half = f64::from(8 >> level);
            assert_eq!(parabola.get(edge(level, Edge::South)), 3.0 * half * half);
            let quarter = 3.0 * half * half / 4.0;
            assert_eq!(
                parabola.get(edge(level, Edge::East)),
                if level < 3 { quarter } else { 0.0 }
            );
        }
    }

    #[test]
    fn what_one_sample_is_off_by_is_seen_in_all_triangles_that_it_splits_further_down() {
        let spike = finest(|x, y| if (x, y) == (3, 5) { 40 } else { 0 });
        let sees = |quadrant| spike.get(Item::quadrant(PageSquare::ROOT, quadrant));
        assert_eq!(sees(Quadrant::SouthWest), 40.0);
        assert_eq!(sees(Quadrant::NorthEast), 0.0);
        assert_eq!(spike.get(edge(0, Edge::West)), 40.0);
        assert_eq!(spike.get(edge(0, Edge::East)), 0.0);
    }
}
