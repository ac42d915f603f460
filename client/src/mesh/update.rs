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
}

impl MeshTree {
    /// Tests every triangle of the mesh against a view, enables and disables what follows, and
    /// collects what is wanted. The view must be checked.
    pub fn update(&mut self, view: &View) -> UpdateStats {
        let before = self.changes;
        self.updates += 1;
        let mut pass = Pass {
            tests: Tests::of(view),
            frustum: Frustum::of(view),
            quantum_m: self.georef.quantum_m,
            half_diagonals_m: (0..=self.grid.get())
                .map(|level| self.georef.half_diagonal_m(self.grid.square_cells(level)))
                .collect(),
            excess: 0.0,
            squares: 0,
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

    fn run(&mut self, pass: &mut Pass) {
        let Some(&root) = self.by_id.get(&PageId::ROOT) else {
            pass.excess = f64::INFINITY;
            self.wishes.in_view = true;
            self.wishes.blocked = false;
            return self.want_page(PageId::ROOT, f64::INFINITY);
        };
        self.enable_root(root);
        self.visit(pass, root, PageSquare::ROOT);
        // Squares that are enabled for others' sake need no visit in this update: errors and boxes
        // are nested, so no test of theirs can fail where the test above them has passed.
    }

    /// Links pages below flat and empty cells. Whether there were any.
    fn link_implied(&mut self, ids: &[PageId]) -> bool {
        let mut linked = false;
        for &id in ids {
            let Some((above, slot)) = id.parent() else {
                continue;
            };
            let finest = self.grid.is_finest(id);
            let parent: Option<&Page> = self.page(above);
            let implied = parent.and_then(|parent| parent.implied_child(slot, finest));
            if let Some(page) = implied.filter(|_| !self.by_id.contains_key(&id)) {
                linked |= self.link(page).is_ok();
            }
        }
        linked
    }

    /// Tests the triangles of a square whose centre is enabled, and of all below.
    fn visit(&mut self, pass: &mut Pass, index: Index, square: PageSquare) {
        pass.squares += 1;
        if square.level == 0 {
            let now = self.updates;
            self.node_mut(index).last_use = now;
        }
        let (level, column, row) = (square.level, square.column as usize, square.row as usize);
        let errors = *self.node(index).bounds.square(level, column, row);
        let page_level = self.node(index).page.id().level();
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
            let fails = pass.tests.fails(error_m, &region);
            let excess = pass.tests.excess(error_m, &region);
            if fails {
                self.wishes.in_view = pass.frustum.may_see(&region);
                self.wishes.blocked = false;
            }
            self.ask(vertex, edge.into(), fails, excess);
            if !self.is_enabled(vertex) {
                pass.stands(excess, &region);
            }
        }
        for quadrant in Quadrant::ALL {
            self.visit_quadrant(pass, index, square, quadrant);
        }
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
        let fails = pass.tests.fails(error_m, &region);
        let excess = pass.tests.excess(error_m, &region);
        if fails {
            self.wishes.in_view = pass.frustum.may_see(&region);
            self.wishes.blocked = false;
        }
        match self.square_below(index, child) {
            Some((page, square)) => {
                let centre = (page, square.centre() as u16);
                self.ask(centre, Asker::First, fails, excess);
                if self.is_enabled(centre) {
                    return self.visit(pass, page, square);
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
