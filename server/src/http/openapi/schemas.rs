//! The shapes of answers in JSON.

use serde_json::{Map, Value, json};

/// All schemas, by name.
pub(super) fn schemas() -> Value {
    let about = about();
    let with = |properties: Value| object(&[about.clone(), properties]);
    json!({
        "Pair": { "type": "array", "items": { "type": "number" }, "minItems": 2, "maxItems": 2 },
        "Problem": { "type": "object", "required": ["error"], "properties": {
            "error": { "type": "string" },
            "allowed": { "type": "array", "items": { "type": "string" } },
            "datasets": { "type": "array", "items": { "type": "string" } },
            "current": { "type": "object" }
        } },
        "Readiness": object(&[json!({
            "ready": { "type": "boolean" },
            "reasons": { "type": "array", "items": { "type": "string" } },
            "datasets": { "type": "integer" }
        })]),
        "Current": object(&[json!({
            "name": { "type": "string" },
            "generation": { "type": "integer" },
            "id": { "type": "string" },
            "manifest": { "type": "string" },
            "page": { "type": "string" },
            "pack": { "type": "string" }
        })]),
        "Datasets": object(&[json!({
            "datasets": { "type": "array", "items": { "$ref": "#/components/schemas/Dataset" } }
        })]),
        "Dataset": dataset(),
        "Accuracy": { "type": "object", "required": ["storage_m"], "properties": {
            "storage_m": { "type": "number", "minimum": 0 },
            "resampling_m": { "type": "number", "minimum": 0 },
            "horizontal_m": { "type": "number", "minimum": 0 },
            "scale_percent": { "type": "number", "minimum": 0 }
        } },
        "Height": with(json!({
            "point": pair(),
            "height_m": { "type": ["number", "null"] },
            "error_m": { "type": ["number", "null"] },
            "spacing_m": { "type": ["array", "null"], "items": { "type": "number" } }
        })),
        "Heights": with(json!({ "heights_m": numbers(), "errors_m": numbers() })),
        "Profile": with(json!({
            "length_m": { "type": "number" },
            "distances_m": { "type": "array", "items": { "type": "number" } },
            "points": { "type": "array", "items": { "type": ["array", "null"],
                "items": { "type": "number" } } },
            "heights_m": numbers(),
            "errors_m": numbers()
        })),
        "End": object(&[json!({
            "ground_m": { "type": "number" },
            "above_ground_m": { "type": "number" }
        })]),
        "Place": { "type": ["object", "null"], "required": ["point", "distance_m"],
            "additionalProperties": false, "properties": {
                "point": { "type": ["array", "null"], "items": { "type": "number" } },
                "distance_m": { "type": "number" }
        } },
        "Sight": with(json!({
            "visible": { "type": ["boolean", "null"] },
            "certain": { "type": "boolean" },
            "length_m": { "type": "number" },
            "observer": { "$ref": "#/components/schemas/End" },
            "target": { "$ref": "#/components/schemas/End" },
            "margin_m": { "type": ["number", "null"] },
            "margin_error_m": { "type": "number", "minimum": 0 },
            "margin_at": { "$ref": "#/components/schemas/Place" },
            "blocked_at": { "$ref": "#/components/schemas/Place" },
            "over_no_data": { "type": "boolean" }
        }))
    })
}

/// An object that has all of these properties, and no others.
fn object(properties: &[Value]) -> Value {
    let all: Map<String, Value> = properties
        .iter()
        .filter_map(Value::as_object)
        .flatten()
        .map(|(name, schema)| (name.clone(), schema.clone()))
        .collect();
    let required: Vec<&String> = all.keys().collect();
    json!({ "type": "object", "required": required, "additionalProperties": false,
            "properties": all })
}

/// What every answer about heights says of its source.
fn about() -> Value {
    json!({
        "dataset": { "type": "string" },
        "generation": { "type": "integer" },
        "vertical": { "type": ["string", "null"] },
        "crs": { "type": ["string", "null"] },
        "coordinates": { "enum": ["native", "lonlat"] },
        "interpolation": { "enum": ["triangles"] },
        "accuracy": { "$ref": "#/components/schemas/Accuracy" }
    })
}

fn dataset() -> Value {
    object(&[json!({
        "name": { "type": "string" },
        "session_url": { "type": "string" },
        "manifest_url": { "type": "string" },
        "extent_m": { "type": "array", "items": pair(), "minItems": 3, "maxItems": 3 },
        "native": object(&[json!({
            "crs": { "type": ["string", "null"] },
            "unit": { "type": "string" },
            "corners": { "type": "array", "items": pair(), "minItems": 4, "maxItems": 4 }
        })]),
        "samples": { "type": "array", "items": { "type": "integer" } },
        "sample_spacing_m": pair(),
        "levels": { "type": "integer" },
        "pages": { "type": "integer" },
        "bytes": { "type": "integer" },
        "generation": { "type": "integer" },
        "sources": { "type": "array", "items": { "type": "string" } }
    })])
}

fn pair() -> Value {
    json!({ "$ref": "#/components/schemas/Pair" })
}

fn numbers() -> Value {
    json!({ "type": "array", "items": { "type": ["number", "null"] } })
}
