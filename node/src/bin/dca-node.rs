//! The agent of a host.

fn main() -> std::process::ExitCode {
    node::command::main()
}
