//! The table in the formats that reports and documents need.

use super::Row;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;
use std::{fs, io};

/// How many rows hold, are bounded, and fail.
pub fn summary(rows: &[Row]) -> String {
    let count = |name: &str| rows.iter().filter(|row| row.verdict.name() == name).count();
    format!(
        "{} rows: {} hold, {} are bounded, {} fail",
        rows.len(),
        count("holds"),
        count("bounded"),
        count("fails")
    )
}

/// Markdown, a table for each group under a heading of this level.
pub fn markdown(rows: &[Row], heading: usize) -> String {
    let cell = |text: &str| text.replace('|', "\\|").replace('\n', " ");
    let mut text = String::new();
    for group in groups(rows) {
        let name = group[0].group;
        let _ = write!(text, "{} {name}\n\n", "#".repeat(heading));
        text.push_str("| case | must hold | measured | verdict |\n|---|---|---|---|\n");
        for row in group {
            let verdict = match row.known {
                Some(why) => format!("**{}** Known: {why}.", row.verdict),
                None if row.verdict.is_failure() => format!("**{}**", row.verdict),
                None => row.verdict.to_string(),
            };
            let cells = [&row.case, &row.invariant, &row.measured, &verdict].map(|text| cell(text));
            let _ = writeln!(text, "| {} |", cells.join(" | "));
        }
        text.push('\n');
    }
    text
}

/// Comma-separated values with a line of headings, quoted as RFC 4180 says.
pub fn csv(rows: &[Row]) -> String {
    let mut text = String::from("group,case,must hold,measured,verdict,detail,known\r\n");
    for row in rows {
        let verdict = row.verdict.to_string();
        let fields = [
            row.group,
            &row.case,
            &row.invariant,
            &row.measured,
            row.verdict.name(),
            &verdict,
            row.known.unwrap_or(""),
        ];
        let quoted = fields.map(|field| format!("\"{}\"", field.replace('"', "\"\"")));
        text.push_str(&quoted.join(","));
        text.push_str("\r\n");
    }
    text
}

/// A JSON array of objects.
pub fn json(rows: &[Row]) -> Value {
    let object = |row: &Row| {
        json!({
            "group": row.group,
            "case": row.case,
            "must_hold": row.invariant,
            "measured": row.measured,
            "verdict": row.verdict.name(),
            "detail": row.verdict.to_string(),
            "known": row.known,
        })
    };
    rows.iter().map(object).collect()
}

/// Tables in HTML without a page around them: `<h3>` and `<table class="stability">` for each
/// group; rows have the class `holds`, `bounded` or `fails`.
pub fn html(rows: &[Row]) -> String {
    let mut text = format!(
        "<p>{}. Deviations are in tolerances; triangles are the most of any view.</p>\n",
        escaped(&summary(rows))
    );
    for group in groups(rows) {
        let _ = write!(
            text,
            "<h3>{}</h3>\n<table class=\"stability\">\n<thead><tr><th>case</th><th>must hold</th>\
             <th>measured</th><th>verdict</th></tr></thead>\n<tbody>\n",
            escaped(group[0].group)
        );
        for row in group {
            let known = row.known.map(|why| format!(" (known: {why})"));
            let verdict = format!("{}{}", row.verdict, known.unwrap_or_default());
            let cells = [&row.case, &row.invariant, &row.measured, &verdict]
                .map(|text| format!("<td>{}</td>", escaped(text)));
            let _ = writeln!(
                text,
                "<tr class=\"{}\">{}</tr>",
                row.verdict.name(),
                cells.concat()
            );
        }
        text.push_str("</tbody>\n</table>\n");
    }
    text
}

/// A page of its own around [`html`].
pub fn page(rows: &[Row]) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n\
         <title>Stability</title>\n<style>{STYLE}</style>\n</head>\n<body>\n\
         <h1>Stiff and extreme cases</h1>\n{}</body>\n</html>\n",
        html(rows)
    )
}

const STYLE: &str = "
:root{color-scheme:light dark}
body{font:15px/1.5 system-ui,sans-serif;max-width:80rem;margin:2rem auto;padding:0 1rem}
table{border-collapse:collapse;width:100%;margin-bottom:2rem}
th,td{text-align:left;vertical-align:top;padding:.35rem .6rem;border-bottom:1px solid #8886}
td:nth-child(1){width:22%}td:nth-child(2){width:24%}td:nth-child(4){width:18%}
tr.holds td:last-child{color:#2a8a4a}tr.bounded td:last-child{color:#b07a1a}
tr.fails td:last-child{color:#d03030;font-weight:600}
@media print{body{max-width:none;font-size:10px}tr{break-inside:avoid}}
";

/// Writes the table in all formats: `stability.html`, `.md`, `.csv` and `.json`.
///
/// # Errors
/// If the folder or a file cannot be written.
pub fn write(folder: &Path, rows: &[Row]) -> io::Result<()> {
    fs::create_dir_all(folder)?;
    let json = serde_json::to_vec_pretty(&json(rows))?;
    fs::write(folder.join("stability.json"), json)?;
    fs::write(folder.join("stability.csv"), csv(rows))?;
    fs::write(folder.join("stability.md"), markdown(rows, 4))?;
    fs::write(folder.join("stability.html"), page(rows))
}

fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('<', "&lt;");
    text.replace('>', "&gt;").replace('"', "&quot;")
}

/// Rows that follow each other in one group.
fn groups(rows: &[Row]) -> impl Iterator<Item = &[Row]> {
    rows.chunk_by(|a, b| a.group == b.group)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stability::Verdict;

    #[test]
    fn all_formats_are_written() {
        let folder = tempfile::tempdir().unwrap();
        write(&folder.path().join("new"), &rows()).unwrap();
        for format in ["html", "md", "csv", "json"] {
            let file = folder.path().join(format!("new/stability.{format}"));
            assert!(fs::read_to_string(file).unwrap().contains("third"));
        }
    }

    fn rows() -> Vec<Row> {
        let row = |group, case: &str, verdict| Row {
            group,
            case: case.into(),
            invariant: "a < b | c".into(),
            measured: "\"3\" px".into(),
            verdict,
            known: None,
        };
        vec![
            row("one", "first", Verdict::Holds),
            row("one", "second", Verdict::Bounded("5 px".into())),
            row("two", "third", Verdict::Fails("too far".into())),
        ]
    }

    #[test]
    fn a_table_is_grouped_counted_and_escaped_in_each_format() {
        let rows = rows();
        assert_eq!(summary(&rows), "3 rows: 1 hold, 1 are bounded, 1 fail");
        let text = markdown(&rows, 3);
        assert_eq!(text.matches("### ").count(), 2);
        assert!(text.contains("| first | a < b \\| c | \"3\" px | holds |"));
        assert!(text.contains("**fails: too far**"));
        let text = csv(&rows);
        assert_eq!(text.lines().count(), 4);
        assert!(text.contains("\"\"\"3\"\" px\",\"bounded\",\"bounded by 5 px\",\"\"\r\n"));
        assert_eq!(json(&rows)[2]["verdict"], "fails");
        let text = html(&rows);
        assert!(text.contains("<tr class=\"fails\"><td>third</td><td>a &lt; b | c</td>"));
    }
}
