//! `/openapi.json`: all addresses, in the words of OpenAPI 3.1.

mod schemas;

use super::App;
use axum::extract::State;
use axum::response::Json;
use serde_json::{Value, json};

pub(super) async fn openapi(State(app): State<App>) -> Json<Value> {
    Json(description(&app))
}

fn description(app: &App) -> Value {
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "Escarp terrain server",
            "version": env!("CARGO_PKG_VERSION"),
            "description": "Terrain as pages, and heights for programs. Sessions that stream a \
                view are described in proto/PROTOCOL.md, pages and manifests in tiles/FORMAT.md, \
                heights in docs/heights.md. A dataset that has a token answers 401 without it, and 403 with \
                another.",
            "license": { "name": "MIT OR Apache-2.0", "identifier": "MIT OR Apache-2.0" }
        },
        "paths": paths(app),
        "components": {
            "schemas": schemas::schemas(),
            "securitySchemes": { "token": { "type": "http", "scheme": "bearer" } }
        },
        "security": [{}, { "token": [] }]
    })
}

fn paths(app: &App) -> Value {
    let mut paths = json!({});
    for more in [server(), datasets(), data(), heights(app), sights(app)] {
        if let (Value::Object(paths), Value::Object(more)) = (&mut paths, more) {
            paths.extend(more);
        }
    }
    for (path, operations) in paths.as_object_mut().into_iter().flatten() {
        for operation in operations.as_object_mut().into_iter().flatten() {
            let responses = &mut operation.1["responses"];
            for status in shared(path) {
                responses[status.to_string()] = error(status);
            }
        }
    }
    if !app.counted
        && let Value::Object(paths) = &mut paths
    {
        paths.remove("/metrics");
    }
    paths
}

/// What any request for an address may be answered with, before it is looked at.
fn shared(path: &str) -> Vec<u16> {
    let mut statuses = vec![421];
    // Those who ask how the server is are always answered.
    if !["/healthz", "/readyz"].contains(&path) {
        statuses.push(429);
    }
    if path.contains("{name}") {
        statuses.extend([401, 403, 404]);
    }
    if path.contains("{generation}") {
        statuses.push(410);
    }
    statuses
}

/// An answer that does not give what was asked for.
fn error(status: u16) -> Value {
    let description = match status {
        304 => return json!({ "description": "The client has it already." }),
        401 => "The dataset needs a token, and there was none; whether it is there is not said.",
        403 => "The token opens another dataset, or the web page that asks is not allowed.",
        404 => "There is nothing at this address; what there is.",
        410 => "The generation is not hosted any more; which is current.",
        421 => "The server is not addressed by the name in Host.",
        429 => "Too much from one address; Retry-After says when to come again.",
        503 => "All places are taken; Retry-After says when to come again.",
        _ => "What was found, and what is allowed.",
    };
    json!({
        "description": description,
        "content": { "application/json": { "schema": reference("Problem") } }
    })
}

/// One operation, whose errors are all of the same kind.
fn operation(summary: &str, parameters: Vec<Value>, ok: Value, errors: &[u16]) -> Value {
    let mut responses = json!({ "200": ok });
    for status in errors {
        responses[status.to_string()] = error(*status);
    }
    json!({ "summary": summary, "parameters": parameters, "responses": responses })
}

fn reference(name: &str) -> Value {
    json!({ "$ref": format!("#/components/schemas/{name}") })
}

fn as_json(schema: &str) -> Value {
    json!({
        "description": "As its schema says.",
        "content": { "application/json": { "schema": reference(schema) } }
    })
}

fn as_bytes(kind: &str, description: &str) -> Value {
    json!({ "description": description, "content": { kind: {} } })
}

/// A required part of the path.
fn part(name: &str) -> Value {
    let (description, schema) = match name {
        "name" => ("Name of a dataset.", json!({ "type": "string" })),
        "generation" => (
            "Id of a generation, as `current` tells.",
            json!({ "type": "string", "pattern": "^[0-9]+-[0-9a-f]{8}$" }),
        ),
        "level" => (
            "Level of the page's square, a multiple of 4.",
            json!({ "type": "integer", "minimum": 0, "maximum": 24 }),
        ),
        _ => (
            "Column or row of the page's square, from the south-west.",
            json!({ "type": "integer", "minimum": 0 }),
        ),
    };
    json!({ "name": name, "in": "path", "required": true, "description": description,
            "schema": schema })
}

fn query(name: &str, required: bool, schema: Value, description: &str) -> Value {
    json!({ "name": name, "in": "query", "required": required, "schema": schema,
            "description": description })
}

fn number(name: &str, required: bool, description: &str) -> Value {
    query(name, required, json!({ "type": "number" }), description)
}

fn server() -> Value {
    let text = |what: &str| as_bytes("text/plain; charset=utf-8", what);
    let mut session = operation(
        "Opens a session, by WebSocket (proto/PROTOCOL.md).",
        vec![],
        json!({}),
        &[400, 403, 426, 503],
    );
    if let Value::Object(responses) = &mut session["responses"] {
        responses.remove("200");
        responses.insert("101".into(), json!({ "description": "A session." }));
    }
    let mut index = operation("What is hosted, for people.", vec![], json!({}), &[]);
    index["responses"]["200"] = json!({
        "description": "HTML where Accept prefers it, else text.",
        "content": { "text/html; charset=utf-8": {}, "text/plain; charset=utf-8": {} }
    });
    let mut ready = operation(
        "Whether the server is ready.",
        vec![],
        as_json("Readiness"),
        &[],
    );
    ready["responses"]["503"] = as_json("Readiness");
    json!({
        "/": { "get": index },
        "/openapi.json": { "get": operation("This description.", vec![],
            as_bytes("application/json", "OpenAPI 3.1."), &[]) },
        "/healthz": { "get": operation("Whether the server is alive.", vec![],
            text("`ok`."), &[]) },
        "/readyz": { "get": ready },
        "/metrics": { "get": operation("What the server counts, for Prometheus.", vec![],
            as_bytes(crate::metrics::CONTENT_TYPE, "OpenMetrics."), &[]) },
        "/session": { "get": session }
    })
}

fn datasets() -> Value {
    json!({
        "/datasets": { "get": operation("All datasets.", vec![], as_json("Datasets"), &[]) },
        "/{name}": { "get": operation("One dataset.", vec![part("name")],
            as_json("Dataset"), &[404]) },
        "/{name}/current": { "get": operation("Which generation is current.", vec![part("name")],
            as_json("Current"), &[304, 404]) }
    })
}

fn data() -> Value {
    let mut paths = json!({});
    for generation in [false, true] {
        for (what, kind, places) in [
            ("manifest", "application/json", false),
            ("page", "application/octet-stream", true),
            ("pack", "application/octet-stream", true),
        ] {
            let mut path = String::from("/{name}");
            let mut parts = vec![part("name")];
            if generation {
                path += "/{generation}";
                parts.push(part("generation"));
            }
            path = format!("{path}/{what}");
            if places {
                path += "/{level}/{x}/{y}";
                parts.extend(["level", "x", "y"].map(part));
            }
            let summary = match what {
                "manifest" => "What the dataset is (tiles/FORMAT.md, Manifest).",
                "page" => "A page's whole record (tiles/FORMAT.md, Record).",
                _ => "All records below a page, with their table (tiles/FORMAT.md, Family).",
            };
            let bytes = as_bytes(kind, "The bytes as they are stored, with a strong ETag.");
            let mut get = operation(summary, parts, bytes, &[304, 404, 412, 416, 500]);
            get["responses"]["206"] = json!({ "description": "The range that was asked for." });
            paths[path] = json!({ "get": get });
        }
    }
    paths
}

/// Parameters that several have.
fn detail() -> [Value; 2] {
    let length = json!({ "type": "number", "minimum": 0 });
    [
        query(
            "error",
            false,
            length.clone(),
            "Bound of the error that will do, metres; not with resolution.",
        ),
        query(
            "resolution",
            false,
            length,
            "Distance of samples that will do, metres; not with error.",
        ),
    ]
}

fn crs() -> Value {
    let schema = json!({ "enum": ["native", "lonlat"], "default": "native" });
    query(
        "crs",
        false,
        schema,
        "Coordinates of the request and of the answer.",
    )
}

fn heights(app: &App) -> Value {
    let limits = &app.limits.heights;
    let points = |most: usize| {
        json!({ "required": true, "content": { "application/json": { "schema": {
            "type": "object", "required": ["points"], "additionalProperties": false,
            "properties": { "points": { "type": "array", "maxItems": most, "items":
                reference("Pair") } }
        } } } })
    };
    let errors = [400, 404, 422, 500, 503];
    let posted = [400, 404, 408, 413, 422, 500, 503];
    let mut get = vec![part("name")];
    get.extend([
        number("x", false, "Native coordinate; with y."),
        number("y", false, "Native coordinate; with x."),
        number("lon", false, "Longitude, degrees; with lat."),
        number("lat", false, "Latitude, degrees; with lon."),
    ]);
    get.extend(detail());
    let mut many = vec![part("name"), crs()];
    many.extend(detail());
    let mut post = operation("Heights of many points.", many, as_json("Heights"), &posted);
    post["requestBody"] = points(limits.batch_points);
    let csv = json!({ "schema": { "type": "string" } });
    post["requestBody"]["content"]["text/csv"] = csv.clone();
    post["responses"]["200"]["content"]["text/csv; charset=utf-8"] = csv;
    let samples = json!({ "type": "integer", "minimum": 2, "maximum": limits.profile_samples });
    let mut spread = vec![
        query(
            "samples",
            false,
            samples,
            "How many, the ends included; 100 if nothing is said.",
        ),
        number(
            "spacing",
            false,
            "Metres between samples, in place of their number.",
        ),
    ];
    spread.extend([part("name"), crs()]);
    spread.extend(detail());
    let mut line = spread.clone();
    line.push(query(
        "points",
        true,
        json!({ "type": "string" }),
        "The polyline: X,Y;X,Y;...",
    ));
    let along = "Heights along a polyline.";
    let mut profile = operation(along, spread, as_json("Profile"), &posted);
    profile["requestBody"] = points(crate::heights::MAX_VERTICES);
    let one = operation("The height at a point.", get, as_json("Height"), &errors);
    let drawn = operation(along, line, as_json("Profile"), &errors);
    json!({
        "/{name}/heights": { "get": one, "post": post },
        "/{name}/profile": { "get": drawn, "post": profile }
    })
}

fn sights(app: &App) -> Value {
    let limits = &app.limits.heights;
    let pair = |name: &str| query(name, true, json!({ "type": "string" }), "X,Y");
    let shared = || {
        let curvature = json!({ "enum": ["on", "off"], "default": "off" });
        let refraction = json!({ "type": "number", "minimum": 0, "exclusiveMaximum": 1 });
        vec![
            part("name"),
            pair("observer"),
            number(
                "observer_height",
                false,
                "Metres above the ground; 2 if nothing is said.",
            ),
            number(
                "target_height",
                false,
                "Metres above the ground; 0 if nothing is said.",
            ),
            crs(),
            query(
                "curvature",
                false,
                curvature,
                "Whether the body's curvature counts.",
            ),
            query(
                "refraction",
                false,
                refraction,
                "Part of the curvature that light follows; 0.13 if nothing is said.",
            ),
        ]
    };
    let errors = [400, 404, 422, 500, 503];
    let mut sight = shared();
    sight.push(pair("target"));
    let side = |most: u32, default: u32| json!({ "type": "integer", "minimum": 1, "maximum": most, "default": default });
    let mut viewshed = shared();
    viewshed.extend([
        number("radius", true, "Metres."),
        query(
            "size",
            false,
            side(limits.viewshed_side_px, 512),
            "Pixels on a side.",
        ),
        number(
            "resolution",
            false,
            "Distance of samples that will do, metres.",
        ),
    ]);
    let width = side(limits.overview_side_px, super::overview::WIDTH_PX);
    let overview = vec![part("name"), query("width", false, width, "Pixels.")];
    json!({
        "/{name}/sight": { "get":
            operation("A line of sight.", sight, as_json("Sight"), &errors) },
        "/{name}/viewshed.png": { "get": operation("What is seen from a place.", viewshed,
            as_bytes("image/png", "Grey and alpha: white certainly visible, black certainly \
                hidden, grey undecided within the bounds, transparent where no data is."),
            &errors) },
        "/{name}/overview.png": { "get": operation("The whole dataset at a glance.", overview,
            as_bytes("image/png", "A hillshade, transparent where no data is."),
            &[304, 400, 404, 422, 500, 503]) }
    })
}
