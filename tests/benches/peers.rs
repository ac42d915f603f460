//! Triangles at the same measured largest error: our quadtree mesh beside RTIN and a free TIN.
//!
//! `cargo bench -p escarp-tests --bench peers -- DATASET... [--cells N] [--tolerances M,M...]`
//! writes a table for each dataset: of its middle window of at most `N` (a power of two, 1024)
//! cells a side, meshed with the same tolerance everywhere, in metres (1,5,20,80).
//! The others' tolerances are tuned until they measure no worse than ours.

use escarp_tests::peers::ours;
use escarp_tests::peers::right::{VertexErrors, tuned};
use escarp_tests::peers::tin::Tin;
use escarp_tests::peers::window::{Deviation, Triangle, Window};
use escarp_tiles::dataset::Dataset;
use escarp_tiles::process::thread_cpu;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

/// Halvings of the step of 4 % in which a tolerance is looked for.
const STEPS: u32 = 5;
/// Allowed windows, cells a side.
const CELLS: [u32; 2] = [16, 4096];

struct Args {
    datasets: Vec<String>,
    cells: u32,
    tolerances_m: Vec<f64>,
}

/// A line of the table: lengths in quanta.
struct Line<'a> {
    name: &'a str,
    nominal: f64,
    triangles: usize,
    deviation: Deviation,
    cpu: Option<Duration>,
    /// Of records, where the mesh is made of pages.
    bytes: Option<usize>,
}

fn main() -> ExitCode {
    let done = parse(std::env::args().skip(1)).and_then(|args| {
        let each = |dataset: &String| compare(dataset, &args);
        args.datasets.iter().try_for_each(each)
    });
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(why) => {
            eprintln!("peers: {why}");
            ExitCode::FAILURE
        }
    }
}

fn parse(mut words: impl Iterator<Item = String>) -> Result<Args, String> {
    let mut args = Args {
        datasets: Vec::new(),
        cells: 1024,
        tolerances_m: vec![80.0, 20.0, 5.0, 1.0],
    };
    while let Some(word) = words.next() {
        let mut value = || words.next().ok_or_else(|| format!("{word} needs a value"));
        match word.as_str() {
            // Cargo's own.
            "--bench" => {}
            "--cells" => {
                let cells = value()?;
                let allowed = |n: &u32| n.is_power_of_two() && (CELLS[0]..=CELLS[1]).contains(n);
                args.cells = cells.parse().ok().filter(allowed).ok_or_else(|| {
                    format!(
                        "--cells {cells}: allowed are powers of two, {}..={}",
                        CELLS[0], CELLS[1]
                    )
                })?;
            }
            "--tolerances" => {
                let list = value()?;
                let one = |text: &str| {
                    let metres = text.parse().ok().filter(|m| (1e-3..=1e5).contains(m));
                    metres
                        .ok_or_else(|| format!("--tolerances {text}: allowed is 0.001..=100000 m"))
                };
                args.tolerances_m = list.split(',').map(one).collect::<Result<_, _>>()?;
                args.tolerances_m.sort_by(|a: &f64, b| b.total_cmp(a));
            }
            _ => args.datasets.push(word),
        }
    }
    match args.datasets.is_empty() {
        true => Err("no dataset; build one with escarp-tiles build".into()),
        false => Ok(args),
    }
}

fn compare(folder: &str, args: &Args) -> Result<(), String> {
    let dataset = Dataset::open(Path::new(folder)).map_err(|error| format!("{folder}: {error}"))?;
    let found = Window::middle_of(&dataset, args.cells).map_err(|error| error.to_string())?;
    let (window, holes) = found.ok_or_else(|| format!("{folder}: too small"))?;
    let quantum_m = dataset.manifest().georef.quantum_m;
    println!(
        "\n{folder}: the middle {side} x {side} samples, quantum {quantum_m} m, {:.2} % filled\n",
        holes * 100.0,
        side = window.cells + 1
    );
    println!(
        "| E, m | mesh | its tolerance, m | triangles | over ours | largest, m | RMS, m | CPU ms | kB |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    let prepared = Prepared::of(&window);
    let start = thread_cpu();
    let mut tin = Tin::new(&window);
    let mut tin_cpu = thread_cpu() - start;
    for &tolerance_m in &args.tolerances_m {
        prepared.compare((tolerance_m, quantum_m), &mut tin, &mut tin_cpu);
    }
    Ok(())
}

/// What all tolerances share.
struct Prepared<'a> {
    window: &'a Window,
    ours: escarp_tests::terrain::TempDataset,
    derived: VertexErrors,
    coded: VertexErrors,
    exact: VertexErrors,
    rtin: VertexErrors,
    rtin_cpu: Duration,
}

impl Prepared<'_> {
    fn of(window: &Window) -> Prepared<'_> {
        let ours = ours::dataset(window);
        let bounds = ours::bounds(&ours, window.cells);
        let start = thread_cpu();
        let rtin = VertexErrors::rtin(window);
        let rtin_cpu = thread_cpu() - start;
        Prepared {
            derived: ours::errors(&bounds),
            coded: ours::coded_errors(window, &bounds),
            exact: VertexErrors::exact(window),
            rtin,
            rtin_cpu,
            window,
            ours,
        }
    }

    fn compare(
        &self,
        (tolerance_m, quantum_m): (f64, f64),
        tin: &mut Tin<'_>,
        tin_cpu: &mut Duration,
    ) {
        let tolerance = tolerance_m / quantum_m;
        let ours = ours::mesh(&self.ours, tolerance, 0);
        let deviation = self.window.deviation(&ours.triangles);
        let largest = deviation.largest;
        let print = |line: &Line<'_>| print(line, (tolerance_m, quantum_m), ours.triangles.len());
        print(&Line {
            name: "Escarp",
            nominal: tolerance,
            triangles: ours.triangles.len(),
            deviation,
            cpu: Some(ours.cpu),
            bytes: Some(ours.bytes),
        });
        let whole = ours::mesh(&self.ours, tolerance, 4);
        let line = self.line(
            "of whole pages",
            tolerance,
            &whole.triangles,
            Some(whole.cpu),
        );
        print(&Line {
            bytes: Some(whole.bytes),
            ..line
        });
        let timed = |name, nominal, errors: &VertexErrors, before: Option<Duration>| {
            let start = thread_cpu();
            let mesh = errors.mesh(nominal);
            let cpu = before.map(|before| before + thread_cpu() - start);
            print(&self.line(name, nominal, &mesh, cpu));
        };
        for (name, errors, cpu) in [
            ("of whole pages, tuned", &self.derived, None),
            ("with coded bounds, tuned", &self.coded, None),
            ("with exact bounds, tuned", &self.exact, None),
            ("RTIN, tuned", &self.rtin, Some(self.rtin_cpu)),
        ] {
            let (nominal, _) = tuned(errors, self.window, largest, STEPS);
            timed(name, nominal, errors, cpu);
        }
        timed("RTIN as it is", tolerance, &self.rtin, Some(self.rtin_cpu));
        let start = thread_cpu();
        tin.refine(largest);
        *tin_cpu += thread_cpu() - start;
        print(&self.line("free TIN", largest, &tin.triangles(), Some(*tin_cpu)));
    }

    fn line<'n>(
        &self,
        name: &'n str,
        nominal: f64,
        mesh: &[Triangle],
        cpu: Option<Duration>,
    ) -> Line<'n> {
        Line {
            name,
            nominal,
            triangles: mesh.len(),
            deviation: self.window.deviation(mesh),
            cpu,
            bytes: None,
        }
    }
}

fn print(line: &Line<'_>, (tolerance_m, quantum_m): (f64, f64), ours: usize) {
    let cpu = line
        .cpu
        .map_or("".into(), |cpu| format!("{:.0}", cpu.as_secs_f64() * 1e3));
    let kb = line
        .bytes
        .map_or("".into(), |bytes| format!("{:.0}", bytes as f64 / 1e3));
    println!(
        "| {tolerance_m} | {} | {:.3} | {} | {:.3} | {:.3} | {:.4} | {cpu} | {kb} |",
        line.name,
        line.nominal * quantum_m,
        line.triangles,
        line.triangles as f64 / ours as f64,
        line.deviation.largest * quantum_m,
        line.deviation.rms * quantum_m,
    );
}
