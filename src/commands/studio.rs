//! `lumi studio`: relight a capture by hand, in a browser.

use crate::assets;
use crate::device::OnDevice;
use crate::interrupt;
use crate::output::{say, say_aside};
use anyhow::{Context, Result};
use lumi_studio::{Config, Studio};
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use tokio::net::TcpListener;

/// Relight a capture by hand, in a browser
///
/// Opens a local page where you orbit around the capture, place lights and build the lighting up step by step.
/// Sessions are saved as you go and are there again next time.
#[derive(clap::Args)]
pub struct Args {
    /// Folder of the capture (see `lumi scene check`); the bundled one if absent
    scene: Option<PathBuf>,
    /// Weights file; the bundled model if absent
    #[arg(long)]
    model: Option<PathBuf>,
    #[command(flatten)]
    on: OnDevice,
    /// Number of input views to encode
    #[arg(long, default_value_t = 8)]
    inputs: usize,
    /// Side of pictures over the model's own, with detail from the photographs: 1 to 16; 2 if absent, for models that are given
    /// them. Frames take longer
    #[arg(long, value_name = "TIMES")]
    detail: Option<usize>,
    /// Port to listen on; 0 takes a free one
    #[arg(long, default_value_t = 7788)]
    port: u16,
    /// Address to listen on. The server knows no passwords: another address than this machine's own lets everybody
    /// who can reach it in
    #[arg(long, default_value = "127.0.0.1")]
    address: IpAddr,
    /// Further name under which browsers may reach the server (with --address or a tunnel)
    #[arg(long, value_name = "NAME")]
    allow_host: Vec<String>,
    /// Folder of environment maps (.hdr, .exr, or .jpg and .png panoramas) to offer besides the bundled ones
    #[arg(long, value_name = "DIR")]
    maps: Option<PathBuf>,
    /// Where sessions are kept; by default lumi/studio in the user's data folder
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let data = match &args.data {
        Some(data) => data.clone(),
        None => data_folder().context("--data: expected a folder, since HOME is not set")?,
    };
    let folder = match &args.scene {
        Some(scene) => scene.clone(),
        None => assets::demo_scene(&data.join("bundled"))?,
    };
    let config = Config {
        sessions: data.join("sessions"),
        maps: args.maps.clone(),
        allow_hosts: args.allow_host.clone(),
        model: args.model.as_ref().map(|m| m.display().to_string()),
    };
    // Before the encoder has run for nothing.
    let scene = lumi_data::open(&folder)?;
    if super::foretell(&scene).lacks_masks() {
        say!(
            "masks: `lumi scene mask {} --out FOLDER` makes them",
            folder.display()
        );
    }
    let model = assets::model(args.model.as_deref(), &args.on.device)?;
    let detail = args.detail.unwrap_or(Studio::usual_detail(&model));
    let studio = Studio::new(model.with_detail(detail)?, config)?;
    if let Some(warning) = studio.warning() {
        say_aside!("warning: {warning}");
    }
    let runtime = tokio::runtime::Runtime::new()?;
    runtime.block_on(async {
        // The port first: nobody should wait for the encoder to learn that it is taken.
        let listener = TcpListener::bind((args.address, args.port))
            .await
            .with_context(|| format!("--port {}: cannot listen there", args.port))?;
        studio.open(scene, &folder, args.inputs).await?;
        let own = listener.local_addr()?;
        if !own.ip().is_loopback() {
            say_aside!(
                "warning: the studio knows no passwords: whoever can reach {own} can use it, and read what it opens"
            );
        }
        let from_here = SocketAddr::new(reachable(own.ip()), own.port());
        say!("studio: http://{from_here}/   (Ctrl-C ends it)");
        Arc::clone(&studio)
            .serve(listener, interrupt::asked())
            .await?;
        anyhow::Ok(())
    })?;
    Ok(ExitCode::SUCCESS)
}

/// An address at which others find a server that listens at `address`: for that of all interfaces, the one that this machine
/// would itself send from. Nothing is sent.
fn reachable(address: IpAddr) -> IpAddr {
    if !address.is_unspecified() {
        return address;
    }
    let (any, far) = match address {
        IpAddr::V4(_) => ("0.0.0.0:0", "192.0.2.1:9"),
        IpAddr::V6(_) => ("[::]:0", "[2001:db8::1]:9"),
    };
    let own = UdpSocket::bind(any).and_then(|socket| {
        socket.connect(far)?;
        socket.local_addr()
    });
    own.map_or(address, |own| own.ip())
}

/// `lumi/studio` where programs of this user keep their data; `None` if nothing says where that is.
#[must_use]
pub fn data_folder() -> Option<PathBuf> {
    let set = |name: &str| {
        std::env::var_os(name)
            .filter(|v| !v.is_empty())
            .map(PathBuf::from)
    };
    let base = set("XDG_DATA_HOME")
        .or_else(|| set("LOCALAPPDATA"))
        .or_else(|| Some(set("HOME")?.join(".local/share")))?;
    Some(base.join("lumi/studio"))
}
