//! Where a record of a Zarr store is: a folder of this machine, or an object store.

use super::group::plain;
use lumi_core::{Error, Result};
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use zarrs::filesystem::FilesystemStore;
use zarrs::storage::{ReadableWritableListableStorage, StoreKey, StorePrefix};

/// Schemes of the URLs of object stores.
const SCHEMES: [&str; 2] = ["s3", "s3a"];

/// A record's place in its store.
pub(super) struct Place {
    /// Folder or URL of the record, for messages.
    path: PathBuf,
    name: String,
    /// The store's folder, where it is one.
    folder: Option<PathBuf>,
    storage: ReadableWritableListableStorage,
}

impl Place {
    /// The record at `STORE/NAME`.
    pub fn of(path: &Path) -> Result<Self> {
        let wrong = || {
            let expected = "expected STORE/NAME";
            Error::value(format!("path `{}`", path.display()), expected)
        };
        let name = path
            .file_name()
            .and_then(|n| n.to_str())
            .ok_or_else(wrong)?;
        let store = path.parent().ok_or_else(wrong)?;
        let (folder, storage) = storage(store)?;
        Ok(Self {
            path: path.to_owned(),
            name: name.to_owned(),
            folder,
            storage,
        })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    pub fn storage(&self) -> &ReadableWritableListableStorage {
        &self.storage
    }

    /// Whether the record has this key below its group.
    pub fn has(&self, key: &str) -> Result<bool> {
        self.store_has(&format!("{}/{key}", self.name))
    }

    /// Whether the store has this key.
    pub fn store_has(&self, key: &str) -> Result<bool> {
        let size = self.storage.size_key(&self.key(key)?);
        Ok(size.map_err(|e| self.wrong(key, &e))?.is_some())
    }

    /// Stores small metadata whole or not at all.
    pub fn put(&self, key: &str, bytes: &[u8]) -> Result<()> {
        if let Some(folder) = &self.folder {
            let path = folder.join(key);
            if let Some(parent) = path.parent() {
                std::fs::create_dir_all(parent).map_err(|e| Error::io(parent, e))?;
            }
            return lumi_core::fs::atomic_write(path, bytes);
        }
        let stored = self.storage.set(&self.key(key)?, bytes.to_vec().into());
        stored.map_err(|e| self.wrong(key, &e))
    }

    /// Removes the record: its group's metadata first, so that nobody takes a part for the whole.
    pub fn erase(&self) -> Result<()> {
        let key = format!("{}/zarr.json", self.name);
        let erased = self.storage.erase(&self.key(&key)?);
        erased.map_err(|e| self.wrong(&key, &e))?;
        let prefix = StorePrefix::new(format!("{}/", self.name));
        let prefix = prefix.map_err(|e| self.wrong(&key, &e))?;
        let erased = self.storage.erase_prefix(&prefix);
        erased.map_err(|e| self.wrong(&key, &e))
    }

    fn key(&self, key: &str) -> Result<StoreKey> {
        StoreKey::new(key).map_err(|e| self.wrong(key, &e))
    }

    /// What a library says about `field` of the record.
    pub fn wrong(&self, field: &str, e: &dyn Display) -> Error {
        wrong(&self.path, field, e)
    }
}

/// The names of the complete groups of a store, sorted.
pub(super) fn names(store: &Path) -> Result<Vec<String>> {
    let (_, storage) = storage(store)?;
    let wrong = |e: &dyn Display| wrong(store, "store", e);
    let found = storage
        .list_dir(&StorePrefix::root())
        .map_err(|e| wrong(&e))?;
    let mut names = Vec::new();
    for prefix in found.prefixes() {
        let name = prefix.as_str().trim_end_matches('/');
        let key = StoreKey::new(format!("{name}/zarr.json")).map_err(|e| wrong(&e))?;
        if plain(name).is_ok() && storage.size_key(&key).map_err(|e| wrong(&e))?.is_some() {
            names.push(name.to_owned());
        }
    }
    names.sort();
    Ok(names)
}

/// Whether `path` is a URL, of an object store if it is right, and no folder.
pub(super) fn is_remote(path: &Path) -> bool {
    url(path).is_some()
}

/// The URL that a path spells, as scheme and the rest behind the slashes: `s3`, `bucket/folder`.
fn url(path: &Path) -> Option<(&str, &str)> {
    let (scheme, rest) = path.to_str()?.split_once(':')?;
    let word = scheme.len() > 1 && scheme.chars().all(|c| c.is_ascii_alphanumeric());
    // Joining paths may have taken one of the two slashes, and a parent both. Schemes that we do not know are URLs all
    // the same: a folder called `gs:` is nobody's wish. A single letter is a drive.
    let other = word && (rest.is_empty() || rest.starts_with("//"));
    let known = SCHEMES.contains(&scheme) && rest.starts_with('/');
    (other || known).then(|| (scheme, rest.trim_start_matches('/')))
}

/// A store and, where it is on this machine, its folder.
fn storage(store: &Path) -> Result<(Option<PathBuf>, ReadableWritableListableStorage)> {
    if let Some((scheme, rest)) = url(store) {
        let (bucket, folder) = rest.split_once('/').unwrap_or((rest, ""));
        if !SCHEMES.contains(&scheme) || bucket.is_empty() {
            let expected = "expected a folder or s3://BUCKET/FOLDER";
            return Err(Error::invalid(store, "store", expected));
        }
        return Ok((None, super::remote::open(store, bucket, folder)?));
    }
    // An empty path is the current folder, for the file system but not for zarrs.
    let folder = if store.as_os_str().is_empty() {
        Path::new(".")
    } else {
        store
    };
    let opened = FilesystemStore::new(folder);
    let opened = opened.map_err(|e| wrong(folder, "store", &e))?;
    Ok((Some(folder.to_owned()), Arc::new(opened)))
}

/// What a library says about `field`. Its messages, and those of servers, may have several lines; ours have one.
pub(super) fn wrong(path: &Path, field: &str, e: &dyn Display) -> Error {
    let text = e.to_string();
    let words: Vec<&str> = text.split_whitespace().collect();
    Error::invalid(path, field, words.join(" "))
}
