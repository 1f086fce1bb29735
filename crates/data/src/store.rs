//! The training store: objects under one light at a time.
//!
//! A record is a group of a Zarr v3 hierarchy ([`ObjectRecord::write`] to `STORE/NAME`), on this machine or, with
//! the feature `remote`, in an object store (`s3://BUCKET/FOLDER/NAME`); or one safetensors file
//! (`STORE/NAME.safetensors`). Both hold the same and may stand side by side. Radiance stays in half floats
//! from disk to the training step. A record counts only once it is complete, so whatever can be listed can be
//! read, and its checksums are checked (a safetensors file has none).

mod file;
mod group;
mod header;
mod place;
mod reader;
mod remote;
mod sheet;

use half::f16;
pub use header::LightKind;
use lumi_core::{
    Camera, Error, LightBasis, LinearImage, NamedLight, Result, Role, Scene, Similarity, View,
};
use place::Place;
pub use reader::{RecordReader, compose};
pub use sheet::sheet;
use std::path::{Path, PathBuf};

/// Version of the layout; readers refuse others.
pub const VERSION: u32 = 1;
/// Rows of a stored environment map (columns are twice as many).
pub const ENVIRONMENT_ROWS: usize = 32;
/// Extension of records that are one file; a path without it is a Zarr group.
pub const EXTENSION: &str = "safetensors";

/// An object under each of its lights.
#[derive(Clone, Debug)]
pub struct ObjectRecord {
    /// Name, usually the file's stem.
    pub name: String,
    /// One camera per view, all of one size.
    pub cameras: Vec<Camera>,
    /// The lights, in world space, which is model space (unit bounding sphere at the origin).
    pub lights: Vec<NamedLight>,
    /// Linear radiance premultiplied by alpha, `[light, view, y, x, 3]`.
    pub radiance: Vec<f16>,
    /// Coverage by the object, `[view, y, x]`.
    pub alpha: Vec<f16>,
    /// Base colour, linear in [0, 1] and premultiplied by alpha as radiance is, `[view, y, x, 3]`; a metal's is its
    /// tint. Records from before it was rendered have none.
    pub albedo: Option<Vec<f16>>,
}

/// Nearest half float; what is too large for one becomes the largest, 65504, instead of infinity.
#[must_use]
pub fn to_half(v: f32) -> f16 {
    f16::from_f32(v.clamp(-65504.0, 65504.0))
}

impl ObjectRecord {
    /// Packs rendered images: `radiance[light][view]` as in [`LightBasis`], alpha taken from the first light.
    ///
    /// # Errors
    /// If counts or sizes differ, or there is no light or view.
    pub fn pack(name: &str, cameras: Vec<Camera>, basis: &LightBasis) -> Result<Self> {
        let mut record = Self {
            name: name.to_owned(),
            cameras,
            lights: basis.lights.iter().map(header::within_half).collect(),
            radiance: Vec::new(),
            alpha: Vec::new(),
            albedo: None,
        };
        for images in &basis.radiance {
            for (image, camera) in images.iter().zip(&record.cameras) {
                record.radiance.extend(colors("radiance", image, camera)?);
            }
        }
        for image in basis.radiance.first().into_iter().flatten() {
            let alpha = image.pixels.iter().map(|p| to_half(p[3]));
            record.alpha.extend(alpha);
        }
        record.validate()?;
        Ok(record)
    }

    /// The record with the base colour of every view, premultiplied.
    ///
    /// # Errors
    /// If there is not one image per camera, of its size, with finite values ≥ 0.
    pub fn with_albedo(mut self, images: &[LinearImage]) -> Result<Self> {
        let mut albedo = Vec::new();
        for (image, camera) in images.iter().zip(&self.cameras) {
            albedo.extend(colors("albedo", image, camera)?);
        }
        self.albedo = Some(albedo);
        self.validate()?;
        Ok(self)
    }

    /// Width and height of every view in pixels.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        self.cameras.first().map_or((0, 0), |c| (c.width, c.height))
    }

    /// Premultiplied radiance of one light in one view, `[y, x, 3]`, as it is stored.
    ///
    /// # Panics
    /// If an index is out of range.
    #[must_use]
    pub fn radiance_of(&self, light: usize, view: usize) -> &[f16] {
        let (width, height) = self.size();
        let n = width * height * 3;
        &self.radiance[(light * self.cameras.len() + view) * n..][..n]
    }

    /// Coverage in one view, `[y, x]`.
    ///
    /// # Panics
    /// If the index is out of range.
    #[must_use]
    pub fn alpha_of(&self, view: usize) -> &[f16] {
        let (width, height) = self.size();
        &self.alpha[view * width * height..][..width * height]
    }

    /// Premultiplied base colour and coverage of one view, where the record has it.
    ///
    /// # Panics
    /// If the index is out of range.
    #[must_use]
    pub fn albedo_of(&self, view: usize) -> Option<LinearImage> {
        let (width, height) = self.size();
        let n = width * height * 3;
        let colors = &self.albedo.as_ref()?[view * n..][..n];
        let pixels = colors.chunks_exact(3).zip(self.alpha_of(view));
        let pixels = pixels.map(|(c, alpha)| [c[0], c[1], c[2], *alpha].map(f16::to_f32));
        Some(LinearImage {
            width,
            height,
            pixels: pixels.collect(),
        })
    }

    /// `view` under the sum of lights, each with its per-channel gain; no lights give black.
    ///
    /// # Panics
    /// If an index is out of range.
    #[must_use]
    pub fn compose(&self, view: usize, lights: &[(usize, [f32; 3])]) -> LinearImage {
        let pictures: Vec<_> = lights
            .iter()
            .map(|&(light, gain)| (self.radiance_of(light, view), gain))
            .collect();
        compose(self.size(), self.alpha_of(view), &pictures)
    }

    /// The record as a scene: every view is an input without a photograph, the basis holds the images.
    #[must_use]
    pub fn to_scene(&self) -> Scene {
        let views = self.cameras.iter().enumerate().map(|(i, &camera)| View {
            name: format!("v{i:02}"),
            role: Role::Input,
            camera,
            image: None,
        });
        let images = |light: usize| {
            (0..self.cameras.len())
                .map(|view| self.compose(view, &[(light, [1.0; 3])]))
                .collect()
        };
        Scene {
            name: self.name.clone(),
            views: views.collect(),
            to_model: Similarity::IDENTITY,
            basis: Some(LightBasis {
                lights: self.lights.clone(),
                radiance: (0..self.lights.len()).map(images).collect(),
            }),
            lit_by: Vec::new(),
            radiance: Vec::new(),
            warnings: Vec::new(),
        }
    }

    /// Writes the record: to a safetensors file if `path` has that extension, else as the Zarr group
    /// `STORE/NAME`. The folder is made if need be. It counts only once it is complete.
    ///
    /// # Errors
    /// If the record is not valid or cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        self.validate().map_err(|e| e.at(path))?;
        if is_file(path) && place::is_remote(path) {
            let expected = "expected a name without .safetensors: object stores hold groups";
            return Err(Error::invalid(path, "path", expected));
        }
        if let Some(store) = path.parent().filter(|_| !place::is_remote(path)) {
            std::fs::create_dir_all(store).map_err(|e| Error::io(store, e))?;
        }
        if is_file(path) {
            return file::write(self, path);
        }
        group::write(self, &Place::of(path)?)
    }

    /// Reads and checks a record: its checksums, then as [`ObjectRecord::validate`].
    ///
    /// # Errors
    /// Names the file or group, and the field that is missing or wrong.
    pub fn read(path: &Path) -> Result<Self> {
        let record = if is_file(path) {
            file::read(path)?
        } else {
            group::read(&Place::of(path)?)?
        };
        record.validate().map_err(|e| e.at(path))?;
        Ok(record)
    }

    /// The record in the bytes of a safetensors file; `path` is for messages.
    ///
    /// # Errors
    /// As [`ObjectRecord::read`].
    pub fn parse(path: &Path, bytes: &[u8]) -> Result<Self> {
        let record = file::parse(path, bytes)?;
        record.validate().map_err(|e| e.at(path))?;
        Ok(record)
    }

    /// Checks counts, sizes, cameras, lights and that all values are finite.
    ///
    /// # Errors
    /// Names the field and what was expected.
    pub fn validate(&self) -> Result<()> {
        if self.cameras.is_empty() || self.lights.is_empty() {
            return Err(Error::value(
                "cameras, lights",
                "expected at least one of each",
            ));
        }
        let size = self.size();
        for (i, camera) in self.cameras.iter().enumerate() {
            camera
                .validate()
                .map_err(|e| within(&format!("cameras[{i}]"), e))?;
            if (camera.width, camera.height) != size {
                let expected = format!("expected {}×{} like the first", size.0, size.1);
                return Err(Error::value(format!("cameras[{i}]"), expected));
            }
        }
        for (i, light) in self.lights.iter().enumerate() {
            let field = format!("lights[{i}] ({})", light.name);
            light.light.validate().map_err(|e| within(&field, e))?;
            if self.lights[..i].iter().any(|l| l.name == light.name) {
                return Err(Error::value(field, "expected a name of its own"));
            }
        }
        let pixels = self.cameras.len() * size.0 * size.1;
        let arrays = [
            ("alpha", Some(&self.alpha), pixels),
            (
                "radiance",
                Some(&self.radiance),
                pixels * 3 * self.lights.len(),
            ),
            ("albedo", self.albedo.as_ref(), pixels * 3),
        ];
        for (field, values, n) in arrays {
            let Some(values) = values else {
                continue;
            };
            if values.len() != n {
                let expected = format!("expected {n} values, found {}", values.len());
                return Err(Error::value(field, expected));
            }
            if let Some(i) = values
                .iter()
                .position(|v| !v.is_finite() || v.to_f32() < 0.0)
            {
                let expected = format!("expected finite values ≥ 0, found {}", values[i]);
                return Err(Error::value(format!("{field}[{i}]"), expected));
            }
        }
        Ok(())
    }
}

/// The complete records of a store, a folder or a URL, sorted by name.
///
/// # Errors
/// If the store cannot be listed.
pub fn list(store: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    if !place::is_remote(store) {
        for entry in std::fs::read_dir(store).map_err(|e| Error::io(store, e))? {
            let path = entry.map_err(|e| Error::io(store, e))?.path();
            if is_file(&path) {
                paths.push(path);
            }
        }
    }
    let groups = place::names(store)?;
    paths.extend(groups.into_iter().map(|name| store.join(name)));
    paths.sort();
    Ok(paths)
}

/// Whether the store holds the complete record `path`.
///
/// # Errors
/// If the store cannot be reached.
pub fn exists(path: &Path) -> Result<bool> {
    if is_file(path) {
        return Ok(path.is_file());
    }
    let local = !place::is_remote(path);
    if local && !path.is_dir() {
        return Ok(false);
    }
    Place::of(path)?.has("zarr.json")
}

/// Whether the store holds a complete record of this name, of either kind.
///
/// # Errors
/// If the store cannot be reached.
pub fn holds(store: &Path, name: &str) -> Result<bool> {
    let file = store.join(format!("{name}.{EXTENSION}"));
    Ok((!place::is_remote(store) && file.is_file()) || exists(&store.join(name))?)
}

fn is_file(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == EXTENSION)
}

/// The colours of a camera's image, without alpha.
fn colors(field: &str, image: &LinearImage, camera: &Camera) -> Result<impl Iterator<Item = f16>> {
    if (image.width, image.height) != (camera.width, camera.height) {
        return Err(Error::value(
            field,
            "expected images of their camera's size",
        ));
    }
    let colors = image.pixels.iter().flat_map(|p| [p[0], p[1], p[2]]);
    Ok(colors.map(to_half))
}

/// Prefixes the field of an error, to say which of many values was wrong.
fn within(prefix: &str, error: Error) -> Error {
    match error {
        Error::Value { field, expected } => Error::value(format!("{prefix}.{field}"), expected),
        other => other,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use lumi_core::glam::Vec3;
    use lumi_core::{Area, EnvMap, Environment, Light, Point};
    use std::sync::Arc;

    pub(super) fn record() -> ObjectRecord {
        let cameras: Vec<Camera> = (0..2)
            .map(|i| Camera::orbit(i as f32, 0.4, 2.7, 0.87, 4))
            .collect();
        let map = EnvMap {
            width: 64,
            height: 32,
            pixels: (0..2048).map(|i| [i as f32 / 1024.0, 0.5, 2.0]).collect(),
        };
        let lights: Vec<NamedLight> = [
            (
                "env0",
                Light::Environment(Environment::new(Arc::new(map), 0.3, 1.5)),
            ),
            (
                "point0",
                Light::Point(Point::new(Vec3::new(0.0, 3.0, 2.0), 800.0)),
            ),
            (
                "area0",
                Light::Area(Area::facing(
                    Vec3::new(3.0, 0.0, 2.0),
                    Vec3::ZERO,
                    1.5,
                    900.0,
                )),
            ),
        ]
        .map(|(name, light)| NamedLight {
            name: name.to_owned(),
            light,
        })
        .into();
        let radiance = (0..3)
            .map(|l| {
                (0..2)
                    .map(|v| LinearImage {
                        width: 4,
                        height: 4,
                        pixels: (0..16)
                            .map(|i| [l as f32, v as f32, i as f32, 0.5])
                            .collect(),
                    })
                    .collect()
            })
            .collect();
        ObjectRecord::pack("thing", cameras, &LightBasis { lights, radiance }).expect("valid")
    }

    fn same(record: &ObjectRecord, back: &ObjectRecord) {
        assert_eq!((&back.name, &back.cameras), (&record.name, &record.cameras));
        assert_eq!(
            (&back.radiance, &back.alpha),
            (&record.radiance, &record.alpha)
        );
        for (a, b) in back.lights.iter().zip(&record.lights) {
            assert_eq!(a.name, b.name);
            if let (Light::Environment(x), Light::Environment(y)) = (&a.light, &b.light) {
                assert_eq!((x.rotation, x.strength), (y.rotation, y.strength));
                for (p, q) in x.map.pixels.iter().zip(&y.map.pixels) {
                    assert!((p[0] - q[0]).abs() < 1e-3 * q[0].max(1e-3));
                }
            } else {
                assert_eq!(a.light, b.light);
            }
        }
        assert_eq!(back.albedo, record.albedo);
    }

    #[test]
    fn both_kinds_of_record_read_back_side_by_side() {
        let folder = tempfile::tempdir().expect("folder");
        let store = folder.path().join("made/on/the/way");
        let (file, group) = (store.join("a.safetensors"), store.join("b"));
        let bare = record();
        let views = bare
            .to_scene()
            .basis
            .expect("basis")
            .radiance
            .swap_remove(2);
        assert!(bare.clone().with_albedo(&views[..1]).is_err());
        let mut record = bare.with_albedo(&views).expect("one per camera");
        assert_eq!(record.albedo_of(1).as_ref(), Some(&views[1]));
        assert!(!exists(&file).expect("asked") && !exists(&group).expect("asked"));
        assert!(!holds(&store, "a").expect("asked") && !holds(&store, "b").expect("asked"));
        for path in [&file, &group] {
            record.write(path).expect("written");
            assert!(exists(path).expect("asked"));
            let name = path.file_stem().expect("name").to_str().expect("text");
            assert!(holds(&store, name).expect("asked"));
            same(&record, &ObjectRecord::read(path).expect("read"));
        }
        assert_eq!(list(&store).expect("listed"), [file.clone(), group.clone()]);
        // Replacing a record leaves nothing of the old one.
        record.albedo = None;
        record.write(&group).expect("written");
        assert!(!group.join("albedo").exists());
        same(&record, &ObjectRecord::read(&group).expect("read"));
        // What has lost its group's metadata, or never got them, does not count.
        std::fs::remove_file(group.join("zarr.json")).expect("removed");
        assert!(!exists(&group).expect("asked"));
        assert_eq!(list(&store).expect("listed"), [file]);
    }

    #[test]
    fn damage_to_a_group_is_noticed() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("b");
        let mut record = record();
        // Shards of black pictures are stored as well; see below.
        record.radiance[..96].fill(f16::ZERO);
        record.write(&path).expect("written");
        let shard = path.join("radiance/c/0/0/0/0/0");
        let whole = std::fs::read(&shard).expect("one shard holds it all");
        let fails = |part: &str| {
            let message = ObjectRecord::read(&path).expect_err(part).to_string();
            assert!(message.contains(part), "{message}");
            assert!(message.contains(&path.display().to_string()), "{message}");
            assert_eq!(message.lines().count(), 1, "{message}");
        };
        for i in 0..whole.len() {
            let mut flipped = whole.clone();
            flipped[i] ^= 0x10;
            std::fs::write(&shard, &flipped).expect("flipped");
            fails("radiance");
        }
        std::fs::write(&shard, &whole[..whole.len() / 2]).expect("cut");
        fails("radiance");
        std::fs::remove_file(&shard).expect("removed");
        fails("expected shard 0, found none");
        std::fs::write(&shard, &whole).expect("restored");
        let meta = path.join("alpha/zarr.json");
        let text = std::fs::read_to_string(&meta).expect("text");
        // A shape that nobody could allocate.
        let huge = text.replacen("4,\n    4", "4000000000,\n    4000000000", 1);
        assert_ne!(huge, text);
        std::fs::write(&meta, huge).expect("changed");
        fails("alpha");
        std::fs::write(&meta, &text).expect("restored");
        let group = path.join("zarr.json");
        let text = std::fs::read_to_string(&group).expect("text");
        std::fs::write(&group, text.replace("\"version\": 1", "\"version\": 9")).expect("changed");
        fails("version");
        std::fs::write(&group, &text[..text.len() / 2]).expect("cut");
        fails("zarr.json");
    }

    #[test]
    fn names_and_urls_are_checked() {
        let folder = tempfile::tempdir().expect("folder");
        let message = record()
            .write(&folder.path().join("a b"))
            .expect_err("a space")
            .to_string();
        assert!(message.contains("letters, digits"), "{message}");
        let mut record = record();
        record.lights[0].name = "../up".to_owned();
        let message = record
            .write(&folder.path().join("ab"))
            .expect_err("a path")
            .to_string();
        assert!(message.contains("../up"), "{message}");
        assert!(list(folder.path()).expect("listed").is_empty());
        // URLs of other services do not become folders.
        for url in ["gs://bucket/set", "https://host/set", "s3://"] {
            let url = Path::new(url);
            for error in [
                list(url).expect_err("no store"),
                exists(&url.join("a")).expect_err("no store"),
                self::record().write(&url.join("a")).expect_err("no store"),
            ] {
                let message = error.to_string();
                assert!(message.contains("s3://BUCKET/FOLDER"), "{message}");
            }
        }
        if cfg!(not(feature = "remote")) {
            let message = list(Path::new("s3://bucket/set"))
                .expect_err("no client")
                .to_string();
            assert!(message.contains("feature `remote`"), "{message}");
        }
    }

    #[test]
    fn a_file_written_again_is_the_same_file() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("object_000000.safetensors");
        record().write(&path).expect("written");
        assert_eq!(std::fs::read_dir(folder.path()).expect("folder").count(), 1);
        let back = ObjectRecord::read(&path).expect("read");
        let again = folder.path().join("again.safetensors");
        back.write(&again).expect("written");
        let bytes = |p: &Path| std::fs::read(p).expect("bytes");
        assert_eq!(bytes(&path), bytes(&again));
    }

    #[test]
    fn composes_without_converting_everything() {
        let record = record();
        let image = record.compose(1, &[(1, [1.0, 2.0, 0.5]), (2, [1.0; 3])]);
        assert_eq!(image.pixels[6], [3.0, 3.0, 9.0, 0.5]);
        let scene = record.to_scene();
        let basis = scene.basis.expect("basis");
        assert_eq!(
            basis.compose(1, &[(1, [1.0, 2.0, 0.5]), (2, [1.0; 3])]),
            image
        );
    }

    #[test]
    fn large_values_stay_finite() {
        assert_eq!(to_half(1e9).to_f32(), 65504.0);
    }

    #[test]
    fn corrupt_files_are_errors_that_name_file_and_field() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("bad.safetensors");
        let mut record = record();
        record.write(&path).expect("written");
        let bytes = std::fs::read(&path).expect("bytes");
        // Cut anywhere, it is an error that names the file.
        for n in [0, 4, 8, 100, bytes.len() / 2, bytes.len() - 1] {
            std::fs::write(&path, &bytes[..n]).expect("cut");
            let message = ObjectRecord::read(&path).expect_err("cut").to_string();
            assert!(message.contains("bad.safetensors"), "{message}");
        }
        // Any single flipped byte of the header is an error or still a valid record, never a panic.
        for i in 0..600 {
            let mut flipped = bytes.clone();
            flipped[i] ^= 0x15;
            std::fs::write(&path, &flipped).expect("flipped");
            let _ = ObjectRecord::read(&path);
        }
        record.radiance[7] = f16::NAN;
        let message = record.write(&path).expect_err("nan").to_string();
        assert!(message.contains("radiance[7]"), "{message}");
    }
}
