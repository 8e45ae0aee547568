//! The exact state of a render in a file: what is resumed ends in the same bits as what was never interrupted.

use std::io::Write;
use std::path::Path;

use sha2::{Digest, Sha256};

use super::renderer::Renderer;
use super::state::Cursor;
use crate::{Error, Result};

const MAGIC: &[u8; 16] = b"limpid-render-1\n";
const HASH_BYTES: usize = 32;

impl Renderer {
    /// Whatever changes the sums, apart from the number of samples.
    fn identity(&self) -> [u8; HASH_BYTES] {
        let s = &self.settings;
        let mut hash = Sha256::new();
        hash.update(bytemuck::cast_slice::<_, u8>(&self.rows));
        hash.update(format!(
            "{}x{} {} {} {} {} {} {} {:?}",
            self.state.width,
            self.state.height,
            s.seed,
            s.bounces,
            s.estimator,
            s.sampler,
            s.aa,
            s.batch_size(),
            self.features
        ));
        hash.finalize().into()
    }

    /// The state as bytes.
    pub fn checkpoint_bytes(&self) -> Result<Vec<u8>> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend(self.identity());
        for value in [self.cursor.begin, self.cursor.end, self.cursor.row, 0] {
            bytes.extend(value.to_le_bytes());
        }
        for buffer in self.state.sums() {
            bytes.extend(self.gpu.download::<u8>(&buffer.all())?);
        }
        let digest = Sha256::digest(&bytes);
        bytes.extend(digest);
        Ok(bytes)
    }

    /// Goes on from such bytes; they must come from the same scene, size and settings (`spp` may grow).
    pub fn restore_bytes(&mut self, bytes: &[u8]) -> Result<()> {
        let header = MAGIC.len() + HASH_BYTES + 16;
        let sums: Vec<_> = self.state.sums().into_iter().map(|b| b.all()).collect();
        let size = header + sums.iter().map(|s| s.bytes() as usize).sum::<usize>() + HASH_BYTES;
        if bytes.len() < header || bytes[..MAGIC.len()] != MAGIC[..] {
            return Err(Error::input("not a checkpoint of a render"));
        }
        if bytes[MAGIC.len()..MAGIC.len() + HASH_BYTES] != self.identity() {
            return Err(Error::input("this checkpoint belongs to another scene, size or settings: render anew"));
        }
        if bytes.len() != size {
            return Err(Error::input(format!("damaged checkpoint: {} bytes instead of {size}", bytes.len())));
        }
        let (body, digest) = bytes.split_at(size - HASH_BYTES);
        if Sha256::digest(body)[..] != *digest {
            return Err(Error::input("damaged checkpoint: its checksum does not match"));
        }
        let word = |i: usize| u32::from_le_bytes(std::array::from_fn(|k| body[MAGIC.len() + HASH_BYTES + 4 * i + k]));
        let cursor = Cursor { begin: word(0), end: word(1), row: word(2) };
        if cursor.begin > cursor.end || cursor.end > self.settings.spp || cursor.row >= self.state.height {
            return Err(Error::input(format!("this checkpoint has {} samples, more than asked for", cursor.end)));
        }
        if cursor == Cursor::default() {
            self.restart();
            return Ok(());
        }
        let mut at = header;
        for slice in sums {
            let end = at + slice.bytes() as usize;
            self.gpu.upload(&slice, &body[at..end])?;
            at = end;
        }
        self.cursor = cursor;
        self.restore_first_hits()
    }

    /// Writes the state to a file: to a temporary one first, so that none is ever half written.
    pub fn checkpoint(&self, path: &Path) -> Result<()> {
        let directory = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let mut file = tempfile::NamedTempFile::new_in(directory).map_err(|e| Error::io(path, e))?;
        file.write_all(&self.checkpoint_bytes()?).map_err(|e| Error::io(path, e))?;
        file.persist(path).map_err(|e| Error::io(path, e.error))?;
        Ok(())
    }

    /// Goes on from such a file.
    pub fn restore(&mut self, path: &Path) -> Result<()> {
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
        self.restore_bytes(&bytes).map_err(|e| match e {
            Error::Input(text) => Error::input(format!("{}: {text}", path.display())),
            other => other,
        })
    }
}
