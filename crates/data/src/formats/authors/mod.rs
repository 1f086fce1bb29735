//! The layout of the authors' release: photographs of an object under one light after the other.
//!
//! A split is a folder with `full_list.txt`, `metadata/SCENE.json`, `images/SCENE/00000.png` and, where the
//! light is known, `envmaps/SCENE/00000_{ldr,hdr}.png` per frame or `point_light_rays/SCENE.npy`. A scene is
//! an object under one light, `OBJECT_LIGHT`; its metadata file opens it, and so does the split's folder if
//! it holds one scene only.
//!
//! * Cameras: `w2c` in OpenCV axes and `fxfycxcy` in pixels of the stored image. The world is Blender's, z up.
//! * Environments are camera-aligned pairs: `_ldr` is 255·clip(L)^(1/2.2), `_hdr` 255·log1p(10 L)/max. The
//!   largest value is not stored; it is recovered here from mid-grey pixels, which both pictures resolve.
//! * Light rays: rows of intensity, r, g, b, origin, direction. Intensity is log1p(10 t) of the power's
//!   place t in 10–1500 W, clipped; position, size, colour and power are recovered from them.
//! * All frames are inputs unless there are nine or more; then every eighth is held out.
//!
//! Source: the project's notes on the authors' code (facts only); see also [`lumi_core::light::authors`].

mod light;
mod npy;
mod read;
mod write;

pub use read::{detect, open};
pub(super) use write::common_light;
pub use write::write;

use lumi_core::{NamedLight, Result};
use serde::{Deserialize, Serialize};

/// The lights that the bytes of a light-ray file come from.
pub(crate) fn local_lights(bytes: &[u8]) -> Result<Vec<NamedLight>> {
    npy::parse(bytes).and_then(|rows| light::local(&rows))
}

/// `metadata/SCENE.json`.
#[derive(Serialize, Deserialize)]
struct SceneFile {
    scene_name: String,
    frames: Vec<FrameRecord>,
}

#[derive(Serialize, Deserialize)]
struct FrameRecord {
    image_path: String,
    fxfycxcy: [f64; 4],
    w2c: crate::json::Rows,
}
