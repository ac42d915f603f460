//! The OpenAPI description against the server that it describes.

use super::heights::{Hosting, ramp};
use super::*;
use crate::Access;
use crate::access::{Hosts, Proxies, Rule, Token};
use crate::serve::Serving;
use std::collections::BTreeSet;

/// Where routes are made, as text.
const ROUTERS: [&str; 3] = [
    include_str!("../http/mod.rs"),
    include_str!("../http/heights.rs"),
    include_str!("../health.rs"),
];

async fn hosting() -> (Hosting, String) {
    let catalog = Catalog::default();
    let made = ramp();
    let id = PageSource::generation_id(&made.dataset).to_string();
    catalog.add("ramp", Arc::new(made.dataset)).unwrap();
    (Hosting::start(catalog, Limits::default()).await, id)
}

/// Whether a value is as its schema says; where it is not.
fn check(all: &Value, schema: &Value, value: &Value, at: &str) -> Result<(), String> {
    if let Some(name) = schema["$ref"].as_str() {
        let target = name.strip_prefix('#').and_then(|path| all.pointer(path));
        return check(all, target.ok_or(format!("no {name}"))?, value, at);
    }
    let kind = match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(number) if number.is_f64() => "number",
        Value::Number(_) => "integer",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    };
    let allows = |allowed: &Value| allowed == kind || (allowed == "number" && kind == "integer");
    match &schema["type"] {
        Value::Null => {}
        Value::Array(several) if several.iter().any(allows) => {}
        one if allows(one) => {}
        other => return Err(format!("{at} is {value}, its type {other}")),
    }
    if let Some(allowed) = schema["enum"].as_array()
        && !allowed.contains(value)
    {
        return Err(format!("{at} is {value}, allowed {allowed:?}"));
    }
    if let (Some(least), Some(found)) = (schema["minimum"].as_f64(), value.as_f64())
        && found < least
    {
        return Err(format!("{at} is {found}, at least {least}"));
    }
    for (i, item) in value.as_array().into_iter().flatten().enumerate() {
        check(all, &schema["items"], item, &format!("{at}/{i}"))?;
    }
    let Some(object) = value.as_object() else {
        return Ok(());
    };
    for name in schema["required"].as_array().into_iter().flatten() {
        let name = name.as_str().unwrap_or_default();
        object.get(name).ok_or(format!("{at} has no {name}"))?;
    }
    for (name, value) in object {
        match schema["properties"].get(name) {
            Some(schema) => check(all, schema, value, &format!("{at}/{name}"))?,
            None if schema["additionalProperties"] == false => {
                return Err(format!("{at} has an unknown {name}"));
            }
            None => {}
        }
    }
    Ok(())
}

/// Holds an answer against what an operation says of its status.
fn holds(all: &Value, operation: &Value, answer: &Answer, what: &str) {
    let told = &operation["responses"][answer.status.to_string()];
    assert!(
        !told.is_null(),
        "{what}: status {} is not described",
        answer.status
    );
    let Some(content) = told["content"].as_object() else {
        return;
    };
    let kind = answer.header("content-type").unwrap_or_default();
    let body = content.get(kind);
    let body = body.unwrap_or_else(|| panic!("{what}: {kind:?} is not described"));
    if kind == "application/json" && !body["schema"].is_null() {
        let found = check(all, &body["schema"], &answer.json(), "");
        assert_eq!(found, Ok(()), "{what}");
    }
}

#[tokio::test]
async fn every_route_is_described_and_every_description_is_a_route() {
    let (server, _) = hosting().await;
    let all = server.get("/openapi.json").await.json();
    let described: BTreeSet<&str> = all["paths"]
        .as_object()
        .unwrap()
        .keys()
        .map(|k| &**k)
        .collect();
    let routes: BTreeSet<&str> = ROUTERS
        .iter()
        .flat_map(|text| text.split("route(").skip(1))
        .filter_map(|rest| rest.trim_start().strip_prefix('"')?.split('"').next())
        .collect();
    assert!(routes.len() > 15);
    assert_eq!(described, routes);
    server.stop().await;
}

#[tokio::test]
async fn every_address_answers_as_it_is_described() {
    let (server, id) = hosting().await;
    let all = server.get("/openapi.json").await.json();
    for (path, operations) in all["paths"].as_object().unwrap() {
        let place = path
            .replace("{name}", "ramp")
            .replace("{generation}", &id)
            .replace("{level}/{x}/{y}", "0/0/0");
        let end = path.rsplit('/').next().unwrap();
        let query = match end {
            "heights" => "x=500100&y=4999040",
            "profile" => "points=500000,4999040;500100,4999040&samples=5",
            "sight" => "observer=500000,4999040&target=500400,4999040",
            "viewshed.png" => "observer=500320,4999500&radius=200&size=16",
            _ => "",
        };
        for (method, operation) in operations.as_object().unwrap() {
            let what = format!("{method} {path}");
            let body = r#"{"points": [[500000, 4999040], [0, 0]]}"#;
            let answer = match method.as_str() {
                "post" => server.ask("POST", &place, "", body).await,
                _ => server.get(&format!("{place}?{query}")).await,
            };
            let is_session = path == "/session";
            assert_eq!(answer.status == 200, !is_session, "{what}: {}", answer.head);
            holds(&all, operation, &answer, &what);
            // And in error: of a dataset that is not there, and of a wrong query.
            if path.contains("{name}") {
                let nowhere = place.replace("ramp", "mars");
                let verb = method.to_uppercase();
                let answer = server.ask(&verb, &nowhere, "", body).await;
                assert_eq!(answer.status, 404, "{what}");
                holds(&all, operation, &answer, &what);
            }
            if !query.is_empty() {
                let answer = server.get(&format!("{place}?{query}&colour=red")).await;
                assert_eq!(answer.status, 400, "{what}");
                holds(&all, operation, &answer, &what);
            }
            let named = operation["parameters"].as_array().unwrap();
            let in_path = named
                .iter()
                .filter(|parameter| parameter["in"] == "path")
                .count();
            assert_eq!(in_path, path.matches('{').count(), "{what}");
        }
    }
    server.stop().await;
}

/// A server of the same, that only those with a token may see, and nobody twice.
async fn guarded() -> Hosting {
    let catalog = Catalog::default();
    catalog.add("ramp", Arc::new(ramp().dataset)).unwrap();
    let limits = Limits {
        requests_per_second_per_address: 1,
        request_burst_per_address: 1,
        ..Limits::default()
    };
    let access = Access {
        rules: vec![Rule {
            datasets: "*".into(),
            tokens: Some(vec![Token::of("a-token-of-some-length")]),
            origins: None,
        }],
        hosts: Hosts::local(),
        ..Access::default()
    };
    let serving = Serving::new(Arc::new(catalog), limits).with_access(access);
    let proxies = Proxies::parse(&["127.0.0.1"]).unwrap();
    Hosting::of(serving.behind(proxies).limiting_loopback(true)).await
}

#[tokio::test]
async fn what_is_refused_before_it_is_looked_at_is_described_for_every_address() {
    let (open, id) = hosting().await;
    let server = guarded().await;
    let all = open.get("/openapi.json").await.json();
    let past = format!("{}-00000000", id.split('-').next().unwrap());
    let mut clients = 0;
    for (path, operations) in all["paths"].as_object().unwrap() {
        for (method, operation) in operations.as_object().unwrap() {
            let what = format!("{method} {path}");
            let place = path
                .replace("{name}", "ramp")
                .replace("{generation}", &past)
                .replace("{level}/{x}/{y}", "0/0/0");
            let request = format!("{} {place}", method.to_uppercase());
            // Each from an address of its own, unless that is the point.
            clients += 1;
            let from = format!("X-Forwarded-For: 192.0.2.{clients}\r\nContent-Length: 0\r\n");
            let evil = format!("Host: evil.example\r\n{from}");
            let answer = ask(server.address, &request, &evil, "").await;
            assert_eq!(answer.status, 421, "{what}");
            holds(&all, operation, &answer, &what);
            if path.contains("{name}") {
                let answer = ask(server.address, &request, &from, "").await;
                assert_eq!(answer.status, 401, "{what}");
                holds(&all, operation, &answer, &what);
                clients += 1;
                let from = format!("X-Forwarded-For: 192.0.2.{clients}\r\n");
                let wrong = format!("{from}Authorization: Bearer another-token-entirely\r\n");
                let answer = ask(server.address, &request, &wrong, "").await;
                assert_eq!(answer.status, 403, "{what}");
                holds(&all, operation, &answer, &what);
            }
            if path.contains("{generation}") {
                let answer = open.get(&place).await;
                assert_eq!(answer.status, 410, "{what}");
                holds(&all, operation, &answer, &what);
            }
            if ["/healthz", "/readyz"].contains(&path.as_str()) {
                continue;
            }
            let mut last = ask(server.address, &request, &from, "").await;
            // A second may pass between two requests, not between all of them.
            for _ in 0..20 {
                if last.status == 429 {
                    break;
                }
                last = ask(server.address, &request, &from, "").await;
            }
            assert_eq!(last.status, 429, "{what}");
            assert!(last.header("retry-after").is_some());
            holds(&all, operation, &last, &what);
        }
    }
    open.stop().await;
    server.stop().await;
}

#[test]
fn the_check_of_schemas_finds_what_is_wrong() {
    let schema = serde_json::json!({ "type": "object", "required": ["a"],
        "additionalProperties": false, "properties": {
            "a": { "type": ["number", "null"], "minimum": 0 },
            "b": { "enum": ["x"] } } });
    let is = |value: Value| check(&Value::Null, &schema, &value, "").is_ok();
    assert!(is(serde_json::json!({ "a": 1.5, "b": "x" })));
    for wrong in [
        serde_json::json!([]),
        serde_json::json!({}),
        serde_json::json!({ "a": "1" }),
        serde_json::json!({ "a": -1 }),
        serde_json::json!({ "a": null, "b": "y" }),
        serde_json::json!({ "a": null, "c": 1 }),
    ] {
        assert!(!is(wrong.clone()), "{wrong}");
    }
}

#[tokio::test]
async fn a_browser_gets_a_page_that_takes_nothing_from_elsewhere() {
    let (server, _) = hosting().await;
    let accept = "Accept: text/html,*/*;q=0.8\r\n";
    let answer = server.ask("GET", "/", accept, "").await;
    assert_eq!(
        answer.header("content-type"),
        Some("text/html; charset=utf-8")
    );
    let policy = answer.header("content-security-policy").unwrap().to_owned();
    assert!(policy.starts_with("default-src 'none'; img-src 'self'; style-src 'sha256-"));
    let page = String::from_utf8(answer.body).unwrap();
    let command = format!("escarp-client view http://{}/ramp", server.address);
    assert!(page.contains(&command) && !page.contains("<script") && !page.contains(" style="));
    // Whatever it links to is there.
    let links = page.split(['"']).filter(|text| text.starts_with('/'));
    for link in links.map(|link| link.replace("&amp;", "&")) {
        assert_eq!(server.get(&link).await.status, 200, "{link}");
    }
    server.stop().await;
}
