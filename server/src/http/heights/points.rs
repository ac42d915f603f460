//! Lists of points in the body of a request, and their heights in that of the answer.

use super::{Problem, Refused};
use crate::heights::{Height, HeightError};
use axum::body::{Body, Bytes, HttpBody, to_bytes};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::IntoResponse;
use escarp_proto::view::FARTHEST_EYE_M;
use serde::Deserialize;
use std::fmt::Write;
use std::time::Duration;

/// No point takes more bytes: two numbers with all their digits, and what is around them.
const POINT_BYTES: usize = 64;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Points {
    points: Vec<[f64; 2]>,
}

/// The body of a request with at most so many points, if it arrives in time.
pub(super) async fn body(body: Body, most: usize, within: Duration) -> Result<Bytes, Refused> {
    let bytes = most.saturating_mul(POINT_BYTES).saturating_add(1024);
    let refused = |status, error: String| Problem {
        allowed: vec![format!("{most} points in {bytes} bytes, within {within:?}")],
        ..Problem::plain(status, error)
    };
    let length = body.size_hint().lower();
    if length > bytes as u64 {
        let error = format!("the body has {length} bytes");
        return Err(refused(StatusCode::PAYLOAD_TOO_LARGE, error).into());
    }
    match tokio::time::timeout(within, to_bytes(body, bytes)).await {
        Ok(Ok(body)) => Ok(body),
        Ok(Err(error)) => {
            let error = format!("the body was not read: {error}");
            Err(refused(StatusCode::PAYLOAD_TOO_LARGE, error).into())
        }
        Err(_) => {
            let error = "the body did not arrive in time".into();
            Err(refused(StatusCode::REQUEST_TIMEOUT, error).into())
        }
    }
}

pub(super) fn is_csv(headers: &HeaderMap) -> bool {
    let kind = headers.get(header::CONTENT_TYPE);
    let kind = kind.and_then(|kind| kind.to_str().ok());
    kind.is_some_and(|kind| kind.trim_start().starts_with("text/csv"))
}

/// `{"points": [[x, y], ...]}`.
pub(super) fn from_json(body: &[u8], most: usize) -> Result<Vec<[f64; 2]>, HeightError> {
    let points: Points = serde_json::from_slice(body).map_err(|error| {
        let found = format!("the body is not a list of points: {error}");
        HeightError::usage(found, r#"{"points": [[X, Y], ...]}"#)
    })?;
    counted(points.points, most)
}

/// Lines `x,y`, after an optional line of names.
pub(super) fn from_csv(body: &[u8], most: usize) -> Result<Vec<[f64; 2]>, HeightError> {
    let wrong = |found: String| HeightError::usage(found, "lines X,Y in UTF-8");
    let text = std::str::from_utf8(body).map_err(|error| wrong(error.to_string()))?;
    let mut points = Vec::new();
    for (number, line) in text.lines().enumerate() {
        if line.trim().is_empty() {
            continue;
        }
        match point(line) {
            Some(point) => points.push(point),
            None if number == 0 => {}
            None => {
                let shown: String = line.chars().take(60).collect();
                return Err(wrong(format!("line {} is `{shown}`", number + 1)));
            }
        }
    }
    counted(points, most)
}

fn point(line: &str) -> Option<[f64; 2]> {
    let mut numbers = line.split(',').map(|number| number.trim().parse::<f64>());
    let point = [numbers.next()?.ok()?, numbers.next()?.ok()?];
    let is_whole = numbers.next().is_none() && point.iter().all(|v| v.abs() <= FARTHEST_EYE_M);
    is_whole.then_some(point)
}

fn counted(points: Vec<[f64; 2]>, most: usize) -> Result<Vec<[f64; 2]>, HeightError> {
    match points.len() <= most {
        true => Ok(points),
        false => Err(HeightError::usage(
            format!("{} points", points.len()),
            format!("{most} points"),
        )),
    }
}

/// `x,y,height_m,error_m`; the last two are empty where there is no height.
pub(super) fn to_csv(points: &[[f64; 2]], found: &[Option<Height>]) -> impl IntoResponse + use<> {
    let mut csv = String::from("x,y,height_m,error_m\n");
    for ([x, y], found) in points.iter().zip(found) {
        // Writing to a string does not fail.
        let _ = match found {
            Some(found) => writeln!(csv, "{x},{y},{},{}", found.height_m, found.error_m),
            None => writeln!(csv, "{x},{y},,"),
        };
    }
    ([(header::CONTENT_TYPE, "text/csv; charset=utf-8")], csv)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_read_from_both_kinds_of_body() {
        let points = vec![[1.5, -2.0], [3e2, 4.0]];
        let json = br#"{"points": [[1.5, -2], [3e2, 4]]}"#;
        assert_eq!(from_json(json, 2), Ok(points.clone()));
        for csv in ["1.5,-2\n3e2,4\n", "x,y\r\n1.5, -2\r\n\r\n300,4"] {
            assert_eq!(from_csv(csv.as_bytes(), 2), Ok(points.clone()));
        }
    }

    #[test]
    fn what_is_no_list_of_points_is_refused_with_what_was_found() {
        for csv in [
            "1,2\n3\n",
            "1,2\nx,y",
            "1,2,3\n1,2,3",
            "1,2\nNaN,4",
            "1,2\n1e999,2",
        ] {
            let refused = from_csv(csv.as_bytes(), 9);
            let Err(HeightError::Usage { found, .. }) = refused else {
                panic!("{csv:?}: {refused:?}");
            };
            assert!(found.contains("line 2"), "{found}");
        }
        assert!(from_csv(b"\xff\xfe", 9).is_err());
        for json in [
            "",
            "[]",
            "{}",
            r#"{"points": [[1]]}"#,
            r#"{"points": [[1, 1e999]]}"#,
        ] {
            assert!(from_json(json.as_bytes(), 9).is_err(), "{json}");
        }
        let Err(HeightError::Usage { found, allowed }) = from_csv(b"1,2\n3,4", 1) else {
            panic!("too many points");
        };
        assert_eq!((found.as_str(), allowed.as_str()), ("2 points", "1 points"));
    }
}
