//! The execution policy of a node: the programs that others may start on it, and their limits. It is a file on the node's own disk,
//! which other hosts cannot change.
//!
//! ```toml
//! folders = ["/opt/robot/bin"]        # programs below these, or
//! hashes = ["blake3:5f0e…"]           # programs with these BLAKE3 hashes
//! user = "dca-run"                    # as whom programs run
//! root = false                        # whether any may run as root
//! sandbox = "standard"                # or "none"
//! devices = ["arm", "camera"]         # what programs may claim
//! secrets = ["team/camera/"]          # keys of secrets that they may be given
//! environment = ["ROS_*"]             # variables that specs may set or inherit for them
//! realtime = 40                       # the highest real-time priority; 0 for none
//! memory = 2_000_000_000              # bytes of a program
//! cores = 1.5                         # its share of the processors
//! cpu = 3600                          # its processor time, in seconds
//! pids = 64                           # its processes and threads
//! files = 1024                        # its open files
//! file_size = 100_000_000             # its longest file, in bytes
//! ```
//!
//! A missing rule restricts nothing, except that `root` and `sandbox = "none"` have to be permitted explicitly. A limit is the highest
//! value that a spec may request. It is also the default for a program whose spec requests no value.

use serde::Deserialize;
use std::path::{Component, Path, PathBuf};
use thiserror::Error;
use toml::Spanned;

/// The most bytes of the file.
pub const POLICY_MAX: usize = 256 << 10;
/// The most entries of a list.
pub const ENTRIES_MAX: usize = 1024;
/// The highest real-time priority that a program may have. The node's own threads have 50.
pub const REALTIME_MAX: u64 = 49;
/// The largest number of processors that a rule may name.
const CORES_MAX: f64 = 4096.0;

// Wide: each field is a key of the file, which is flat. Serde cannot reject unknown keys in a file with flattened parts.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    folders: Option<Spanned<Vec<PathBuf>>>,
    hashes: Option<Spanned<Vec<String>>>,
    user: Option<Spanned<String>>,
    root: Option<Spanned<bool>>,
    #[serde(default)]
    sandbox: Sandbox,
    devices: Option<Spanned<Vec<String>>>,
    secrets: Option<Spanned<Vec<String>>>,
    environment: Option<Spanned<Vec<String>>>,
    realtime: Option<Spanned<u64>>,
    memory: Option<Spanned<u64>>,
    cores: Option<Spanned<f64>>,
    cpu: Option<Spanned<u64>>,
    pids: Option<Spanned<u64>>,
    files: Option<Spanned<u64>>,
    file_size: Option<Spanned<u64>>,
}

/// Which rights are taken away from a program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Sandbox {
    /// The program has no capabilities, and programs that it executes cannot gain rights.
    #[default]
    Standard,
    /// Nothing.
    None,
}

/// A rule with its line in the file.
#[derive(Clone, Debug, PartialEq)]
struct Rule<T> {
    value: T,
    /// From 1 on.
    line: usize,
}

/// A policy that was read and found valid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Policy {
    folders: Option<Rule<Vec<PathBuf>>>,
    hashes: Option<Rule<Vec<[u8; 32]>>>,
    user: Option<Rule<String>>,
    root: Option<Rule<bool>>,
    sandbox: Sandbox,
    devices: Option<Rule<Vec<String>>>,
    secrets: Option<Rule<Vec<String>>>,
    environment: Option<Rule<Vec<String>>>,
    limits: Vec<(&'static str, Rule<u64>)>,
}

/// The limits that a program requests or gets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Limits {
    /// The real-time priority.
    pub realtime: Option<u64>,
    /// The memory, in bytes.
    pub memory: Option<u64>,
    /// The share of the processors, in thousandths of one processor.
    pub cores: Option<u64>,
    /// The processor time, in seconds.
    pub cpu: Option<u64>,
    /// The number of processes and threads.
    pub pids: Option<u64>,
    /// The number of open files.
    pub files: Option<u64>,
    /// The longest file, in bytes.
    pub file_size: Option<u64>,
}

/// A program to be started.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// The path of the program. The caller has resolved all links in it.
    pub program: &'a Path,
    /// The BLAKE3 hash of the program; needed only if [`Policy::needs_hash`] returns true.
    pub hash: Option<[u8; 32]>,
    /// The user that the program is to run as, for people.
    pub user: &'a str,
    /// Whether that user is root.
    pub is_root: bool,
    /// Why the program cannot run as another user. Empty if it can run as another user.
    pub only: &'a str,
    /// The devices that the program claims.
    pub devices: &'a [String],
    /// The keys of the secrets that the program is to get.
    pub secrets: &'a [String],
    /// The variables that the spec sets or inherits: names, or beginnings of names, such as `ROS_*`.
    pub variables: &'a [String],
    /// The limits that the spec requests.
    pub limits: Limits,
}

/// A rule that a program breaks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Denied {
    /// The word of the rule.
    pub rule: &'static str,
    /// The line in the file, from 1; none for a missing rule.
    pub line: Option<usize>,
    /// The reason against the program.
    pub why: String,
}

impl Denied {
    /// Returns the reason as a sentence that names the rule and its line in the file at `path`.
    #[must_use]
    pub fn sentence(&self, path: &Path) -> String {
        let Self { rule, line, why } = self;
        match line {
            Some(line) => format!("{why} (rule `{rule}`, `{}` line {line})", path.display()),
            None => format!("{why} (there is no rule `{rule}` in `{}`)", path.display()),
        }
    }
}

/// Why a policy cannot be used. A node with an invalid policy starts no program.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PolicyError {
    /// The file is not TOML, or has an unknown rule.
    #[error("line {line}: {why}")]
    Toml {
        /// From 1 on.
        line: usize,
        /// The mistake.
        why: String,
    },
    /// The file is too long.
    #[error("a policy has at most {POLICY_MAX} bytes, and {ENTRIES_MAX} entries in a list")]
    TooLong,
    /// A value is not permitted.
    #[error("line {line}: `{value}` is not allowed in `{rule}`: {hint}")]
    Value {
        /// From 1 on.
        line: usize,
        /// The value.
        value: String,
        /// The word of the rule.
        rule: &'static str,
        /// The allowed values.
        hint: &'static str,
    },
}

impl Policy {
    /// Reads a policy.
    ///
    /// # Errors
    /// If the text is not a policy. Mistakes are never corrected by guessing.
    pub fn parse(text: &str) -> Result<Self, PolicyError> {
        if text.len() > POLICY_MAX {
            return Err(PolicyError::TooLong);
        }
        let file: File = toml::from_str(text).map_err(|error| PolicyError::Toml {
            line: line(text, error.span().map_or(0, |span| span.start)),
            why: error.message().trim_end().replace('\n', "; "),
        })?;
        let reader = Reader { text };
        let limits = [
            reader.limit("realtime", file.realtime)?,
            reader.limit("memory", file.memory)?,
            reader.cores(file.cores)?,
            reader.limit("cpu", file.cpu)?,
            reader.limit("pids", file.pids)?,
            reader.limit("files", file.files)?,
            reader.limit("file_size", file.file_size)?,
        ];
        let no_path = "write an absolute path without `..`";
        let no_hash = "write 64 digits from 0 to f";
        let no_name = "write a name that is not empty";
        let is_named = |name: &String| (!name.is_empty()).then(|| name.clone());
        Ok(Self {
            folders: reader.list("folders", file.folders, no_path, |path| is_plain(path).then(|| path.clone()))?,
            hashes: reader.list("hashes", file.hashes, no_hash, |text| hash(text))?,
            user: file.user.map(|user| reader.checked("user", user, no_name, is_named)).transpose()?,
            root: file.root.map(|root| reader.rule(root)),
            sandbox: file.sandbox,
            devices: reader.list("devices", file.devices, no_name, is_named)?,
            secrets: reader.list("secrets", file.secrets, no_name, is_named)?,
            environment: reader.list("environment", file.environment, no_name, is_named)?,
            limits: limits.into_iter().flatten().collect(),
        })
    }

    /// Returns the user that programs run as; none for the node's own user.
    #[must_use]
    pub fn user(&self) -> Option<&str> {
        self.user.as_ref().map(|user| user.value.as_str())
    }

    /// Returns the line of the rule `user`, from 1.
    #[must_use]
    pub fn user_line(&self) -> Option<usize> {
        self.user.as_ref().map(|user| user.line)
    }

    /// Returns the sandbox for programs.
    #[must_use]
    pub const fn sandbox(&self) -> Sandbox {
        self.sandbox
    }

    /// Returns whether the policy restricts which programs may be started.
    #[must_use]
    pub const fn limits_programs(&self) -> bool {
        self.folders.is_some() || self.hashes.is_some()
    }

    /// Returns whether the hash of a program decides whether it may be started.
    #[must_use]
    pub fn needs_hash(&self, program: &Path) -> bool {
        self.hashes.is_some() && !self.is_in_folder(program)
    }

    /// Returns the limits that a program gets.
    ///
    /// # Errors
    /// All rules that the program breaks.
    pub fn admit(&self, start: &Start<'_>) -> Result<Limits, Vec<Denied>> {
        let mut denied = Vec::new();
        denied.extend(self.against_program(start));
        if start.is_root && !self.root.as_ref().is_some_and(|root| root.value) {
            let line = self.root.as_ref().map(|root| root.line);
            denied.push(Denied { rule: "root", line, why: "no program runs as root on this node".to_owned() });
        }
        if let Some(user) = self.user.as_ref().filter(|user| user.value != start.user) {
            let (wanted, found) = (&user.value, start.user);
            let why = format!(
                "programs run as `{wanted}` on this node, and this program would run as `{found}`{}",
                start.only
            );
            denied.push(Denied { rule: "user", line: Some(user.line), why });
        }
        if let Some(devices) = &self.devices {
            let others = start.devices.iter().filter(|device| !devices.value.contains(device));
            denied.extend(others.map(|device| Denied {
                rule: "devices",
                line: Some(devices.line),
                why: format!("no program may claim `{device}` on this node"),
            }));
        }
        if let Some(secrets) = &self.secrets {
            let others = start.secrets.iter().filter(|key| !secrets.value.iter().any(|listed| gives(listed, key)));
            denied.extend(others.map(|key| Denied {
                rule: "secrets",
                line: Some(secrets.line),
                why: format!("no program may read the secret `{key}` on this node"),
            }));
        }
        denied.extend(self.against_variables(start.variables));
        let limits = self.limited(&start.limits, &mut denied);
        if denied.is_empty() { Ok(limits) } else { Err(denied) }
    }

    /// Returns the rules that variables break. If only some programs may run, a variable such as `LD_PRELOAD` could make them run other
    /// programs.
    fn against_variables(&self, variables: &[String]) -> Vec<Denied> {
        let is_open = self.folders.is_none() && self.hashes.is_none();
        let (line, listed) = match &self.environment {
            Some(rule) => (Some(rule.line), rule.value.as_slice()),
            None if is_open => return Vec::new(),
            None => (None, &[][..]),
        };
        let is_listed = |variable: &&String| {
            listed
                .iter()
                .any(|one| *one == **variable || one.strip_suffix('*').is_some_and(|one| variable.starts_with(one)))
        };
        let others = variables.iter().filter(|variable| !is_listed(variable));
        let why = |variable: &String| format!("no spec may set or inherit the variable `{variable}` on this node");
        others.map(|variable| Denied { rule: "environment", line, why: why(variable) }).collect()
    }

    fn is_in_folder(&self, program: &Path) -> bool {
        let is_below = |folder: &PathBuf| program.starts_with(folder) && program != folder.as_path();
        is_plain(program) && self.folders.as_ref().is_some_and(|folders| folders.value.iter().any(is_below))
    }

    fn against_program(&self, start: &Start<'_>) -> Option<Denied> {
        let is_listed = |hashes: &Rule<Vec<[u8; 32]>>| start.hash.is_some_and(|hash| hashes.value.contains(&hash));
        if self.is_in_folder(start.program) || self.hashes.as_ref().is_some_and(is_listed) {
            return None;
        }
        let program = start.program.display();
        let (rule, line, why) = match (&self.folders, &self.hashes) {
            (None, None) => return None,
            (Some(folders), None) => {
                ("folders", folders.line, format!("`{program}` is not in a folder of allowed programs"))
            }
            (None, Some(hashes)) => ("hashes", hashes.line, format!("the hash of `{program}` is not listed")),
            (Some(folders), Some(_)) => {
                let why = format!("`{program}` is not in a folder of allowed programs, and its hash is not listed");
                ("folders", folders.line, why)
            }
        };
        Some(Denied { rule, line: Some(line), why })
    }

    /// Returns the requested limits, and the policy's limits for those that were not requested.
    fn limited(&self, asked: &Limits, denied: &mut Vec<Denied>) -> Limits {
        let mut limits = *asked;
        for (rule, Rule { value, line }) in &self.limits {
            let limit = match *rule {
                // A program does not need a priority, so this rule gives none to programs that do not request it.
                "realtime" => {
                    deny_above("real-time priority", rule, asked.realtime, *value, *line, denied);
                    continue;
                }
                "memory" => &mut limits.memory,
                "cores" => &mut limits.cores,
                "cpu" => &mut limits.cpu,
                "pids" => &mut limits.pids,
                "files" => &mut limits.files,
                _ => &mut limits.file_size,
            };
            deny_above(rule, rule, *limit, *value, *line, denied);
            limit.get_or_insert(*value);
        }
        limits
    }
}

fn deny_above(what: &str, rule: &'static str, asked: Option<u64>, limit: u64, line: usize, denied: &mut Vec<Denied>) {
    let Some(asked) = asked.filter(|asked| *asked > limit) else { return };
    let [asked, limit] = [asked, limit].map(|value| amount(rule, value));
    let why = format!("its {what} of {asked} is above {limit}");
    denied.push(Denied { rule, line: Some(line), why });
}

/// Returns the value of a limit in the form that people write.
fn amount(rule: &str, value: u64) -> String {
    match rule {
        "memory" | "file_size" => format!("{value} B"),
        "cpu" => format!("{value} s"),
        "cores" => format!("{}.{:03}", value / 1000, value % 1000),
        _ => value.to_string(),
    }
}

/// Turns the parsed text into rules.
struct Reader<'a> {
    text: &'a str,
}

impl Reader<'_> {
    fn rule<T>(&self, read: Spanned<T>) -> Rule<T> {
        let line = line(self.text, read.span().start);
        Rule { value: read.into_inner(), line }
    }

    fn checked<T: ToString, U>(
        &self,
        rule: &'static str,
        read: Spanned<T>,
        hint: &'static str,
        check: impl Fn(&T) -> Option<U>,
    ) -> Result<Rule<U>, PolicyError> {
        let Rule { value, line } = self.rule(read);
        let checked = check(&value);
        checked.map(|value| Rule { value, line }).ok_or_else(|| PolicyError::Value {
            line,
            value: value.to_string(),
            rule,
            hint,
        })
    }

    fn list<T: AsRef<Path>, U>(
        &self,
        rule: &'static str,
        read: Option<Spanned<Vec<T>>>,
        hint: &'static str,
        check: impl Fn(&T) -> Option<U>,
    ) -> Result<Option<Rule<Vec<U>>>, PolicyError> {
        let Some(Rule { value: entries, line }) = read.map(|read| self.rule(read)) else { return Ok(None) };
        if entries.len() > ENTRIES_MAX {
            return Err(PolicyError::TooLong);
        }
        let wrong = |entry: &T| PolicyError::Value { line, value: entry.as_ref().display().to_string(), rule, hint };
        let value = entries.iter().map(|entry| check(entry).ok_or_else(|| wrong(entry))).collect::<Result<_, _>>()?;
        Ok(Some(Rule { value, line }))
    }

    fn limit(
        &self,
        rule: &'static str,
        read: Option<Spanned<u64>>,
    ) -> Result<Option<(&'static str, Rule<u64>)>, PolicyError> {
        let is_priority = rule == "realtime";
        let hint = if is_priority { "write a number from 0 to 49" } else { "write a number above 0" };
        let is_good = |value: &u64| if is_priority { *value <= REALTIME_MAX } else { *value > 0 };
        let check = |value: &u64| is_good(value).then_some(*value);
        read.map(|read| Ok((rule, self.checked(rule, read, hint, check)?))).transpose()
    }

    fn cores(&self, read: Option<Spanned<f64>>) -> Result<Option<(&'static str, Rule<u64>)>, PolicyError> {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it is between 1 and 4 million")]
        let check = |cores: &f64| (0.001..=CORES_MAX).contains(cores).then(|| (cores * 1000.0).round() as u64);
        let hint = "write a number from 0.001 to 4096";
        read.map(|read| Ok(("cores", self.checked("cores", read, hint, check)?))).transpose()
    }
}

/// Returns whether a rule covers a key. A listed key that ends in `/` covers all keys below it.
fn gives(listed: &str, key: &str) -> bool {
    if listed.ends_with('/') { key.starts_with(listed) } else { key == listed }
}

/// Returns the line of a byte position in a text, from 1.
fn line(text: &str, place: usize) -> usize {
    text.bytes().take(place).filter(|byte| *byte == b'\n').count() + 1
}

/// Returns whether a path is absolute and has no `..`.
fn is_plain(path: &Path) -> bool {
    path.is_absolute() && path.components().all(|part| matches!(part, Component::RootDir | Component::Normal(_)))
}

fn hash(text: &str) -> Option<[u8; 32]> {
    let digits = text.strip_prefix("blake3:").unwrap_or(text);
    blake3::Hash::from_hex(digits).ok().map(|hash| *hash.as_bytes())
}
