//! The datasets of the simulation: small, each in several generations by real updates.

use crate::terrain::{FunctionSource, Heights, TempDataset, cliff, hash, hills, holed_hills};
use escarp_proto::manifest::Manifest;
use escarp_server::PageSource;
use escarp_tiles::dem::DemSource;
use escarp_tiles::update::{Edit, update};
use std::sync::Arc;

/// Generations of each dataset.
pub const GENERATIONS: usize = 4;

/// A dataset in all its generations, oldest first.
pub struct Ground {
    /// What it is.
    pub name: &'static str,
    /// The generations, with their samples.
    pub generations: Vec<TempDataset>,
    sources: Vec<Arc<dyn PageSource>>,
}

/// Columns, rows, and heights of a dataset.
type Shape = (&'static str, [u32; 2], Heights);

/// The last one is three pages deep.
const SHAPES: [Shape; 4] = [
    ("hills", [120, 100], hills),
    ("holes", [110, 90], holed_hills),
    ("cliff", [90, 110], cliff),
    ("strip", [290, 30], hills),
];

impl Ground {
    /// All of them.
    ///
    /// # Panics
    /// If one cannot be built or updated.
    pub fn all() -> Vec<Ground> {
        SHAPES.map(Ground::of).into()
    }

    fn of((name, size, heights): Shape) -> Ground {
        let mut generations = vec![TempDataset::of(size[0], size[1], heights)];
        while generations.len() < GENERATIONS {
            let last = &generations[generations.len() - 1];
            edit(last, size, generations.len() as u32);
            generations.push(last.newest());
        }
        let source = |data: &TempDataset| {
            let generation = data.dataset.manifest().generation;
            let source: Arc<dyn PageSource> = Arc::new(data.open_generation(generation));
            source
        };
        let sources = generations.iter().map(source).collect();
        Ground {
            name,
            generations,
            sources,
        }
    }

    /// A generation as a server hosts it.
    pub fn source(&self, index: usize) -> Arc<dyn PageSource> {
        self.sources[index].clone()
    }

    /// The samples of the generation that a manifest is of.
    pub fn samples(&self, manifest: &Manifest) -> Option<&TempDataset> {
        let is_same = |data: &&TempDataset| data.dataset.manifest() == manifest;
        self.generations.iter().find(is_same)
    }
}

/// Publishes a generation with a part raised, another new, and a rectangle removed.
fn edit(data: &TempDataset, [width, height]: [u32; 2], number: u32) {
    let place = |salt: u32, of: u32, most: u32| hash(number * 9 + salt, of) % (of - most);
    let patch = |salt: u32, [columns, rows]: [u32; 2], rise: f64| {
        let (west, north) = (place(salt, width, columns), place(salt + 1, height, rows));
        let heights = move |x: u32, y: u32| {
            (f64::from(hash(x / 3, number)) % 97.0).round() + rise + f64::from(y)
        };
        FunctionSource::new(columns, rows, heights).with(|info| {
            let (dx, dy) = (info.placement.dx, info.placement.dy);
            info.placement.x0 += f64::from(west) * dx;
            // That of the whole, less the rows above.
            info.placement.y0 = 2000.0 + f64::from(height - 1 - north) * dy;
        })
    };
    let mut patches = [
        patch(1, [width / 4, height / 3], 300.0),
        patch(3, [9, 7], -40.0 * f64::from(number)),
    ];
    let west = 1000.0 + 10.0 * f64::from(place(5, width, width / 6));
    let south = 2000.0 + 10.0 * f64::from(place(6, height, height / 6));
    let removed = [
        west,
        south,
        west + 10.0 * f64::from(width / 6),
        south + 10.0 * f64::from(height / 6),
    ];
    let edit = Edit {
        patches: patches
            .iter_mut()
            .map(|patch| patch as &mut dyn DemSource)
            .collect(),
        remove: vec![removed],
        sources: vec![format!("edit {number}")],
    };
    let report = update(&data.dataset, edit, &|_, _| {}).expect("an update");
    assert!(report.changed > 0, "edit {number} changes nothing");
}
