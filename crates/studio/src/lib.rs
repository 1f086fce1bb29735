//! A local web studio: relight a capture by hand, in a browser.
//!
//! [`Studio`] holds the model, the environment maps and the sessions; [`Studio::serve`] answers HTTP and WebSocket
//! requests on a socket. The page (`web/`) is embedded and uses nothing but the documented interface:
//! the OpenAPI document that `routes` makes for HTTP, `docs/studio.md` for the WebSocket.
//!
//! Read [`server`] for who may talk to it, `api` for what can be asked, [`tree`] for what a session is, and `engine`
//! for the one place that runs the model.

mod api;
mod camera;
mod engine;
mod error;
mod export;
mod form;
pub mod limits;
mod look;
mod maps;
mod open;
mod openapi;
mod page;
mod references;
mod reply;
mod routes;
pub mod server;
mod session;
mod session_file;
mod sessions;
mod socket;
mod tree;
mod unpack;
mod upload;

pub use error::{Error, Result};
pub use server::{Config, Studio};
