//! The bridge against `zenoh-ros2-sdk` from PyPI, which is independent of DCA: twenty types, there and back.

use super::peer::{Bridge, Router, value_of};
use ros::logic::cdr::{self, Value};
use ros::logic::definition::{Count, Element, Field, Primitive};
use ros::logic::name::TypeName;
use ros::logic::qos::Qos;
use ros::logic::route::{Route, Way};
use ros::logic::schema::{Schema, Struct};
use ros::logic::{hash, key::GraphName, library};
use std::io::{BufRead, BufReader, Lines, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

const TYPES: [&str; 20] = [
    "std_msgs/String",
    "std_msgs/Bool",
    "std_msgs/Float64MultiArray",
    "builtin_interfaces/Time",
    "geometry_msgs/Twist",
    "geometry_msgs/PoseStamped",
    "geometry_msgs/TransformStamped",
    "geometry_msgs/PoseWithCovarianceStamped",
    "sensor_msgs/LaserScan",
    "sensor_msgs/Image",
    "sensor_msgs/PointCloud2",
    "sensor_msgs/Imu",
    "sensor_msgs/JointState",
    "sensor_msgs/BatteryState",
    "nav_msgs/Odometry",
    "nav_msgs/Path",
    "nav_msgs/OccupancyGrid",
    "tf2_msgs/TFMessage",
    "diagnostic_msgs/DiagnosticArray",
    "visualization_msgs/MarkerArray",
];

/// Makes a value of a type in which each number differs from the others.
struct Filler<'a> {
    schema: &'a Schema,
    next: u8,
}

impl Filler<'_> {
    fn record(&mut self, of: &Struct) -> Value {
        Value::Record(of.fields.iter().map(|field| self.field(field)).collect())
    }

    fn field(&mut self, of: &Field<usize>) -> Value {
        let count = match of.count {
            Count::One => return self.element(&of.element),
            Count::Array(count) => count,
            Count::Any => 2,
            Count::Max(max) => max.min(2),
        };
        if let Element::Primitive(Primitive::U8 | Primitive::Byte) = of.element {
            return Value::Bytes((0..count).map(|_| self.number()).collect());
        }
        Value::List((0..count).map(|_| self.element(&of.element)).collect())
    }

    fn element(&mut self, of: &Element<usize>) -> Value {
        match of {
            Element::Text { .. } => Value::Text(format!("text {}", self.number())),
            Element::Message(index) => {
                let schema = self.schema;
                self.record(schema.at(*index))
            }
            Element::Primitive(of) => match of {
                Primitive::Bool => Value::Truth(self.number().is_multiple_of(2)),
                Primitive::F32 => Value::Single(f32::from(self.number()) / 4.0),
                Primitive::F64 => Value::Double(f64::from(self.number()) / 4.0),
                Primitive::I8 | Primitive::I16 | Primitive::I32 | Primitive::I64 => Value::Signed(self.number().into()),
                Primitive::Byte | Primitive::U8 | Primitive::U16 | Primitive::U32 | Primitive::U64 => {
                    Value::Unsigned(self.number().into())
                }
            },
        }
    }

    fn number(&mut self) -> u8 {
        self.next = self.next % 100 + 1;
        self.next
    }
}

/// A program on `zenoh-ros2-sdk` that talks in lines, in a virtual environment of its own. Both end with the test.
pub(crate) struct Peer {
    process: Child,
    folder: PathBuf,
    input: ChildStdin,
    output: Lines<BufReader<ChildStdout>>,
}

impl Peer {
    /// Starts a script of this folder with the address of a router; returns nothing, and says why, if the package cannot be had.
    #[expect(clippy::print_stdout, reason = "a user who runs the tests has to know what was skipped")]
    pub(crate) fn start(script: &str, router: &Router) -> Option<Self> {
        let folder = std::env::temp_dir().join(format!("dca-{script}-{}", std::process::id()));
        let python = match python(&folder) {
            Ok(python) => python,
            Err(why) => {
                println!("skipped: zenoh-ros2-sdk cannot be had from PyPI: {why}");
                return None;
            }
        };
        let (script, locator) = (format!("{}/tests/{script}", env!("CARGO_MANIFEST_DIR")), router.locator());
        let port = locator.rsplit(':').next().unwrap_or_default();
        let mut command = Command::new(python);
        command.args([&script, "127.0.0.1", port]).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut process = command.spawn().expect("the interpreter is there");
        let input = process.stdin.take().expect("it is a pipe");
        let output = BufReader::new(process.stdout.take().expect("it is a pipe")).lines();
        Some(Self { process, folder, input, output })
    }

    pub(crate) fn write(&mut self, line: &str) {
        writeln!(self.input, "{line}").expect("the peer reads");
    }

    pub(crate) fn read(&mut self) -> String {
        self.output.next().expect("the peer goes on").expect("it writes text")
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.process.kill().unwrap_or_default();
        self.process.wait().map(drop).unwrap_or_default();
        std::fs::remove_dir_all(&self.folder).unwrap_or_default();
    }
}

/// Returns the interpreter of a new virtual environment with the package, or why there is none.
fn python(folder: &Path) -> Result<PathBuf, String> {
    let run = |program: &Path, arguments: &[&str]| {
        let output = Command::new(program).args(arguments).output().map_err(|why| why.to_string())?;
        let errors = String::from_utf8_lossy(&output.stderr);
        if output.status.success() { Ok(()) } else { Err(errors.lines().last().unwrap_or_default().to_owned()) }
    };
    run(Path::new("python3"), &["-m", "venv", &folder.display().to_string()])?;
    let python = folder.join("bin/python");
    run(&python, &["-m", "pip", "install", "-q", "--disable-pip-version-check", "zenoh-ros2-sdk==0.1.8"])?;
    Ok(python)
}

fn route(way: Way, name: &str, of: &TypeName) -> Route {
    let name = GraphName::parse(name).expect("a name of ROS 2");
    Route { name, of: of.clone(), way, qos: Qos { depth: 10, ..Qos::default() }, frames: None }
}

#[test]
#[ignore = "long: PyPI"]
fn twenty_types_go_to_an_independent_node_and_come_back() {
    let router = Router::new();
    let Some(mut peer) = Peer::start("peer.py", &router) else { return };

    let names = TYPES.map(|name| TypeName::parse(name).unwrap());
    let schemas = names.clone().map(|name| library::schema(&name).unwrap());
    let mut routes = Vec::new();
    for (number, schema) in schemas.iter().enumerate() {
        let (name, there, back) = (&names[number], format!("/there/t{number}"), format!("/back/t{number}"));
        routes.extend([route(Way::ToRos, &there, name), route(Way::FromRos, &back, name)]);
        let line = format!(
            "{{\"type\": \"{name}\", \"hash\": \"{}\", \"definition\": {:?}, \"there\": \"{there}\", \"back\": \"{back}\", \"qos\": \"{}\", \"last\": {}}}",
            hash::rihs01(schema),
            schema.text(),
            routes[0].qos,
            number + 1 == schemas.len(),
        );
        peer.write(&line);
        assert_eq!(peer.read(), name.to_string());
    }
    assert_eq!(peer.read(), "ready");
    let mut bridge = Bridge::new(&Route::text(&routes), &router);
    for (number, schema) in schemas.iter().enumerate() {
        let mut filler = Filler { schema, next: 0 };
        let message = cdr::write(schema, &filler.record(schema.root())).unwrap();
        assert!(bridge.deliver(&format!("there.t{number}"), &value_of(&message)));
        let sent = bridge.sent(1);
        let (port, value) = &sent.values[0];
        assert_eq!(*port, format!("back.t{number}"));
        // The padding at the end of a value is free.
        let back = &value[value.len() - message.len()..];
        assert_eq!(cdr::read(schema, back), cdr::read(schema, &message), "{}", names[number]);
    }
    for (number, _) in schemas.iter().enumerate() {
        bridge.expect_signal(&format!("/back/t{number} refused"), 0.0);
    }
}
