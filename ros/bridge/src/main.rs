//! `dca-ros`: the bridge between the wires of a mission and the topics of ROS 2. A node starts it.

fn main() -> std::process::ExitCode {
    bridge::log();
    bridge::run()
}
