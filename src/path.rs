//! A path: keys of a camera and of lights, and the frames between them.

use crate::edits;
use anyhow::{Context, Result, bail};
use lumi_core::glam::{Quat, Vec3};
use lumi_core::light::LightSpec;
use lumi_core::{Area, Camera, Environment, Light, Point, Scene, Spot, Sun};
use lumi_data::Orbit;
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A path's file (docs/capture.md).
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    /// Pictures from the first key to the last.
    frames: usize,
    key: Vec<Key>,
}

/// Camera and lights at one place of the path.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Key {
    /// Share of the path's time, in [0, 1]; keys without are spread evenly.
    at: Option<f32>,
    #[serde(default)]
    camera: KeyCamera,
    /// Replace all light; either all keys have as many, or none has any.
    #[serde(default)]
    lights: Vec<String>,
}

/// A camera that looks at the scene's centre: degrees, and radii of the scene's ball. What is left out is the mean of the capture's
/// own cameras, and 0 for the azimuth.
#[derive(Clone, Copy, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct KeyCamera {
    azimuth: Option<f32>,
    elevation: Option<f32>,
    distance: Option<f32>,
    fov: Option<f32>,
}

/// One picture of a path.
pub struct Frame {
    /// In world space.
    pub camera: Camera,
    /// All light of this frame, in world space; none if the path is the camera's alone.
    pub lights: Vec<Light>,
}

/// Most pictures of a path.
const FRAMES: usize = 10_000;

/// The frames of a path's file around a scene, square at `side` pixels.
///
/// # Errors
/// If the file cannot be read, names no path, or lights of its keys do not go together; with the file, the key and the field.
pub fn frames(path: &Path, scene: &Scene, side: usize) -> Result<Vec<Frame>> {
    let place = || format!("--views {}", path.display());
    let text = std::fs::read_to_string(path).with_context(place)?;
    let file: File = toml::from_str(&text).with_context(place)?;
    if !(2..=FRAMES).contains(&file.frames) || file.key.len() < 2 {
        bail!(
            "{}: expected 2 to {FRAMES} frames and 2 keys at least, found {} and {}",
            place(),
            file.frames,
            file.key.len()
        );
    }
    let times = times(&file.key).with_context(place)?;
    let base = path.parent().unwrap_or(Path::new(""));
    let usual = Orbit::of(scene);
    let mut keys = Vec::new();
    for (i, key) in file.key.iter().enumerate() {
        let place = || format!("{}: key[{i}]", place());
        let orbit = orbit(key.camera, &usual).with_context(place)?;
        keys.push((orbit, lights(&key.lights, base).with_context(place)?));
    }
    let to_world = scene.to_model.inverse();
    let centre = to_world.point(Vec3::ZERO);
    let frame = |n: usize| -> Result<Frame> {
        let t = n as f32 / (file.frames - 1) as f32;
        let next = times.partition_point(|time| *time <= t).min(keys.len() - 1);
        let before = next.max(1) - 1;
        let span = times[next] - times[before];
        let share = if span > 0.0 {
            ((t - times[before]) / span).clamp(0.0, 1.0)
        } else {
            1.0
        };
        let ((a, from), (b, to)) = (&keys[before], &keys[next]);
        let [azimuth, elevation, distance, fov] = std::array::from_fn(|i| mixed(a[i], b[i], share));
        let camera = Camera::orbit(azimuth, elevation, distance, fov, side);
        let lights = between(from, to, share, centre);
        Ok(Frame {
            camera: camera.transformed(&to_world),
            lights: lights.with_context(|| format!("{}: key[{next}]", place()))?,
        })
    };
    (0..file.frames).map(frame).collect()
}

/// When each key is reached, rising from 0 to 1.
fn times(keys: &[Key]) -> Result<Vec<f32>> {
    let even = |i: usize| i as f32 / (keys.len() - 1) as f32;
    let times = keys.iter().enumerate();
    let times: Vec<f32> = times.map(|(i, key)| key.at.unwrap_or(even(i))).collect();
    let rising = times.windows(2).all(|pair| pair[0] < pair[1]);
    if times[0] != 0.0 || times[times.len() - 1] != 1.0 || !rising {
        bail!("key.at: expected numbers that rise from 0 to 1, found {times:?}");
    }
    Ok(times)
}

/// Azimuth, elevation and field of view in radians, with the distance between the last two.
fn orbit(key: KeyCamera, usual: &Orbit) -> Result<[f32; 4]> {
    let within = |name: &str, value: Option<f32>, usual: f32, [low, high]: [f32; 2]| {
        let value = value.unwrap_or(usual);
        if !(low..=high).contains(&value) {
            bail!("camera.{name}: expected {low} to {high}, found {value}");
        }
        Ok(value)
    };
    let degrees = f32::to_degrees;
    Ok([
        within("azimuth", key.azimuth, 0.0, [-36e3, 36e3])?.to_radians(),
        within(
            "elevation",
            key.elevation,
            degrees(usual.elevation),
            [-90.0, 90.0],
        )?
        .to_radians(),
        within("distance", key.distance, usual.distance, [1.05, 20.0])?,
        within("fov", key.fov, degrees(usual.fov), [6.0, 140.0])?.to_radians(),
    ])
}

/// A key's light, and the file of an environment's map.
type KeyLight = (Light, Option<PathBuf>);

fn lights(written: &[String], base: &Path) -> Result<Vec<KeyLight>> {
    let one = |text: &String| -> Result<KeyLight> {
        let spec: LightSpec = text.parse().map_err(anyhow::Error::msg)?;
        let spec = spec.with_map(|file| base.join(file));
        let light = edits::open(std::slice::from_ref(&spec))?.remove(0);
        Ok((light, spec.map().cloned()))
    };
    let one = |(i, text): (usize, &String)| one(text).with_context(|| format!("lights[{i}]"));
    written.iter().enumerate().map(one).collect()
}

/// All light at a share of the way between two keys. Lamps go around the scene's centre, not through it.
fn between(from: &[KeyLight], to: &[KeyLight], share: f32, centre: Vec3) -> Result<Vec<Light>> {
    if from.len() != to.len() {
        let (a, b) = (to.len(), from.len());
        bail!("lights: expected as many as in the key before, {b}, found {a}");
    }
    let mut all = Vec::new();
    for (i, (from, to)) in from.iter().zip(to).enumerate() {
        match (from, to) {
            ((Light::Environment(a), one), (Light::Environment(b), other)) => {
                all.extend(skies(a, b, one == other, share));
            }
            ((Light::Point(a), _), (Light::Point(b), _)) => {
                let mut point = Point::new(
                    around(a.position, b.position, share, centre),
                    mixed(a.power, b.power, share),
                );
                point.color = colour(a.color, b.color, share);
                all.push(Light::Point(point));
            }
            ((Light::Area(a), _), (Light::Area(b), _)) => {
                let mut area = Area::facing(
                    around(a.position, b.position, share, centre),
                    a.target.lerp(b.target, share),
                    mixed(a.size, b.size, share),
                    mixed(a.power, b.power, share),
                );
                area.color = colour(a.color, b.color, share);
                all.push(Light::Area(area));
            }
            ((Light::Spot(a), _), (Light::Spot(b), _)) => all.push(Light::Spot(Spot {
                position: around(a.position, b.position, share, centre),
                target: a.target.lerp(b.target, share),
                angle: mixed(a.angle, b.angle, share),
                blend: mixed(a.blend, b.blend, share),
                power: mixed(a.power, b.power, share),
                color: colour(a.color, b.color, share),
                radius: mixed(a.radius, b.radius, share),
            })),
            ((Light::Sun(a), _), (Light::Sun(b), _)) => all.push(Light::Sun(Sun {
                from: around(a.toward(), b.toward(), share, Vec3::ZERO),
                strength: mixed(a.strength, b.strength, share),
                angle: mixed(a.angle, b.angle, share),
                color: colour(a.color, b.color, share),
            })),
            ((a, _), (b, _)) => bail!(
                "lights[{i}]: expected the kind that it has in the key before, {}, found {}",
                a.kind(),
                b.kind()
            ),
        }
    }
    Ok(all)
}

/// One map that turns, or two of which one fades into the other.
fn skies(a: &Environment, b: &Environment, same: bool, share: f32) -> Vec<Light> {
    let fade = |map: &Environment, by: f32| {
        let map = Light::Environment(map.clone());
        (by > 0.0).then(|| map.scaled([by; 3]))
    };
    if same && a.rotation == b.rotation {
        return vec![Light::Environment(Environment {
            map: Arc::clone(&a.map),
            rotate: mixed(a.rotate, b.rotate, share),
            rotation: a.rotation,
            strength: colour(a.strength, b.strength, share),
        })];
    }
    let both = [fade(a, 1.0 - share), fade(b, share)];
    both.into_iter().flatten().collect()
}

fn mixed(a: f32, b: f32, share: f32) -> f32 {
    a + (b - a) * share
}

fn colour(a: [f32; 3], b: [f32; 3], share: f32) -> [f32; 3] {
    std::array::from_fn(|c| mixed(a[c], b[c], share))
}

/// Between two places by the angle around a centre and the distance from it.
fn around(a: Vec3, b: Vec3, share: f32, centre: Vec3) -> Vec3 {
    let (a, b) = (a - centre, b - centre);
    let (from, to) = (a.normalize_or(Vec3::Z), b.normalize_or(Vec3::Z));
    let turn = Quat::IDENTITY.slerp(Quat::from_rotation_arc(from, to), share);
    centre + turn * from * mixed(a.length(), b.length(), share)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lamp(x: f32, power: f32) -> KeyLight {
        (
            Light::Point(Point::new(Vec3::new(x, 0.0, 0.0), power)),
            None,
        )
    }

    #[test]
    fn a_lamp_goes_around_the_scene_at_its_distance() {
        let (from, to) = ([lamp(3.0, 100.0)], [lamp(-5.0, 300.0)]);
        for share in [0.0, 0.3, 0.5, 1.0] {
            let lights = between(&from, &to, share, Vec3::ZERO).expect("lights");
            let Light::Point(point) = &lights[0] else {
                panic!("a point light");
            };
            assert!((point.position.length() - (3.0 + 2.0 * share)).abs() < 1e-4);
            assert!((point.power - (100.0 + 200.0 * share)).abs() < 1e-3);
        }
        let end = between(&from, &to, 1.0, Vec3::ZERO).expect("lights");
        let Light::Point(point) = &end[0] else {
            panic!("a point light");
        };
        assert!(point.position.distance(Vec3::new(-5.0, 0.0, 0.0)) < 1e-4);
    }

    #[test]
    fn spots_and_suns_go_their_ways() {
        let spot = |x: f32, angle: f32| {
            let target = Vec3::new(0.0, 0.0, x / 10.0);
            let spot = Spot::facing(Vec3::new(x, 0.0, 0.0), target, 100.0);
            (Light::Spot(Spot { angle, ..spot }), None)
        };
        let half = between(&[spot(3.0, 20.0)], &[spot(-5.0, 40.0)], 0.5, Vec3::ZERO);
        let Light::Spot(half) = half.expect("lights")[0] else {
            panic!("a spot light");
        };
        assert!((half.position.length() - 4.0).abs() < 1e-4);
        assert!((half.angle - 30.0).abs() < 1e-4 && half.target.distance(-0.1 * Vec3::Z) < 1e-5);
        let sun = |from: Vec3| (Light::Sun(Sun::new(from, 3.0)), None);
        let half = between(
            &[sun(2.0 * Vec3::Z)],
            &[sun(Vec3::X)],
            0.5,
            Vec3::splat(9.0),
        );
        let Light::Sun(half) = half.expect("lights")[0] else {
            panic!("a sun");
        };
        let between = (Vec3::X + Vec3::Z).normalize();
        assert!(half.toward().distance(between) < 1e-5, "{}", half.from);
    }

    #[test]
    fn lights_that_do_not_go_together_are_named() {
        let area = Area::facing(Vec3::X * 3.0, Vec3::ZERO, 1.0, 100.0);
        let error = |to: &[KeyLight]| {
            let failed = between(&[lamp(3.0, 1.0)], to, 0.5, Vec3::ZERO);
            failed.expect_err("an error").to_string()
        };
        assert!(error(&[]).contains("as many"));
        let kind = error(&[(Light::Area(area), None)]);
        assert!(
            kind.contains("lights[0]") && kind.contains("point"),
            "{kind}"
        );
    }
}
