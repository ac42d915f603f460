//! Conditional and range requests, for contents that have a strong validator and no date
//! (RFC 9110, sections 8.8.3, 13 and 14).

use axum::http::{HeaderMap, HeaderName, Method, header};
use std::ops::Range;

/// What a request is to be answered with.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Verdict {
    /// 200: all of it.
    Whole,
    /// 206: these bytes.
    Part(Range<usize>),
    /// 304: the client has it.
    NotModified,
    /// 412: it is not what the client takes it for.
    PreconditionFailed,
    /// 416: there are no such bytes.
    NotSatisfiable,
}

/// Holds a request's conditions, in the order of RFC 9110, section 13.2.2, against the tag of a
/// content, in its quotes, and its length in bytes. What depends on a date does not apply, as
/// contents have none.
pub(super) fn verdict(method: &Method, headers: &HeaderMap, tag: &str, bytes: usize) -> Verdict {
    if headers.contains_key(header::IF_MATCH) && !matches(headers, &header::IF_MATCH, tag, strong) {
        return Verdict::PreconditionFailed;
    }
    if matches(headers, &header::IF_NONE_MATCH, tag, weak) {
        return Verdict::NotModified;
    }
    let asked = headers.get(header::RANGE).filter(|_| method == Method::GET);
    let Some(asked) = asked.and_then(|range| range.to_str().ok()) else {
        return Verdict::Whole;
    };
    let stands = headers.get(header::IF_RANGE).is_none_or(|condition| {
        condition
            .to_str()
            .is_ok_and(|given| strong(given.trim(), tag))
    });
    match part(asked, bytes) {
        Some(part) if stands => part,
        _ => Verdict::Whole,
    }
}

/// Whether a list of tags, or `*`, has this one.
fn matches(
    headers: &HeaderMap,
    name: &HeaderName,
    tag: &str,
    same: fn(&str, &str) -> bool,
) -> bool {
    let lists = headers.get_all(name).iter();
    lists
        .filter_map(|list| list.to_str().ok())
        .any(|list| list.trim() == "*" || tags(list).any(|given| same(given, tag)))
}

/// Both strong, and the same.
fn strong(given: &str, tag: &str) -> bool {
    given == tag
}

/// The same, weak or not.
fn weak(given: &str, tag: &str) -> bool {
    given.strip_prefix("W/").unwrap_or(given) == tag
}

/// The tags of a list. Commas may stand in a tag; what is no tag ends the list.
fn tags(list: &str) -> impl Iterator<Item = &str> {
    let mut rest = list;
    std::iter::from_fn(move || {
        rest = rest.trim_start_matches([' ', '\t', ',']);
        let open = rest
            .find('"')
            .filter(|&at| ["", "W/"].contains(&&rest[..at]))?;
        let close = open + 1 + rest[open + 1..].find('"')?;
        let (tag, after) = rest.split_at(close + 1);
        rest = after;
        Some(tag)
    })
}

/// The part that one range names. `None` if it is to be ignored: another unit, several ranges, or
/// no range at all.
fn part(asked: &str, bytes: usize) -> Option<Verdict> {
    let (unit, ranges) = asked.split_once('=')?;
    let (first, last) = ranges.trim().split_once('-')?;
    if !unit.trim().eq_ignore_ascii_case("bytes") {
        return None;
    }
    let (start, end) = match (number(first), number(last)) {
        (Some(first), Some(last)) if first <= last => (first, last.saturating_add(1)),
        (Some(first), None) if last.is_empty() => (first, usize::MAX),
        (None, Some(suffix)) if first.is_empty() => match suffix {
            0 => (usize::MAX, usize::MAX),
            _ => (bytes.saturating_sub(suffix), usize::MAX),
        },
        _ => return None,
    };
    Some(match start < bytes {
        true => Verdict::Part(start..end.min(bytes)),
        false => Verdict::NotSatisfiable,
    })
}

/// Digits, however many.
fn number(digits: &str) -> Option<usize> {
    let plain = !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
    plain.then(|| digits.parse().unwrap_or(usize::MAX))
}

#[cfg(test)]
mod tests;
