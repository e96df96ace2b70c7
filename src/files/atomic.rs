use crate::error::{Error, Result};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Writes a file that is whole or absent: beside its final name first, renamed when complete.
///
/// A file of that name is replaced, through symbolic links; a failure or an interruption leaves it as it was. `write` is given a
/// buffered writer.
///
/// # Errors
/// Where the folder cannot be written to, the name is that of something other than a file, or `write` fails.
pub fn write_whole(
    path: &Path,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<()> {
    let target = resolve(path)?;
    let in_place = || -> io::Result<()> {
        let mut file = temporary_beside(&target)?;
        let mut out = BufWriter::new(file.as_file_mut());
        write(&mut out)?;
        out.flush()?;
        drop(out);
        file.persist(&target)?;
        Ok(())
    };
    in_place().map_err(|e| Error::io(path, e))
}

/// Whether [`write_whole`] could write a file of this name: to be asked before the work, not after it.
///
/// # Errors
/// Where the folder cannot be written to, or the name is that of something other than a file.
pub fn check_place(path: &Path) -> Result<()> {
    let target = resolve(path)?;
    temporary_beside(&target).map_err(|e| Error::io(path, e))?;
    Ok(())
}

/// The file itself where the name is a link to it: renaming would replace the link.
fn resolve(path: &Path) -> Result<PathBuf> {
    let target = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
    if target.exists() && !target.is_file() {
        return Err(Error::file(
            path,
            "output",
            "it exists and is not a regular file",
            "give the name of a file",
        ));
    }
    Ok(target)
}

fn temporary_beside(target: &Path) -> io::Result<tempfile::NamedTempFile> {
    let folder = match target.parent() {
        Some(folder) if folder != Path::new("") => folder,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    builder.prefix(".vorofit-");
    #[cfg(unix)]
    {
        // Temporary files are private by default; results get what the user's umask gives to any file.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<std::ffi::OsString> {
        let entries = std::fs::read_dir(folder).unwrap();
        entries.map(|e| e.unwrap().file_name()).collect()
    }

    #[test]
    fn a_failure_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write_whole(&path, |out| out.write_all(b"old")).unwrap();
        let failed = write_whole(&path, |out| {
            out.write_all(b"half of the new")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("disk full"));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["a.txt"]);
        write_whole(&path, |out| out.write_all(b"new")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["a.txt"]);
    }

    #[test]
    fn folders_and_missing_folders_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        for path in [folder.path().into(), folder.path().join("none/a.txt")] {
            let attempts = [check_place(&path), write_whole(&path, |_| Ok(()))];
            for message in attempts.map(|attempt| attempt.unwrap_err().to_string()) {
                assert!(
                    message.starts_with(&path.display().to_string()),
                    "{message}"
                );
            }
        }
        assert!(names(folder.path()).is_empty());
    }

    #[cfg(unix)]
    #[test]
    fn links_stay_and_devices_are_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        std::fs::write(&file, "old").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        write_whole(&link, |out| out.write_all(b"new")).unwrap();
        assert!(link.is_symlink());
        assert_eq!(std::fs::read(&file).unwrap(), b"new");
        assert!(write_whole(Path::new("/dev/null"), |_| Ok(())).is_err());
    }
}
