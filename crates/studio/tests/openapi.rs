//! What the OpenAPI document promises: the routes that there are, and answers as it describes them.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Server, point};
use serde_json::{Value, json};
use std::collections::BTreeSet;

#[test]
fn openapi_states_the_routes_that_there_are() {
    let server = Server::start();
    let api: Value = server.get("/api/openapi.json").ok();
    let mut stated = BTreeSet::new();
    for (path, operations) in api["paths"].as_object().unwrap() {
        for method in operations.as_object().unwrap().keys() {
            stated.insert(format!("{method} {path}"));
        }
    }
    let there: BTreeSet<String> = lumi_studio::server::routes()
        .into_iter()
        .flat_map(|(path, methods)| methods.into_iter().map(move |m| format!("{m} {path}")))
        .collect();
    assert_eq!(
        stated, there,
        "the document (left) against the table (right)"
    );
    // The table's methods are those that the router answers.
    for (path, methods) in lumi_studio::server::routes() {
        let path = path.replace(['{', '}'], "");
        for method in ["get", "post", "put", "delete"] {
            let reply = server.send(&method.to_uppercase(), &path, "application/json", b"");
            let answered = reply.status != 405;
            assert_eq!(
                answered,
                methods.contains(&method),
                "{method} {path}: {}",
                reply.status
            );
        }
    }
    // Every schema that is named is there.
    let text = api.to_string();
    for part in text.split("#/components/schemas/").skip(1) {
        let name = part.split('"').next().unwrap();
        assert!(api["components"]["schemas"][name].is_object(), "{name}");
    }
}

/// Whether a value is what a schema of the document says.
fn fits(api: &Value, schema: &Value, value: &Value) -> bool {
    if let Some(name) = schema["$ref"].as_str() {
        let name = name.rsplit('/').next().unwrap();
        return fits(api, &api["components"]["schemas"][name], value);
    }
    for choice in ["anyOf", "oneOf"] {
        if let Some(schemas) = schema[choice].as_array() {
            return schemas.iter().any(|s| fits(api, s, value));
        }
    }
    if let Some(only) = schema.get("const") {
        return only == value;
    }
    if let Some(all) = schema["enum"].as_array() {
        return all.contains(value);
    }
    let kinds = match &schema["type"] {
        Value::Array(kinds) => kinds.clone(),
        kind => vec![kind.clone()],
    };
    let is = |kind: &Value| match kind.as_str() {
        Some("object") => value.is_object(),
        Some("array") => value.is_array(),
        Some("string") => value.is_string(),
        Some("boolean") => value.is_boolean(),
        Some("integer") => value.is_u64() || value.is_i64(),
        Some("number") => value.is_number(),
        Some("null") => value.is_null(),
        _ => false,
    };
    if !kinds.iter().any(is) {
        return false;
    }
    let members = value.as_object().into_iter().flatten();
    let known = schema["properties"].as_object();
    let described = members.into_iter().all(|(name, value)| match known {
        Some(known) => known.get(name).is_some_and(|s| fits(api, s, value)),
        None => true,
    });
    let needed = schema["required"].as_array().into_iter().flatten();
    let whole = needed
        .into_iter()
        .all(|name| value.get(name.as_str().unwrap()).is_some());
    let mut items = value.as_array().into_iter().flatten();
    described && whole && items.all(|item| fits(api, &schema["items"], item))
}

#[test]
fn answers_are_what_the_document_says() {
    let server = Server::start();
    let api: Value = server.get("/api/openapi.json").ok();
    let map = server.get("/api/maps").ok()["maps"][0]["id"].clone();
    let lights = [
        json!({"kind": "environment", "map": map, "rotate": 20.0, "strength": 0.5}),
        point(2.0, 50.0),
        json!({"kind": "area", "position": [2, 0, 3], "target": [0, 0, 0], "size": 1.0, "power": 50.0, "color": [1, 1, 1]}),
        json!({"kind": "spot", "position": [2, 0, 3], "angle": 20.0, "blend": 0.5, "power": 50.0}),
        json!({"kind": "sun", "from": [2, 1, 3], "strength": 2.0}),
    ];
    let light = &api["components"]["schemas"]["Light"];
    let mut parent = 0;
    for light_form in &lights {
        assert!(fits(&api, light, light_form), "{light_form}");
        let mut odd = light_form.clone();
        odd["watts"] = json!(3);
        assert!(!fits(&api, light, &odd), "{odd}");
        parent = server.add(parent, &json!({"mode": "add", "lights": [light_form]}));
    }
    let session = server.path("");
    for (path, stated) in [
        ("/api/studio", "/api/studio"),
        ("/api/maps", "/api/maps"),
        ("/api/sessions", "/api/sessions"),
        (session.trim_end_matches('/'), "/api/sessions/{session}"),
    ] {
        let answer = server.get(path).ok();
        let schema = &api["paths"][stated]["get"]["responses"]["200"]["content"];
        let schema = &schema["application/json"]["schema"];
        assert!(
            fits(&api, schema, &answer),
            "{path}: {answer} against {schema}"
        );
    }
    let refused = server.get("/api/sessions/none");
    let text: Value = serde_json::from_str(&refused.text()).unwrap();
    assert!(
        fits(&api, &api["components"]["schemas"]["Error"], &text),
        "{text}"
    );
    // What was sent is what comes back, with what was left out.
    let nodes = server.session()["nodes"].clone();
    for (node, sent) in nodes.as_array().unwrap()[1..].iter().zip(&lights) {
        let kept = &node["edit"]["lights"][0];
        for (name, value) in sent.as_object().unwrap() {
            let same = kept[name] == *value || numbers(&kept[name]) == numbers(value);
            assert!(same, "{name} of {kept}");
        }
    }
    assert_eq!(
        nodes[5]["edit"]["lights"][0]["color"],
        json!([1.0, 1.0, 1.0])
    );
}

/// JSON does not tell 1 from 1.0.
fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(all) => all.iter().filter_map(Value::as_f64).collect(),
        one => one.as_f64().into_iter().collect(),
    }
}
