//! Rules, tokens, origins and proxies.

use super::*;
use axum::http::{HeaderMap, HeaderValue, header};
use proptest::prelude::*;
use std::sync::Arc;

const SECRET: &str = "correct-horse-battery";
const OTHER: &str = "another-token-entirely";

fn rule(datasets: &str, tokens: Option<&[&str]>, origins: Option<&[&str]>) -> Rule {
    let configured = |text: &&str| Token::configured(text).unwrap();
    Rule {
        datasets: datasets.into(),
        tokens: tokens.map(|tokens| tokens.iter().map(configured).collect()),
        origins: origins.map(|origins| Origins::parse(origins).unwrap()),
    }
}

fn access(rules: impl Into<Vec<Rule>>) -> Access {
    Access {
        rules: rules.into(),
        ..Access::default()
    }
}

#[test]
fn a_dataset_opens_to_its_tokens_only_and_without_a_rule_to_all() {
    let access = access([
        rule("survey-*", Some(&[SECRET]), None),
        rule("survey-2", Some(&[OTHER]), None),
        rule("closed", Some(&[]), None),
    ]);
    assert!(access.allows("moon", None) && access.allows("moon", Some("anything")));
    assert!(access.allows("survey-1", Some(SECRET)));
    assert!(!access.allows("survey-1", Some(OTHER)));
    assert!(!access.allows("survey-1", None));
    // Two rules fit: a token of either will do.
    assert!(access.allows("survey-2", Some(SECRET)) && access.allows("survey-2", Some(OTHER)));
    assert!(!access.allows("closed", Some(SECRET)) && !access.allows("closed", None));
    assert!(!access.allows("survey-1", Some("")));
}

#[test]
fn a_token_can_be_configured_by_its_hash_and_is_never_shown() {
    let hash = "sha256:".to_owned() + HASH_OF_SECRET;
    assert_eq!(Token::configured(&hash), Ok(Token::of(SECRET)));
    assert_eq!(
        Token::configured(&hash.to_uppercase().replace("SHA", "sha")),
        Ok(Token::of(SECRET))
    );
    assert_eq!(format!("{:?}", Token::of(SECRET)), "Token");
    assert_eq!(Token::configured("sha256:12"), Err(TokenError::Hash));
    assert_eq!(Token::configured("short"), Err(TokenError::Length(5)));
    assert_eq!(
        Token::configured("with a blank, and long"),
        Err(TokenError::Character(' '))
    );
}

/// By coreutils' `printf %s correct-horse-battery | sha256sum`.
const HASH_OF_SECRET: &str = "62249369389075490555a758353aec61500c6218fa597252d52dc4bd0148f12d";

#[test]
fn a_file_of_tokens_has_one_a_line_and_wrong_lines_are_numbered() {
    let text = format!("# of the survey\n\n{SECRET}\n  {OTHER}  \n");
    let tokens = Token::listed(&text).unwrap();
    assert_eq!(tokens, [Token::of(SECRET), Token::of(OTHER)]);
    let wrong = Token::listed("# one\nshort\n").unwrap_err();
    assert_eq!(wrong, (2, TokenError::Length(5)));
}

fn headers(lines: &[(header::HeaderName, &str)]) -> HeaderMap {
    let value = |text: &str| HeaderValue::from_str(text).unwrap();
    lines
        .iter()
        .map(|(name, text)| (name.clone(), value(text)))
        .collect()
}

fn caller(access: Access, lines: &[(header::HeaderName, &str)]) -> Caller {
    Caller::of(Arc::new(access), &headers(lines))
}

#[test]
fn the_token_of_a_request_stands_after_bearer_and_that_of_a_hello_goes_before_it() {
    let rules = access([
        rule("a", Some(&[SECRET]), None),
        rule("b", Some(&[OTHER]), None),
    ]);
    let of = |value: &str| caller(rules.clone(), &[(header::AUTHORIZATION, value)]);
    let bearer = of(&format!("bearer  {SECRET}"));
    assert!(bearer.sees("a") && !bearer.sees("b"));
    assert!(!of(SECRET).sees("a") && !of(&format!("Basic {SECRET}")).sees("a"));
    let both = bearer.with_token(Some(OTHER));
    assert!(both.sees("b") && !both.sees("a"));
    assert!(of(&format!("Bearer {SECRET}")).with_token(None).sees("a"));
}

#[test]
fn a_web_page_uses_what_its_origin_may_and_that_of_the_server_everything() {
    let rules = access([
        rule("closed", Some(&[SECRET]), None),
        rule("mapped", Some(&[SECRET]), Some(&["https://map.example"])),
    ]);
    let of = |origin: &str| {
        let lines = [(header::ORIGIN, origin), (header::HOST, "here:8787")];
        caller(rules.clone(), &lines).with_token(Some(SECRET))
    };
    assert_eq!(of("https://else.example").check("open"), Ok(()));
    assert_eq!(
        of("https://else.example").check("closed"),
        Err(Denied::Origin)
    );
    assert_eq!(
        of("https://else.example").check("mapped"),
        Err(Denied::Origin)
    );
    assert_eq!(of("https://MAP.example").check("mapped"), Ok(()));
    assert_eq!(
        of("https://map.example").check("closed"),
        Err(Denied::Origin)
    );
    assert_eq!(of("http://here:8787").check("closed"), Ok(()));
    let strict = Access {
        origins: Origins::none(),
        ..rules
    };
    let of = |origin| caller(strict.clone(), &[(header::ORIGIN, origin)]);
    assert!(of("https://map.example").may_connect());
    assert!(!of("https://else.example").may_connect());
}

#[test]
fn what_is_no_origin_is_refused_by_name() {
    for text in [
        "map.example",
        "https://",
        "https://a/b",
        "https://*.example",
        "",
        "a b://c",
    ] {
        let error = Origins::parse(&[text]).unwrap_err().to_string();
        assert!(error.contains(&format!("{text:?}")), "{error}");
    }
    assert_eq!(Origins::parse(&["https://a", "*"]), Ok(Origins::Any));
}

#[test]
fn a_trusted_proxy_tells_for_whom_it_asks_and_nobody_else_does() {
    let proxies = Proxies::parse(&["10.0.0.0/8", "::1"]).unwrap();
    let client = |peer: &str, forwarded: &str| {
        let name = header::HeaderName::from_static("x-forwarded-for");
        let ip = proxies.client(peer.parse().unwrap(), &headers(&[(name, forwarded)]));
        ip.to_string()
    };
    assert_eq!(client("192.0.2.1", "198.51.100.7"), "192.0.2.1");
    assert_eq!(client("10.1.1.1", "198.51.100.7"), "198.51.100.7");
    assert_eq!(client("::ffff:10.1.1.1", "198.51.100.7"), "198.51.100.7");
    // The client itself wrote what stands before the first address that is not trusted.
    assert_eq!(
        client("::1", "203.0.113.9, 198.51.100.7, 10.2.2.2"),
        "198.51.100.7"
    );
    assert_eq!(client("::1", "198.51.100.7, nonsense"), "::1");
    assert_eq!(client("::1", ""), "::1");
    assert!(Proxies::parse(&["10.0.0.0/33"]).is_err());
}

#[test]
fn an_ipv6_network_counts_as_one_address() {
    let of = |ip: &str| Address::of(ip.parse().unwrap());
    assert_eq!(of("2001:db8::1"), of("2001:db8::ffff:1"));
    assert_ne!(of("2001:db8::1"), of("2001:db8:0:1::1"));
    assert_eq!(of("::ffff:192.0.2.1"), of("192.0.2.1"));
    assert_ne!(of("192.0.2.2"), of("192.0.2.1"));
}

/// The same by trying all.
fn fits_naively(pattern: &[u8], name: &[u8]) -> bool {
    match pattern.split_first() {
        None => name.is_empty(),
        Some((b'*', rest)) => (0..=name.len()).any(|at| fits_naively(rest, &name[at..])),
        Some((byte, rest)) => name.first() == Some(byte) && fits_naively(rest, &name[1..]),
    }
}

proptest! {
    #[test]
    fn patterns_fit_as_by_trying_all(pattern in "[ab*]{0,7}", name in "[ab]{0,9}") {
        let naive = fits_naively(pattern.as_bytes(), name.as_bytes());
        prop_assert_eq!(fits(&pattern, &name), naive);
    }

    #[test]
    fn only_the_token_itself_opens(given in "[ -~]{0,40}") {
        let access = access([rule("*", Some(&[SECRET]), None)]);
        prop_assert_eq!(access.allows("moon", Some(&given)), given == SECRET);
    }
}
