//! LIGHT on the command line and in edit files, read and written:
//! `env:FILE[,rotate=DEG][,strength=S]`, `point:X,Y,Z[,power=W][,color=R,G,B]`,
//! `area:X,Y,Z[,target=X,Y,Z][,size=S][,power=W][,color=R,G,B]`.

use super::{Area, EnvMap, Environment, Light, Point};
use glam::Vec3;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

/// A light as it was written; its file is not read yet.
#[derive(Clone, Debug, PartialEq)]
pub enum LightSpec {
    /// `env:`
    Environment {
        /// Lat-long map.
        file: PathBuf,
        /// Degrees about +z, counter-clockwise from above.
        rotate: f32,
        /// Factor on the map's radiance.
        strength: f32,
    },
    /// `point:` or `area:`, complete as it is.
    Local(Light),
}

/// Watts of a local light that names none.
const DEFAULT_POWER: f32 = 1000.0;

impl LightSpec {
    /// Reads what there is to read; relative files are relative to `base`.
    ///
    /// # Errors
    /// If an environment map cannot be read or holds no light.
    pub fn open(&self, base: &Path) -> crate::Result<Light> {
        Ok(self.open_with_warnings(base)?.0)
    }

    /// [`LightSpec::open`], and what there is to say of the map, by its file.
    ///
    /// # Errors
    /// As [`LightSpec::open`].
    pub fn open_with_warnings(&self, base: &Path) -> crate::Result<(Light, Vec<String>)> {
        match self {
            Self::Local(light) => Ok((light.clone(), Vec::new())),
            Self::Environment {
                file,
                rotate,
                strength,
            } => {
                let (map, said) = EnvMap::read_with_warnings(base.join(file))?;
                let light = Environment::new(Arc::new(map), rotate.to_radians(), *strength);
                let place = file.display();
                let warnings = said.iter().map(|text| format!("{place}: {text}"));
                Ok((Light::Environment(light), warnings.collect()))
            }
        }
    }
}

/// As [`FromStr`] reads it. An area light's roll about its axis has no place in the grammar.
impl fmt::Display for LightSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let triple = |v: [f32; 3]| format!("{},{},{}", v[0], v[1], v[2]);
        match self {
            Self::Environment {
                file,
                rotate,
                strength,
            } => write!(
                f,
                "env:{},rotate={rotate},strength={strength}",
                file.display()
            ),
            Self::Local(Light::Point(l)) => write!(
                f,
                "point:{},power={},color={}",
                triple(l.position.into()),
                l.power,
                triple(l.color)
            ),
            Self::Local(Light::Area(l)) => write!(
                f,
                "area:{},target={},size={},power={},color={}",
                triple(l.position.into()),
                triple((l.position + l.direction).into()),
                l.size,
                l.power,
                triple(l.color)
            ),
            // Parsing never makes one: an environment without a file cannot be written down.
            Self::Local(Light::Environment(_)) => f.write_str("env:"),
        }
    }
}

impl FromStr for LightSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (kind, rest) = text.split_once(':').unwrap_or((text, ""));
        let (first, options) = split(rest);
        match kind {
            "env" => {
                if first.is_empty() {
                    return Err(format!("`{text}`: expected env:FILE"));
                }
                let mut light = (0.0, 1.0);
                for (key, value) in options {
                    match key {
                        "rotate" => light.0 = number(key, value)?,
                        "strength" => light.1 = number(key, value)?,
                        _ => return Err(unknown(key, "rotate, strength")),
                    }
                }
                let (rotate, strength) = light;
                Ok(Self::Environment {
                    file: first.into(),
                    rotate,
                    strength,
                })
            }
            "point" => {
                let mut light = Point::new(vector("position", first)?, DEFAULT_POWER);
                for (key, value) in options {
                    match key {
                        "power" => light.power = number(key, value)?,
                        "color" => light.color = colour(key, value)?,
                        _ => return Err(unknown(key, "power, color")),
                    }
                }
                Ok(Self::Local(Light::Point(light)))
            }
            "area" => {
                let position = vector("position", first)?;
                let (mut target, mut size, mut power) = (Vec3::ZERO, 1.0, DEFAULT_POWER);
                let mut color = [1.0; 3];
                for (key, value) in options {
                    match key {
                        "target" => target = vector(key, value)?,
                        "size" => size = number(key, value)?,
                        "power" => power = number(key, value)?,
                        "color" => color = colour(key, value)?,
                        _ => return Err(unknown(key, "target, size, power, color")),
                    }
                }
                if target == position {
                    return Err(format!(
                        "target: expected another place than the light's own, found `{first}`"
                    ));
                }
                let light = Area {
                    color,
                    ..Area::facing(position, target, size, power)
                };
                Ok(Self::Local(Light::Area(light)))
            }
            _ => Err(format!(
                "`{kind}`: expected a light that begins with env:, point: or area:"
            )),
        }
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

fn unknown(key: &str, known: &str) -> String {
    format!("unknown key `{key}`: expected {known}")
}

fn number(key: &str, text: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(v) if v.is_finite() => Ok(v),
        _ => Err(format!("{key}: expected a number, found `{text}`")),
    }
}

fn vector(key: &str, text: &str) -> Result<Vec3, String> {
    let parts: Vec<f32> = text
        .split(',')
        .map(|p| number(key, p))
        .collect::<Result<_, _>>()?;
    match parts.as_slice() {
        &[x, y, z] => Ok(Vec3::new(x, y, z)),
        _ => Err(format!("{key}: expected three numbers, found `{text}`")),
    }
}

/// Shares of the power, from 0 to 1: larger ones are the 0 to 255 of other programs.
fn colour(key: &str, text: &str) -> Result<[f32; 3], String> {
    let colour: [f32; 3] = vector(key, text)?.into();
    if colour.iter().any(|c| !(0.0..=1.0).contains(c)) {
        let expected = "expected three numbers from 0 to 1 (brighter light has more power)";
        return Err(format!("{key}: {expected}, found `{text}`"));
    }
    Ok(colour)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_grammar() {
        let spec: LightSpec = "env:a b.hdr,rotate=90,strength=2".parse().unwrap();
        let expected = LightSpec::Environment {
            file: "a b.hdr".into(),
            rotate: 90.0,
            strength: 2.0,
        };
        assert_eq!(spec, expected);
        let LightSpec::Local(Light::Point(p)) =
            "point:1,-2,3,power=50,color=1,0.5,0".parse().unwrap()
        else {
            panic!("a point light")
        };
        assert_eq!(
            (p.position, p.power, p.color),
            (Vec3::new(1., -2., 3.), 50.0, [1.0, 0.5, 0.0])
        );
        let LightSpec::Local(Light::Area(a)) = "area:0,0,4,size=2".parse().unwrap() else {
            panic!("an area light")
        };
        assert_eq!((a.size, a.power, a.direction), (2.0, 1000.0, Vec3::NEG_Z));
    }

    #[test]
    fn what_is_written_reads_back() {
        for text in [
            "env:a b.hdr,rotate=90.5,strength=0.25",
            "point:1,-2,3,power=50,color=1,0.5,0",
            "area:0.5,0,4,target=0.5,0,3,size=2,power=7,color=1,1,0.2",
        ] {
            let spec: LightSpec = text.parse().unwrap();
            assert_eq!(spec.to_string(), text);
        }
    }

    #[test]
    fn mistakes_are_named() {
        for (text, word) in [
            ("spot:1,2,3", "expected a light"),
            ("point:1,2", "three numbers"),
            ("point:1,2,3,colour=1,1,1", "unknown key `colour`"),
            ("area:1,2,3,size=big", "size: expected a number"),
            ("env:", "env:FILE"),
            ("point:1,2,3,color=255,128,0", "from 0 to 1"),
            ("area:1,2,3,color=1,-1,0", "from 0 to 1"),
            ("area:1,2,3,target=1,2,3", "another place"),
            ("area:0,0,0", "another place"),
            ("point:nan,0,0", "expected a number"),
        ] {
            let error = text.parse::<LightSpec>().unwrap_err();
            assert!(error.contains(word), "{text}: {error}");
        }
    }
}
