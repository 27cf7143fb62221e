//! `dca run`: runs a spec on this machine alone. A node for each of its hosts runs inside this command. When the
//! command ends, for whatever reason, nothing of the nodes remains.

use crate::client::Client;
use crate::follow::Spec;
use crate::reader::Leave;
use crate::verify::Proof;
use crate::{Controllers, Values, check, deploy, follow};
use anyhow::{Context, anyhow};
use comms::io::clock;
use comms::io::session::Reach;
use node::console::{Failure, block_on, ended};
use node::io::driver::{self, Config, DatabaseConfig, Inherited, NetworkConfig, ProgramsConfig};
use node::io::service_manager::ServiceManager;
use node::io::{cgroup, programs, run_dir, state_dir};
use node::logic::database::TEAM;
use node::logic::protocol::StartMode;
use shim::protocol::AGENT_LOSS_GRACE;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinSet;

/// How long the nodes may take to end.
const LEAVE_WITHIN: Duration = Duration::from_secs(30);
/// How long the nodes may take to end if the user does not wait. When a node is gone, the shims end its remaining programs.
const LEAVE_AT_ONCE: Duration = Duration::from_millis(300);

/// The arguments of `dca run`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The spec
    file: PathBuf,
    #[command(flatten)]
    following: follow::FollowArgs,
    #[command(flatten)]
    controllers: Controllers,
    #[command(flatten)]
    values: Values,
    /// Keep the database of its nodes in this folder [default: the database is gone when the command ends]
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Folder with the sockets of this machine's nodes, where other verbs find this command's, too
    #[arg(long, value_name = "DIR")]
    run_dir: Option<PathBuf>,
    #[command(flatten)]
    proof: Proof,
}

/// The options of a run on this machine.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Here<'a> {
    pub(crate) following: &'a follow::FollowArgs,
    pub(crate) controllers: &'a Controllers,
    /// The folder for the databases of the nodes; nothing if they are deleted when the command ends.
    pub(crate) state: Option<&'a Path>,
}

/// The nodes inside this command.
#[derive(Debug)]
struct Nodes {
    base: PathBuf,
    leave: watch::Sender<bool>,
    running: JoinSet<anyhow::Result<()>>,
}

/// Runs the verb.
pub(crate) fn run(arguments: Arguments) -> Result<(), Failure> {
    let spec = check::load(&arguments.file, &arguments.controllers, &arguments.values, false)?;
    arguments.proof.require(&spec)?;
    programs::check_shim()?;
    let Arguments { following, controllers, state, run_dir, .. } = &arguments;
    let base = base(run_dir.as_deref())?;
    carry_out(spec, &base, Here { following, controllers, state: state.as_deref() })
}

/// Returns the folder for the nodes of this command, in the folder that the user names.
pub(crate) fn base(run_dir: Option<&Path>) -> anyhow::Result<PathBuf> {
    let base = run_dir.map_or_else(run_dir::default_base, Path::to_path_buf);
    let base = std::path::absolute(&base).with_context(|| format!("finding the folder `{}`", base.display()))?;
    Ok(run_dir::of_this_command(&base))
}

/// Starts a node for each host of a spec, with a folder in `base`, and runs the spec to its end.
pub(crate) fn carry_out(spec: Spec, base: &Path, here: Here<'_>) -> Result<(), Failure> {
    block_on(async {
        let mut nodes = Nodes::start(&spec.plan.hosts, base, here).await?;
        let result = nodes.carry(spec, here.following).await;
        nodes.leave(if follow::is_left(&result) { LEAVE_AT_ONCE } else { LEAVE_WITHIN }).await;
        result
    })
}

impl Nodes {
    async fn start(hosts: &[String], base: &Path, here: Here<'_>) -> Result<Self, Failure> {
        let Here { controllers, state, .. } = here;
        let base = base.to_owned();
        let mut nodes = Self { base, leave: watch::Sender::new(false), running: JoinSet::new() };
        for host in hosts {
            let config = Config {
                name: host.clone(),
                base: nodes.base.clone(),
                network: NetworkConfig { reach: Reach::Host, member: None, port: 0, peers: Vec::new() },
                programs: ProgramsConfig {
                    controllers: programs::chosen(&controllers.programs),
                    inherited: Inherited::All,
                    agent_loss_grace: Some(AGENT_LOSS_GRACE),
                },
                database: DatabaseConfig { store: None, team: TEAM.to_owned(), founds: hosts.first() == Some(host) },
                state: state.map(|state| state_dir::take(Some(state), host)).transpose()?,
                adopts: false,
                boot: None,
                log: None,
                service: ServiceManager::default(),
            };
            let ready = watch::Sender::new(false);
            let mut is_ready = ready.subscribe();
            nodes.running.spawn(driver::run(config, nodes.leave.subscribe(), ready));
            tokio::select! {
                // A node that ends at once never becomes ready. The reason of its end is the better message.
                Ok(_) = is_ready.wait_for(|ready| *ready) => {}
                why = ended(&mut nodes.running) => {
                    nodes.leave(LEAVE_WITHIN).await;
                    return Err(why.err().unwrap_or_else(|| anyhow!("the node `{host}` ended at once")).into());
                }
            }
        }
        Ok(nodes)
    }

    async fn carry(&mut self, spec: Spec, following: &follow::FollowArgs) -> Result<(), Failure> {
        let home = spec.plan.home().context("the plan names no host for `main`")?.to_owned();
        let client = Client::to_socket(self.base.join(&home).join("node.sock")).await?;
        let result = tokio::select! {
            result = deploy::deploy(&client, spec, following, StartMode::AtOnce, None) => result,
            why = ended(&mut self.running) => {
                Err(why.err().unwrap_or_else(|| anyhow!("a node ended during the run")).into())
            }
        };
        client.close().await;
        result
    }

    /// Stops the nodes, and then removes their folder. Another Ctrl-C shortens the wait.
    async fn leave(&mut self, within: Duration) {
        self.leave.send_replace(true);
        let mut deadline = clock::now() + within;
        let mut impatient = Leave::new().ok();
        loop {
            let asked = async {
                match &mut impatient {
                    Some(leave) => leave.asked().await,
                    None => std::future::pending().await,
                }
            };
            tokio::select! {
                ended = self.running.join_next() => if ended.is_none() { break },
                () = asked => deadline = deadline.min(clock::now() + LEAVE_AT_ONCE),
                () = clock::sleep_until(deadline) => break,
            }
        }
        self.running.abort_all();
        cgroup::leave();
        remove(&self.base);
    }
}

/// Removes the folder of the nodes of this command.
pub(crate) fn remove(base: &Path) {
    if let Err(error) = std::fs::remove_dir_all(base) {
        tracing::debug!(%error, "cannot remove the nodes' folder");
    }
}
