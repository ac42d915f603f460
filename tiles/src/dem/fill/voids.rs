//! Enclosed voids, found while rows come one after the other.

use super::FilledRun;

/// A connected set of samples without data, and the heights around it.
#[derive(Debug, Default)]
pub(super) struct Void {
    runs: Vec<FilledRun>,
    rim: Vec<Rim>,
    samples: u64,
    /// It reaches the border of the source: it is the outside.
    outside: bool,
}

/// A height beside a sample of a void: to its west, east, north or south.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rim {
    /// Row and column of the void's sample.
    pub(super) place: (u32, u32),
    /// The height beside it.
    pub(super) height_m: f64,
}

impl Void {
    /// Its samples, by row, then column, once it is closed.
    pub(super) fn runs(&self) -> &[FilledRun] {
        &self.runs
    }

    /// The heights around it, by place, once it is closed.
    pub(super) fn rim(&self) -> &[Rim] {
        &self.rim
    }

    fn bytes(&self) -> usize {
        self.runs.len() * size_of::<FilledRun>() + self.rim.len() * size_of::<Rim>()
    }

    /// Takes another in. What is not going to be filled needs no memory.
    fn take(&mut self, mut other: Void, max_samples: u32) {
        self.outside |= other.outside;
        self.samples += other.samples;
        if self.runs.len() < other.runs.len() {
            std::mem::swap(&mut self.runs, &mut other.runs);
            std::mem::swap(&mut self.rim, &mut other.rim);
        }
        self.runs.append(&mut other.runs);
        self.rim.append(&mut other.rim);
        self.forget_if_left(max_samples);
    }

    fn is_left(&self, max_samples: u32) -> bool {
        self.outside || self.samples > u64::from(max_samples)
    }

    fn forget_if_left(&mut self, max_samples: u32) {
        if self.is_left(max_samples) {
            self.runs = Vec::new();
            self.rim = Vec::new();
        }
    }
}

/// Samples without data next to each other in one row, and the void that they belong to.
#[derive(Debug, Clone, Copy)]
struct Run {
    start: usize,
    end: usize,
    void: usize,
}

/// Follows voids from row to row: those that reach the last row are open.
pub(super) struct Voids {
    height: u32,
    max_samples: u32,
    row: u32,
    last_row: Vec<f64>,
    last_runs: Vec<Run>,
    open: Vec<Void>,
    closed: Vec<Void>,
    too_large: u64,
}

impl Voids {
    pub(super) fn new(width: u32, height: u32, max_samples: u32) -> Voids {
        Voids {
            height,
            max_samples,
            row: 0,
            last_row: vec![f64::NAN; width as usize],
            last_runs: Vec::new(),
            open: Vec::new(),
            closed: Vec::new(),
            too_large: 0,
        }
    }

    /// Enclosed voids that were too large, so far.
    pub(super) fn too_large(&self) -> u64 {
        self.too_large
    }

    /// What the voids that are followed take in memory.
    pub(super) fn bytes(&self) -> usize {
        self.open.iter().map(Void::bytes).sum()
    }

    /// Voids that ended, and are to be filled.
    pub(super) fn take_closed(&mut self) -> Vec<Void> {
        std::mem::take(&mut self.closed)
    }

    /// Takes the next row, from north to south. NaN is no data.
    pub(super) fn push_row(&mut self, heights: &[f64]) {
        self.rims_south_of_last(heights);
        let mut parents: Vec<usize> = (0..self.open.len()).collect();
        let mut runs = Vec::new();
        let mut next = 0;
        while let Some((start, end)) = next_void(heights, next) {
            next = end;
            let void = self.open.len();
            parents.push(void);
            let opened = self.open_run(heights, start, end);
            self.open.push(opened);
            runs.push(Run { start, end, void });
        }
        self.join(&mut parents, &runs);
        self.close(&mut parents, &mut runs);
        self.last_row.copy_from_slice(heights);
        self.last_runs = runs;
        self.row += 1;
        if self.row == self.height {
            // What reaches the last row is outside.
            self.open.clear();
        }
    }

    /// Heights of a new row that lie south of the samples of voids in the last.
    fn rims_south_of_last(&mut self, heights: &[f64]) {
        for run in &self.last_runs {
            let void = &mut self.open[run.void];
            if void.is_left(self.max_samples) {
                continue;
            }
            let rim = (run.start..run.end).filter(|&column| !heights[column].is_nan());
            void.rim.extend(rim.map(|column| Rim {
                place: (self.row - 1, column as u32),
                height_m: heights[column],
            }));
        }
    }

    /// A void of one run, with the heights west, east and north of it.
    fn open_run(&self, heights: &[f64], start: usize, end: usize) -> Void {
        let at_border = start == 0 || end == heights.len();
        let mut void = Void {
            samples: (end - start) as u64,
            outside: at_border || self.row == 0 || self.row + 1 == self.height,
            ..Void::default()
        };
        if void.is_left(self.max_samples) {
            return void;
        }
        void.runs.push(FilledRun {
            row: self.row,
            column: start as u32,
            length: (end - start) as u32,
        });
        let north = (start..end).map(|column| (column, self.last_row[column]));
        let beside = [(start, heights[start - 1]), (end - 1, heights[end])];
        let rim = north.chain(beside).filter(|(_, height)| !height.is_nan());
        void.rim.extend(rim.map(|(column, height_m)| Rim {
            place: (self.row, column as u32),
            height_m,
        }));
        void
    }

    /// Joins voids whose runs touch, at a corner too, in the last row and the new one. `parents`
    /// leads from each void to the one that took it in.
    fn join(&mut self, parents: &mut [usize], runs: &[Run]) {
        let mut first = 0;
        for run in runs {
            while self.last_runs.get(first).is_some_and(|r| r.end < run.start) {
                first += 1;
            }
            let touching = self.last_runs[first..].iter();
            let touching: Vec<usize> = touching
                .take_while(|last| last.start <= run.end)
                .map(|last| last.void)
                .collect();
            for other in touching {
                let (a, b) = (root(parents, run.void), root(parents, other));
                if a != b {
                    parents[a] = b;
                    let taken = std::mem::take(&mut self.open[a]);
                    self.open[b].take(taken, self.max_samples);
                }
            }
        }
    }

    /// Closes voids without a run in the new row, and numbers the others anew.
    fn close(&mut self, parents: &mut [usize], runs: &mut [Run]) {
        let mut numbers = vec![None; self.open.len()];
        let mut open = Vec::new();
        for run in runs {
            let void = root(parents, run.void);
            run.void = *numbers[void].get_or_insert_with(|| {
                open.push(std::mem::take(&mut self.open[void]));
                open.len() - 1
            });
        }
        for (void, number) in std::mem::replace(&mut self.open, open)
            .into_iter()
            .zip(numbers)
        {
            if number.is_some() || void.samples == 0 || void.outside {
                continue;
            }
            if void.is_left(self.max_samples) {
                self.too_large += 1;
                continue;
            }
            self.closed.push(sorted(void));
        }
    }
}

fn sorted(mut void: Void) -> Void {
    void.runs.sort_unstable_by_key(|run| (run.row, run.column));
    void.rim.sort_by_key(|rim| rim.place);
    void
}

/// The next run of samples without data from a column on.
fn next_void(heights: &[f64], from: usize) -> Option<(usize, usize)> {
    let start = from + heights[from..].iter().position(|h| h.is_nan())?;
    let length = heights[start..].iter().position(|h| !h.is_nan());
    Some((start, length.map_or(heights.len(), |length| start + length)))
}

/// The void that took in this one, at last.
fn root(parents: &mut [usize], mut void: usize) -> usize {
    while parents[void] != void {
        parents[void] = parents[parents[void]];
        void = parents[void];
    }
    void
}
