//! Writing files so that nobody ever sees half of one.

use crate::{Error, Result};
use std::fs::{File, TryLockError};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Distinguishes temporary files that one process writes at the same time.
static COUNTER: AtomicU64 = AtomicU64::new(0);

/// Takes the file `lock` in `folder` for this process alone, as long as what is returned lives; `None` while another has it.
///
/// # Errors
/// Names the file if it cannot be made.
pub fn alone(folder: &Path) -> Result<Option<File>> {
    let path = folder.join("lock");
    let file = File::create(&path).map_err(|e| Error::io(&path, e))?;
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Ok(None),
        // File systems without locks have to do without.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(Some(file)),
    }
}

/// Writes `bytes` to `path`; see [`atomic_file`].
///
/// # Errors
/// Names the file if the folder is missing or cannot be written.
pub fn atomic_write(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    atomic_file(path, |temporary| std::fs::write(temporary, bytes))
}

/// Lets `write` make a temporary file in the same folder, and renames it to `path`: a reader sees
/// the old file or the whole new one, also when this process is killed in between. Whatever `write` does, the file has the
/// permissions of any new file.
///
/// # Errors
/// Names the file if the folder is missing or cannot be written.
pub fn atomic_file(
    path: impl AsRef<Path>,
    write: impl FnOnce(&Path) -> std::io::Result<()>,
) -> Result<()> {
    let path = path.as_ref();
    let Some(name) = path.file_name() else {
        return Err(Error::value(
            "path",
            format!("expected a file name, found `{}`", path.display()),
        ));
    };
    let mut hidden = std::ffi::OsString::from(".");
    hidden.push(name);
    let count = COUNTER.fetch_add(1, Ordering::Relaxed);
    hidden.push(format!(".{}-{count}.tmp", std::process::id()));
    let temporary = path.with_file_name(hidden);
    let written = || {
        // Some writers replace it by a file that nobody else may read.
        let usual = File::create(&temporary)?.metadata()?.permissions();
        write(&temporary)?;
        std::fs::set_permissions(&temporary, usual)?;
        std::fs::rename(&temporary, path)
    };
    written().map_err(|e| {
        // The first error is the one worth reporting, whether or not this removal works.
        let _ = std::fs::remove_file(&temporary);
        Error::io(path, e)
    })
}

/// The bytes of a file.
///
/// # Errors
/// Names the file.
pub fn read_bytes(path: impl AsRef<Path>) -> Result<Vec<u8>> {
    let path = path.as_ref();
    std::fs::read(path).map_err(|e| Error::io(path, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_one_holders_until_it_lets_go() {
        let folder = tempfile::tempdir().expect("folder");
        let first = alone(folder.path()).expect("opens");
        assert!(first.is_some());
        assert!(alone(folder.path()).expect("opens").is_none());
        drop(first);
        assert!(alone(folder.path()).expect("opens").is_some());
        assert!(alone(&folder.path().join("none")).is_err());
    }

    #[test]
    fn replaces_a_file_and_leaves_nothing_else() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("a.txt");
        for text in ["one", "two"] {
            atomic_write(&path, text.as_bytes()).expect("writes");
            assert_eq!(read_bytes(&path).expect("reads"), text.as_bytes());
        }
        assert_eq!(std::fs::read_dir(folder.path()).expect("lists").count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn permissions_are_those_of_any_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("folder");
        let mode = |path: &Path| std::fs::metadata(path).expect("there").permissions().mode();
        let (path, other) = (folder.path().join("a"), folder.path().join("b"));
        std::fs::write(&other, "x").expect("writes");
        let private = |temporary: &Path| {
            std::fs::remove_file(temporary)?;
            let file = tempfile::NamedTempFile::new_in(folder.path())?;
            file.persist(temporary).map_err(|e| e.error)?;
            Ok(())
        };
        atomic_file(&path, private).expect("writes");
        assert_eq!(mode(&path), mode(&other));
    }

    #[test]
    fn an_unwritable_place_is_named() {
        let folder = tempfile::tempdir().expect("folder");
        let file = folder.path().join("file");
        std::fs::write(&file, "x").expect("writes");
        let message = atomic_write(file.join("child.png"), b"x")
            .expect_err("parent is a file")
            .to_string();
        assert!(message.contains("child.png"), "{message}");
        assert!(atomic_write("/", b"x").is_err());
    }
}
