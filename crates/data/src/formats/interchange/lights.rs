//! Lights of the layout: those of [`LightSource`], with some fields under other names.
//!
//! A light's `type` is `env`, `point`, `area`, `spot` or `sun`. Where it faces is a `direction`, or the origin without one, and a
//! map's turn is in radians.

use lumi_core::glam::{Mat3, Vec3};
use lumi_core::light::{LightSource, ahead};
use lumi_core::{Error, Result};
use serde::Deserialize;
use serde_json::{Map, Value};

type Fields = Map<String, Value>;

/// Kinds in the file and of ours, and what each must have.
const KINDS: [(&str, &str, &[&str]); 5] = [
    ("env", "environment", &["file"]),
    ("point", "point", &["position", "power_watts"]),
    ("area", "area", &["position", "size", "power_watts"]),
    ("spot", "spot", &["position", "power_watts"]),
    ("sun", "sun", &["from"]),
];

/// Fields in the file and of ours, where they are called otherwise.
const NAMES: [(&str, &str); 3] = [
    ("file", "map"),
    ("power_watts", "power"),
    ("side_u", "side"),
];

/// Fields that repeat others in another form, for people; any other that is not known is an error, so that a misspelt one is noticed.
const REPEATED: [&str; 7] = [
    "lookup",
    "distance",
    "radiant_intensity",
    "sphere_radiance",
    "radiance",
    "side_v",
    "light_to_world",
];

/// The light of a record without its name; its map is a file.
///
/// # Errors
/// Names the field and what was expected.
pub(super) fn read(mut record: Fields) -> Result<LightSource<String>> {
    let kind = record.remove("type");
    let kind = kind.as_ref().and_then(Value::as_str).unwrap_or_default();
    let known = KINDS.into_iter().find(|(written, ..)| *written == kind);
    let Some((_, kind, needed)) = known else {
        let all = KINDS.map(|(written, ..)| written).join(", ");
        let expected = format!("expected one of {all}, found `{kind}`");
        return Err(Error::value("type", expected));
    };
    if let Some(missing) = needed.iter().find(|field| !record.contains_key(**field)) {
        return Err(Error::value(*missing, "missing field"));
    }
    record.retain(|field, _| !REPEATED.contains(&field.as_str()));
    for (written, own) in NAMES {
        if record.contains_key(own) {
            let expected = format!("unknown field, expected `{written}`");
            return Err(Error::value(own, expected));
        }
        if let Some(value) = record.remove(written) {
            record.insert(own.to_owned(), value);
        }
    }
    let aimed = matches!(kind, "area" | "spot");
    if let Some(direction) = vector(&mut record, "direction", aimed)? {
        let position = record.get("position").map(Vec3::deserialize);
        let position = position.and_then(std::result::Result::ok);
        let target = ahead(position.unwrap_or_default(), direction);
        record.insert("target".to_owned(), target.to_array().to_vec().into());
    }
    if kind == "environment" {
        let turn = record.remove("rotation_z").map(f32::deserialize);
        let turn = turn
            .transpose()
            .map_err(|e| Error::value("rotation_z", e.to_string()))?;
        let rotation = Mat3::from_rotation_z(turn.unwrap_or_default()).to_cols_array();
        record.insert("rotation".to_owned(), rotation.to_vec().into());
    }
    record.insert("kind".to_owned(), kind.into());
    LightSource::from_fields(record).map_err(|e| match e {
        // As the file calls it.
        Error::Value { field, expected } => {
            let field = field.rsplit('.').next().unwrap_or_default();
            let name = NAMES.into_iter().find(|(_, own)| *own == field);
            Error::value(name.map_or(field, |(written, _)| written), expected)
        }
        other => other,
    })
}

/// Takes three numbers out of a record, where it `may` have them.
fn vector(record: &mut Fields, field: &str, may: bool) -> Result<Option<Vec3>> {
    let value = if may { record.remove(field) } else { None };
    let value = value.filter(|v| !v.is_null()).map(Vec3::deserialize);
    value
        .transpose()
        .map_err(|e| Error::value(field, e.to_string()))
}

/// The record of a light whose map is a file.
///
/// # Errors
/// On a map that is turned about another axis than z: the layout knows no tilt.
pub(super) fn write(name: &str, light: &LightSource<String>) -> Result<Fields> {
    let wrong = |e: serde_json::Error| Error::value("lights", e.to_string());
    let mut own = match serde_json::to_value(light).map_err(wrong)? {
        Value::Object(fields) => fields,
        _ => Fields::new(),
    };
    let array = |v: Vec3| Value::from(v.to_array().to_vec());
    match light {
        LightSource::Environment(l) => {
            let turned = l.orientation();
            let rotation_z = turned.x_axis.y.atan2(turned.x_axis.x);
            if !turned.abs_diff_eq(Mat3::from_rotation_z(rotation_z), 1e-5) {
                let expected = "expected a map turned about z only; the layout knows no tilt";
                return Err(Error::value(format!("light `{name}`"), expected));
            }
            own.remove("rotate");
            own.remove("rotation");
            own.insert("rotation_z".to_owned(), rotation_z.into());
        }
        LightSource::Area(l) => {
            own.insert("target".to_owned(), array(l.direction()));
            own.insert("side".to_owned(), array(l.sides()[0]));
        }
        LightSource::Spot(l) => {
            own.insert("target".to_owned(), array(l.direction()));
        }
        LightSource::Point(_) | LightSource::Sun(_) => {}
    }
    let kind = KINDS.into_iter().find(|(_, kind, _)| *kind == light.kind());
    let kind = kind.map_or("", |(written, ..)| written);
    let mut record = Fields::new();
    record.insert("name".to_owned(), name.into());
    record.insert("type".to_owned(), kind.into());
    for (field, value) in own.into_iter().filter(|(field, _)| field != "kind") {
        let names = NAMES.into_iter().chain([("direction", "target")]);
        let written = names.into_iter().find(|(_, own)| *own == field);
        let written = written.map_or(field.as_str(), |(written, _)| written);
        record.insert(written.to_owned(), value);
    }
    Ok(record)
}

#[cfg(test)]
mod tests {
    use super::*;
    use lumi_core::{Area, Environment, Point, Spot, Sun};

    #[test]
    fn every_kind_reads_back() {
        let place = Vec3::new(3.0, -1.0, 2.0);
        let area = Area {
            side: Some(Vec3::new(0.3, 1.0, 0.2)),
            ..Area::facing(place, Vec3::ONE, 1.5, 900.0)
        };
        let spot = Spot {
            angle: 30.0,
            color: [1.0, 0.5, 0.25],
            ..Spot::facing(place, Vec3::ONE, 900.0)
        };
        let sky = Environment::oriented("a.exr".to_owned(), Mat3::from_rotation_z(0.7), [2.0; 3]);
        for light in [
            LightSource::Environment(sky),
            LightSource::Point(Point::new(place, 800.0)),
            LightSource::Area(area),
            LightSource::Spot(spot),
            LightSource::Sun(Sun::new(place, 3.0)),
        ] {
            let mut record = write("light", &light).expect("a record");
            assert_eq!(record.remove("name"), Some("light".into()));
            let back = read(record.clone()).expect("the light");
            match (&light, &back) {
                (LightSource::Area(a), LightSource::Area(b)) => {
                    assert!(a.direction().distance(b.direction()) < 1e-6);
                    assert!(a.sides()[0].distance(b.sides()[0]) < 1e-6);
                    assert_eq!((a.size, a.power), (b.size, b.power));
                }
                (LightSource::Spot(a), LightSource::Spot(b)) => {
                    assert!(a.direction().distance(b.direction()) < 1e-6);
                    let target = a.target;
                    assert_eq!(*a, Spot { target, ..*b });
                }
                (LightSource::Environment(a), LightSource::Environment(b)) => {
                    assert!(a.orientation().abs_diff_eq(b.orientation(), 1e-6));
                }
                _ => assert_eq!(light, back),
            }
            record.insert("watts".to_owned(), 5.into());
            let error = read(record).expect_err("a misspelt field").to_string();
            assert!(error.contains("watts"), "{error}");
        }
    }
}
