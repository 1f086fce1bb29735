//! From a scene of a split to a [`Scene`].

use super::{FrameRecord, SceneFile, light};
use crate::formats::Opening;
use crate::formats::photo::{self, Bounds, Encoding, Intrinsics, Shot, Stage, Up, usual_role};
use crate::json;
use lumi_core::fs::read_bytes;
use lumi_core::{Error, NamedLight, Result, Role, Scene};
use std::path::{Path, PathBuf};

/// Most names that a message lists.
const LISTED: usize = 8;

/// Whether `path` is a scene's metadata file, or a split's folder.
#[must_use]
pub fn detect(path: &Path) -> bool {
    if path.is_file() {
        let folder = path.parent().and_then(Path::file_name);
        return path.extension().is_some_and(|e| e == "json")
            && folder.is_some_and(|f| f == "metadata");
    }
    path.join("metadata").is_dir() && path.join("images").is_dir()
}

/// Reads the photographs and the light of one scene.
///
/// # Errors
/// Lists the scenes of a split that holds several; names the file and the frame or field that is wrong.
pub fn open(path: &Path, opening: &Opening) -> Result<Scene> {
    let metadata = scene_file(path)?;
    let split = metadata.parent().and_then(Path::parent);
    let split = split.unwrap_or(Path::new("."));
    let file: SceneFile = json::read(&metadata)?;
    // The name becomes part of paths.
    if file.scene_name.is_empty() || file.scene_name.contains(['/', '\\', '\0']) {
        let expected = format!("expected a plain name, found `{}`", file.scene_name);
        return Err(Error::invalid(&metadata, "scene_name", expected));
    }
    let mut shots = Vec::with_capacity(file.frames.len());
    for (i, frame) in file.frames.iter().enumerate() {
        let place = format!("frames[{i}]");
        let shot = shot(split, &file.scene_name, frame);
        let mut shot = shot.map_err(|e| e.within(&place).at(&metadata))?;
        shot.role = usual_role(i, file.frames.len());
        shot.place = place;
        shots.push(shot);
    }
    if let Some(first) = shots.first() {
        let lights = lights(split, &file.scene_name, first)?;
        for shot in &mut shots {
            shot.lit_by.clone_from(&lights);
        }
    }
    let stage = Stage {
        up: Up::Z,
        bounds: Bounds::Unknown,
        opening,
        warnings: Vec::new(),
    };
    let mut scene = photo::scene(split, &metadata, shots, stage)?;
    scene.name = file.scene_name;
    Ok(scene)
}

/// The metadata file that `path` means.
fn scene_file(path: &Path) -> Result<PathBuf> {
    if path.is_file() {
        return Ok(path.to_owned());
    }
    let folder = path.join("metadata");
    let mut files = Vec::new();
    for entry in std::fs::read_dir(&folder).map_err(|e| Error::io(&folder, e))? {
        let file = entry.map_err(|e| Error::io(&folder, e))?.path();
        if file.extension().is_some_and(|e| e == "json") {
            files.push(file);
        }
    }
    files.sort();
    match files.len() {
        1 => Ok(files.remove(0)),
        0 => Err(Error::invalid(folder, "scenes", "expected at least one")),
        n => {
            let name = |f: &PathBuf| format!("`{}`", f.display());
            let listed: Vec<_> = files.iter().take(LISTED).map(name).collect();
            let expected = format!(
                "expected one scene, found {n}; open one of them: {}{}",
                listed.join(", "),
                if n > LISTED { " …" } else { "" }
            );
            Err(Error::invalid(folder, "scenes", expected))
        }
    }
}

fn shot(split: &Path, scene: &str, frame: &FrameRecord) -> Result<Shot> {
    // The machine that wrote the path may have had `\` in it.
    let stored = PathBuf::from(frame.image_path.replace('\\', "/"));
    let Some(name) = stored.file_name() else {
        let expected = format!(
            "expected the path of an image, found `{}`",
            frame.image_path
        );
        return Err(Error::value("image_path", expected));
    };
    // Paths are absolute on the machine that wrote them; the split may have moved since.
    let moved = split.join("images").join(scene).join(name);
    let image = if moved.is_file() {
        moved
    } else {
        stored.clone()
    };
    let [fx, fy, cx, cy] = frame.fxfycxcy;
    Ok(Shot {
        place: String::new(),
        path: name.to_string_lossy().into_owned(),
        role: Role::Input,
        image,
        mask: None,
        intrinsics: Intrinsics {
            focal: [Some(fx), Some(fy)],
            centre: [Some(cx), Some(cy)],
            ..Intrinsics::default()
        },
        pose: json::matrix(&frame.w2c).inverse(),
        encoding: Encoding::Srgb,
        lit_by: Vec::new(),
    })
}

/// The scene's lights, the same for all frames: what its first frame's maps and its light rays say.
fn lights(split: &Path, scene: &str, first: &Shot) -> Result<Vec<NamedLight>> {
    let mut lights = Vec::new();
    let stem = Path::new(&first.path).file_stem().unwrap_or_default();
    let map = |kind: &str| {
        let file = format!("{}_{kind}.png", stem.to_string_lossy());
        split.join("envmaps").join(scene).join(file)
    };
    let (ldr, hdr) = (map("ldr"), map("hdr"));
    if ldr.is_file() || hdr.is_file() {
        lights.push(light::environment("env", &ldr, &hdr, &first.pose)?);
    }
    let rays = split.join("point_light_rays").join(format!("{scene}.npy"));
    if rays.is_file() {
        let local = super::local_lights(&read_bytes(&rays)?);
        lights.extend(local.map_err(|e| e.at(&rays))?);
    }
    Ok(lights)
}
