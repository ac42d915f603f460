use super::Verdict::*;
use super::*;
use axum::http::HeaderValue;

const TAG: &str = "\"0000beef\"";
const BYTES: usize = 100;

fn judge(method: Method, headers: &[(HeaderName, &str)]) -> Verdict {
    let pairs = headers.iter().map(|(name, value)| {
        let value = HeaderValue::from_bytes(value.as_bytes()).unwrap();
        (name.clone(), value)
    });
    let mut map = HeaderMap::new();
    pairs.for_each(|(name, value)| {
        map.append(name, value);
    });
    verdict(&method, &map, TAG, BYTES)
}

#[test]
fn if_none_match_takes_lists_stars_and_weak_tags() {
    let table = [
        (TAG, NotModified),
        ("W/\"0000beef\"", NotModified),
        ("*", NotModified),
        (" * ", NotModified),
        ("\"1\", \"0000beef\"", NotModified),
        ("\"1\",W/\"0000beef\" , \"2\"", NotModified),
        (",, \"1\" ,, \"0000beef\"", NotModified),
        ("\"a,b\", \"0000beef\"", NotModified),
        ("\"1\"", Whole),
        ("0000beef", Whole),
        ("\"0000bee\"", Whole),
        ("\"0000BEEF\"", Whole),
        ("\", \"0000beef", Whole),
        ("w/\"0000beef\"", Whole),
        ("\"*\"", Whole),
        ("\"", Whole),
        ("", Whole),
        ("\u{fc}", Whole),
    ];
    for (value, right) in table {
        for method in [Method::GET, Method::HEAD] {
            let found = judge(method, &[(header::IF_NONE_MATCH, value)]);
            assert_eq!(found, right, "{value}");
        }
    }
    let two = [
        (header::IF_NONE_MATCH, "\"1\""),
        (header::IF_NONE_MATCH, TAG),
    ];
    assert_eq!(judge(Method::GET, &two), NotModified);
}

#[test]
fn if_match_wants_the_same_strong_tag() {
    let table = [
        (TAG, Whole),
        ("*", Whole),
        ("\"1\", \"0000beef\"", Whole),
        ("W/\"0000beef\"", PreconditionFailed),
        ("\"1\"", PreconditionFailed),
        ("", PreconditionFailed),
    ];
    for (value, right) in table {
        assert_eq!(
            judge(Method::GET, &[(header::IF_MATCH, value)]),
            right,
            "{value}"
        );
    }
    // It is looked at first (RFC 9110, section 13.2.2).
    let both = [(header::IF_MATCH, "\"1\""), (header::IF_NONE_MATCH, "*")];
    assert_eq!(judge(Method::GET, &both), PreconditionFailed);
    let both = [(header::IF_MATCH, TAG), (header::IF_NONE_MATCH, TAG)];
    assert_eq!(judge(Method::GET, &both), NotModified);
}

#[test]
fn one_range_of_bytes_is_cut_out() {
    let table = [
        ("bytes=0-0", Part(0..1)),
        ("bytes=0-99", Part(0..100)),
        ("bytes=10-19", Part(10..20)),
        ("bytes=90-200", Part(90..100)),
        ("bytes=99-", Part(99..100)),
        ("bytes=0-", Part(0..100)),
        ("bytes=-1", Part(99..100)),
        ("bytes=-100", Part(0..100)),
        ("bytes=-1000", Part(0..100)),
        ("Bytes=1-1", Part(1..2)),
        ("bytes= 1-1 ", Part(1..2)),
        ("bytes=000-0009", Part(0..10)),
        ("bytes=5-99999999999999999999999", Part(5..100)),
        ("bytes=100-", NotSatisfiable),
        ("bytes=100-200", NotSatisfiable),
        ("bytes=99999999999999999999999-", NotSatisfiable),
        ("bytes=-0", NotSatisfiable),
        // Several may be answered by the whole; what is none is ignored.
        ("bytes=0-1,5-6", Whole),
        ("bytes=0-1,", Whole),
        ("bytes=2-1", Whole),
        ("bytes=-", Whole),
        ("bytes=", Whole),
        ("bytes", Whole),
        ("bytes=a-b", Whole),
        ("bytes=+1-2", Whole),
        ("bytes=1--2", Whole),
        ("bytes=1 - 2", Whole),
        ("seconds=0-1", Whole),
        ("", Whole),
    ];
    for (value, right) in table {
        assert_eq!(
            judge(Method::GET, &[(header::RANGE, value)]),
            right,
            "{value}"
        );
        // It has no meaning with any other method (RFC 9110, section 14.2).
        assert_eq!(
            judge(Method::HEAD, &[(header::RANGE, value)]),
            Whole,
            "{value}"
        );
    }
}

#[test]
fn a_range_holds_only_of_the_content_that_if_range_names() {
    let range = (header::RANGE, "bytes=10-19");
    let table = [
        (TAG, Part(10..20)),
        ("\"1\"", Whole),
        ("W/\"0000beef\"", Whole),
        ("Sun, 06 Nov 1994 08:49:37 GMT", Whole),
        ("", Whole),
    ];
    for (value, right) in table {
        let headers = [range.clone(), (header::IF_RANGE, value)];
        assert_eq!(judge(Method::GET, &headers), right, "{value}");
    }
    let beyond = [(header::RANGE, "bytes=100-"), (header::IF_RANGE, "\"1\"")];
    assert_eq!(judge(Method::GET, &beyond), Whole);
    let known = [range, (header::IF_NONE_MATCH, TAG)];
    assert_eq!(judge(Method::GET, &known), NotModified);
}

#[test]
fn dates_do_not_count_where_contents_have_none() {
    for name in [header::IF_MODIFIED_SINCE, header::IF_UNMODIFIED_SINCE] {
        let headers = [(name, "Sun, 06 Nov 1994 08:49:37 GMT")];
        assert_eq!(judge(Method::GET, &headers), Whole);
    }
}
