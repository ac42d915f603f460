//! What every mesher works on: the resident pages, how they hang together, and which of their
//! vertices are enabled.

use super::contradiction::{Contradiction, Known};
use super::page_mesh::PageMesh;
use super::place::PageSquare;
use super::vertices::{VertexRef, VertexState};
use super::wants::Wishes;
use escarp_proto::geometry::{Edge, GridLevels, PAGE_SAMPLES, PageId, Slot};
use escarp_proto::georef::Georef;
use escarp_proto::page::{Bounds, BoxError, PAGE_AREA, Page, PageError};
use std::collections::HashMap;
use thiserror::Error;

/// Place of a page in the tree's list.
pub(super) type Index = u32;

/// Why a page was not linked.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum LinkError {
    /// The page above it is not resident, or says that there is no such page. It came too late.
    #[error("page {0} hangs below nothing that is resident")]
    Orphan(PageId),
    /// It is not what the page above it says, or those beside it have.
    #[error("page {page} contradicts what is known of it: {what}")]
    Contradiction {
        /// The page.
        page: PageId,
        /// What it says that cannot be.
        what: Contradiction,
    },
    /// It was refused and asked for again, and came without the parts that are missing.
    #[error("page {0} came again with no more parts than are here")]
    Repeated(PageId),
    /// It does not decode.
    #[error(transparent)]
    Page(#[from] PageError),
}

/// Which vertices of a page's mesh are not up to date.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Stale(u8);

impl Stale {
    pub(super) const NONE: Stale = Stale(0);
    pub(super) const ALL: Stale = Stale(0x10);

    pub(super) fn is_all(self) -> bool {
        self.0 & Stale::ALL.0 != 0
    }

    /// The normals on an edge: the page across has come, gone or changed.
    pub(super) fn add_edge(&mut self, edge: Edge) {
        self.0 |= 1 << edge as u8;
    }

    pub(super) fn has_edge(self, edge: Edge) -> bool {
        self.0 & (1 << edge as u8) != 0
    }
}

/// A resident page.
#[derive(Debug)]
pub(super) struct Node {
    pub(super) page: Page,
    pub(super) bounds: Bounds,
    pub(super) promise: Option<BoxError>,
    pub(super) parent: Option<(Index, Slot)>,
    pub(super) neighbours: [Option<Index>; 4],
    /// Resident children, few.
    pub(super) children: Vec<(Slot, Index)>,
    pub(super) vertices: Box<[VertexState; PAGE_AREA]>,
    /// Enabled vertices.
    pub(super) enabled: u32,
    /// Update in which it was last of use.
    pub(super) last_use: u64,
    /// World `x` and `y` of its columns and rows of samples, metres.
    pub(super) columns_m: [f64; PAGE_SAMPLES],
    pub(super) rows_m: [f64; PAGE_SAMPLES],
    pub(super) mesh: PageMesh,
    /// The mesh's triangles are not up to date.
    pub(super) stale_triangles: bool,
    /// The mesh's vertices are not up to date: all, or those on some edges.
    pub(super) stale_vertices: Stale,
    /// Vertices have been enabled or disabled since the morph was updated.
    pub(super) flagged: bool,
}

/// The resident pages, and the mesh that their enabled vertices make. Whatever a mesher does to
/// it, it covers the grid without a crack.
#[derive(Debug)]
pub(super) struct Surface {
    pub(super) grid: GridLevels,
    pub(super) georef: Georef,
    pub(super) nodes: Vec<Option<Node>>,
    free: Vec<Index>,
    pub(super) by_id: HashMap<PageId, Index>,
    pub(super) wishes: Wishes,
    pub(super) updates: u64,
    pub(super) changes: u64,
    pub(super) stamps: u64,
    /// Vertices enabled (`true`) and disabled since they were taken, in order; `None` if nobody
    /// asks.
    pub(super) flips: Option<Vec<(VertexRef, bool)>>,
}

impl Surface {
    /// A surface without pages.
    pub(super) fn new(grid: GridLevels, georef: Georef) -> Surface {
        Surface {
            grid,
            georef,
            nodes: Vec::new(),
            free: Vec::new(),
            by_id: HashMap::new(),
            wishes: Wishes::default(),
            updates: 0,
            changes: 0,
            stamps: 0,
            flips: None,
        }
    }

    pub(super) fn resident(&self) -> usize {
        self.by_id.len()
    }

    pub(super) fn page(&self, id: PageId) -> Option<&Page> {
        Some(&self.node(*self.by_id.get(&id)?).page)
    }

    pub(super) fn pages(&self) -> impl Iterator<Item = &Page> {
        self.nodes.iter().flatten().map(|node| &node.page)
    }

    pub(super) fn meshes(&self) -> impl Iterator<Item = &PageMesh> {
        let nodes = self.nodes.iter().flatten();
        nodes
            .map(|node| &node.mesh)
            .filter(|mesh| !mesh.indices.is_empty())
    }

    pub(super) fn memory_bytes(&self) -> usize {
        const NODE: usize =
            2 * PAGE_AREA * size_of::<i32>() + PAGE_AREA * size_of::<VertexState>() + 9000;
        self.resident() * NODE
            + self
                .meshes()
                .map(|mesh| mesh.indices.capacity() * 2)
                .sum::<usize>()
    }

    pub(super) fn node(&self, index: Index) -> &Node {
        // An index is handed out for a linked page and forgotten when the page is unlinked.
        self.nodes[index as usize].as_ref().expect("a linked page")
    }

    pub(super) fn node_mut(&mut self, index: Index) -> &mut Node {
        self.nodes[index as usize].as_mut().expect("a linked page")
    }

    /// Links a page whose parent is resident, or more parts of one that is linked.
    ///
    /// # Errors
    /// [`LinkError`]; the surface is then as it was.
    pub(super) fn link(&mut self, page: Page) -> Result<Index, LinkError> {
        let id = page.id();
        if let Some(&index) = self.by_id.get(&id) {
            self.replace(index, page)?;
            return Ok(index);
        }
        let parent = self.parent_of(id)?;
        let promise = parent.map(|(index, slot)| {
            let (column, row) = slot.position();
            self.node(index).bounds.box_error(4, column, row)
        });
        let known = Known { parent, promise };
        let bounds = self.vetted_bounds(&page, known)?;
        let index = self.free.pop().unwrap_or(self.nodes.len() as Index);
        let node = self.new_node(page, bounds, known);
        match self.nodes.get_mut(index as usize) {
            Some(place) => *place = Some(node),
            None => self.nodes.push(Some(node)),
        }
        self.by_id.insert(id, index);
        if let Some((parent, slot)) = parent {
            self.node_mut(parent).children.push((slot, index));
        }
        for edge in Edge::ALL {
            let neighbour = id
                .neighbour(edge)
                .and_then(|id| self.by_id.get(&id).copied());
            self.node_mut(index).neighbours[edge as usize] = neighbour;
            if let Some(neighbour) = neighbour {
                let node = self.node_mut(neighbour);
                node.neighbours[edge.opposite() as usize] = Some(index);
            }
        }
        self.mark_around(index);
        self.changes += 1;
        Ok(index)
    }

    fn new_node(&self, page: Page, bounds: Bounds, known: Known) -> Node {
        let Known { parent, promise } = known;
        let id = page.id();
        let (x, y) = self.grid.page_origin(id);
        let stride = self.grid.page_stride(id);
        let range = bounds.box_error(0, 0, 0).range;
        let cells = self.grid.square_cells(id.level());
        Node {
            mesh: PageMesh {
                id,
                origin: [x, y],
                stride,
                bounds: self.georef.world_box([x, x + cells], [y, y + cells], range),
                vertices: Vec::new(),
                vertex_stamp: 0,
                offsets: None,
                offset_stamp: 0,
                indices: Vec::new(),
                index_stamp: 0,
            },
            columns_m: std::array::from_fn(|i| self.georef.world_x(x + i as u32 * stride)),
            rows_m: std::array::from_fn(|i| self.georef.world_y(y + i as u32 * stride)),
            page,
            bounds,
            promise,
            parent,
            neighbours: [None; 4],
            children: Vec::new(),
            vertices: Box::new([VertexState::default(); PAGE_AREA]),
            enabled: 0,
            last_use: self.updates,
            stale_triangles: true,
            stale_vertices: Stale::ALL,
            flagged: false,
        }
    }

    /// The page above, and its slot for this one.
    fn parent_of(&self, id: PageId) -> Result<Option<(Index, Slot)>, LinkError> {
        let Some((parent, slot)) = id.parent() else {
            return Ok(None);
        };
        let index = *self.by_id.get(&parent).ok_or(LinkError::Orphan(id))?;
        match self.node(index).page.has_slots() {
            true => Ok(Some((index, slot))),
            false => Err(LinkError::Orphan(id)),
        }
    }

    /// More parts of a page: its enabled vertices stay as they are.
    fn replace(&mut self, index: Index, page: Page) -> Result<(), LinkError> {
        let node = self.node(index);
        let known = Known {
            parent: node.parent,
            promise: node.promise,
        };
        let bounds = self.vetted_bounds(&page, known)?;
        let node = self.node_mut(index);
        node.page = page;
        node.bounds = bounds;
        node.stale_vertices = Stale::ALL;
        node.stale_triangles = true;
        self.mark_around(index);
        self.changes += 1;
        Ok(())
    }

    /// A page has come, gone or changed: the vertices that the pages around share with it are
    /// stale. Those across a corner share one, on two of their edges.
    fn mark_around(&mut self, index: Index) {
        let neighbours = self.node(index).neighbours;
        for edge in Edge::ALL {
            let Some(neighbour) = neighbours[edge as usize] else {
                continue;
            };
            let node = self.node_mut(neighbour);
            node.stale_vertices.add_edge(edge.opposite());
            let beyond = node.neighbours;
            for side in [Edge::South, Edge::North] {
                if matches!(edge, Edge::East | Edge::West)
                    && let Some(diagonal) = beyond[side as usize]
                {
                    self.node_mut(diagonal)
                        .stale_vertices
                        .add_edge(side.opposite());
                }
            }
        }
    }

    /// Pages that nothing on the screen needs, the longest unused first. Parents become idle when
    /// their children go.
    pub(super) fn idle(&self) -> Vec<PageId> {
        let nodes = self.nodes.iter().flatten();
        let mut idle: Vec<(u64, PageId)> = nodes
            .filter(|node| node.enabled == 0 && node.children.is_empty() && node.parent.is_some())
            .map(|node| (node.last_use, node.page.id()))
            .collect();
        idle.sort_unstable();
        idle.into_iter().map(|(_, id)| id).collect()
    }

    /// Unlinks an idle page; gives where it was.
    pub(super) fn unlink(&mut self, id: PageId) -> Option<Index> {
        let index = self.by_id.remove(&id)?;
        self.mark_around(index);
        let node = self.nodes[index as usize].take()?;
        self.free.push(index);
        if let Some((parent, _)) = node.parent {
            self.node_mut(parent)
                .children
                .retain(|&(_, child)| child != index);
        }
        for edge in Edge::ALL {
            if let Some(neighbour) = node.neighbours[edge as usize] {
                self.node_mut(neighbour).neighbours[edge.opposite() as usize] = None;
            }
        }
        self.changes += 1;
        Some(index)
    }

    /// The resident child in a slot.
    pub(super) fn child(&self, index: Index, slot: Slot) -> Option<Index> {
        let children = &self.node(index).children;
        children
            .iter()
            .find(|(own, _)| *own == slot)
            .map(|&(_, child)| child)
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

    /// Which vertices were enabled and disabled since the last time, of the two that are one across
    /// a border only one. They are to be given back emptied, for their room.
    pub(super) fn take_flips(&mut self) -> Vec<(VertexRef, bool)> {
        self.flips.as_mut().map(std::mem::take).unwrap_or_default()
    }

    pub(super) fn give_back_flips(&mut self, emptied: Vec<(VertexRef, bool)>) {
        if let Some(flips) = self.flips.as_mut().filter(|flips| flips.is_empty()) {
            *flips = emptied;
        }
    }

    /// Notes that a page is of use now.
    pub(super) fn touch(&mut self, page: Index) {
        let now = self.updates;
        self.node_mut(page).last_use = now;
    }

    /// A page that needs no record, as the page above has it; `None` if it is resident already.
    pub(super) fn implied(&self, id: PageId) -> Option<Page> {
        let (above, slot) = id.parent().filter(|_| !self.by_id.contains_key(&id))?;
        self.page(above)?.implied_child(slot, self.grid)
    }
}
