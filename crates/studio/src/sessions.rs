//! All sessions: a few in memory, the others in a folder, one file each.

use crate::engine::Engine;
use crate::limits::{OPEN_SESSIONS, SAVED_SESSIONS};
use crate::maps::Maps;
use crate::session::Session;
use crate::session_file::{self, Summary};
use crate::{Error, Result};
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::HashMap;
use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Instant, UNIX_EPOCH};

/// Suffix of session files.
const SUFFIX: &str = "lumi-session";

/// The sessions.
pub struct Sessions {
    folder: PathBuf,
    engine: Arc<Engine>,
    maps: Arc<Maps>,
    open: Mutex<HashMap<String, Open>>,
    /// One file is written at a time.
    writing: Mutex<()>,
    /// The folder's lock, unless another studio has it.
    lock: Option<File>,
}

/// A session in memory.
struct Open {
    session: Arc<Session>,
    used: Instant,
    /// Revision that its file holds, or that needs none; `None` if it must be written.
    saved: Option<u64>,
}

/// A row of the list of sessions.
#[derive(Serialize, JsonSchema)]
pub struct Listed {
    id: String,
    #[serde(flatten)]
    summary: Summary,
    /// Seconds since 1970 of the last change, for sessions on disk.
    modified: Option<u64>,
    /// Whether the model at hand can open it.
    usable: bool,
}

/// An id that nobody guesses by accident: 16 hexadecimal digits.
#[must_use]
pub fn new_id() -> String {
    format!("{:016x}", rand::random::<u64>())
}

impl Sessions {
    /// Sessions that are kept in `folder`, which is made if it is missing.
    ///
    /// # Errors
    /// If the folder cannot be made.
    pub fn new(folder: PathBuf, engine: Arc<Engine>, maps: Arc<Maps>) -> Result<Self> {
        std::fs::create_dir_all(&folder).map_err(|e| lumi_core::Error::io(&folder, e))?;
        let lock = lumi_core::fs::alone(&folder)?;
        Ok(Self {
            folder,
            engine,
            maps,
            open: Mutex::default(),
            writing: Mutex::default(),
            lock,
        })
    }

    /// Whether no other studio keeps its sessions in the folder.
    #[must_use]
    pub fn are_alone(&self) -> bool {
        self.lock.is_some()
    }

    /// Takes a new session in, which the next [`Self::save_all`] writes.
    ///
    /// # Errors
    /// If there are too many on disk.
    pub fn insert(&self, session: Arc<Session>) -> Result<()> {
        if self.files().len() >= SAVED_SESSIONS {
            let text = format!(
                "{}: expected at most {SAVED_SESSIONS} saved sessions: delete some",
                self.folder.display()
            );
            return Err(Error::TooLarge(text));
        }
        self.keep(session, None);
        self.make_room()
    }

    /// Takes the session in that the program begins with. It is made anew at every start, so it is written only once it
    /// is changed, and needs no room on disk: a full folder must not keep anybody from deleting sessions.
    ///
    /// # Errors
    /// If another session must leave memory for it and cannot be written.
    pub fn insert_opening(&self, session: Arc<Session>) -> Result<()> {
        let saved = session.revision();
        self.keep(session, Some(saved));
        self.make_room()
    }

    /// The session called `id`, from memory or from its file.
    ///
    /// # Errors
    /// If there is none, or its file cannot be read.
    pub fn get(&self, id: &str) -> Result<Arc<Session>> {
        if let Some(open) = self.open().get_mut(id) {
            open.used = Instant::now();
            return Ok(Arc::clone(&open.session));
        }
        let path = self.path(id)?;
        if !path.is_file() {
            let text = format!("session `{id}`: there is no such session");
            return Err(Error::NotFound(text));
        }
        let bytes = lumi_core::fs::read_bytes(&path)?;
        let session = session_file::decode(id.to_owned(), &bytes, &self.engine, &self.maps)?;
        let session = self.keep(session, Some(0));
        self.make_room()?;
        Ok(session)
    }

    /// Every session, newest first.
    #[must_use]
    pub fn list(&self) -> Vec<Listed> {
        let here = &self.engine.model().fingerprint;
        let mut rows: HashMap<String, Listed> = HashMap::new();
        for path in self.files() {
            let id = path.file_stem().unwrap_or_default().to_string_lossy();
            // A broken file is not listed; asking for it by name says what is wrong with it.
            let Ok(summary) = session_file::summary(&path) else {
                continue;
            };
            let modified = path.metadata().and_then(|m| m.modified()).ok();
            let seconds = modified.and_then(|t| t.duration_since(UNIX_EPOCH).ok());
            let row = Listed {
                id: id.clone().into_owned(),
                usable: summary.model == *here,
                summary,
                modified: seconds.map(|s| s.as_secs()),
            };
            rows.insert(id.into_owned(), row);
        }
        for (id, open) in self.open().iter() {
            let steps = open.session.tree().nodes().count();
            let row = Listed {
                id: id.clone(),
                modified: rows.get(id).and_then(|r| r.modified),
                usable: true,
                summary: Summary {
                    name: open.session.capture.name.clone(),
                    steps,
                    model: here.clone(),
                },
            };
            rows.insert(id.clone(), row);
        }
        let mut rows: Vec<Listed> = rows.into_values().collect();
        rows.sort_by(|a, b| b.modified.cmp(&a.modified).then(a.id.cmp(&b.id)));
        rows
    }

    /// Forgets a session and deletes its file.
    ///
    /// # Errors
    /// If there is none.
    pub fn remove(&self, id: &str) -> Result<()> {
        let path = self.path(id)?;
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        let open = self.open().remove(id).is_some();
        match std::fs::remove_file(&path) {
            Ok(()) => Ok(()),
            Err(_) if open => Ok(()),
            Err(_) => Err(Error::NotFound(format!(
                "session `{id}`: there is no such session"
            ))),
        }
    }

    /// Writes every session that changed since its file was written.
    ///
    /// # Errors
    /// The first file that could not be written; the others are tried all the same.
    pub fn save_all(&self) -> Result<()> {
        let changed: Vec<Arc<Session>> = {
            let open = self.open();
            let changed = open
                .values()
                .filter(|o| o.saved != Some(o.session.revision()));
            changed.map(|o| Arc::clone(&o.session)).collect()
        };
        let save = |session: &Arc<Session>| {
            // A fault with one session must not keep the others from being written.
            let saved = catch_unwind(AssertUnwindSafe(|| self.save(session)));
            let fault = |_| {
                let text = format!("session `{}`: writing it ended early", session.id);
                Err(Error::Internal(text))
            };
            saved.unwrap_or_else(fault)
        };
        let written: Vec<Result<()>> = changed.iter().map(save).collect();
        written.into_iter().collect()
    }

    fn save(&self, session: &Arc<Session>) -> Result<()> {
        let _writing = self.writing.lock().unwrap_or_else(PoisonError::into_inner);
        if !self.open().contains_key(&session.id) {
            return Ok(()); // Removed meanwhile.
        }
        let revision = session.revision();
        let bytes = session_file::encode(session, &self.engine, &self.maps)?;
        lumi_core::fs::atomic_write(self.path(&session.id)?, &bytes)?;
        if let Some(open) = self.open().get_mut(&session.id) {
            open.saved = Some(revision);
        }
        Ok(())
    }

    /// Puts a session into memory, unless somebody else has just done so; returns the one that stays.
    fn keep(&self, session: Arc<Session>, saved: Option<u64>) -> Arc<Session> {
        let mut open = self.open();
        let open = open.entry(session.id.clone()).or_insert(Open {
            session,
            used: Instant::now(),
            saved,
        });
        Arc::clone(&open.session)
    }

    /// Moves the sessions that nobody has used for longest to disk.
    fn make_room(&self) -> Result<()> {
        loop {
            let oldest = {
                let open = self.open();
                if open.len() <= OPEN_SESSIONS {
                    return Ok(());
                }
                // Those that a request or a page holds stay.
                let idle = open.values().filter(|o| Arc::strong_count(&o.session) == 1);
                let oldest = idle.min_by_key(|o| o.used);
                oldest.map(|o| Arc::clone(&o.session))
            };
            let Some(oldest) = oldest else {
                return Ok(());
            };
            self.save(&oldest)?;
            let mut open = self.open();
            // Two owners are this function and the table: a request that took it meanwhile keeps it.
            let idle = Arc::strong_count(&oldest) == 2;
            if idle
                && open
                    .get(&oldest.id)
                    .is_some_and(|o| o.saved == Some(oldest.revision()))
            {
                open.remove(&oldest.id);
            } else if let Some(open) = open.get_mut(&oldest.id) {
                open.used = Instant::now();
            }
        }
    }

    fn open(&self) -> MutexGuard<'_, HashMap<String, Open>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn files(&self) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(&self.folder).into_iter().flatten();
        let paths = entries.flatten().map(|e| e.path());
        let session = |p: &PathBuf| p.extension().is_some_and(|e| e == SUFFIX);
        paths.filter(session).collect()
    }

    /// The file of `id`, which comes from a request.
    fn path(&self, id: &str) -> Result<PathBuf> {
        let plain = id.len() == 16 && id.bytes().all(|b| b.is_ascii_hexdigit());
        if !plain {
            return Err(Error::NotFound(
                "session: expected an id of 16 hexadecimal digits".into(),
            ));
        }
        Ok(Path::new(&self.folder).join(format!("{id}.{SUFFIX}")))
    }
}
