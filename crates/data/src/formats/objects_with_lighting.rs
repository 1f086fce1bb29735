//! Objects With Lighting (Ummenhofer et al. 2024) as published: `dataset/OBJECT/test`.
//!
//! * Inputs: `inputs/image_NNNN.png`, `camera_NNNN.txt`, `mask_NNNN.png`, `exposure.txt` and
//!   `object_bounding_box.txt` (xmin xmax ymin ymax zmin zmax).
//! * Held out: `gt_image_NNNN.png`, `gt_camera_NNNN.txt`, `gt_mask_NNNN.png`, `gt_exposure_NNNN.txt`, each in
//!   an environment of its own.
//! * Cameras: rows of K (3), R (3), t (1) and `width height channels`, x = K (R X + t), OpenCV axes.
//! * Images hold 255 (x 2^exposure)^(1/2.2); they become sRGB here. Lights are scaled by 2^exposure, so
//!   that light and photograph fit.
//! * Environment maps (`env.hdr` of the inputs, `gt_env_NNNN.hdr`) are laid out as ours (+z up, +x in the
//!   middle, +y at a quarter) in a frame of their own; `world_to_env.txt` and `gt_world_to_env_NNNN.txt`
//!   turn the world into it. `gt_env_512_rotated_NNNN.hdr` is the same in the world's frame, and smaller,
//!   so it is preferred. The inputs' map is read for their light, as `scene check` reports it; the data
//!   set's rules forbid methods to use it.
//! * Up is the +z of the inputs' environment, where `world_to_env.txt` is there.
//!
//! Source: the data set's README, "Dataset format" and "Coordinate systems".

use super::Opening;
use super::photo::{self, Bounds, Encoding, Intrinsics, Shot, Stage, Up};
use glam::{DMat3, DMat4, DVec3, Mat3, Vec3};
use lumi_core::fs::read_bytes;
use lumi_core::{EnvMap, Environment, Error, Light, NamedLight, Result, Role, Scene};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Rows to which maps are averaged.
const MAP_ROWS: usize = 256;

/// Exponent of the data set's tone curve.
const GAMMA: f32 = 2.2;

/// Whether `folder` holds the cameras of inputs.
#[must_use]
pub fn detect(folder: &Path) -> bool {
    folder.join("inputs/object_bounding_box.txt").is_file()
        && folder.join("inputs/exposure.txt").is_file()
}

/// Reads inputs and held-out views with their lights.
///
/// # Errors
/// Names the file and what is missing or wrong in it.
pub fn open(folder: &Path, opening: &Opening) -> Result<Scene> {
    let mut warnings = Vec::new();
    let inputs = folder.join("inputs");
    let exposure = scalar(&inputs.join("exposure.txt"))?;
    let own_env = optional(&folder.join("world_to_env.txt"), rotation)?;
    let env = folder.join("env.hdr");
    let light = match own_env {
        Some(to_env) if env.is_file() => {
            vec![environment(
                "env",
                &env,
                to_env.transpose(),
                exposure,
                &mut warnings,
            )?]
        }
        _ => Vec::new(),
    };
    let mut shots = Vec::new();
    for number in numbers(&inputs, "image_")? {
        let file =
            |stem: &str, extension: &str| inputs.join(format!("{stem}_{number}.{extension}"));
        let mut shot = shot(
            &file("camera", "txt"),
            file("image", "png"),
            file("mask", "png"),
        )?;
        shot.path = format!("input_{number}");
        shot.lit_by.clone_from(&light);
        shots.push(shot);
    }
    for number in numbers(folder, "gt_image_")? {
        let file =
            |stem: &str, extension: &str| folder.join(format!("{stem}_{number}.{extension}"));
        let exposure = scalar(&file("gt_exposure", "txt"))?;
        let mask = file("gt_mask", "png");
        let mut shot = shot(&file("gt_camera", "txt"), file("gt_image", "png"), mask)?;
        shot.path = format!("gt_{number}");
        shot.role = Role::Target;
        let name = format!("gt_env_{number}");
        let (rotated, own) = (file("gt_env_512_rotated", "hdr"), file("gt_env", "hdr"));
        if rotated.is_file() {
            shot.lit_by = vec![environment(
                &name,
                &rotated,
                Mat3::IDENTITY,
                exposure,
                &mut warnings,
            )?];
        } else if own.is_file() {
            let to_env = rotation(&file("gt_world_to_env", "txt"))?;
            shot.lit_by = vec![environment(
                &name,
                &own,
                to_env.transpose(),
                exposure,
                &mut warnings,
            )?];
        }
        shots.push(shot);
    }
    let stage = Stage {
        up: own_env.map_or(Up::FromCameras, |r| Up::Along(r.transpose() * Vec3::Z)),
        bounds: bounding_box(&inputs.join("object_bounding_box.txt"))?,
        opening,
        warnings,
    };
    let mut scene = photo::scene(folder, &inputs, shots, stage)?;
    // The folder is called `test`; the object's name is its parent's.
    if let Some(object) = folder.canonicalize().ok().as_deref().and_then(Path::parent) {
        scene.name = super::folder_name(object);
    }
    Ok(scene)
}

/// The numbers NNNN of files `PREFIXNNNN.png`, sorted.
fn numbers(folder: &Path, prefix: &str) -> Result<Vec<String>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e))? {
        let name = entry.map_err(|e| Error::io(folder, e))?.file_name();
        let number = name
            .to_str()
            .and_then(|n| n.strip_prefix(prefix)?.strip_suffix(".png"));
        if let Some(number) = number.filter(|n| n.bytes().all(|b| b.is_ascii_digit())) {
            found.push(number.to_owned());
        }
    }
    found.sort();
    Ok(found)
}

fn shot(camera: &Path, image: PathBuf, mask: PathBuf) -> Result<Shot> {
    let v = values(camera, 24)?;
    let wrong = |expected: &str| Error::invalid(camera, "camera", expected);
    if v[1] != 0.0 || v[3] != 0.0 || v[6..9] != [0.0, 0.0, 1.0] {
        return Err(wrong("expected K with no skew and a last row of 0 0 1"));
    }
    let rotation = DMat3::from_cols_slice(&v[9..18]).transpose();
    if rotation.determinant().abs() < 0.5 {
        return Err(wrong("expected a rotation in rows 4 to 6"));
    }
    // The inverse of a rigid motion: transposed rotation, and the centre −Rᵀ t.
    let mut pose = DMat4::from_mat3(rotation.transpose());
    pose.w_axis = (-(rotation.transpose() * DVec3::from_slice(&v[18..21]))).extend(1.0);
    Ok(Shot {
        place: format!("{}", camera.file_name().unwrap_or_default().display()),
        path: String::new(),
        role: Role::Input,
        mask: mask.is_file().then_some(mask),
        image,
        intrinsics: Intrinsics {
            size: [Some(v[21]), Some(v[22])],
            focal: [Some(v[0]), Some(v[4])],
            centre: [Some(v[2]), Some(v[5])],
            ..Intrinsics::default()
        },
        pose: pose.as_mat4(),
        encoding: Encoding::Gamma(GAMMA),
        lit_by: Vec::new(),
    })
}

fn environment(
    name: &str,
    path: &Path,
    rotation: Mat3,
    exposure: f64,
    warnings: &mut Vec<String>,
) -> Result<NamedLight> {
    let (map, said) = EnvMap::read_with_warnings(path)?;
    warnings.extend(said.iter().map(|text| format!("light `{name}`: {text}")));
    let map = map.at_most(MAP_ROWS).into_owned();
    Ok(NamedLight {
        name: name.to_owned(),
        light: Light::Environment(Environment::oriented(
            Arc::new(map),
            rotation,
            [exposure.exp2() as f32; 3],
        )),
    })
}

/// The rotation of a 4×4 world-to-environment matrix.
fn rotation(path: &Path) -> Result<Mat3> {
    let v = values(path, 16)?;
    let r = DMat4::from_cols_slice(&v).transpose();
    let r = DMat3::from_mat4(r).as_mat3();
    let off = (r * r.transpose() - Mat3::IDENTITY).to_cols_array();
    if off.iter().any(|v| v.abs() > 1e-2) || r.determinant() < 0.0 {
        let expected = "expected a rotation in the upper left 3×3";
        return Err(Error::invalid(path, "matrix", expected));
    }
    Ok(r)
}

fn bounding_box(path: &Path) -> Result<Bounds> {
    let v = values(path, 6)?;
    let low = Vec3::new(v[0] as f32, v[2] as f32, v[4] as f32);
    let high = Vec3::new(v[1] as f32, v[3] as f32, v[5] as f32);
    if !(high - low).cmpgt(Vec3::ZERO).all() {
        let expected = format!("expected xmin < xmax and so on, found {v:?}");
        return Err(Error::invalid(path, "box", expected));
    }
    Ok(Bounds::Box(low, high))
}

fn scalar(path: &Path) -> Result<f64> {
    let exposure = values(path, 1)?[0];
    if exposure.abs() > 32.0 {
        let expected = format!("expected a power of two of at most 32, found {exposure}");
        return Err(Error::invalid(path, "exposure", expected));
    }
    Ok(exposure)
}

fn optional<T>(path: &Path, read: fn(&Path) -> Result<T>) -> Result<Option<T>> {
    path.is_file().then(|| read(path)).transpose()
}

/// The `count` numbers of a text file, whatever its lines.
fn values(path: &Path, count: usize) -> Result<Vec<f64>> {
    let bytes = read_bytes(path)?;
    let wrong = |expected: String| Error::invalid(path, "numbers", expected);
    let text = str::from_utf8(&bytes).map_err(|_| wrong("expected text".to_owned()))?;
    let mut numbers = Vec::with_capacity(count);
    for word in text.split_whitespace() {
        match word.parse::<f64>() {
            Ok(v) if v.is_finite() && numbers.len() < count => numbers.push(v),
            Ok(v) if v.is_finite() => return Err(wrong(format!("expected {count}, found more"))),
            _ => return Err(wrong(format!("expected finite numbers, found `{word}`"))),
        }
    }
    if numbers.len() == count {
        return Ok(numbers);
    }
    Err(wrong(format!("expected {count}, found {}", numbers.len())))
}
