//! `escarp-tiles bench`: what the codec makes of given heights, and how fast.

use super::source::SourceArgs;
use crate::build::{BuildOptions, Quantum, build, choose_quantum};
use crate::dataset::Dataset;
use crate::process::thread_cpu;
use crate::verify::compare;
use anyhow::{Context, Result};
use clap::Args;
use escarp_proto::page::{Codec, Page, Record, SymbolCounts, last_part};
use serde::Serialize;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

/// Where several sources make one set of tables, none of them counts for more symbols of a table.
const MOST_OF_A_SOURCE: u64 = 1 << 20;

/// The system tells CPU time in steps of some milliseconds: less work than this is not timed.
const LEAST_TIMED: Duration = Duration::from_millis(50);

#[derive(Debug, Args)]
pub(super) struct BenchArgs {
    /// DEM files, as `build` takes them
    #[arg(required = true, value_name = "INPUT")]
    inputs: Vec<PathBuf>,
    /// Largest errors, in units of stored height: heights are stored in steps of 2 E + 1 units
    #[arg(
        long,
        value_name = "E,...",
        value_delimiter = ',',
        default_value = "0,1,4,8"
    )]
    max_error: Vec<u32>,
    /// Metres a unit of stored height; default: the input's own step, 0.01 for floating point
    #[arg(long, value_name = "M")]
    quantum: Option<f64>,
    /// Where to build; default: the system's temporary folder
    #[arg(long, value_name = "FOLDER")]
    scratch: Option<PathBuf>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Make the codec's tables anew from the inputs, each by itself, and write their source text
    #[arg(long, hide = true, value_name = "FILE.rs")]
    train: Option<PathBuf>,
    #[command(flatten)]
    source: SourceArgs,
}

/// What was measured at one largest error.
#[derive(Debug, Serialize)]
struct Measured {
    max_error: u32,
    quantum_m: f64,
    samples: u64,
    pages: u64,
    /// Bits a sample: of corners and residuals, of what else records hold, of the whole dataset.
    heights_bits: f64,
    rests_bits: f64,
    slots_bits: f64,
    masks_bits: f64,
    records_bits: f64,
    dataset_bits: f64,
    /// Of records with codec 0.
    plain_records_bits: f64,
    /// Million heights of records a second of one core; absent if it was too little work to tell.
    encode_msamples_s: Option<f64>,
    decode_msamples_s: Option<f64>,
    largest_error_m: f64,
    allowed_error_m: f64,
}

pub(super) fn run(args: &BenchArgs) -> Result<ExitCode> {
    if let Some(path) = &args.train {
        return train(args, path);
    }
    let mut holds = true;
    let mut all = Vec::new();
    if !args.json {
        println!("{HEAD}");
    }
    for &max_error in &args.max_error {
        let (measured, _) = measure(args, &args.inputs, max_error)?;
        holds &= measured.largest_error_m <= measured.allowed_error_m;
        if !args.json {
            print(&measured);
        }
        all.push(measured);
    }
    if args.json {
        println!("{:#}", serde_json::to_value(&all)?);
    } else if !holds {
        println!("FAILED: a height is further from the input than allowed");
    }
    Ok(match holds {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}

const HEAD: &str = concat!(
    "    bits a sample                                                      ",
    "Msamples/s a core  largest error, m\n",
    "  E   heights   rests   slots   masks  records  dataset  (codec 0)    encode   decode    ",
    "measured   allowed"
);

fn print(m: &Measured) {
    let speed = |told: Option<f64>| told.map_or("-".into(), |speed| format!("{speed:.1}"));
    println!(
        "{:3} {:9.3} {:7.3} {:7.3} {:7.3} {:8.3} {:8.3} {:10.3} {:>9} {:>8} {:11.6} {:9.6}",
        m.max_error,
        m.heights_bits,
        m.rests_bits,
        m.slots_bits,
        m.masks_bits,
        m.records_bits,
        m.dataset_bits,
        m.plain_records_bits,
        speed(m.encode_msamples_s),
        speed(m.decode_msamples_s),
        m.largest_error_m,
        m.allowed_error_m
    );
}

/// Builds a dataset, compares it with its inputs, and codes every record of it again.
fn measure(
    args: &BenchArgs,
    inputs: &[PathBuf],
    max_error: u32,
) -> Result<(Measured, SymbolCounts)> {
    let mut source = args.source.open(inputs)?;
    let wish = args.quantum.map_or(Quantum::Natural, Quantum::Metres);
    let unit_m = choose_quantum(&mut *source, wish)?;
    let quantum_m = unit_m * f64::from(2 * max_error + 1);
    let scratch = match &args.scratch {
        Some(folder) => tempfile::tempdir_in(folder),
        None => tempfile::tempdir(),
    }
    .context("cannot make a temporary folder")?;
    let options = BuildOptions {
        quantum: Quantum::Metres(quantum_m),
        ..BuildOptions::default()
    };
    let folder = scratch.path().join("bench.escarp");
    build(&mut *source, &folder, Vec::new(), options, &|_, _| {})?;
    let dataset = Dataset::open(&folder)?;
    let against = compare(&dataset, &mut *source, &|_, _| {})?;
    let coded = code_all(&dataset)?;
    // Integers are off by whole units; other heights are rounded to a step first.
    let whole_units = source.info().sample_type.is_integer() && args.quantum.is_none();
    let allowed = f64::from(max_error) + if whole_units { 0.0 } else { 0.5 };
    let manifest = dataset.manifest();
    let samples = u64::from(manifest.samples[0]) * u64::from(manifest.samples[1]);
    let bits = |bits: f64| bits / samples as f64;
    let weight = coded.counts.weigh();
    let speed = |spent: Duration| {
        (spent >= LEAST_TIMED).then(|| coded.heights as f64 / 1e6 / spent.as_secs_f64())
    };
    let measured = Measured {
        max_error,
        quantum_m,
        samples,
        pages: manifest.pages,
        heights_bits: bits(weight.heights),
        rests_bits: bits(weight.rests),
        slots_bits: bits(weight.slots),
        masks_bits: bits(weight.masks),
        records_bits: bits(coded.bytes as f64 * 8.0),
        dataset_bits: bits(dataset.total_bytes() as f64 * 8.0),
        plain_records_bits: bits(coded.plain_bytes as f64 * 8.0),
        encode_msamples_s: speed(coded.encoding),
        decode_msamples_s: speed(coded.decoding),
        largest_error_m: against.largest_difference_m,
        // As much as the products of a step and whole numbers are rounded.
        allowed_error_m: allowed * unit_m * (1.0 + 1e-9)
            + largest_height_m(&dataset) * f64::EPSILON,
    };
    Ok((measured, coded.counts))
}

fn largest_height_m(dataset: &Dataset) -> f64 {
    let manifest = dataset.manifest();
    let [lo, hi] = manifest.height_range.unwrap_or([0, 0]);
    f64::from(lo.unsigned_abs().max(hi.unsigned_abs())) * manifest.georef.quantum_m
}

/// All records of a dataset, decoded and encoded again.
#[derive(Default)]
struct Coded {
    heights: u64,
    bytes: u64,
    plain_bytes: u64,
    encoding: Duration,
    decoding: Duration,
    counts: SymbolCounts,
}

fn code_all(dataset: &Dataset) -> Result<Coded> {
    let mut coded = Coded::default();
    let mut pages: Vec<Page> = Vec::new();
    for entry in dataset.families() {
        let table = dataset.family(&entry)?;
        let records = table.records().collect::<Result<Vec<_>, _>>()?;
        let started = thread_cpu();
        pages.clear();
        for record in &records {
            let finest = dataset.grid().is_finest(record.page);
            let parts = last_part(finest);
            pages.push(Page::decode(record.page, finest, parts, record.bytes)?);
        }
        let decoded = thread_cpu();
        let again: Vec<Record> = pages
            .iter()
            .map(|page| Record::encode(page, Codec::Dense))
            .collect();
        let encoded = thread_cpu();
        coded.decoding += decoded.saturating_sub(started);
        coded.encoding += encoded.saturating_sub(decoded);
        for ((record, again), page) in records.iter().zip(&again).zip(&pages) {
            anyhow::ensure!(
                record.bytes == again.bytes(),
                "page {}: encoded again, the record is another",
                record.page
            );
            coded.bytes += record.bytes.len() as u64;
            coded.plain_bytes += Record::encode(page, Codec::Plain).bytes().len() as u64;
            coded.counts.add(page);
        }
        coded.heights += (records.len() * escarp_proto::page::PAGE_AREA) as u64;
    }
    Ok(coded)
}

/// The tables that suit the inputs, at all errors that are given.
fn train(args: &BenchArgs, path: &PathBuf) -> Result<ExitCode> {
    let mut counts = SymbolCounts::default();
    for input in &args.inputs {
        for &max_error in &args.max_error {
            let (_, own) = measure(args, std::slice::from_ref(input), max_error)?;
            counts.add_scaled(&own, MOST_OF_A_SOURCE);
        }
    }
    std::fs::write(path, counts.to_source())
        .with_context(|| format!("cannot write {}", path.display()))?;
    Ok(ExitCode::SUCCESS)
}
