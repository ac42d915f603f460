//! Update(): the tests of all triangles, from the last state onwards.

use super::frustum::Frustum;
use super::place::PageSquare;
use super::tree::{Index, MeshTree, Node};
use super::vertices::Asker;
use escarp_proto::geometry::{Edge, PageId, Quadrant, Slot};
use escarp_proto::georef::WorldBox;
use escarp_proto::page::{Page, Range};
use escarp_proto::view::{Tests, View, error_m};

/// What an update found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UpdateStats {
    /// Largest bound of a triangle that may be seen, over the tolerance. At most 1 if nothing in
    /// view is wanted; infinite if there is no bound yet.
    pub excess: f64,
    /// Squares whose triangles were tested.
    pub squares: u64,
    /// Vertices that were enabled or disabled, pages that were linked or unlinked.
    pub changes: u64,
    /// Pages that the mesh would use and that are not resident.
    pub wanted: usize,
}

/// One update's view.
struct Pass {
    tests: Tests,
    frustum: Frustum,
    quantum_m: f64,
    /// Half the diagonal of a square, metres, by level.
    half_diagonals_m: Vec<f64>,
    excess: f64,
    squares: u64,
    /// What the page that is being visited has come to.
    page: Findings,
}

/// What the tests of one page's squares came to, and for how long that stays so.
///
/// All tests compare a fixed length with a distance from the eye, and a distance changes by no
/// more than the eye moves. So until the eye has moved by the smallest difference, every test of
/// the page comes out as it did; and where no test failed, the bound stays within the tolerance.
#[derive(Debug, Clone, Copy)]
pub(super) struct Findings {
    /// Smallest difference of the two sides of a test, metres.
    slack_m: f64,
    /// Largest bound of a triangle that stands, seen or not, over the tolerance.
    excess: f64,
    /// Way of the eye until then, metres, and threshold then.
    travel_m: f64,
    threshold: f64,
}

impl Findings {
    /// Of a page that has not been visited, or has changed since.
    pub(super) const NONE: Findings = Findings {
        slack_m: 0.0,
        excess: f64::INFINITY,
        travel_m: 0.0,
        threshold: 0.0,
    };

    fn still_hold(&self, travel_m: f64, threshold: f64) -> bool {
        // The way is a sum of rounded steps: hold back more than their rounding.
        let moved_m = (travel_m - self.travel_m) * (1.0 + 1e-9);
        self.excess <= 1.0 && self.threshold == threshold && moved_m < self.slack_m
    }
}

impl MeshTree {
    /// Tests the triangles of the mesh against a view, enables and disables what follows, and
    /// collects what is wanted. The view must be checked. Pages in which no test can have changed
    /// since they were visited are passed over.
    pub fn update(&mut self, view: &View) -> UpdateStats {
        let before = self.changes;
        self.updates += 1;
        self.travel(view.eye_m);
        let mut pass = Pass {
            tests: Tests::of(view),
            frustum: Frustum::of(view),
            quantum_m: self.georef.quantum_m,
            half_diagonals_m: (0..=self.grid.get())
                .map(|level| self.georef.half_diagonal_m(self.grid.square_cells(level)))
                .collect(),
            excess: 0.0,
            squares: 0,
            page: Findings::NONE,
        };
        loop {
            pass.excess = 0.0;
            self.wishes.clear();
            self.run(&mut pass);
            let implied = self.wishes.take_implied();
            if !self.link_implied(&implied) {
                break;
            }
        }
        UpdateStats {
            excess: pass.excess,
            squares: pass.squares,
            changes: self.changes - before,
            wanted: self.wishes.len(),
        }
    }

    /// Adds to the eye's way, in the measure of [`WorldBox::distance_m`].
    fn travel(&mut self, eye_m: [f64; 3]) {
        if let Some(last) = self.eye_m {
            let step = (0..3).map(|axis| (eye_m[axis] - last[axis]).abs());
            self.travel_m += step.fold(0.0, f64::max);
        }
        self.eye_m = Some(eye_m);
    }

    fn run(&mut self, pass: &mut Pass) {
        let Some(&root) = self.by_id.get(&PageId::ROOT) else {
            pass.excess = f64::INFINITY;
            self.wishes.in_view = true;
            self.wishes.blocked = false;
            return self.want_page(PageId::ROOT, f64::INFINITY);
        };
        // Squares that are enabled for others' sake need no visit in this update: errors and boxes
        // are nested, so no test of theirs can fail where the test above them has passed.
        self.enable_root(root);
        let mut pages = vec![root];
        while let Some(index) = pages.pop() {
            self.visit_page(pass, index);
            let enabled = |&(_, child): &(Slot, Index)| {
                let centre = (child, PageSquare::ROOT.centre() as u16);
                self.is_enabled(centre).then_some(child)
            };
            pages.extend(self.node(index).children.iter().filter_map(enabled));
        }
    }

    /// Visits the squares of a page, or passes it over.
    fn visit_page(&mut self, pass: &mut Pass, index: Index) {
        let (now, travel_m) = (self.updates, self.travel_m);
        let threshold = pass.tests.threshold;
        let node = self.node_mut(index);
        node.last_use = now;
        if node.findings.still_hold(travel_m, threshold) {
            // No triangle of it is beyond the tolerance; how far below does not matter.
            let any = node.findings.excess > 0.0;
            if any && pass.excess < 1.0 && pass.frustum.may_see(&node.mesh.bounds) {
                pass.excess = 1.0;
            }
            return;
        }
        pass.page = Findings {
            slack_m: f64::INFINITY,
            excess: 0.0,
            travel_m,
            threshold,
        };
        self.visit(pass, index, PageSquare::ROOT);
        self.node_mut(index).findings = pass.page;
    }

    /// Links pages below flat and empty cells. Whether there were any.
    fn link_implied(&mut self, ids: &[PageId]) -> bool {
        let mut linked = false;
        for &id in ids {
            let Some((above, slot)) = id.parent() else {
                continue;
            };
            let parent: Option<&Page> = self.page(above);
            let implied = parent.and_then(|parent| parent.implied_child(slot, self.grid));
            if let Some(page) = implied.filter(|_| !self.by_id.contains_key(&id)) {
                linked |= self.link(page).is_ok();
            }
        }
        linked
    }

    /// Tests the triangles of a square whose centre is enabled, and of all below it in its page.
    fn visit(&mut self, pass: &mut Pass, index: Index, square: PageSquare) {
        pass.squares += 1;
        let (level, column, row) = (square.level, square.column as usize, square.row as usize);
        let node = self.node(index);
        let errors = *node.bounds.square(level, column, row);
        let page_level = node.page.id().level();
        let half_diagonal_m = pass.half_diagonals_m[usize::from(page_level + level)];
        for edge in Edge::ALL {
            let at = edge as usize;
            let error_m = error_m(
                errors.edges[at],
                errors.kinds[at],
                pass.quantum_m,
                half_diagonal_m,
            );
            let region = edge_box(self.node(index), square, edge, errors.range, pass.quantum_m);
            let vertex = (index, square.edge(edge) as u16);
            let (fails, excess) = self.test(pass, error_m, &region);
            self.ask(vertex, edge.into(), fails, excess);
            if !self.is_enabled(vertex) {
                pass.stands(excess, &region);
            }
        }
        for quadrant in Quadrant::ALL {
            self.visit_quadrant(pass, index, square, quadrant);
        }
    }

    /// Whether a triangle's error is beyond the tolerance, and how many times over it is.
    fn test(&mut self, pass: &mut Pass, error_m: f64, region: &WorldBox) -> (bool, f64) {
        if error_m <= 0.0 {
            return (false, 0.0);
        }
        let (reach_m, distance_m) = pass.tests.sides(error_m, region);
        let fails = reach_m > distance_m;
        pass.page.slack_m = pass.page.slack_m.min((reach_m - distance_m).abs());
        if fails {
            self.wishes.in_view = pass.frustum.may_see(region);
            self.wishes.blocked = false;
        }
        (fails, reach_m / distance_m)
    }

    fn visit_quadrant(
        &mut self,
        pass: &mut Pass,
        index: Index,
        square: PageSquare,
        quadrant: Quadrant,
    ) {
        let corners = quadrant
            .edges()
            .map(|edge| (index, square.edge(edge) as u16));
        if !corners.into_iter().any(|corner| self.is_enabled(corner)) {
            return;
        }
        let child = square.child(quadrant);
        let (column, row) = (child.column as usize, child.row as usize);
        let node = self.node(index);
        let below = node.bounds.box_error(child.level, column, row);
        let level = node.page.id().level() + child.level;
        let half_diagonal_m = pass.half_diagonals_m[usize::from(level)];
        let error_m = match self.grid.get() == level {
            true => 0.0,
            false => error_m(below.error, below.kind, pass.quantum_m, half_diagonal_m),
        };
        let region = child_box(node, square, quadrant, below.range, pass.quantum_m);
        let (fails, excess) = self.test(pass, error_m, &region);
        match self.square_below(index, child) {
            Some((page, square)) => {
                let centre = (page, square.centre() as u16);
                self.ask(centre, Asker::First, fails, excess);
                if self.is_enabled(centre) {
                    // A page below is visited by itself.
                    if page == index {
                        self.visit(pass, page, square);
                    }
                    return;
                }
            }
            None if fails => self.want_below(index, child, excess),
            None => {}
        }
        pass.stands(excess, &region);
    }

    /// A square by its parent's page: in that page, or the root of a resident child page.
    pub(super) fn square_below(
        &self,
        index: Index,
        child: PageSquare,
    ) -> Option<(Index, PageSquare)> {
        if child.level < 4 {
            return Some((index, child));
        }
        let slot = Slot::at(child.column as usize, child.row as usize);
        self.child(index, slot).map(|page| (page, PageSquare::ROOT))
    }

    fn want_below(&mut self, index: Index, child: PageSquare, excess: f64) {
        let slot = Slot::at(child.column as usize, child.row as usize);
        if let Some(id) = self.node(index).page.id().child(slot) {
            self.want_page(id, excess);
        }
    }
}

impl Pass {
    /// A triangle stands as it is.
    fn stands(&mut self, excess: f64, region: &WorldBox) {
        self.page.excess = self.page.excess.max(excess);
        if excess > self.excess && self.frustum.may_see(region) {
            self.excess = excess;
        }
    }
}

fn world_box(node: &Node, x: [usize; 2], y: [usize; 2], range: Range, quantum_m: f64) -> WorldBox {
    let z = |height: i32| f64::from(height) * quantum_m;
    WorldBox {
        min: [node.columns_m[x[0]], node.rows_m[y[0]], z(range.lo)],
        max: [node.columns_m[x[1]], node.rows_m[y[1]], z(range.hi)],
    }
}

/// The half of a square that holds an edge triangle.
fn edge_box(node: &Node, square: PageSquare, edge: Edge, range: Range, quantum_m: f64) -> WorldBox {
    let side = square.side();
    let (x, y) = (square.column as usize * side, square.row as usize * side);
    let (half, end) = (side / 2, side);
    let (xs, ys) = match edge {
        Edge::East => ([x + half, x + end], [y, y + end]),
        Edge::North => ([x, x + end], [y + half, y + end]),
        Edge::West => ([x, x + half], [y, y + end]),
        Edge::South => ([x, x + end], [y, y + half]),
    };
    world_box(node, xs, ys, range, quantum_m)
}

fn child_box(
    node: &Node,
    square: PageSquare,
    quadrant: Quadrant,
    range: Range,
    quantum_m: f64,
) -> WorldBox {
    let half = square.side() / 2;
    let (dx, dy) = quadrant.offset();
    let x = square.column as usize * square.side() + dx as usize * half;
    let y = square.row as usize * square.side() + dy as usize * half;
    world_box(node, [x, x + half], [y, y + half], range, quantum_m)
}
