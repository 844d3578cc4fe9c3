//! Atomic file writes: a temporary file in the same directory, synced to disk, then renamed.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use tempfile::{NamedTempFile, TempPath};

use super::ImageError;

/// Checks that a file could be written to `path`, without changing an existing one.
pub fn check_writable(path: &Path) -> Result<(), ImageError> {
    // Check the folder and the path
    let folder = folder_of(path);
    if !folder.is_dir() {
        return Err(ImageError::NoFolder {
            path: path.to_owned(),
            folder,
        });
    }
    if path.is_dir() {
        return Err(ImageError::IsFolder(path.to_owned()));
    }
    // Create and remove a temporary file
    temporary_in(&folder).map_err(|source| ImageError::NotWritable { folder, source })?;
    Ok(())
}

/// Writes a temporary file beside `path` with `write`, then renames it to `path`.
///
/// If anything fails the temporary file is removed and `path` is unchanged. On return the new file is on disk; after a
/// crash of the machine before that, the old one is.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), ImageError> {
    let attempt = || {
        let mut file = AtomicFile::create(path)?;
        write(&mut file.file)?;
        file.commit()
    };
    attempt().map_err(|error| write_error(path, &error))
}

/// Returns the error for a failed write of `path`.
pub(super) fn write_error(path: &Path, error: &io::Error) -> ImageError {
    ImageError::Write {
        path: path.to_owned(),
        message: error.to_string(),
    }
}

/// File that is written under a temporary name in the target's directory and renamed by [`AtomicFile::commit`].
///
/// Dropped before that, it removes itself.
#[derive(Debug)]
pub(super) struct AtomicFile {
    path: PathBuf,
    file: BufWriter<File>,
    name: TempPath,
}

impl AtomicFile {
    /// Creates the temporary file in the directory of `path`.
    pub(super) fn create(path: &Path) -> io::Result<AtomicFile> {
        let (file, name) = temporary_in(&folder_of(path))?.into_parts();
        Ok(AtomicFile {
            path: path.to_owned(),
            file: BufWriter::with_capacity(BUFFER_BYTES, file),
            name,
        })
    }

    /// Syncs the contents to disk, renames the file, and syncs the directory.
    pub(super) fn commit(self) -> io::Result<()> {
        let file = self.file.into_inner().map_err(io::IntoInnerError::into_error)?;
        // Without this the rename could reach the disk before the contents.
        file.sync_all()?;
        // Close before the rename, which some systems refuse for an open file.
        drop(file);
        self.name.persist(&self.path).map_err(|failed| failed.error)?;
        sync_folder(&folder_of(&self.path))
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for AtomicFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// Syncs the directory entries to disk, if the system supports it.
#[cfg(unix)]
fn sync_folder(folder: &Path) -> io::Result<()> {
    use io::ErrorKind::{InvalidInput, PermissionDenied, Unsupported};
    match File::open(folder).and_then(|folder| folder.sync_all()) {
        // Some file systems persist names by other means, and a directory may be writable but not readable.
        Err(error) if matches!(error.kind(), InvalidInput | PermissionDenied | Unsupported) => Ok(()),
        result => result,
    }
}

/// Does nothing: other systems have no such call.
#[cfg(not(unix))]
fn sync_folder(_: &Path) -> io::Result<()> {
    Ok(())
}

/// Buffer size in bytes, as encoders write in small pieces.
const BUFFER_BYTES: usize = 1 << 18;

/// Returns the directory of `path`, `.` if its name has none.
fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent.to_owned(),
        _ => PathBuf::from("."),
    }
}

/// Creates a temporary file that is deleted unless it is renamed, with the permissions of any new file.
fn temporary_in(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".whit-").suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // The umask applies, as for every new file; the builder's default would deny access to other users.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names_in(folder: &Path) -> Vec<String> {
        std::fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect()
    }

    #[test]
    fn failed_write_leaves_only_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        std::fs::write(&path, b"old").unwrap();
        let error = write_atomically(&path, |file| {
            file.write_all(b"new")?;
            Err(io::Error::other("no more ink"))
        })
        .unwrap_err();
        assert_eq!(
            error.to_string(),
            format!("could not write {}: no more ink", path.display())
        );
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(names_in(folder.path()), ["a.png"]);
    }

    #[test]
    fn finished_write_replaces_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        std::fs::write(&path, b"old").unwrap();
        write_atomically(&path, |file| file.write_all(b"new")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(names_in(folder.path()), ["a.png"]);
    }

    #[test]
    fn dropped_incomplete_file_leaves_only_the_old_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        std::fs::write(&path, b"old").unwrap();
        let mut file = AtomicFile::create(&path).unwrap();
        file.write_all(b"half of the n").unwrap();
        file.flush().unwrap();
        drop(file);
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(names_in(folder.path()), ["a.exr"]);
    }

    #[test]
    fn folder_at_the_target_path_fails_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        std::fs::create_dir(&path).unwrap();
        write_atomically(&path, |file| file.write_all(b"new")).unwrap_err();
        assert!(path.is_dir());
        assert_eq!(names_in(folder.path()), ["a.exr"]);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn full_disk_reports_the_system_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        std::fs::write(&path, b"old").unwrap();
        let error = write_atomically(&path, |_| {
            // This device is always full.
            let mut full = File::options().write(true).open("/dev/full")?;
            full.write_all(b"new")
        })
        .unwrap_err();
        let said = error.to_string();
        assert!(
            said.starts_with(&format!("could not write {}: No space left", path.display())),
            "{said}"
        );
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
    }

    #[cfg(unix)]
    #[test]
    fn written_file_has_default_permissions() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (ours, plain) = (folder.path().join("ours"), folder.path().join("plain"));
        write_atomically(&ours, |_| Ok(())).unwrap();
        std::fs::write(&plain, b"").unwrap();
        let mode = |path| std::fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(ours), mode(plain));
    }

    #[test]
    fn path_check_separates_missing_parent_from_folder_at_path() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("no/a.png");
        assert!(matches!(
            check_writable(&missing),
            Err(ImageError::NoFolder { .. })
        ));
        assert!(matches!(
            check_writable(folder.path()),
            Err(ImageError::IsFolder(_))
        ));
        check_writable(&folder.path().join("a.png")).unwrap();
        assert_eq!(names_in(folder.path()), Vec::<String>::new());
    }
}
