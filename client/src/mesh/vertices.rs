//! Enabling, propagation and reference counts.

use super::place::{PageSquare, Role, across, border, part_of, role};
use super::squares;
use super::surface::{Index, Surface};
use escarp_proto::geometry::{Edge, PageId};
use std::fmt::{self, Debug};

/// A vertex of a page: `(page, sample)`.
pub(super) type VertexRef = (Index, u16);

/// State of a vertex in one page, in one byte.
#[derive(Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct VertexState(u8);

impl VertexState {
    /// At most four squares' centres hang on an edge vertex, and four edge vertices on a centre.
    const DEPENDENTS: u8 = 0b111;
    const ASKED_SHIFT: u8 = 3;
    const ENABLED: u8 = 1 << 5;

    /// Part of the mesh.
    pub(super) fn is_enabled(self) -> bool {
        self.0 & Self::ENABLED != 0
    }

    /// Which triangles of this page ask for it, a bit each: see [`Asker`].
    pub(super) fn asked(self) -> u8 {
        (self.0 >> Self::ASKED_SHIFT) & (Asker::First as u8 | Asker::Second as u8)
    }

    pub(super) fn is_asked_by(self, asker: Asker) -> bool {
        self.0 & ((asker as u8) << Self::ASKED_SHIFT) != 0
    }

    /// Enabled vertices of this page, and of its children, that depend on it.
    pub(super) fn dependents(self) -> u8 {
        self.0 & Self::DEPENDENTS
    }

    fn set_enabled(&mut self, enabled: bool) {
        self.0 = (self.0 & !Self::ENABLED) | (u8::from(enabled) * Self::ENABLED);
    }

    fn set_asked_by(&mut self, asker: Asker, asked: bool) {
        let bit = (asker as u8) << Self::ASKED_SHIFT;
        self.0 = (self.0 & !bit) | (u8::from(asked) * bit);
    }

    fn add_dependent(&mut self) {
        debug_assert!(self.dependents() < Self::DEPENDENTS);
        self.0 += 1;
    }

    fn remove_dependent(&mut self) {
        debug_assert!(self.dependents() > 0);
        self.0 -= 1;
    }
}

impl Debug for VertexState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("VertexState")
            .field("enabled", &self.is_enabled())
            .field("asked", &self.asked())
            .field("dependents", &self.dependents())
            .finish()
    }
}

/// Whose test asks for a vertex: a centre has one asker, an edge vertex one on each side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Asker {
    /// The quadrant's box, for a centre; for an edge vertex the square to its west or south.
    First = 1,
    /// The square to its east or north.
    Second = 2,
}

impl From<Edge> for Asker {
    fn from(edge: Edge) -> Asker {
        match edge {
            Edge::East | Edge::North => Asker::First,
            Edge::West | Edge::South => Asker::Second,
        }
    }
}

/// Vertices on which one depends directly: at most two, and none for the root's centre.
struct Dependencies {
    known: [Option<VertexRef>; 2],
    /// A page across the border that is not resident.
    missing: Option<(Index, Edge)>,
}

impl Surface {
    pub(super) fn state(&self, (index, sample): VertexRef) -> VertexState {
        self.node(index).vertices[sample as usize]
    }

    pub(super) fn is_enabled(&self, vertex: VertexRef) -> bool {
        self.state(vertex).is_enabled()
    }

    /// The same vertex in the page across the border, if it lies on one and that is resident.
    fn mirror(&self, (index, sample): VertexRef) -> Option<VertexRef> {
        let edge = border(sample as usize)?;
        let neighbour = self.node(index).neighbours[edge as usize]?;
        Some((neighbour, across(sample as usize, edge) as u16))
    }

    fn dependencies(&self, vertex: VertexRef) -> Dependencies {
        let (index, sample) = vertex;
        let mut found = Dependencies {
            known: [None; 2],
            missing: None,
        };
        match role(sample as usize) {
            Role::Corner => {}
            Role::Centre(square) => found.known = self.corners_needed(index, square),
            Role::Edge(sides) => {
                let centre = |side: Option<(PageSquare, Edge)>| {
                    side.map(|(square, _)| (index, square.centre() as u16))
                };
                found.known = sides.map(centre);
                if let Some(edge) = border(sample as usize) {
                    let own = found.known[0].or(found.known[1]);
                    found.known = [own, self.centre_across(vertex)];
                    let beyond = self.node(index).page.id().neighbour(edge);
                    let in_grid = beyond.is_some();
                    if found.known[1].is_none() && in_grid {
                        found.missing = Some((index, edge));
                    }
                }
            }
        }
        found
    }

    fn centre_across(&self, vertex: VertexRef) -> Option<VertexRef> {
        let (neighbour, sample) = self.mirror(vertex)?;
        match role(sample as usize) {
            Role::Edge([Some((square, _)), None] | [None, Some((square, _))]) => {
                Some((neighbour, square.centre() as u16))
            }
            _ => None,
        }
    }

    /// The edge vertices of the square above that are corners of a square.
    fn corners_needed(&self, index: Index, square: PageSquare) -> [Option<VertexRef>; 2] {
        let (page, above, quadrant) = match square.parent() {
            Some((above, quadrant)) => (index, above, quadrant),
            None => match self.node(index).parent {
                None => return [None; 2],
                Some((parent, slot)) => {
                    let (column, row) = slot.position();
                    let cell = PageSquare {
                        level: 4,
                        column: column as u8,
                        row: row as u8,
                    };
                    match cell.parent() {
                        Some((above, quadrant)) => (parent, above, quadrant),
                        None => return [None; 2],
                    }
                }
            },
        };
        quadrant
            .edges()
            .map(|edge| Some((page, above.edge(edge) as u16)))
    }

    /// Whether the parts that hold a vertex are resident, here and across the border.
    fn has_data(&self, vertex: VertexRef) -> bool {
        let part = part_of(vertex.1 as usize);
        let has = |index: Index| self.node(index).page.depth() >= part;
        has(vertex.0)
            && self
                .mirror(vertex)
                .is_none_or(|(neighbour, _)| has(neighbour))
    }

    /// Whether anything holds the vertex enabled.
    fn is_held(&self, vertex: VertexRef) -> bool {
        let holds = |v: VertexRef| {
            let state = self.state(v);
            state.asked() != 0 || state.dependents() > 0
        };
        holds(vertex) || self.mirror(vertex).is_some_and(holds)
    }

    /// Sets whether a test asks for a vertex, and lets all that follows from it follow. `excess`
    /// is how far the test failed, for what is wanted.
    pub(super) fn ask(&mut self, vertex: VertexRef, asker: Asker, asked: bool, excess: f64) {
        if asked {
            if self.enable(vertex, excess) {
                self.set(vertex, |state| state.set_asked_by(asker, true));
            }
        } else if self.state(vertex).is_asked_by(asker) {
            self.set(vertex, |state| state.set_asked_by(asker, false));
            self.release(vertex);
        }
    }

    fn set(&mut self, (index, sample): VertexRef, change: impl FnOnce(&mut VertexState)) {
        change(&mut self.node_mut(index).vertices[sample as usize]);
    }

    /// Enables a vertex and all that it depends on, or, if some of that is not resident, wants
    /// what is missing, and changes nothing.
    fn enable(&mut self, vertex: VertexRef, excess: f64) -> bool {
        if self.is_enabled(vertex) {
            return true;
        }
        let needed = self.dependencies(vertex);
        let mut possible = self.has_data(vertex);
        if !possible {
            self.want_parts_of(vertex, excess);
        }
        if let Some((index, edge)) = needed.missing {
            self.want_neighbour(index, edge, excess);
            possible = false;
        }
        for needed in needed.known.into_iter().flatten() {
            possible &= self.enable(needed, excess);
        }
        if !possible {
            for needed in needed.known.into_iter().flatten() {
                self.release(needed);
            }
            return false;
        }
        for needed in needed.known.into_iter().flatten() {
            self.set(needed, VertexState::add_dependent);
        }
        self.flag(vertex, true);
        true
    }

    /// Disables a vertex that nothing holds any more, and so on upwards.
    fn release(&mut self, vertex: VertexRef) {
        if !self.is_enabled(vertex) || self.is_held(vertex) || self.is_root_centre(vertex) {
            return;
        }
        self.flag(vertex, false);
        for needed in self.dependencies(vertex).known.into_iter().flatten() {
            self.set(needed, VertexState::remove_dependent);
            self.release(needed);
        }
    }

    fn is_root_centre(&self, (index, sample): VertexRef) -> bool {
        sample as usize == PageSquare::ROOT.centre() && self.node(index).parent.is_none()
    }

    /// Sets the enabled flag on both sides, and marks what has to be triangulated again.
    fn flag(&mut self, vertex: VertexRef, enabled: bool) {
        self.changes += 1;
        match enabled {
            true => self.splits += 1,
            false => self.merges += 1,
        }
        let now = self.updates;
        if let Some(flips) = &mut self.flips {
            flips.push((vertex, enabled));
        }
        for (index, sample) in [Some(vertex), self.mirror(vertex)].into_iter().flatten() {
            let node = self.node_mut(index);
            node.vertices[sample as usize].set_enabled(enabled);
            node.enabled = match enabled {
                true => node.enabled + 1,
                false => node.enabled - 1,
            };
            node.last_use = now;
            node.flagged = true;
            let centre = squares::at_centre(sample);
            if let Some(at) = centre {
                node.centres = match enabled {
                    true => node.centres | 1 << at,
                    false => node.centres & !(1 << at),
                };
            }
            let parent = node.parent.filter(|_| centre == Some(squares::ROOT));
            self.mark_triangles(index);
            if let Some((parent, slot)) = parent {
                self.node_mut(parent).children_enabled.set(slot, enabled);
                self.mark_triangles(parent);
            }
        }
    }

    /// Enables the root's centre, which depends on nothing. Whether the root is resident.
    pub(super) fn enable_root(&mut self) -> bool {
        let Some(&root) = self.by_id.get(&PageId::ROOT) else {
            return false;
        };
        let centre = (root, PageSquare::ROOT.centre() as u16);
        self.enable(centre, f64::INFINITY);
        true
    }
}
