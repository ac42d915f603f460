//! Tables: for the page, for programs, and a short one for the terminal.

use super::conduct::Report;
use super::plot::number;
use super::sweep::Run;

/// Rows of texts below names of columns.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// Names of the columns.
    pub columns: Vec<String>,
    /// The rows, each as long as `columns`.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// A table without rows.
    pub fn new(columns: &[&str]) -> Table {
        Table {
            columns: columns.iter().map(|&name| name.to_owned()).collect(),
            rows: Vec::new(),
        }
    }

    /// The table as Markdown, columns in line.
    pub fn markdown(&self) -> String {
        let cells = |i: usize| {
            let below = self.rows.iter().map(move |row| row[i].chars().count());
            below.fold(self.columns[i].chars().count(), usize::max)
        };
        let widths: Vec<usize> = (0..self.columns.len()).map(cells).collect();
        let line = |row: &[String]| {
            let cells = row
                .iter()
                .zip(&widths)
                .enumerate()
                .map(|(i, (cell, &width))| match i {
                    0 => format!("{cell:<width$}"),
                    _ => format!("{cell:>width$}"),
                });
            format!("| {} |\n", cells.collect::<Vec<_>>().join(" | "))
        };
        let rule = widths.iter().enumerate().map(|(i, &width)| match i {
            0 => "-".repeat(width),
            _ => format!("{}:", "-".repeat(width.saturating_sub(1))),
        });
        let rule = format!("| {} |\n", rule.collect::<Vec<_>>().join(" | "));
        let rows: String = self.rows.iter().map(|row| line(row)).collect();
        line(&self.columns) + &rule + &rows
    }

    /// The table as CSV (RFC 4180).
    pub fn csv(&self) -> String {
        let cell = |text: &String| match text.contains([',', '"', '\n', '\r']) {
            true => format!("\"{}\"", text.replace('"', "\"\"")),
            false => text.clone(),
        };
        let line = |row: &Vec<String>| row.iter().map(cell).collect::<Vec<_>>().join(",") + "\r\n";
        line(&self.columns) + &self.rows.iter().map(line).collect::<String>()
    }
}

/// The short table: a row a mesher and tolerance.
pub fn runs(report: &Report) -> Table {
    let mut table = Table::new(&[
        "mesher",
        "asked px",
        "triangles",
        "ms median",
        "ms p99",
        "ms max",
        "RMS px",
        "p99.9 px",
        "max px",
        "max / asked",
        "max / stated",
        "above asked",
    ]);
    for run in &report.runs {
        let error = &run.error;
        table.rows.push(vec![
            run.mesher.to_string(),
            run.error_px.to_string(),
            format!("{:.0}", run.triangles_mean),
            number(run.resident.median_ms),
            number(run.resident.p99_ms),
            number(run.resident.max_ms),
            number(error.rms_px),
            number(error.p999_px),
            number(error.max_px),
            ratio(error.max_over_asked),
            ratio(error.max_over_stated),
            percent(error.share_above_asked),
        ]);
    }
    table
}

/// A ratio, never rounded down to what it is above.
pub fn ratio(value: f64) -> String {
    format!("{:.3}", (value * 1e3 - 1e-6).ceil().max(0.0) / 1e3)
}

/// A share in per cent, none only where there is none.
pub fn percent(share: f64) -> String {
    match share * 100.0 {
        0.0 => "0 %".into(),
        percent => format!("{} %", number(percent)),
    }
}

/// What the program prints.
pub fn summary(report: &Report) -> String {
    let facts = &report.dataset;
    let [width, height] = facts.samples;
    let compared: u64 = report.runs.iter().map(|run| run.error.compared).sum();
    let how = match report.every_sample {
        true => "every sample in view",
        false => "a share of the samples in view",
    };
    let mut text = format!(
        "{}: {width} x {height} samples; {} ({} threads); times are {}, of update and triangulation \
         with all pages there; error against {how}, {compared} comparisons\n\n{}",
        facts.name,
        report.machine.processor,
        report.machine.threads,
        report.clock,
        runs(report).markdown()
    );
    for skipped in &report.skipped {
        text += &format!("\nnot measured: {}: {}", skipped.what, skipped.why);
    }
    text
}

/// All numbers of the runs.
pub fn runs_csv(report: &Report) -> Table {
    let mut table = Table::new(&[
        "mesher",
        "asked_px",
        "keeps_tolerance",
        "triangles_mean",
        "triangles_max",
        "resident_median_ms",
        "resident_p99_ms",
        "resident_max_ms",
        "coming_median_ms",
        "coming_p99_ms",
        "coming_max_ms",
        "update_ms",
        "triangulate_ms",
        "coming_decode_ms",
        "coming_link_ms",
        "coming_update_ms",
        "coming_triangulate_ms",
        "cold_ms",
        "teleport_ms",
        "changes_mean",
        "splits_mean",
        "merges_mean",
        "excess_max",
        "rms_px",
        "p999_px",
        "max_px",
        "max_over_asked",
        "max_over_stated",
        "share_above_asked",
        "share_above_stated",
        "rms_projected_px",
        "max_projected_px",
        "measured_frames",
        "compared",
        "in_view",
        "left_out",
        "covered",
        "crooked_edges",
        "bytes",
        "pages",
        "memory_bytes",
    ]);
    table.rows = report.runs.iter().map(run_row).collect();
    table
}

fn run_row(run: &Run) -> Vec<String> {
    let (error, coming) = (&run.error, &run.coming_stages);
    let left_out = error.left_out.map(|count| count.to_string());
    let teleport = run.teleport.map(|stages| stages.total_ms().to_string());
    let mut row = vec![
        run.mesher.to_string(),
        run.error_px.to_string(),
        run.keeps_tolerance.to_string(),
    ];
    let numbers = [
        run.triangles_mean,
        run.triangles_max as f64,
        run.resident.median_ms,
        run.resident.p99_ms,
        run.resident.max_ms,
        run.coming.median_ms,
        run.coming.p99_ms,
        run.coming.max_ms,
        run.resident_stages.update_ms,
        run.resident_stages.triangulate_ms,
        coming.decode_ms,
        coming.link_ms,
        coming.update_ms,
        coming.triangulate_ms,
        run.cold.total_ms(),
    ];
    row.extend(numbers.map(|number| number.to_string()));
    row.push(teleport.unwrap_or_default());
    let numbers = [
        run.changes_mean,
        run.splits_mean,
        run.merges_mean,
        run.excess_max,
        error.rms_px,
        error.p999_px,
        error.max_px,
        error.max_over_asked,
        error.max_over_stated,
        error.share_above_asked,
        error.share_above_stated,
        error.rms_projected_px,
        error.max_projected_px,
        error.frames as f64,
        error.compared as f64,
        error.in_view,
    ];
    row.extend(numbers.map(|number| number.to_string()));
    row.push(left_out.unwrap_or_default());
    let numbers = [
        error.covered,
        error.crooked_edges,
        run.bytes,
        run.pages,
        run.memory_bytes,
    ];
    row.extend(numbers.map(|number| number.to_string()));
    row
}

/// Every frame of every run.
pub fn frames_csv(report: &Report) -> Table {
    let mut table = Table::new(&[
        "mesher",
        "asked_px",
        "frame",
        "time_s",
        "leap",
        "coming_decode_ms",
        "coming_link_ms",
        "coming_update_ms",
        "coming_triangulate_ms",
        "resident_update_ms",
        "resident_triangulate_ms",
        "triangles",
        "changes",
        "splits",
        "merges",
        "squares",
        "rounds",
        "bytes",
        "excess",
    ]);
    for run in &report.runs {
        for (i, frame) in run.frames.iter().enumerate() {
            let (coming, resident) = (&frame.coming, &frame.resident);
            let mut row = vec![
                run.mesher.to_string(),
                run.error_px.to_string(),
                i.to_string(),
                frame.time_s.to_string(),
                frame.leap.to_string(),
            ];
            let times = [
                coming.decode_ms,
                coming.link_ms,
                coming.update_ms,
                coming.triangulate_ms,
                resident.update_ms,
                resident.triangulate_ms,
            ];
            row.extend(times.map(|ms| ms.to_string()));
            let counts = [
                frame.triangles,
                frame.changes,
                frame.splits,
                frame.merges,
                frame.squares,
                frame.rounds.into(),
                frame.bytes,
            ];
            row.extend(counts.map(|count| count.to_string()));
            row.push(frame.excess.to_string());
            table.rows.push(row);
        }
    }
    table
}

/// The distribution of the deviations of each run.
pub fn cdf_csv(report: &Report) -> Table {
    let mut table = Table::new(&["mesher", "asked_px", "over_stated", "share"]);
    for run in &report.runs {
        for (ratio, share) in &run.error.ratio_cdf {
            table.rows.push(vec![
                run.mesher.to_string(),
                run.error_px.to_string(),
                ratio.to_string(),
                share.to_string(),
            ]);
        }
    }
    table
}

/// The histograms of jumps.
pub fn pops_csv(report: &Report) -> Table {
    let mut table = Table::new(&["mesher", "morph", "asked_px", "jump_from_px", "share"]);
    for pops in &report.pops {
        for (from, share) in &pops.histogram {
            table.rows.push(vec![
                pops.mesher.to_string(),
                pops.morph.to_string(),
                pops.error_px.to_string(),
                from.to_string(),
                share.to_string(),
            ]);
        }
    }
    table
}

/// The cold starts, moment by moment.
pub fn cold_csv(report: &Report) -> Table {
    let mut table = Table::new(&[
        "line",
        "time_s",
        "bound_px",
        "measured_px",
        "bytes",
        "triangles",
    ]);
    let maybe = |value: Option<f64>| value.map(|v| v.to_string()).unwrap_or_default();
    for start in &report.cold_starts {
        for moment in &start.moments {
            table.rows.push(vec![
                start.line.to_string(),
                moment.time_s.to_string(),
                maybe(moment.bound_px),
                maybe(moment.measured_px),
                moment.bytes.to_string(),
                moment.triangles.to_string(),
            ]);
        }
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_markdown_and_csv_whatever_their_cells_hold() {
        let mut table = Table::new(&["a", "number"]);
        table.rows.push(vec!["x, \"y\"".into(), "1".into()]);
        assert_eq!(table.csv(), "a,number\r\n\"x, \"\"y\"\"\",1\r\n");
        let lines: Vec<String> = table.markdown().lines().map(str::to_owned).collect();
        assert_eq!(lines[0].len(), lines[2].len());
        assert_eq!(lines[1], "| ------ | -----: |");
    }

    #[test]
    fn a_ratio_beyond_one_is_never_shown_as_one() {
        assert_eq!(
            (ratio(1.0).as_str(), ratio(1.0001).as_str()),
            ("1.000", "1.001")
        );
        assert_eq!(
            (percent(0.0).as_str(), percent(1e-9).as_str()),
            ("0 %", "1e-7 %")
        );
    }
}
