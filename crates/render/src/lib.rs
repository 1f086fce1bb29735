//! Path tracer and procedural objects for light-basis data.
//!
//! The way through: [`objects`] (or [`models`], from a file) make a [`scene::mesh::Model`], [`scene::Geometry`] makes it
//! traceable, [`film::render_basis`] renders it under each light at once, and [`generate`] writes whole data sets.

pub mod bsdf;
pub mod cycles;
pub mod denoise;
pub mod draw;
pub mod environment;
pub mod film;
pub mod generate;
pub mod gltf;
pub mod image_file;
pub mod image_texture;
pub mod integrator;
pub mod light;
pub mod material;
pub mod models;
pub mod noise;
pub mod obj;
pub mod objects;
pub mod sampling;
pub mod scene;
pub mod texture;
