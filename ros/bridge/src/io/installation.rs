//! An installation of ROS 2 on this host: its environment, and the files of its packages.
//!
//! Executables and launch files are found in the same way as by `ros2 run` and `ros2 launch`. Source: `ros2pkg`, `ros2launch` and
//! `ament_index_python`.

use super::container::Request;
use crate::logic::command::{Declared, What, variables};
use crate::logic::component::Component;
use ros::logic::parameters;
use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Read};
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::sync_channel;
use std::time::Duration;

/// The time limit for a setup file.
const SETUP_WITHIN: Duration = Duration::from_secs(10);
/// The largest size of an environment, in bytes.
const ENVIRONMENT_MAX: u64 = 1 << 20;
/// How much of the output of a failed setup file the reason contains, in bytes.
const TROUBLE_MAX: u64 = 2000;
/// The greatest depth of folders in a package that are searched for files, and the largest number of entries.
const DEPTH_MAX: usize = 5;
const ENTRIES_MAX: usize = 10_000;
/// The largest number of executables or components that are named in the reason why one is not found.
const NAMED_MAX: usize = 8;
/// The folder with the packages of an installation, below each of its prefixes.
const INDEX: &str = "share/ament_index/resource_index/packages";
/// The folder with the components of each package, below each prefix. A line has a class, `;` and a library.
const COMPONENTS: &str = "share/ament_index/resource_index/rclcpp_components";
/// The longest list of the components of a package, and the longest file of their parameters, in bytes.
const LIST_MAX: u64 = 1 << 20;
/// Variables of the bridge that the node of ROS 2 does not get. So it cannot send signs of life for the bridge, and cannot talk to the node
/// of the host.
const OWN: [&str; 6] = ["NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID", "DCA_CONTROL", "DCA_DATA_SOCKET", "DCA_TEAM"];
/// Sources a file, and writes the resulting environment. Output of the setup file does not disturb this.
const SOURCE: &str = "source \"$1\" >&2; exec env -0";

/// The environment of a program: its variables by name.
pub(crate) type Environment = BTreeMap<String, String>;

/// A program that can be started.
#[derive(Clone, Debug)]
pub(crate) struct Prepared {
    pub(crate) path: PathBuf,
    pub(crate) arguments: Vec<String>,
    pub(crate) environment: Environment,
}

/// Returns the environment of programs: the environment of this process, changed by a setup file if there is one. Blocks.
///
/// # Errors
/// The error is a sentence for a person.
pub(crate) fn environment(setup: &str) -> Result<Environment, String> {
    let mut environment: Environment =
        if setup.is_empty() { own_variables().collect() } else { sourced(Path::new(setup))?.into_iter().collect() };
    environment.retain(|name, _| !OWN.contains(&name.as_str()));
    let mut default = |name: &str, value: &str| {
        environment.entry(name.to_owned()).or_insert_with(|| value.to_owned());
    };
    default("RMW_IMPLEMENTATION", "rmw_zenoh_cpp");
    // Without this, the output of a Python program only arrives when the program has ended.
    default("PYTHONUNBUFFERED", "1");
    Ok(environment)
}

fn own_variables() -> impl Iterator<Item = (String, String)> {
    std::env::vars_os().filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)))
}

/// Returns how a program is started in an environment. Blocks.
///
/// # Errors
/// The error is a sentence for a person.
pub(crate) fn prepare(declared: &Declared, environment: Environment) -> Result<Prepared, String> {
    let package = &declared.package;
    let prefixes = environment.get("AMENT_PREFIX_PATH").map_or("", String::as_str);
    if prefixes.is_empty() {
        let help = "name the installation of ROS 2, for example `setup \"/opt/ros/jazzy/setup.bash\";`";
        return Err(format!("package `{package}` cannot be found: `AMENT_PREFIX_PATH` is not set; {help}"));
    }
    let has_package = |prefix: &&str| Path::new(prefix).join(INDEX).join(package).is_file();
    let prefix = prefixes.split(':').filter(|prefix| !prefix.is_empty()).find(has_package);
    let prefix = Path::new(prefix.ok_or_else(|| {
        format!(
            "ROS 2 has no package `{package}` in `{prefixes}`; is it installed, and is the setup file the right one?"
        )
    })?);
    for file in &declared.files {
        check_readable(Path::new(file))
            .map_err(|error| format!("the file of parameters `{file}` cannot be read: {error}"))?;
    }
    let path = match &declared.what {
        What::Executable(name) => executable(&prefix.join("lib").join(package), package, name)?,
        What::LaunchFile(name) => {
            let folder = prefix.join("share").join(package);
            if !files(&folder).iter().any(|path| has_name(path, name)) {
                return Err(format!("package `{package}` has no launch file `{name}` below `{}`", folder.display()));
            }
            on_path("ros2", &environment).ok_or("a launch file needs the program `ros2`, and `PATH` has none")?
        }
    };
    Ok(Prepared { path, arguments: declared.arguments(), environment })
}

/// Returns the requests that load the components of a container. Reads their files of parameters, and checks that they are installed.
///
/// # Errors
/// The error is a sentence for a person.
pub(crate) fn requests(declared: &Declared, environment: &Environment) -> Result<Vec<Request>, String> {
    let prefixes = environment.get("AMENT_PREFIX_PATH").map_or("", String::as_str);
    let request = |component: &Component| {
        check_installed(component, prefixes)?;
        let mut in_files = BTreeMap::new();
        for file in &component.files {
            let text = read_short(Path::new(file)).map_err(|error| error.to_string());
            let found =
                text.and_then(|text| parameters::of_node(&text, &component.node).map_err(|why| why.to_string()));
            in_files.extend(found.map_err(|why| format!("the file of parameters `{file}` cannot be read: {why}"))?);
        }
        let message = component.request(in_files, &declared.given)?;
        Ok(Request { shown: component.shown(), node: component.node.to_string(), message })
    };
    declared.components.iter().map(request).collect()
}

/// Checks that a package has a component, as a container will look for it.
fn check_installed(component: &Component, prefixes: &str) -> Result<(), String> {
    let Component { package, class, .. } = component;
    let lists = prefixes.split(':').filter(|prefix| !prefix.is_empty());
    let mut lists = lists.map(|prefix| Path::new(prefix).join(COMPONENTS).join(package));
    let Some(list) = lists.find(|list| list.is_file()) else {
        return Err(format!("{}: ROS 2 has no package `{package}` with components in `{prefixes}`", component.shown()));
    };
    let text = read_short(&list).map_err(|error| format!("`{}` cannot be read: {error}", list.display()))?;
    let classes = text.lines().filter_map(|line| line.split(';').next()).filter(|found| !found.is_empty());
    if classes.clone().any(|found| found == class) {
        return Ok(());
    }
    let mut known: Vec<String> = classes.take(NAMED_MAX).map(|found| format!("`{found}`")).collect();
    if known.is_empty() {
        known.push("no components".to_owned());
    }
    Err(format!("package `{package}` has no component `{class}`; it has {}", known.join(", ")))
}

/// Reads a text file of limited size.
fn read_short(path: &Path) -> io::Result<String> {
    check_readable(path)?;
    let mut text = String::new();
    fs::File::open(path)?.take(LIST_MAX + 1).read_to_string(&mut text)?;
    if text.len() as u64 > LIST_MAX { Err(io::Error::other("it is longer than 1 MiB")) } else { Ok(text) }
}

/// Checks the kind of the file first: a folder could be opened without an error, and opening a pipe would wait for its writer.
fn check_readable(path: &Path) -> io::Result<()> {
    let kind = fs::metadata(path)?.file_type();
    if kind.is_dir() {
        return Err(io::Error::new(io::ErrorKind::IsADirectory, "it is a directory"));
    }
    if kind.is_fifo() {
        return Err(io::Error::other("it is a pipe"));
    }
    fs::File::open(path).map(drop)
}

fn executable(folder: &Path, package: &str, name: &str) -> Result<PathBuf, String> {
    let mut found: Vec<PathBuf> = files(folder).into_iter().filter(|path| is_executable(path)).collect();
    found.sort();
    if let Some(path) = found.iter().find(|path| has_name(path, name)) {
        return Ok(path.clone());
    }
    let names = found.iter().filter_map(|path| path.file_name()?.to_str());
    let mut names: Vec<String> = names.take(NAMED_MAX).map(|name| format!("`{name}`")).collect();
    if found.len() > NAMED_MAX {
        names.push("others".to_owned());
    }
    let known = if names.is_empty() { "no executables".to_owned() } else { names.join(", ") };
    Err(format!("package `{package}` has no executable `{name}`; `{}` has {known}", folder.display()))
}

fn has_name(path: &Path, name: &str) -> bool {
    path.file_name().is_some_and(|own| own == name)
}

fn is_executable(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| found.is_file() && found.permissions().mode() & 0o111 != 0)
}

/// Returns the files of a folder and of the folders in it, up to the limits.
fn files(folder: &Path) -> Vec<PathBuf> {
    let (mut found, mut folders) = (Vec::new(), vec![(folder.to_owned(), 0)]);
    while let Some((folder, depth)) = folders.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            if found.len() >= ENTRIES_MAX {
                return found;
            }
            let path = entry.path();
            // Folders behind links are not searched, because such links may lead in a circle.
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                if depth < DEPTH_MAX {
                    folders.push((path, depth + 1));
                }
            } else {
                found.push(path);
            }
        }
    }
    found
}

fn on_path(program: &str, environment: &Environment) -> Option<PathBuf> {
    let folders = environment.get("PATH").map_or("", String::as_str).split(':');
    folders.map(|folder| Path::new(folder).join(program)).find(|path| is_executable(path))
}

/// Returns the environment that a setup file makes.
fn sourced(setup: &Path) -> Result<Vec<(String, String)>, String> {
    let shown = setup.display();
    check_readable(setup).map_err(|error| format!("the setup file `{shown}` cannot be read: {error}"))?;
    let mut command = Command::new("bash");
    command.args(["--noprofile", "--norc", "-c", SOURCE, "bash"]).arg(setup);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).process_group(0);
    let failed = |error: io::Error| format!("the setup file `{shown}` cannot be sourced with `bash`: {error}");
    let mut child = command.spawn().map_err(failed)?;
    let heard = heard(&mut child);
    let ended = heard.and_then(|heard| Ok((heard, child.wait()?)));
    let ((output, trouble), status) = match ended {
        Ok(ended) => ended,
        Err(error) => {
            end_group(&mut child);
            return Err(failed(error));
        }
    };
    if status.success() {
        return Ok(variables(&output));
    }
    let trouble = String::from_utf8_lossy(&trouble);
    let trouble = trouble.trim_end().lines().last().unwrap_or("it has printed no error").to_owned();
    Err(format!("the setup file `{shown}` cannot be sourced: {status}; {trouble}"))
}

/// Reads the output and the errors of a setup file.
fn heard(child: &mut Child) -> io::Result<(Vec<u8>, Vec<u8>)> {
    let (out, errors) = (child.stdout.take(), child.stderr.take());
    let (tx, output) = sync_channel(1);
    let (errors_tx, trouble) = sync_channel(1);
    // The threads are not joined, because a program that the setup file started may keep the pipes open.
    let read = move || {
        let mut bytes = Vec::new();
        let read = out.map_or(Ok(0), |out| out.take(ENVIRONMENT_MAX).read_to_end(&mut bytes));
        tx.try_send(read.map(|_| bytes)).unwrap_or_default();
    };
    let read_errors = move || {
        let mut bytes = Vec::new();
        let Some(mut errors) = errors else { return };
        // The output beyond the limit is also read. Otherwise the setup file would wait for ever.
        let mut begin = errors.by_ref().take(TROUBLE_MAX);
        begin.read_to_end(&mut bytes).map(drop).unwrap_or_default();
        errors_tx.try_send(bytes).unwrap_or_default();
        io::copy(&mut errors, &mut io::sink()).map(drop).unwrap_or_default();
    };
    std::thread::Builder::new().name("setup".to_owned()).spawn(read)?;
    std::thread::Builder::new().name("setup errors".to_owned()).spawn(read_errors)?;
    let late = || io::Error::new(io::ErrorKind::TimedOut, format!("no end within {} s", SETUP_WITHIN.as_secs()));
    let output = output.recv_timeout(SETUP_WITHIN).map_err(|_late| late())??;
    Ok((output, trouble.recv_timeout(Duration::from_millis(200)).unwrap_or_default()))
}

fn end_group(child: &mut Child) {
    let group = rustix::process::Pid::from_child(child);
    rustix::process::kill_process_group(group, rustix::process::Signal::KILL).unwrap_or_default();
    child.wait().map(drop).unwrap_or_default();
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An installation in a folder of its own, with a package `demo`.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let folder = std::env::temp_dir().join(format!("dca-ros-{name}-{}", std::process::id()));
            fs::create_dir_all(folder.join(INDEX)).unwrap();
            let folder = Self(folder);
            folder.file(&format!("{INDEX}/demo"), "", 0o644);
            folder.file("lib/demo/talker", "", 0o755);
            folder.file("lib/demo/inner/deep", "", 0o755);
            folder.file("lib/demo/notes", "", 0o644);
            folder.file("share/demo/launch/up.launch.py", "", 0o644);
            folder
        }

        fn file(&self, path: &str, text: &str, mode: u32) {
            let path = self.0.join(path);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, text).unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        }

        fn path(&self, path: &str) -> String {
            self.0.join(path).display().to_string()
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            fs::remove_dir_all(&self.0).unwrap_or_default();
        }
    }

    #[test]
    fn executables_are_found_as_ros_finds_them() {
        let folder = Folder::new("find");
        let environment = |more: &str| {
            Environment::from([
                ("AMENT_PREFIX_PATH".to_owned(), format!("/nowhere:{}{more}", folder.0.display())),
                ("PATH".to_owned(), folder.path("bin")),
            ])
        };
        let find =
            |what: What| prepare(&Declared::demo(what), environment("")).map(|found| found.path.display().to_string());
        let executable = |name: &str| find(What::Executable(name.to_owned()));
        assert_eq!(executable("talker"), Ok(folder.path("lib/demo/talker")));
        assert_eq!(executable("deep"), Ok(folder.path("lib/demo/inner/deep")));
        let known = format!("`{}` has `deep`, `talker`", folder.path("lib/demo"));
        assert_eq!(executable("notes"), Err(format!("package `demo` has no executable `notes`; {known}")));
        let launch = |name: &str| find(What::LaunchFile(name.to_owned()));
        assert_eq!(
            launch("up.launch.py"),
            Err("a launch file needs the program `ros2`, and `PATH` has none".to_owned())
        );
        folder.file("bin/ros2", "", 0o755);
        assert_eq!(launch("up.launch.py"), Ok(folder.path("bin/ros2")));
        assert!(launch("down.launch.py").unwrap_err().contains("has no launch file `down.launch.py` below"));
        let other = Declared { package: "other".to_owned(), ..Declared::demo(What::Executable("talker".to_owned())) };
        let why = prepare(&other, environment(":")).unwrap_err();
        assert!(why.starts_with("ROS 2 has no package `other` in `/nowhere:"), "{why}");
        let why = prepare(&other, Environment::new()).unwrap_err();
        assert!(why.contains("`AMENT_PREFIX_PATH` is not set"), "{why}");
        let files = vec![folder.path("none.yaml")];
        let missing = Declared { files, ..Declared::demo(What::Executable("talker".to_owned())) };
        assert!(prepare(&missing, environment("")).unwrap_err().contains("none.yaml` cannot be read"));
        let not_a_file = Declared { files: vec![folder.path("lib")], ..missing };
        let why = prepare(&not_a_file, environment("")).unwrap_err();
        assert!(why.ends_with("lib` cannot be read: it is a directory"), "{why}");
    }

    #[test]
    fn components_are_found_as_a_container_finds_them() {
        let folder = Folder::new("components");
        folder.file(&format!("{COMPONENTS}/demo"), "demo::Talker;lib/libtalker.so\ndemo::Listener;lib/l.so\n", 0o644);
        folder.file("own.yaml", "/**: { ros__parameters: { rate: 5 } }", 0o644);
        let environment = Environment::from([("AMENT_PREFIX_PATH".to_owned(), format!(":{}", folder.0.display()))]);
        let requests = |class: &str, package: &str, file: &str| {
            let words = ["component=talk", &format!("package={package}"), &format!("class={class}"), "node=/a/talk"];
            let mut components = Component::list(&words.map(str::to_owned)).unwrap();
            components[0].files.push(folder.path(file));
            let given = vec!["talk.on=true".to_owned()];
            requests(
                &Declared { components, given, ..Declared::demo(What::Executable("box".to_owned())) },
                &environment,
            )
        };
        let found = requests("demo::Talker", "demo", "own.yaml").unwrap();
        let names: Vec<&str> = found[0].message.parameters.iter().map(|one| one.name.as_str()).collect();
        assert_eq!((found[0].node.as_str(), names), ("/a/talk", vec!["on", "rate"]));
        let why = |class: &str, package: &str, file: &str| requests(class, package, file).unwrap_err();
        assert_eq!(
            why("demo::Walker", "demo", "own.yaml"),
            "package `demo` has no component `demo::Walker`; it has `demo::Talker`, `demo::Listener`"
        );
        assert!(why("demo::Talker", "other", "own.yaml").contains("no package `other` with components"));
        assert!(
            why("demo::Talker", "demo", "none.yaml")
                .ends_with("none.yaml` cannot be read: No such file or directory (os error 2)")
        );
        folder.file("own.yaml", "a: [", 0o644);
        assert!(why("demo::Talker", "demo", "own.yaml").contains("own.yaml` cannot be read: line "));
    }

    #[test]
    fn a_setup_file_is_sourced_by_bash() {
        let folder = Folder::new("setup");
        folder.file("setup.bash", "echo hello; words=(a b); export FROM=\"${words[1]} $PWD\"; false", 0o644);
        let found = environment(&folder.path("setup.bash")).unwrap();
        assert_eq!(found.get("FROM"), Some(&format!("b {}", std::env::current_dir().unwrap().display())));
        assert_eq!(found.get("RMW_IMPLEMENTATION").map(String::as_str), Some("rmw_zenoh_cpp"));
        assert!(OWN.iter().all(|name| !found.contains_key(*name)));
        let missing = environment(&folder.path("none.bash")).unwrap_err();
        assert!(missing.contains("none.bash` cannot be read: No such file"), "{missing}");
        let not_a_file = environment(&folder.path("lib")).unwrap_err();
        assert!(not_a_file.ends_with("lib` cannot be read: it is a directory"), "{not_a_file}");
        let made = Command::new("mkfifo").arg(folder.path("pipe")).status().unwrap();
        assert!(made.success());
        let pipe = environment(&folder.path("pipe")).unwrap_err();
        assert!(pipe.ends_with("pipe` cannot be read: it is a pipe"), "{pipe}");
        folder.file("exits.bash", "echo no such robot >&2; exit 3", 0o644);
        let failed = environment(&folder.path("exits.bash")).unwrap_err();
        assert!(failed.ends_with("cannot be sourced: exit status: 3; no such robot"), "{failed}");
        folder.file("loud.bash", "head -c 300000 /dev/zero >&2; export LOUD=1", 0o644);
        assert_eq!(environment(&folder.path("loud.bash")).unwrap().get("LOUD").map(String::as_str), Some("1"));
    }
}
