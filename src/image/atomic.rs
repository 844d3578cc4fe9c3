//! Files that appear whole or not at all: a temporary neighbour, then a rename.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use super::ImageError;

/// Checks that a file could be written to `path`, without touching whatever is there.
pub fn check_writable(path: &Path) -> Result<(), ImageError> {
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
    temporary_in(&folder).map_err(|source| ImageError::NotWritable { folder, source })?;
    Ok(())
}

/// Lets `write` fill a temporary file beside `path`, then renames it to `path`.
///
/// If anything fails the temporary file is removed and `path` is as it was. A crash of the whole machine may lose
/// the new file, as it is not forced to the disk.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), ImageError> {
    let fail = |error: &dyn std::fmt::Display| ImageError::Write {
        path: path.to_owned(),
        message: error.to_string(),
    };
    let (file, name) = temporary_in(&folder_of(path)).map_err(|e| fail(&e))?.into_parts();
    let mut file = BufWriter::with_capacity(BUFFER_BYTES, file);
    write(&mut file)
        .and_then(|()| file.flush())
        .map_err(|e| fail(&e))?;
    // Closed before the rename, which some systems refuse for an open file.
    drop(file);
    name.persist(path).map_err(|e| fail(&e.error))
}

/// Encoders write in small pieces; this many bytes reach the system at once.
const BUFFER_BYTES: usize = 1 << 18;

/// The folder that holds `path`, which may have none in its name.
fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent.to_owned(),
        _ => PathBuf::from("."),
    }
}

/// A file that vanishes unless it is renamed, with the permissions of any new file.
fn temporary_in(folder: &Path) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".whit-").suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Less the umask, as for every new file; the builder's own default shuts everybody else out.
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
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
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
    fn a_finished_write_replaces_the_old_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        std::fs::write(&path, b"old").unwrap();
        write_atomically(&path, |file| file.write_all(b"new")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(names_in(folder.path()), ["a.png"]);
    }

    #[cfg(unix)]
    #[test]
    fn a_written_file_has_the_permissions_of_any_new_file() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (ours, plain) = (folder.path().join("ours"), folder.path().join("plain"));
        write_atomically(&ours, |_| Ok(())).unwrap();
        std::fs::write(&plain, b"").unwrap();
        let mode = |path| std::fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(ours), mode(plain));
    }

    #[test]
    fn checking_tells_a_missing_folder_from_a_folder_in_the_way_and_leaves_nothing() {
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
