//! LIGHT on the command line and in edit files: the members of a light's JSON on one line.
//!
//! `KIND:FIRST,KEY=VALUE,…`, where FIRST is what a light of this kind cannot be without, and numbers of a value have commas between:
//! `env:FILE`, `point:X,Y,Z`, `area:X,Y,Z`, `spot:X,Y,Z`, `sun:X,Y,Z`. What is left out is as usual.

use super::{LightSource, LightSpec};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::fmt;
use std::str::FromStr;

/// What is written, the kind in JSON, and the key of what comes first.
const KINDS: [(&str, &str, &str); 5] = [
    ("env", "environment", "map"),
    ("point", "point", "position"),
    ("area", "area", "position"),
    ("spot", "spot", "position"),
    ("sun", "sun", "from"),
];

/// As [`FromStr`] reads it; what is as usual is left out.
impl fmt::Display for LightSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kinds = KINDS.into_iter().find(|(_, kind, _)| *kind == self.kind());
        let (written, kind, first) = kinds.ok_or(fmt::Error)?;
        // Paths that are no text are shown as far as they are.
        let named = self.clone().with_map(|file| file.display().to_string());
        let fields =
            |light: &LightSource<String>| serde_json::to_value(light).map_err(|_| fmt::Error);
        let all = fields(&named)?;
        let bare = [("kind", Value::from(kind)), (first, all[first].clone())];
        let bare = bare.map(|(key, value)| (key.to_owned(), value));
        let usual = LightSource::from_fields(Map::from_iter(bare)).map_err(|_| fmt::Error)?;
        let usual = fields(&usual)?;
        write!(f, "{written}:{}", Text(&all[first]))?;
        for (key, value) in all.as_object().into_iter().flatten() {
            if usual.get(key) != Some(value) {
                write!(f, ",{key}={}", Text(value))?;
            }
        }
        Ok(())
    }
}

/// A light in a file of edits: a line as on the command line, or the table of its fields.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum LightEntry {
    /// As [`LightSpec`] is read from text.
    Line(String),
    /// The members of its JSON.
    Fields(Map<String, Value>),
}

impl LightEntry {
    /// The light.
    ///
    /// # Errors
    /// Names the field and what was expected.
    pub fn light(&self) -> Result<LightSpec, String> {
        match self {
            Self::Line(text) => text.parse(),
            Self::Fields(fields) => checked(fields.clone()),
        }
    }
}

fn checked(fields: Map<String, Value>) -> Result<LightSpec, String> {
    let light = LightSpec::from_fields(fields).map_err(|e| e.to_string())?;
    light.check().map_err(|e| e.to_string())?;
    Ok(light)
}

/// A value of a light's JSON as it is written on the command line.
struct Text<'a>(&'a Value);

impl fmt::Display for Text<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Value::String(text) => f.write_str(text),
            // All numbers of lights are f32, which JSON's are wider than.
            Value::Number(v) => write!(f, "{}", v.as_f64().unwrap_or_default() as f32),
            Value::Array(values) => values.iter().enumerate().try_for_each(|(i, v)| {
                let comma = if i > 0 { "," } else { "" };
                write!(f, "{comma}{}", Text(v))
            }),
            other => write!(f, "{other}"),
        }
    }
}

impl FromStr for LightSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (kind, rest) = text.split_once(':').unwrap_or((text, ""));
        let known = KINDS.into_iter().find(|(written, ..)| *written == kind);
        let Some((_, kind, key)) = known else {
            let all = KINDS.map(|(written, ..)| format!("{written}:"));
            let expected = format!("expected a light that begins with {}", all.join(", "));
            return Err(format!("`{kind}`: {expected}"));
        };
        let (first, options) = split(rest);
        let first = match key {
            "map" if first.is_empty() => return Err(format!("`{text}`: expected env:FILE")),
            "map" => Value::from(first),
            _ => triple(key, first)?,
        };
        let mut fields = Map::new();
        fields.insert("kind".to_owned(), kind.into());
        fields.insert(key.to_owned(), first);
        for (key, value) in options {
            let value = match key {
                "color" => colour(key, value)?,
                _ => numbers(key, value)?,
            };
            if fields.insert(key.to_owned(), value).is_some() {
                return Err(format!("{key}: expected it once"));
            }
        }
        checked(fields)
    }
}

/// `a,b,key=v,w,key=x` into `a,b` and [(key, `v,w`), (key, x)].
fn split(text: &str) -> (&str, Vec<(&str, &str)>) {
    // A key starts after a comma; commas without a following `=` before the next comma belong to the value.
    let mut starts = vec![0];
    for (i, _) in text.match_indices(',') {
        let part = &text[i + 1..];
        if part.split(',').next().is_some_and(|p| p.contains('=')) {
            starts.push(i + 1);
        }
    }
    let end = |k: usize| starts.get(k + 1).map_or(text.len(), |s| s - 1);
    let parts: Vec<&str> = (0..starts.len())
        .map(|k| &text[starts[k]..end(k)])
        .collect();
    let options = parts[1..]
        .iter()
        .filter_map(|p| p.split_once('='))
        .collect();
    (parts[0], options)
}

/// One number, or several with commas between.
fn numbers(key: &str, text: &str) -> Result<Value, String> {
    let number = |part: &str| match part.trim().parse::<f32>() {
        Ok(v) if v.is_finite() => Ok(v),
        _ => Err(format!("{key}: expected a number, found `{part}`")),
    };
    let all: Vec<f32> = text.split(',').map(number).collect::<Result<_, _>>()?;
    Ok(match all.as_slice() {
        [one] => Value::from(*one),
        _ => Value::from(all),
    })
}

fn triple(key: &str, text: &str) -> Result<Value, String> {
    match numbers(key, text)? {
        Value::Array(values) if values.len() == 3 => Ok(values.into()),
        _ => Err(format!("{key}: expected three numbers, found `{text}`")),
    }
}

/// Shares of the power, from 0 to 1: larger ones are the 0 to 255 of other programs.
fn colour(key: &str, text: &str) -> Result<Value, String> {
    let colour = triple(key, text)?;
    let share = |c: &Value| c.as_f64().is_some_and(|c| (0.0..=1.0).contains(&c));
    if !colour.as_array().is_some_and(|c| c.iter().all(share)) {
        let expected = "expected three numbers from 0 to 1 (brighter light has more power)";
        return Err(format!("{key}: {expected}, found `{text}`"));
    }
    Ok(colour)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::light::{Environment, Spot};
    use glam::{Mat3, Vec3};

    #[test]
    fn the_grammar() {
        let spec: LightSpec = "env:a b.hdr,rotate=90,strength=2".parse().unwrap();
        let expected = Environment {
            rotate: 90.0,
            ..Environment::oriented("a b.hdr".into(), Mat3::IDENTITY, [2.0; 3])
        };
        assert_eq!(spec, LightSource::Environment(expected));
        let LightSource::Point(p) = "point:1,-2,3,power=50,color=1,0.5,0".parse().unwrap() else {
            panic!("a point light")
        };
        assert_eq!(
            (p.position, p.power, p.color),
            (Vec3::new(1., -2., 3.), 50.0, [1.0, 0.5, 0.0])
        );
        let LightSource::Area(a) = "area:0,0,4,size=2".parse().unwrap() else {
            panic!("an area light")
        };
        assert_eq!((a.size, a.power, a.direction()), (2.0, 1000.0, Vec3::NEG_Z));
        let LightSource::Spot(s) = "spot:0,0,4,angle=30".parse().unwrap() else {
            panic!("a spot light")
        };
        let usual = Spot::facing(Vec3::new(0.0, 0.0, 4.0), Vec3::ZERO, 1000.0);
        assert_eq!(
            s,
            Spot {
                angle: 30.0,
                ..usual
            }
        );
        let LightSource::Sun(s) = "sun:1,0,2,strength=3".parse().unwrap() else {
            panic!("a sun")
        };
        assert_eq!((s.from, s.strength), (Vec3::new(1.0, 0.0, 2.0), 3.0));
    }

    #[test]
    fn what_is_written_reads_back() {
        for text in [
            "env:a b.hdr,rotate=90.5,strength=0.25",
            "env:a.hdr,strength=1,0.5,0.1",
            "env:a.hdr,rotation=1,0,0,0,0,1,0,-1,0",
            "point:1,-2,3,power=50,color=1,0.5,0",
            "point:1,-2,3,radius=0.1",
            "area:0.5,0,4,target=0.5,0,3,size=2,power=7,color=1,1,0.2",
            "area:0.5,0,4,side=1,1,0",
            "spot:0.5,0,4,target=0.5,0,3,angle=30,blend=0,power=7,color=1,1,0.2,radius=0",
            "sun:1,-2,3,strength=4.5,angle=2,color=1,0.9,0.7",
        ] {
            let spec: LightSpec = text.parse().unwrap();
            assert_eq!(spec.to_string(), text);
        }
    }

    #[test]
    fn mistakes_are_named() {
        for (text, word) in [
            ("laser:1,2,3", "expected a light"),
            ("point:1,2", "three numbers"),
            ("point:1,2,3,colour=1,1,1", "unknown field `colour`"),
            ("point:1,2,3,position=1,2,3", "position: expected it once"),
            ("point:1,2,3,power=-5", "point.power: expected a positive"),
            ("area:1,2,3,size=big", "size: expected a number"),
            ("area:1,2,3,size=1,2,3", "area.size: invalid type"),
            ("env:", "env:FILE"),
            ("point:1,2,3,color=255,128,0", "from 0 to 1"),
            ("area:1,2,3,color=1,-1,0", "from 0 to 1"),
            ("area:1,2,3,target=1,2,3", "another place"),
            ("area:0,0,0", "another place"),
            ("point:nan,0,0", "expected a number"),
            ("spot:1,2,3,angle=270", "spot.angle: expected 1 to 180"),
            ("sun:0,0,0", "sun.from: expected a direction"),
            ("sun:0,0,1,power=5", "unknown field `power`"),
        ] {
            let error = text.parse::<LightSpec>().unwrap_err();
            assert!(error.contains(word), "{text}: {error}");
        }
    }
}
