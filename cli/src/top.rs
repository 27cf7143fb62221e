//! `dca top`: robots, processes, wires, events and questions on the whole terminal, as they change.
//!
//! It shows only data that nodes report. Orders use the same path as the orders of `dca estop` and
//! `dca ctl`. Before an order is sent, the user confirms it with a key.

use crate::ConnectArgs;
use crate::client::{Client, words};
use crate::io::screen::{self, Drawer, Keys, Taken};
use crate::live::Live;
use crate::logic::top::{Action, Look, Top, draw};
use crate::orders;
use crate::output;
use crate::reader::Leave;
use anyhow::{Context as _, anyhow};
use comms::io::clock;
use comms::logic::time::Time;
use node::console::{self, Failure, block_on};
use ratatui_core::terminal::Terminal;
use std::sync::Arc;
use std::time::Duration;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::task::JoinSet;
use view::Model;

/// How often the picture is drawn when nothing happens: the ages in it change.
const DRAW_EVERY: Duration = Duration::from_secs(1);
/// How long after one picture the next may come when something has happened. A key is answered at once.
const DRAW_AGAIN: Duration = Duration::from_millis(200);

/// The arguments of `dca top`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Draw with characters of ASCII only
    #[arg(long)]
    ascii: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if !screen::is_there() {
        return Err(Failure::Usage(anyhow!(
            "`dca top` needs a terminal as standard input and output; without a terminal, use `dca status --watch`"
        )));
    }
    block_on(async {
        let mut leave = Leave::of_terminal()?;
        let live = tokio::select! {
            live = Live::open(&arguments.connect) => live?,
            () = leave.asked() => return Ok(()),
        };
        let look = Look { is_ascii: arguments.ascii, is_coloured: output::has_colours(&output::results()) };
        let mut shown = Shown::new(live, look)?;
        let watched = shown.watch(&mut leave).await;
        // The terminal is given back before anything is printed.
        let Shown { live, taken, mut orders, .. } = shown;
        drop(taken);
        tokio::select! {
            () = finish(&mut orders) => {}
            () = leave.asked() => console::note("left before the result of an order arrived: the order may have been carried out"),
        }
        orders.shutdown().await;
        live.close().await;
        watched
    })
}

/// Waits for the orders that are still being given, and prints the results.
async fn finish(orders: &mut JoinSet<String>) {
    if !orders.is_empty() {
        console::note("waiting for the result of an order; Ctrl-C leaves without it");
    }
    while let Some(done) = orders.join_next().await {
        console::note(&done.unwrap_or_else(|error| error.to_string()));
    }
}

/// The view on the terminal.
struct Shown {
    live: Live,
    model: Model,
    top: Top,
    taken: Option<Taken>,
    terminal: Terminal<Drawer>,
    keys: Keys,
    resized: Signal,
    /// Orders that are being given; each ends with a word about it.
    orders: JoinSet<String>,
    drawn: Time,
    is_new: bool,
}

impl Shown {
    fn new(live: Live, look: Look) -> anyhow::Result<Self> {
        Taken::give_back_on_panic();
        let number = u64::try_from(clock::unix_time().as_millis()).unwrap_or(u64::MAX);
        let taken = Some(Taken::take()?);
        Ok(Self {
            live,
            model: Model::new(number),
            top: Top::new(look),
            taken,
            terminal: Terminal::new(Drawer::default()).context("reading the size of the terminal")?,
            keys: Keys::new()?,
            resized: signal(SignalKind::window_change())?,
            orders: JoinSet::new(),
            drawn: Time::ZERO,
            is_new: true,
        })
    }

    async fn watch(&mut self, leave: &mut Leave) -> Result<(), Failure> {
        self.draw()?;
        loop {
            let next = self.drawn + if self.is_new { DRAW_AGAIN } else { DRAW_EVERY };
            tokio::select! {
                input = self.live.next() => {
                    self.model.apply(clock::now(), input);
                    self.is_new = true;
                }
                pressed = self.keys.next() => {
                    let pressed = pressed.context("reading the terminal")?;
                    let is_pressed = !pressed.is_empty();
                    for key in pressed {
                        self.top.tick(clock::now());
                        match self.top.key(&self.model, key) {
                            Some(Action::Leave) => return Ok(()),
                            Some(Action::Redraw) => self.terminal.clear().context("writing to the terminal")?,
                            Some(action) => self.act(action).await?,
                            None => {}
                        }
                    }
                    if is_pressed {
                        self.draw()?;
                    }
                }
                Some(done) = self.orders.join_next() => {
                    self.top.say(&done.map_err(anyhow::Error::from)?);
                    self.draw()?;
                }
                _ = self.resized.recv() => self.draw()?,
                () = clock::sleep_until(next) => self.draw()?,
                () = leave.asked() => return Ok(()),
            }
        }
    }

    fn draw(&mut self) -> anyhow::Result<()> {
        let now = clock::now();
        self.top.tick(now);
        let measured = self.top.measured(&self.model);
        self.live.follow(&self.model, self.top.heard(), measured);
        self.top.resize(self.terminal.size().context("reading the size of the terminal")?.height);
        let (top, model, time) = (&self.top, &self.model, clock::unix_time());
        self.terminal
            .draw(|frame| draw::draw(top, model, time, frame.buffer_mut()))
            .context("writing to the terminal")?;
        (self.drawn, self.is_new) = (now, false);
        Ok(())
    }

    async fn act(&mut self, action: Action) -> anyhow::Result<()> {
        let (clients, connect) = (self.live.clients(), self.live.connect());
        let hosts: Vec<(Arc<Client>, String)> = match &action {
            Action::Answer(answer) => {
                let home = answer.mission.robot(&answer.mission.home);
                self.live.client_of(&home).map(|client| (client, home.host)).into_iter().collect()
            }
            Action::Leave | Action::Redraw | Action::Estop | Action::Release => self.live.locals(),
        };
        if let Err(failure) = self.unlock(&hosts).await? {
            self.top.say(&words(&failure));
            return Ok(());
        }
        match action {
            Action::Estop | Action::Release => {
                self.top.say(if action == Action::Estop { "stopping everything …" } else { "releasing …" });
                self.orders.spawn(async move { orders::everywhere(&clients, &connect, &action).await });
            }
            Action::Answer(answer) => match hosts.into_iter().next() {
                Some((client, _)) => drop(self.orders.spawn(orders::tell(client, answer))),
                None => self.top.say(&format!("`{}` does not answer", answer.mission.home)),
            },
            Action::Leave | Action::Redraw => {}
        }
        Ok(())
    }

    /// Unlocks the key of the user, if these nodes are in a team. The passphrase is asked for on the usual screen.
    async fn unlock(&mut self, hosts: &[(Arc<Client>, String)]) -> anyhow::Result<Result<(), Failure>> {
        for (client, host) in hosts {
            match client.asks_for_passphrase(host).await {
                Ok(true) => {}
                // The order itself says what is wrong.
                Ok(false) | Err(_) => continue,
            }
            self.keys.rest().await;
            self.taken = None;
            console::note(&format!("`{host}` accepts only requests that users of its team have signed"));
            let unlocked = client.unlock(host).await;
            self.taken = Some(Taken::take()?);
            self.terminal.clear().context("writing to the terminal")?;
            if unlocked.is_err() {
                return Ok(unlocked);
            }
        }
        Ok(Ok(()))
    }
}
