//! What a level of pages leaves for the one above: heights of page corners, and child slots.

use super::BuildError;
use super::rows::Rows;
use escarp_proto::err8::Err8;
use escarp_proto::page::{ChildSlot, Range};
use std::collections::HashMap;

/// A [`ChildSlot`] without what it carries.
#[derive(Debug, Clone, Copy)]
#[repr(u8)]
enum State {
    Full,
    Cut,
    Empty,
    Mixed,
}

/// Child slots of a whole level, in little memory: one a page of the level below.
#[derive(Debug)]
pub(crate) struct Slots {
    /// The first column and row.
    first: (usize, usize),
    columns: usize,
    states: Vec<State>,
    errors: Vec<Err8>,
    mixed: HashMap<usize, Range>,
}

impl Slots {
    pub(super) fn new(columns: usize, rows: usize) -> Slots {
        Self::window((0, 0), columns, rows)
    }

    /// Of a part of a level.
    pub(crate) fn window(first: (usize, usize), columns: usize, rows: usize) -> Slots {
        Slots {
            first,
            columns,
            states: vec![State::Empty; columns * rows],
            errors: vec![Err8(0); columns * rows],
            mixed: HashMap::new(),
        }
    }

    pub(crate) fn set(&mut self, column: usize, row: usize, slot: ChildSlot) {
        let at = (row - self.first.1) * self.columns + column - self.first.0;
        self.states[at] = match slot {
            ChildSlot::Full(error) => {
                self.errors[at] = error;
                State::Full
            }
            ChildSlot::Cut(error) => {
                self.errors[at] = error;
                State::Cut
            }
            ChildSlot::Mixed(range) => {
                self.mixed.insert(at, range);
                State::Mixed
            }
            ChildSlot::Empty => State::Empty,
        };
    }

    /// Beyond the data there is nothing.
    pub(crate) fn get(&self, column: usize, row: usize) -> ChildSlot {
        let (column, row) = (column - self.first.0, row - self.first.1);
        let at = row * self.columns + column;
        if column >= self.columns || at >= self.states.len() {
            return ChildSlot::Empty;
        }
        match self.states[at] {
            State::Full => ChildSlot::Full(self.errors[at]),
            State::Cut => ChildSlot::Cut(self.errors[at]),
            State::Empty => ChildSlot::Empty,
            State::Mixed => self
                .mixed
                .get(&at)
                .map_or(ChildSlot::Empty, |&r| ChildSlot::Mixed(r)),
        }
    }
}

/// What a level leaves for the one above: a sample a page corner, a slot a page.
#[derive(Debug)]
pub(super) struct Above {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) heights: Vec<i32>,
    pub(super) slots: Slots,
}

/// Rows of the samples that a level below left.
pub(super) struct MemoryRows<'a> {
    from: &'a Above,
}

impl<'a> MemoryRows<'a> {
    pub(super) fn new(from: &'a Above) -> Self {
        MemoryRows { from }
    }
}

impl Rows for MemoryRows<'_> {
    fn read(
        &mut self,
        first: u32,
        n: u32,
        stride: usize,
        out: &mut [i32],
    ) -> Result<(), BuildError> {
        let width = self.from.width;
        let rows = self.from.heights.chunks_exact(width).skip(first as usize);
        for (out, row) in out.chunks_mut(stride).zip(rows.take(n as usize)) {
            out[..width].copy_from_slice(row);
        }
        Ok(())
    }
}
