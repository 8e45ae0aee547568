//! The verdict of a self-check on disk. A file that is missing or damaged counts as none; one that cannot be written is left
//! out.

use crate::image::file::write_bytes;
use crate::{Error, Result};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// More than any verdict has.
const MAX_BYTES: u64 = 1 << 16;

/// What a self-check found.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Every row was within its bound.
    Passed,
    /// The first that was not.
    Failed(String),
}

impl Verdict {
    /// What an earlier process left in a file.
    pub fn recall(file: &Path) -> Option<Self> {
        if std::fs::metadata(file).ok()?.len() > MAX_BYTES {
            return None;
        }
        serde_json::from_slice(&std::fs::read(file).ok()?).ok()
    }

    /// Leaves it for later processes.
    pub fn remember(&self, file: &Path) {
        if let Err(error) = self.write(file) {
            log::info!("the self-check is not remembered: {error}");
        }
    }

    fn write(&self, file: &Path) -> Result<()> {
        let folder = file.parent().unwrap_or(file);
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        let text = serde_json::to_vec(self).map_err(|e| Error::input(e.to_string()))?;
        write_bytes(file, &text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_verdict_comes_back_and_a_damaged_file_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("checks/cpu");
        assert_eq!(Verdict::recall(&file), None);
        for verdict in [Verdict::Passed, Verdict::Failed("conv2d, \"row\": NaN".to_owned())] {
            verdict.remember(&file);
            assert_eq!(Verdict::recall(&file), Some(verdict));
        }
        for bad in [&b""[..], b"{", b"\"pass", b"{\"failed\":", b"{\"failed\":1}", b"true", b"\xff\xfe"] {
            std::fs::write(&file, bad).unwrap();
            assert_eq!(Verdict::recall(&file), None, "{bad:?}");
        }
        // A file where a folder should be, and a folder where the file should be.
        Verdict::Passed.remember(&file.join("x"));
        Verdict::Passed.remember(folder.path());
        assert_eq!(Verdict::recall(folder.path()), None);
    }
}
