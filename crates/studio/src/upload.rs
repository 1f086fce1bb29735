//! Captures that were dropped on the page: received into a private folder, checked, and kept until they are encoded.

use crate::limits::{INPUTS, RECEIVING, UPLOAD_BYTES, UPLOAD_FILES, UPLOADS};
use crate::references::{self, plain_path};
use crate::{Error, Result, unpack};
use axum::extract::Multipart;
use lumi_core::image::encode_png;
use lumi_core::{Scene, View};
use lumi_data::check::{self, Report};
use lumi_data::formats;
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use tempfile::TempDir;
use tokio::io::AsyncWriteExt;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Side of the pictures that go with a check.
const PREVIEW: usize = 128;

/// A capture that waits to be encoded.
pub struct Upload {
    /// Its id.
    pub id: String,
    /// Where it is, inside the private folder.
    pub scene: PathBuf,
    /// What was found out about it.
    pub checked: Checked,
    /// PNGs of its input views.
    pub previews: Vec<Vec<u8>>,
    /// The PNG that `lumi scene check` draws.
    pub picture: Vec<u8>,
    _folder: TempDir,
}

/// What a page shows of a check.
#[derive(Clone, Serialize, JsonSchema)]
#[schemars(rename = "Check")]
pub struct Checked {
    /// The findings, as `lumi scene check --json` writes them.
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    pub report: Report,
    /// The same as `lumi scene check` prints it.
    pub text: String,
    /// Whether it can be encoded.
    pub usable: bool,
    /// Names of the input views that have pictures here.
    pub views: Vec<String>,
    /// Camera centres of all views in model space, where the scene is the unit ball.
    pub cameras: Vec<[f32; 3]>,
    /// Lights that the inputs may be composed under; empty for photographs.
    pub sources: Vec<String>,
}

/// The uploads.
pub struct Uploads {
    held: Mutex<VecDeque<Arc<Upload>>>,
    receiving: Arc<Semaphore>,
    /// Opening a capture can take gigabytes, so it is done one at a time.
    opening: Arc<Semaphore>,
}

impl Default for Uploads {
    fn default() -> Self {
        Self {
            held: Mutex::default(),
            receiving: Arc::new(Semaphore::new(RECEIVING)),
            opening: Arc::new(Semaphore::new(1)),
        }
    }
}

impl Uploads {
    /// Receives files (each part is named by its path in the folder, or by a mere form field if it has a file name) or one zip
    /// (told by its first bytes), and checks the scene in them.
    ///
    /// # Errors
    /// On limits, paths that leave the folder, and scenes that cannot be opened. Nothing is kept then.
    pub async fn receive(&self, parts: Multipart) -> Result<Arc<Upload>> {
        let many = |_| Error::Busy("too many uploads at the same time: try again soon".into());
        let receiving = Arc::clone(&self.receiving).try_acquire_owned();
        let receiving = receiving.map_err(many)?;
        let folder =
            TempDir::new().map_err(|e| Error::Internal(format!("temporary folder: {e}")))?;
        let files = folder.path().join("upload");
        let name = receive_files(parts, &files).await?;
        let turn = self.turn().await?;
        // A client that leaves ends this function, not the work: the permits stay with that.
        let open = move || {
            let _permits = (receiving, turn);
            opened(folder, &files, &name)
        };
        let upload = Arc::new(tokio::task::spawn_blocking(open).await??);
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        held.push_back(Arc::clone(&upload));
        while held.len() > UPLOADS {
            held.pop_front();
        }
        Ok(upload)
    }

    /// Waits until no other capture is being opened.
    ///
    /// # Errors
    /// If the server is shutting down.
    pub async fn turn(&self) -> Result<OwnedSemaphorePermit> {
        let closed = |_| Error::Busy("the server is shutting down".into());
        let turn = Arc::clone(&self.opening).acquire_owned().await;
        turn.map_err(closed)
    }

    /// The upload called `id`.
    ///
    /// # Errors
    /// If there is none, or it was dropped for newer ones.
    pub fn get(&self, id: &str) -> Result<Arc<Upload>> {
        let held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        let found = held.iter().find(|u| u.id == id).cloned();
        found.ok_or_else(|| Error::NotFound(format!("upload `{id}`: it is gone; send it again")))
    }

    /// Forgets an upload and deletes its files.
    pub fn remove(&self, id: &str) {
        let mut held = self.held.lock().unwrap_or_else(PoisonError::into_inner);
        held.retain(|u| u.id != id);
    }
}

/// Streams the parts to files below `folder`; returns a name for the capture.
async fn receive_files(mut parts: Multipart, folder: &Path) -> Result<String> {
    let io = |e: std::io::Error| Error::Internal(format!("receiving the upload: {e}"));
    tokio::fs::create_dir_all(folder).await.map_err(io)?;
    let (mut left, mut count, mut name) = (UPLOAD_BYTES, 0, String::new());
    while let Some(mut part) = parts.next_field().await? {
        let path = plain_path(sent_as(part.name(), part.file_name()))?;
        count += 1;
        if count > UPLOAD_FILES {
            let text = format!("upload: expected at most {UPLOAD_FILES} files");
            return Err(Error::TooLarge(text));
        }
        if name.is_empty() {
            let first = path
                .components()
                .next()
                .map(|c| PathBuf::from(c.as_os_str()));
            let first = first.unwrap_or_default().with_extension("");
            name = first.to_string_lossy().into_owned();
        }
        let target = folder.join(&path);
        if let Some(parent) = target.parent() {
            let clash = |e| Error::Invalid(format!("{}: {e}", path.display()));
            tokio::fs::create_dir_all(parent).await.map_err(clash)?;
        }
        let clash = |e| Error::Invalid(format!("{}: {e}", path.display()));
        let mut file = tokio::fs::File::create_new(&target).await.map_err(clash)?;
        while let Some(chunk) = part.chunk().await? {
            left = left.checked_sub(chunk.len() as u64).ok_or_else(|| {
                Error::TooLarge(format!(
                    "upload: expected at most {} MiB",
                    UPLOAD_BYTES >> 20
                ))
            })?;
            file.write_all(&chunk).await.map_err(io)?;
        }
        file.flush().await.map_err(io)?;
    }
    if count == 0 {
        return Err(Error::Invalid(
            "upload: expected a folder or a zip, found no files".into(),
        ));
    }
    Ok(name)
}

/// Unpacks, finds, checks and opens what was received. Messages name files as the sender knows them.
fn opened(folder: TempDir, files: &Path, name: &str) -> Result<Upload> {
    let mut root = files.to_owned();
    if let Some(archive) = only_zip(files) {
        root = folder.path().join("unpacked");
        let file = std::fs::File::open(archive)
            .map_err(|e| Error::Internal(format!("reading the upload: {e}")))?;
        unpack::unpack(file, &root)?;
    }
    references::check(&root)?;
    let scene = scene_folder(&root);
    let open = || -> lumi_core::Result<(Scene, &str)> {
        let format = formats::detect(&scene)?;
        Ok((format.open(&scene)?, format.name))
    };
    let here = format!("{}/", scene.display());
    let shorter = |e: lumi_core::Error| {
        let text = e.to_string().replace(&here, "");
        Error::Invalid(text.replace(&scene.display().to_string(), name))
    };
    let (opened, format) = open().map_err(shorter)?;
    let mut report = check::check(&opened, format);
    if report.name == scene.file_name().unwrap_or_default().to_string_lossy() && scene == root {
        name.clone_into(&mut report.name);
    }
    let picture = encode_png(&check::picture(&opened, &report)?)?;
    let usable = !report.has_errors() && report.inputs > 0;
    let views = if usable {
        lumi_data::spread_inputs(&opened, INPUTS, None, PREVIEW).map_err(shorter)?
    } else {
        Vec::new()
    };
    let checked = Checked {
        text: report.to_string(),
        usable,
        views: views.iter().map(|v| v.name.clone()).collect(),
        cameras: camera_centres(&opened),
        sources: sources(&opened),
        report,
    };
    Ok(Upload {
        id: crate::sessions::new_id(),
        scene,
        checked,
        previews: pngs(&views)?,
        picture,
        _folder: folder,
    })
}

fn pngs(views: &[View]) -> Result<Vec<Vec<u8>>> {
    let images = views.iter().filter_map(|v| v.image.as_ref());
    Ok(images.map(encode_png).collect::<lumi_core::Result<_>>()?)
}

fn camera_centres(scene: &Scene) -> Vec<[f32; 3]> {
    let centre = |v: &View| scene.to_model.point(v.camera.centre()).into();
    scene.views.iter().map(centre).collect()
}

fn sources(scene: &Scene) -> Vec<String> {
    let lights = scene.basis.iter().flat_map(|b| &b.lights);
    lights.map(|l| l.name.clone()).collect()
}

/// The zip, if it is all that was sent.
fn only_zip(folder: &Path) -> Option<PathBuf> {
    let mut entries = std::fs::read_dir(folder).ok()?.flatten();
    let (first, second) = (entries.next()?, entries.next());
    let path = first.path();
    if second.is_some() || !path.is_file() {
        return None;
    }
    let mut magic = [0; 4];
    let mut file = std::fs::File::open(&path).ok()?;
    let read = std::io::Read::read_exact(&mut file, &mut magic);
    // The second is that of an archive of nothing.
    let is = read.is_ok() && [*b"PK\x03\x04", *b"PK\x05\x06"].contains(&magic);
    // What says that it is one is opened as one, so that the error is about that.
    let says = path
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("zip"));
    (is || says).then_some(path)
}

/// A part's path in the folder: its name, as the page sends it; or its file's name where its own is a mere field
/// (`curl -F file=@capture.zip`).
fn sent_as<'a>(name: Option<&'a str>, file: Option<&'a str>) -> &'a str {
    let name = name.unwrap_or_default();
    match file {
        Some(file) if !file.is_empty() && !name.contains(['/', '.']) => file,
        _ => name,
    }
}

/// The folder with the scene: folders that hold nothing but one folder are stepped into.
fn scene_folder(root: &Path) -> PathBuf {
    let mut folder = root.to_owned();
    while formats::detect(&folder).is_err() {
        let Ok(entries) = std::fs::read_dir(&folder) else {
            break;
        };
        // Archives made on a Mac carry `__MACOSX` and `.DS_Store` beside the content.
        let ours = |e: &std::fs::DirEntry| {
            let name = e.file_name();
            let name = name.to_string_lossy();
            !name.starts_with('.') && !name.starts_with("__")
        };
        let inside: Vec<_> = entries.flatten().filter(ours).collect();
        match inside.as_slice() {
            [one] if one.path().is_dir() => folder = one.path(),
            _ => break,
        }
    }
    folder
}
