//! The interface as OpenAPI 3.1, made of the table of routes and of the types that are read and written.

use crate::reply::Failed;
use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde_json::{Map, Value, json};

/// A method of a route, as it is described.
pub struct Operation {
    /// `get`, `post`, `put` or `delete`.
    pub method: &'static str,
    summary: &'static str,
    query: Option<MakeSchema>,
    body: Option<Content>,
    reply: Content,
}

type MakeSchema = fn(&mut SchemaGenerator) -> Schema;

enum Content {
    Json(MakeSchema),
    /// Bytes of a media type.
    Bytes(&'static str),
    /// One file a part.
    Files,
    /// The connection becomes a WebSocket.
    Socket,
}

impl Operation {
    /// One that takes nothing and answers with bytes of unknown type.
    pub fn new(method: &'static str, summary: &'static str) -> Self {
        Self {
            method,
            summary,
            query: None,
            body: None,
            reply: Content::Bytes("application/octet-stream"),
        }
    }

    /// Takes a query of these fields.
    pub fn asks<T: JsonSchema>(self) -> Self {
        Self {
            query: Some(T::json_schema),
            ..self
        }
    }

    /// Takes a JSON body.
    pub fn takes<T: JsonSchema>(self) -> Self {
        let body = Some(Content::Json(SchemaGenerator::subschema_for::<T>));
        Self { body, ..self }
    }

    /// Takes the bytes of a file.
    pub fn takes_bytes(self) -> Self {
        let body = Some(Content::Bytes("application/octet-stream"));
        Self { body, ..self }
    }

    /// Takes the files of a folder.
    pub fn takes_files(self) -> Self {
        let body = Some(Content::Files);
        Self { body, ..self }
    }

    /// Answers with JSON.
    pub fn gives<T: JsonSchema>(self) -> Self {
        let reply = Content::Json(SchemaGenerator::subschema_for::<T>);
        Self { reply, ..self }
    }

    /// Answers with bytes of a media type.
    pub fn gives_bytes(self, mime: &'static str) -> Self {
        let reply = Content::Bytes(mime);
        Self { reply, ..self }
    }

    /// Becomes a WebSocket.
    pub fn opens_socket(self) -> Self {
        let reply = Content::Socket;
        Self { reply, ..self }
    }

    fn describe(&self, path: &str, generator: &mut SchemaGenerator) -> Value {
        let mut parameters = path_parameters(path);
        if let Some(query) = self.query {
            parameters.extend(query_parameters(&query(generator)));
        }
        let failed = content("application/json", generator.subschema_for::<Failed>());
        let mut responses = json!({
            "default": {"description": "What is wrong, in words", "content": failed},
        });
        responses[self.reply.status()] = self.reply.describe("Done", generator);
        let mut described = json!({"summary": self.summary});
        if !parameters.is_empty() {
            described["parameters"] = parameters.into();
        }
        if let Some(body) = &self.body {
            described["requestBody"] = body.describe("What to do it with", generator);
            described["requestBody"]["required"] = true.into();
        }
        described["responses"] = responses;
        described
    }
}

impl Content {
    fn status(&self) -> &'static str {
        match self {
            Self::Socket => "101",
            _ => "200",
        }
    }

    fn describe(&self, description: &str, generator: &mut SchemaGenerator) -> Value {
        let bytes = json!({"type": "string", "format": "binary"});
        let content = match self {
            Self::Socket => return json!({"description": "Switches to WebSocket"}),
            Self::Json(schema) => content("application/json", schema(generator)),
            Self::Bytes(mime) => content(mime, bytes),
            Self::Files => content(
                "multipart/form-data",
                json!({"type": "object", "additionalProperties": bytes}),
            ),
        };
        json!({"description": description, "content": content})
    }
}

fn content(mime: &str, schema: impl Into<Value>) -> Value {
    let schema: Value = schema.into();
    json!({mime: {"schema": schema}})
}

/// `{node}` and `{index}` are numbers, everything else is a name.
fn path_parameters(path: &str) -> Vec<Value> {
    let names = path.split('{').skip(1).filter_map(|p| p.split('}').next());
    let parameter = |name: &str| {
        let schema = match name {
            "node" | "index" => json!({"type": "integer", "minimum": 0}),
            _ => json!({"type": "string"}),
        };
        json!({"name": name, "in": "path", "required": true, "schema": schema})
    };
    names.map(parameter).collect()
}

/// A query's fields, one parameter each.
fn query_parameters(schema: &Schema) -> Vec<Value> {
    let required: Vec<&Value> = match schema.get("required") {
        Some(Value::Array(names)) => names.iter().collect(),
        _ => Vec::new(),
    };
    let properties = schema.get("properties").and_then(Value::as_object);
    let parameter = |(name, schema): (&String, &Value)| {
        let required = required.iter().any(|r| r.as_str() == Some(name));
        json!({"name": name, "in": "query", "required": required, "schema": schema})
    };
    properties.into_iter().flatten().map(parameter).collect()
}

/// The document of a table of routes.
pub fn document<'a>(routes: impl Iterator<Item = (&'a str, &'a [Operation])>) -> Value {
    let settings = SchemaSettings::draft2020_12();
    let mut generator = settings
        .with(|s| s.definitions_path = "/components/schemas".into())
        .into_generator();
    let mut paths = Map::new();
    for (path, operations) in routes {
        let described = operations.iter();
        let described = described.map(|o| (o.method.to_owned(), o.describe(path, &mut generator)));
        paths.insert(path.to_owned(), Value::Object(described.collect()));
    }
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "Lumi Studio",
            "version": "1",
            "description": "What the studio's page uses, and nothing else. Errors are JSON with one text. \
                Lights are in the scene's world space and in Blender's units.",
        },
        "paths": paths,
        "components": {"schemas": generator.take_definitions(true)},
    })
}
