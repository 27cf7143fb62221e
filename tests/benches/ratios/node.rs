//! A real node with its programs under shims, and a client that deploys.

use anyhow::{Context, bail, ensure};
use comms::io::clock::now;
use comms::io::session::{Replies, Session};
use comms::logic::time::Time;
use comms::logic::{codec, key};
use language::{Options, Source, Style, compile, render};
use node::logic::protocol::{Answer, Report, Request};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// The node's name.
pub(crate) const HOST: &str = "bench";
/// How long the next report may take.
const WITHIN: Duration = Duration::from_secs(40);

/// A running `dca-node`.
#[derive(Debug)]
pub(crate) struct Node {
    running: Running,
    client: Session,
    request: u64,
}

/// The process of the node. If a measurement fails, the node is asked to leave together with all of its programs.
#[derive(Debug)]
struct Running(Child);

impl Running {
    fn end(&mut self) -> anyhow::Result<()> {
        if self.0.try_wait()?.is_none() {
            let pid = rustix::process::Pid::from_child(&self.0);
            rustix::process::kill_process(pid, rustix::process::Signal::TERM)?;
        }
        ensure!(self.0.wait()?.success(), "the node failed");
        Ok(())
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.end().unwrap_or_default();
    }
}

/// The reports of one deployment.
#[derive(Debug)]
pub(crate) struct Deployment {
    replies: Replies,
    pub(crate) asked: Time,
}

impl Node {
    /// Brings the node in this program's folder up to date, and starts it.
    pub(crate) async fn start(dir: &Path) -> anyhow::Result<Self> {
        Self::start_with(dir, &[]).await
    }

    /// Starts it with variables of the environment.
    pub(crate) async fn start_with(dir: &Path, variables: &[(&str, &str)]) -> anyhow::Result<Self> {
        let program = built()?.join("dca-node");
        let child = Command::new(&program)
            .args(["--name", HOST, "--controllers"])
            .arg(std::env::current_exe()?)
            .arg("--run-dir")
            .arg(dir)
            .arg("--state")
            .arg(dir.join("state"))
            .envs(variables.iter().copied())
            .stdout(Stdio::piped())
            .spawn()
            .with_context(|| format!("starting {}", program.display()))?;
        let (mut running, mut said) = (Running(child), String::new());
        BufReader::new(running.0.stdout.take().context("no pipe")?).read_line(&mut said)?;
        ensure!(said.contains("ready"), "the node said `{said}`");
        let client = Session::open_client(&dir.join(HOST).join("node.sock")).await?;
        Ok(Self { running, client, request: 0 })
    }

    /// Asks the node to run a spec.
    pub(crate) fn deploy(&mut self, spec: &str) -> anyhow::Result<Deployment> {
        let source = Source::new("bench.dca", spec);
        let interfaces = [Source::new("bench", crate::programs::registry().interface_text())];
        let compiled = compile(&source, &interfaces, &Options::named("bench"));
        let problems = || render(&compiled.diagnostics, &source, &interfaces, Style::Plain);
        let plan = compiled.plan.clone().with_context(problems)?;
        self.request += 1;
        let bytes = codec::encode(&Request::Deploy {
            request: self.request,
            plan,
            by: "a benchmark".into(),
            start: Default::default(),
        })?;
        let asked = now();
        Ok(Deployment { replies: self.client.call_stream(&key::rpc(HOST, "request"), bytes, WITHIN)?, asked })
    }

    /// Stops the deployment, and waits until all of its processes have gone.
    pub(crate) async fn stop(&self, mut deployment: Deployment) -> anyhow::Result<()> {
        let (request, key) = (codec::encode(&Request::Stop { name: "bench".into() })?, key::rpc(HOST, "request"));
        // Both run at the same time, since unread reports would be an overrun.
        let stopping = self.client.call(&key, request, WITHIN);
        let finishing = async {
            while deployment.next().await?.is_some() {}
            anyhow::Ok(())
        };
        let (stopped, finished) = tokio::join!(stopping, finishing);
        stopped?;
        finished
    }

    /// Ends the node.
    pub(crate) async fn end(mut self) -> anyhow::Result<()> {
        self.client.close().await;
        self.running.end()
    }
}

impl Deployment {
    /// Returns the next report, or none at the end.
    pub(crate) async fn next(&mut self) -> anyhow::Result<Option<Report>> {
        let Some(reply) = tokio::time::timeout(WITHIN, self.replies.next()).await? else { return Ok(None) };
        let answer = codec::decode::<Answer>(&reply?)?;
        let Answer::Report(report) = answer else { bail!("no report but {answer:?}") };
        if let Report::Refused { reasons } = &report {
            bail!("refused: {}", reasons.join("; "));
        }
        Ok(Some(report))
    }

    /// Waits for GO. Returns the time from PREPARE, by the node's clock.
    pub(crate) async fn go(&mut self) -> anyhow::Result<Duration> {
        loop {
            if let Report::Go { took, .. } = self.next().await?.context("it ended before GO")? {
                return Ok(took);
            }
        }
    }
}

/// Returns the folder of the node's programs. They are up to date, and have the profile of this program.
fn built() -> anyhow::Result<PathBuf> {
    let own = std::env::current_exe()?;
    let folder = own.ancestors().nth(2).context("this program stands in no target folder")?.to_owned();
    if let Some(cargo) = std::env::var_os("CARGO") {
        let mut command = Command::new(cargo);
        command.args(["build", "--quiet", "-p", "node", "-p", "shim", "-p", "bridge", "--bins"]);
        command.args(folder.ends_with("release").then_some("--release")).current_dir(env!("CARGO_MANIFEST_DIR"));
        ensure!(command.status()?.success(), "the node does not build");
    }
    Ok(folder)
}
