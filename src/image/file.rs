//! Files that are whole or not there: written beside their place, then renamed.

use crate::{Error, Result};
use std::fs::{File, OpenOptions};
use std::io::{BufWriter, Cursor, Seek, Write};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// What an encoder writes to.
pub trait WriteSeek: Write + Seek {}
impl<W: Write + Seek> WriteSeek for W {}

/// Calls `fill` with a temporary file in the folder of `path`, then renames it to `path`. Whatever fails, `path` keeps
/// what it had and the temporary file is removed. A path that is no regular file (`/dev/null`, a pipe) is written
/// directly, after `fill` has succeeded.
pub fn write_atomically(path: impl AsRef<Path>, fill: impl FnOnce(&mut dyn WriteSeek) -> Result<()>) -> Result<()> {
    let path = &target(path.as_ref())?;
    if is_special(path) {
        let mut bytes = Cursor::new(Vec::new());
        fill(&mut bytes)?;
        let mut file = open_special(path).map_err(|error| Error::io(path, error))?;
        return file.write_all(bytes.get_ref()).map_err(|error| Error::io(path, error));
    }
    let mut temporary = temporary(path)?;
    let mut writer = BufWriter::new(temporary.as_file_mut());
    fill(&mut writer)?;
    writer.flush().map_err(|error| Error::io(path, error))?;
    drop(writer);
    temporary.as_file().sync_all().map_err(|error| Error::io(path, error))?;
    temporary.persist(path).map_err(|error| Error::io(path, error.error))?;
    Ok(())
}

/// [`write_atomically`] with all bytes at hand.
pub fn write_bytes(path: impl AsRef<Path>, bytes: &[u8]) -> Result<()> {
    let path = path.as_ref();
    write_atomically(path, |out| out.write_all(bytes).map_err(|error| Error::io(path, error)))
}

/// Checks that [`write_atomically`] could make `path`, before hours of work go into what it shall hold. Leaves nothing.
pub fn writable(path: impl AsRef<Path>) -> Result<()> {
    let path = &target(path.as_ref())?;
    if is_special(path) {
        return open_special(path).map(drop).map_err(|error| Error::io(path, error));
    }
    temporary(path).map(drop)
}

/// The file itself where `path` is a link, so that the link stays one.
fn target(path: &Path) -> Result<PathBuf> {
    let path = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    if path.is_dir() || path.file_name().is_none() {
        return Err(Error::input(format!("{}: is a directory; name a file to write", path.display())));
    }
    Ok(path)
}

fn is_special(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|metadata| !metadata.is_file())
}

fn open_special(path: &Path) -> std::io::Result<File> {
    OpenOptions::new().write(true).open(path)
}

fn temporary(path: &Path) -> Result<NamedTempFile> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    if !folder.is_dir() {
        return Err(Error::input(format!(
            "{}: there is no folder '{}'; create it or name another output",
            path.display(),
            folder.display()
        )));
    }
    let mut builder = tempfile::Builder::new();
    builder.prefix(".limpid-").suffix(".part");
    // What a plain new file would get; tempfile alone gives the owner's rights only.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder).map_err(|error| {
        Error::input(format!("{}: cannot write into '{}': {}", path.display(), folder.display(), cause(&error)))
    })
}

/// The operating system's words without the temporary file's name.
fn cause(error: &std::io::Error) -> String {
    error.raw_os_error().map_or_else(|| error.kind(), |code| std::io::Error::from_raw_os_error(code).kind()).to_string()
}
