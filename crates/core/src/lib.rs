//! Cameras, images, lights, light rays and scenes of LumiTokens as plain types.
//!
//! Conventions, converted once at the border and never again:
//! * World: right-handed, z up.
//! * Cameras: OpenCV (x right, y down, z forward), camera-to-world poses, pixel centres at +0.5.
//! * Colour: linear Rec. 709 radiance inside; sRGB only in [`DisplayImage`], which is what files show.
//! * Lights: Blender's units (watts; radiance for environments; W/m² for suns).

pub mod authors;
pub mod camera;
pub mod color;
pub mod error;
pub mod event;
pub mod fs;
pub mod image;
pub mod light;
pub mod memory;
pub mod reprojection;
pub mod scene;
pub mod seed;
pub mod similarity;

pub use camera::Camera;
pub use error::{Error, Result};
pub use event::{Event, Progress};
pub use image::{DisplayImage, LinearImage};
pub use light::{Area, EnvMap, Environment, Light, Point, Spot, Sun};
pub use reprojection::Reprojection;
pub use scene::{LightBasis, NamedLight, Role, Scene, View};
pub use seed::Seed;
pub use similarity::Similarity;

pub use glam;
