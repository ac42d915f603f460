//! The vertices of a page in the order in which they depend on one another, as tables.

use super::super::place::PageSquare;
use escarp_proto::geometry::{Edge, PAGE_LEVELS, Quadrant};
use escarp_proto::page::PAGE_AREA;
use std::sync::LazyLock;

/// Stands in tables where there is no vertex: one place beyond the page's samples.
pub(super) const NOWHERE: u16 = PAGE_AREA as u16;

/// A vertex that is the middle of an edge, or of a diagonal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Step {
    pub(super) vertex: u16,
    /// What depends on it directly, in the page itself.
    pub(super) dependents: [u16; 4],
    /// The ends of what it splits.
    pub(super) ends: [u16; 2],
}

/// The vertices of one of the page's four levels of squares.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct Tier {
    pub(super) centres: Vec<Step>,
    /// Edge vertices inside the page.
    pub(super) inner: Vec<Step>,
    /// Edge vertices on the page's border.
    pub(super) border: Vec<(Edge, Step)>,
}

/// By level of squares, the coarsest first.
pub(super) static TIERS: LazyLock<[Tier; PAGE_LEVELS as usize]> =
    LazyLock::new(|| std::array::from_fn(|level| Tier::of(level as u8)));

impl Tier {
    fn of(level: u8) -> Tier {
        let mut tier = Tier::default();
        let side = 1u8 << level;
        for (column, row) in (0..side).flat_map(|row| (0..side).map(move |column| (column, row))) {
            let square = PageSquare { level, column, row };
            tier.centres.push(centre(square));
            for edge in Edge::ALL {
                tier.add_edge(square, edge);
            }
        }
        tier
    }

    /// Adds an edge's vertex, or what depends on it on this side.
    fn add_edge(&mut self, square: PageSquare, edge: Edge) {
        let vertex = square.edge(edge) as u16;
        let dependents = match square.level + 1 < PAGE_LEVELS {
            true => PageSquare::end_quadrants(edge).map(|q| square.child(q).centre() as u16),
            false => [NOWHERE; 2],
        };
        if let Some(step) = self.inner.iter_mut().find(|step| step.vertex == vertex) {
            step.dependents[2..].copy_from_slice(&dependents);
            return;
        }
        let step = Step {
            vertex,
            dependents: [dependents[0], dependents[1], NOWHERE, NOWHERE],
            ends: square.ends(edge).map(|end| end as u16),
        };
        match super::super::place::border(vertex as usize) {
            Some(edge) => self.border.push((edge, step)),
            None => self.inner.push(step),
        }
    }
}

fn centre(square: PageSquare) -> Step {
    Step {
        vertex: square.centre() as u16,
        dependents: Edge::ALL.map(|edge| square.edge(edge) as u16),
        // Which diagonal the page itself is split by, the page above says.
        ends: square
            .parent()
            .map_or([NOWHERE; 2], |(_, quadrant)| diagonal(square, quadrant)),
    }
}

/// The ends of the diagonal of a quadrant: the centre of the square above, and its corner.
pub(super) fn diagonal(square: PageSquare, quadrant: Quadrant) -> [u16; 2] {
    let (x, y) = quadrant.offset();
    let (x, y) = (2 * x as usize, 2 * y as usize);
    [square.sample(2 - x, 2 - y), square.sample(x, y)].map(|end| end as u16)
}

#[cfg(test)]
mod tests {
    use super::*;
    use escarp_proto::geometry::PAGE_SAMPLES;

    /// All steps, the coarsest first, centres before edges: what one depends on comes before it.
    fn steps() -> Vec<Step> {
        let tier = |tier: &Tier| {
            let mut steps = tier.centres.clone();
            steps.extend(&tier.inner);
            steps.extend(tier.border.iter().map(|(_, step)| *step));
            steps
        };
        TIERS.iter().flat_map(tier).collect()
    }

    #[test]
    fn every_vertex_but_the_corners_is_in_the_tables_once_and_is_the_middle_of_its_ends() {
        let steps = steps();
        let mut vertices: Vec<u16> = steps.iter().map(|step| step.vertex).collect();
        vertices.sort_unstable();
        vertices.dedup();
        assert_eq!(
            (steps.len(), vertices.len()),
            (PAGE_AREA - 4, PAGE_AREA - 4)
        );
        let at = |v: u16| [v as usize % PAGE_SAMPLES, v as usize / PAGE_SAMPLES];
        for step in steps.iter().filter(|step| step.ends[0] != NOWHERE) {
            let [a, b] = step.ends.map(at);
            assert_eq!([a[0] + b[0], a[1] + b[1]], at(step.vertex).map(|w| 2 * w));
        }
    }

    #[test]
    fn the_ends_of_what_a_vertex_splits_are_corners_or_among_what_it_depends_on() {
        let steps = steps();
        let corners = [0, 16, 272, 288];
        // ancestors[v]: all that depends on nothing of v, and v on it; itself included.
        let mut ancestors: Vec<Vec<u16>> = vec![Vec::new(); PAGE_AREA + 1];
        for step in &steps {
            let mut found = vec![step.vertex];
            for above in steps.iter().filter(|s| s.dependents.contains(&step.vertex)) {
                found.extend(&ancestors[above.vertex as usize]);
            }
            let ends = step.ends.iter().filter(|&&end| end != NOWHERE);
            for end in ends {
                assert!(corners.contains(end) || found.contains(end), "{step:?}");
            }
            ancestors[step.vertex as usize] = found;
        }
    }
}
