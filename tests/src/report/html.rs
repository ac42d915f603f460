//! The page.

use super::conduct::Report;
use super::plot::drawing::Ink;
use super::plot::svg::escape;
use super::sections::Section;
use super::tables::{Table, percent, ratio};
use std::fmt::Write;

const STYLE: &str = include_str!("style.css");

/// Begins a page: no other file is needed to show it.
fn head(title: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{}</title>\n<style>\n\
         :root{{{}}}\n@media screen and (prefers-color-scheme:dark){{:root{{{}}}}}\n{STYLE}</style>\n\
         </head>\n<body>\n",
        escape(title),
        Ink::declarations(false),
        Ink::declarations(true),
    )
}

/// The page of a dataset. `svgs` has the plots of each section.
pub fn page(report: &Report, sections: &[Section], svgs: &[Vec<String>]) -> String {
    let facts = &report.dataset;
    let mut out = head(&format!("{}: error against run time", facts.name));
    header(&mut out, report);
    let links: String = sections
        .iter()
        .enumerate()
        .map(|(i, section)| format!("<li><a href=\"#s{i}\">{}</a></li>", escape(section.title)))
        .collect();
    let _ = writeln!(out, "<nav><ol>{links}</ol></nav>");
    for (i, (section, svgs)) in sections.iter().zip(svgs).enumerate() {
        let _ = writeln!(
            out,
            "<section id=\"s{i}\">\n<h2>{}</h2>\n<p>{}</p>\n<p class=\"correct\"><b>A correct system shows:</b> {}</p>",
            escape(section.title),
            escape(&section.shows),
            escape(section.correct),
        );
        out.push_str("<div class=\"plots\">\n");
        for svg in svgs {
            let _ = writeln!(out, "<figure>{svg}</figure>");
        }
        out.push_str("</div>\n");
        for table in section.tables.iter().filter(|table| !table.rows.is_empty()) {
            html_table(&mut out, table);
        }
        out.push_str("</section>\n");
    }
    footer(&mut out, report);
    out
}

fn header(out: &mut String, report: &Report) {
    let (facts, machine) = (&report.dataset, &report.machine);
    let [width, height] = facts.samples;
    let [dx, dy] = facts.sample_spacing_m;
    let [low, high] = facts.heights_m;
    let verdicts: Vec<String> = report
        .plan
        .meshers
        .iter()
        .filter_map(|&m| verdict(report, m))
        .collect();
    let _ = writeln!(
        out,
        "<header>\n<h1>{}</h1>\n<p class=\"facts\">{width} × {height} samples, {} with data, {dx:.6} × {dy:.6} m \
         apart, {low:.2} to {high:.2} m; {} bytes on disk</p>\n<ul class=\"verdicts\">{}</ul>\n\
         <p class=\"facts\">{}, {} threads, {}; escarp {}, {}. Times are {}.</p>\n\
         <p><code>{}</code></p>\n</header>",
        escape(&facts.name),
        facts.valid_samples,
        facts.bytes,
        verdicts.concat(),
        escape(&machine.processor),
        machine.threads,
        escape(&machine.system),
        machine.version,
        machine.date,
        report.clock,
        escape(&report.command),
    );
}

/// Whether a mesher kept what it promised, in a line.
fn verdict(report: &Report, mesher: super::variant::Variant) -> Option<String> {
    let runs: Vec<_> = report
        .runs
        .iter()
        .filter(|run| run.mesher == mesher)
        .collect();
    let worst = |of: fn(&super::sweep::ErrorFigures) -> f64| {
        runs.iter().map(|run| of(&run.error)).fold(0.0, f64::max)
    };
    let first = runs.first()?;
    let asked = worst(|error| error.max_over_asked);
    let above = worst(|error| error.share_above_asked);
    let (class, mark, promise) = match (first.keeps_tolerance, asked <= 1.0 + 1e-9) {
        (true, true) => ("kept", "kept", "promises the tolerance"),
        (true, false) => ("broken", "broken", "promises the tolerance"),
        (false, _) => ("none", "–", "promises no tolerance"),
    };
    Some(format!(
        "<li class=\"{class}\"><span>{mark}</span><b>{}</b> {promise}; largest error measured {} of it, {} of the \
         samples above it</li>",
        escape(&mesher.to_string()),
        ratio(asked),
        percent(above),
    ))
}

fn html_table(out: &mut String, table: &Table) {
    out.push_str("<div class=\"scroll\"><table>\n<thead><tr>");
    for column in &table.columns {
        let _ = write!(out, "<th>{}</th>", escape(column));
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    let mut before = None;
    for row in &table.rows {
        let first = row.first();
        let class = if before.is_some() && before != first {
            " class=\"next\""
        } else {
            ""
        };
        let _ = write!(out, "<tr{class}>");
        for cell in row {
            let _ = write!(out, "<td>{}</td>", escape(cell));
        }
        out.push_str("</tr>\n");
        before = first;
    }
    out.push_str("</tbody></table></div>\n");
}

fn footer(out: &mut String, report: &Report) {
    out.push_str("<footer>\n");
    if !report.skipped.is_empty() {
        out.push_str("<h2>Not measured</h2>\n<ul>");
        for skipped in &report.skipped {
            let (what, why) = (escape(&skipped.what), escape(&skipped.why));
            let _ = write!(out, "<li>{what}: {why}</li>");
        }
        out.push_str("</ul>\n");
    }
    out.push_str(
        "<p>Every number is in <a href=\"report.json\">report.json</a> and in the CSV files beside it; the plots are in \
         the folder <code>plots</code> as SVG and PNG.</p>\n</footer>\n</body>\n</html>\n",
    );
}

/// A page with a link to each report.
pub fn index(reports: &[(&Report, String)]) -> String {
    let mut out = head("Error against run time");
    out.push_str("<header><h1>Error against run time</h1></header>\n<div class=\"scroll\"><table>\n<thead><tr>");
    for column in [
        "dataset",
        "samples",
        "mesher",
        "triangles",
        "ms median",
        "max px",
        "max / asked",
    ] {
        let _ = write!(out, "<th>{column}</th>");
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    for (report, link) in reports {
        for (i, &mesher) in report.plan.meshers.iter().enumerate() {
            let Some(run) = report.run(mesher, report.reference_px) else {
                continue;
            };
            let [width, height] = report.dataset.samples;
            let _ = writeln!(
                out,
                "<tr{}><td><a href=\"{}\">{}</a></td><td>{width} × {height}</td><td>{} at {} px</td><td>{:.0}</td>\
                 <td>{:.3}</td><td>{:.3}</td><td>{}</td></tr>",
                if i == 0 { " class=\"next\"" } else { "" },
                escape(link),
                escape(&report.dataset.name),
                escape(&mesher.to_string()),
                run.error_px,
                run.triangles_mean,
                run.resident.median_ms,
                run.error.max_px,
                ratio(run.error.max_over_asked),
            );
        }
    }
    out.push_str("</tbody></table></div>\n</body>\n</html>\n");
    out
}
