//! The stand-ins of `dca-fakes`: their journal, and the orders for them.

use super::{Cluster, executable};
use comms::logic::time::Time;
use std::collections::BTreeMap;

/// A folder in which all programs are stand-ins.
#[derive(Debug)]
pub struct Fakes<'c> {
    cluster: &'c Cluster,
}

/// The last journal entry of a stand-in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Said {
    /// `active`, `ended` or `stopped`.
    pub word: String,
    /// When, on the machine's clock.
    pub at: Time,
}

impl<'c> Fakes<'c> {
    /// Prepares the folder.
    ///
    /// # Panics
    /// Panics if the folder cannot be written.
    pub fn new(cluster: &'c Cluster) -> Self {
        for folder in ["orders", "heard", "draft"] {
            std::fs::create_dir_all(cluster.folder().join("fakes").join(folder)).expect("the folder is the test's own");
        }
        Self { cluster }
    }

    /// Returns the path of the program, for `--controllers`.
    pub fn program() -> String {
        executable("dca-fakes").display().to_string()
    }

    /// Gives an order to a program: `done`, `abort why`, `hang`.
    ///
    /// # Panics
    /// Panics if the order cannot be written.
    pub fn order(&self, path: &str, order: &str) {
        let file = self.file("orders", path);
        // Read as a whole, or not there yet.
        let draft = file.with_extension("draft");
        std::fs::write(&draft, order).and_then(|()| std::fs::rename(&draft, &file)).expect("an order is a file");
    }

    /// Returns the last journal entry of each program, by its path.
    ///
    /// # Panics
    /// Panics if the time of a journal entry is not a number.
    pub fn said(&self) -> BTreeMap<String, Said> {
        let text = std::fs::read_to_string(self.cluster.folder().join("fakes/journal")).unwrap_or_default();
        let mut said = BTreeMap::new();
        // It reads a line that is still being written the next time.
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        for line in whole.lines() {
            if let [at, path, word] = line.split(' ').collect::<Vec<_>>()[..] {
                let at = Time::from_nanos(at.parse().expect("a stand-in writes nanoseconds"));
                said.insert(path.to_owned(), Said { word: word.to_owned(), at });
            }
        }
        said
    }

    /// Returns the paths of the active programs: they have begun, and have not ended, stopped or died.
    pub fn active(&self) -> Vec<String> {
        let alive = self.cluster.left();
        let is_alive = |path: &str| {
            let mark = format!("DCA_INSTANCE={path}");
            alive.iter().any(|process| process.environment.contains(&mark))
        };
        let active = self.said().into_iter().filter(|(_, said)| said.word == "active").map(|(path, _)| path);
        active.filter(|path| is_alive(path)).collect()
    }

    /// Returns how many samples an input of a program has received, from its file of counts.
    pub fn heard(&self, path: &str, port: &str) -> u64 {
        let text = std::fs::read_to_string(self.file("heard", path)).unwrap_or_default();
        let mut lines = text.lines().filter_map(|line| line.split_once(' '));
        lines.find(|(name, _)| *name == port).and_then(|(_, count)| count.parse().ok()).unwrap_or(0)
    }

    fn file(&self, folder: &str, path: &str) -> std::path::PathBuf {
        self.cluster.folder().join("fakes").join(folder).join(path.replace('/', "+"))
    }
}
