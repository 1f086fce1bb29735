//! What a person takes away: pictures, a turntable, and the edits for `lumi relight`.

use crate::camera::OrbitCamera;
use crate::engine::Engine;
use crate::form;
use crate::limits::{EXPORT_SIDE, TURNTABLE_FRAMES};
use crate::look::{Look, Tone};
use crate::maps::{MapEntry, Maps};
use crate::session::Session;
use crate::tree::NodeId;
use crate::{Error, Result};
use lumi_core::DisplayImage;
use lumi_core::fs::atomic_write;
use lumi_core::image::{encode_exr, encode_gif, encode_png, encode_png_with_alpha, enlarged};
use lumi_core::light::LightEntry;
use lumi_model::{EditEntry, EditsFile, Mode};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::json;
use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A file to download.
pub struct Download {
    /// Its name.
    pub name: String,
    /// Its media type.
    pub mime: &'static str,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// What a picture should be.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PictureQuery {
    /// Radians from +x, counter-clockwise from above.
    pub azimuth: f32,
    /// Radians above the horizon, within ±π/2.
    pub elevation: f32,
    /// Radii of the scene's ball from its centre, 1.05 to 20.
    pub distance: f32,
    /// Field of view in radians, 0.1 to 2.5.
    pub fov: f32,
    /// Side in pixels; the model's own if absent.
    #[schemars(range(min = 1, max = EXPORT_SIDE))]
    pub size: Option<usize>,
    /// Frames of a turntable.
    #[schemars(range(min = 2, max = TURNTABLE_FRAMES))]
    pub frames: Option<usize>,
    /// In stops, −10 to 10: each one doubles the radiance.
    #[serde(default)]
    pub exposure: f32,
    /// What becomes of bright radiance.
    #[serde(default)]
    pub tone: Tone,
    /// Whether a PNG keeps alpha, instead of white behind the object.
    #[serde(default)]
    pub alpha: bool,
}

impl PictureQuery {
    fn camera(&self) -> OrbitCamera {
        OrbitCamera {
            azimuth: self.azimuth,
            elevation: self.elevation,
            distance: self.distance,
            fov: self.fov,
        }
    }

    fn look(&self) -> Result<Look> {
        let look = Look {
            exposure: self.exposure,
            tone: self.tone,
        };
        look.check().map(|()| look)
    }

    fn size(&self, side: usize) -> Result<usize> {
        let size = self.size.unwrap_or(side);
        if (1..=EXPORT_SIDE).contains(&size) {
            return Ok(size);
        }
        let text = format!("size: expected 1 to {EXPORT_SIDE} pixels, found {size}");
        Err(Error::Invalid(text))
    }
}

/// Where a command line looks from: a whole camera, or nothing of one.
#[derive(Default, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ViewQuery {
    azimuth: Option<f32>,
    elevation: Option<f32>,
    distance: Option<f32>,
    fov: Option<f32>,
}

impl ViewQuery {
    fn camera(&self) -> Result<Option<OrbitCamera>> {
        let all = [self.azimuth, self.elevation, self.distance, self.fov];
        match all {
            [Some(azimuth), Some(elevation), Some(distance), Some(fov)] => Ok(Some(OrbitCamera {
                azimuth,
                elevation,
                distance,
                fov,
            })),
            _ if all.iter().all(Option::is_none) => Ok(None),
            _ => Err(Error::Invalid(
                "camera: expected azimuth, elevation, distance and fov, or none of them".into(),
            )),
        }
    }
}

/// One picture of a step: `png` as it is shown, `exr` its radiance with alpha, at the model's size and without a look.
///
/// # Errors
/// On an unknown step or format, and a camera or size out of range.
pub async fn picture(
    session: &Session,
    engine: &Arc<Engine>,
    id: NodeId,
    format: &str,
    query: &PictureQuery,
) -> Result<Download> {
    let size = query.size(engine.side())?;
    let tokens = Arc::clone(&session.tree().get(id)?.tokens);
    let to_model = &session.capture.to_model;
    let look = query.look()?;
    let frame = engine.render(tokens, to_model, query.camera(), engine.side(), look);
    let frame = frame.await?;
    let image = || match size == engine.side() {
        true => frame.image.clone(),
        false => enlarged(&frame.image, size),
    };
    let (mime, bytes) = match format {
        "png" if query.alpha => ("image/png", encode_png_with_alpha(&image())?),
        "png" => ("image/png", encode_png(&image())?),
        "exr" => ("image/x-exr", encode_exr(&frame.radiance)?),
        other => {
            let text = format!("format: expected png or exr, found `{other}`");
            return Err(Error::NotFound(text));
        }
    };
    let name = format!("{}-step{id}.{format}", plain(&session.capture.name));
    Ok(Download { name, mime, bytes })
}

/// A turntable of a step as an endless GIF.
///
/// # Errors
/// As [`picture`], and on too many frames.
pub async fn turntable(
    session: &Session,
    engine: &Arc<Engine>,
    id: NodeId,
    query: &PictureQuery,
) -> Result<Download> {
    let frames = query.frames.unwrap_or(48);
    if !(2..=TURNTABLE_FRAMES).contains(&frames) {
        let text = format!("frames: expected 2 to {TURNTABLE_FRAMES}, found {frames}");
        return Err(Error::Invalid(text));
    }
    let size = query.size(320)?.min(640);
    let look = query.look()?;
    let first = query.camera();
    let around = |i: usize| OrbitCamera {
        azimuth: first.azimuth + std::f32::consts::TAU * i as f32 / frames as f32,
        ..first
    };
    let tokens = Arc::clone(&session.tree().get(id)?.tokens);
    let mut images: Vec<DisplayImage> = Vec::with_capacity(frames);
    // A few at a time, so that others' frames come in between.
    for start in (0..frames).step_by(8) {
        let cameras = (start..frames.min(start + 8)).map(around).collect();
        let to_model = &session.capture.to_model;
        let part = engine.render_all(Arc::clone(&tokens), to_model, cameras, engine.side());
        images.extend(part.await?.0.iter().map(|radiance| look.shown(radiance)));
    }
    let encode = move || encode_gif(&images, size, 16);
    let bytes = tokio::task::spawn_blocking(encode).await??;
    Ok(Download {
        name: format!("{}-step{id}-turntable.gif", plain(&session.capture.name)),
        mime: "image/gif",
        bytes,
    })
}

/// The edits that lead to a step, as `lumi relight --edits` reads them: `edits.toml`, or a zip of it and the maps
/// that have no file on this machine.
///
/// # Errors
/// On an unknown step.
pub fn edits(session: &Session, maps: &Maps, id: NodeId) -> Result<Download> {
    let mut carried = Carried::into("maps".into());
    let mut file = EditsFile::default();
    for (mode, lights) in written(session, maps, id, &mut carried)? {
        let lights = lights.into_iter().map(LightEntry::Line).collect();
        file.edit.push(EditEntry { mode, lights });
    }
    let toml = file.to_toml()?.into_bytes();
    let name = plain(&session.capture.name);
    if carried.maps.is_empty() {
        return Ok(Download {
            name: "edits.toml".into(),
            mime: "application/toml",
            bytes: toml,
        });
    }
    let failed = |e: String| Error::Internal(format!("zip: {e}"));
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let mut put = |path: &str, bytes: &[u8]| -> Result<()> {
        let options = zip::write::SimpleFileOptions::default();
        zip.start_file(path, options)
            .map_err(|e| failed(e.to_string()))?;
        zip.write_all(bytes).map_err(|e| failed(e.to_string()))
    };
    put("edits.toml", &toml)?;
    for (file, entry) in &carried.maps {
        put(&format!("maps/{file}"), &encode_exr(&entry.map.to_image())?)?;
    }
    let bytes = zip
        .finish()
        .map_err(|e| failed(e.to_string()))?
        .into_inner();
    Ok(Download {
        name: format!("{name}-edits.zip"),
        mime: "application/zip",
        bytes,
    })
}

/// The command line that makes the same step, and the same picture if `view` names a camera. It runs as it is on this machine: maps
/// without a file get one in `folder`.
///
/// # Errors
/// On an unknown step, half a camera, and if a map cannot be written.
pub fn command(
    session: &Session,
    engine: &Engine,
    maps: (&Maps, &Path),
    model: Option<&str>,
    (id, view): (NodeId, &ViewQuery),
) -> Result<String> {
    let (maps, folder) = maps;
    let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    let source = &session.capture.source;
    let scene = source.path.as_deref().unwrap_or(&session.capture.name);
    let mut words = vec![
        "lumi relight".to_owned(),
        quoted(scene),
        format!("--inputs {}", source.inputs),
    ];
    if let Some(light) = &source.light {
        words.push(format!("--source {}", quoted(light)));
    }
    if let Some(model) = model {
        let path = std::path::absolute(model).unwrap_or_else(|_| model.into());
        words.push(format!("--model {}", quoted(&path.display().to_string())));
    }
    let config = &engine.model().config;
    if config.reprojection {
        words.push(format!("--detail {}", engine.side() / config.resolution));
    }
    let mut carried = Carried::into(folder);
    for (mode, lights) in written(session, maps, id, &mut carried)? {
        let lights: Vec<String> = lights.iter().map(|l| quoted(l)).collect();
        let mode = json!(mode);
        let mode = mode.as_str().unwrap_or_default().to_owned();
        words.push(format!("--{mode} {}", lights.join(" ")));
    }
    carried.write()?;
    let name = format!("{}-step{id}", plain(&session.capture.name));
    let place = match source.path {
        Some(_) => "",
        None => "# The capture was uploaded: run this where its folder lies.\n",
    };
    let Some(camera) = view.camera()? else {
        words.push(format!("--views orbit:24 --out {name}"));
        return Ok(format!("{place}{}", words.join(" \\\n  ")));
    };
    let camera = camera.camera(&session.capture.to_model, engine.side())?;
    let camera = serde_json::to_string(&camera).map_err(|e| Error::Internal(e.to_string()))?;
    words.push(format!("--views {name}.json --out {name}"));
    Ok(format!(
        "{place}cat > {name}.json <<'END'\n[{{\"name\": \"view\", \"camera\": {camera}}}]\nEND\n{}",
        words.join(" \\\n  ")
    ))
}

/// Maps that have no file on this machine and need one, by its name in a folder.
struct Carried {
    folder: PathBuf,
    maps: BTreeMap<String, Arc<MapEntry>>,
}

impl Carried {
    fn into(folder: PathBuf) -> Self {
        let maps = BTreeMap::new();
        Self { folder, maps }
    }

    /// The map's own file, or the one that will be carried.
    fn file(&mut self, entry: Arc<MapEntry>) -> PathBuf {
        if let Some(file) = &entry.file {
            return file.clone();
        }
        let name = format!("{}-{}.exr", plain(&entry.name), &entry.id[..6]);
        let file = self.folder.join(&name);
        self.maps.insert(name, entry);
        file
    }

    /// Writes the files that are not there yet; their names hold the fingerprint of what is in them.
    fn write(&self) -> Result<()> {
        for (name, entry) in &self.maps {
            let file = self.folder.join(name);
            if !file.is_file() {
                let failed = |e| lumi_core::Error::io(&self.folder, e);
                std::fs::create_dir_all(&self.folder).map_err(failed)?;
                atomic_write(file, &encode_exr(&entry.map.to_image())?)?;
            }
        }
        Ok(())
    }
}

/// Mode and lights of every edit on the way to a step, in the grammar of the command line.
fn written(
    session: &Session,
    maps: &Maps,
    id: NodeId,
    carried: &mut Carried,
) -> Result<Vec<(Mode, Vec<String>)>> {
    let tree = session.tree();
    let mut edits = Vec::new();
    for edit in tree.path(id)?.iter().filter_map(|n| n.edit.as_ref()) {
        let mut lights = Vec::new();
        for light in &edit.lights {
            let spec = form::spec(light, maps, |map| carried.file(map))?;
            lights.push(spec.to_string());
        }
        edits.push((edit.mode, lights));
    }
    Ok(edits)
}

/// A name that is safe in file names and headers.
fn plain(name: &str) -> String {
    let keep = |c: char| {
        if c.is_ascii_alphanumeric() {
            c.to_ascii_lowercase()
        } else {
            '-'
        }
    };
    let name: String = name.chars().take(40).map(keep).collect();
    let name = name.trim_matches('-').to_owned();
    if name.is_empty() {
        "scene".into()
    } else {
        name
    }
}

/// A word as a POSIX shell reads it.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-:,=+".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}
