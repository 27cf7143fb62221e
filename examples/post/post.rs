//! Orders through a queue: a clerk who takes the most urgent one first, and customers who order.

use crate::headline;
use controllers::sdk::messaging::{Full, Queue, QueueClient, QueueMessage, Receipt, SendEnd};
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Calls, Controller, Exports, Kind, Message, Outputs, Parameter, Progress, Quantity, Registry,
    Signal, Tick,
};
use std::time::Duration;

/// How many orders wait for the clerk.
const ORDERS_MAX: usize = 8;
/// How long a customer tries to hand in an order.
const WITHIN: Duration = Duration::from_secs(30);

/// What is ordered.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct Order {
    /// How much of it.
    amount: f64,
}

impl Message for Order {
    const TYPE: &'static str = "Order";
    const FIELDS: &'static str = "amount: Number";
}

/// Works on one order after the other, the most urgent first.
struct Clerk {
    /// How long an order takes (s).
    pace: f64,
    /// How long this one still takes (s).
    left: f64,
    orders: Queue<Order>,
    amount: f64,
}

impl Controller for Clerk {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Clerk";

    fn about() -> About {
        const PACE: &[Parameter] = &[Parameter::new("pace", Kind::Quantity(Quantity::Time, 0.0, 3600.0))];
        About::service("Works on orders, the most urgent first.").every(Duration::from_millis(5)).with(PACE)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self {
            pace: arguments.number("pace"),
            left: 0.0,
            orders: Queue::new(ORDERS_MAX, Full::Reject),
            amount: 0.0,
        })
    }

    fn exports(exports: &mut Exports<Self>) {
        exports
            .procedure("Orders", "Takes an order.", |clerk: &mut Self, message| Ok(clerk.orders.receive(message)))
            .state("orders", "The orders that wait.", |clerk| clerk.orders.status());
    }

    fn main_calc(&mut self, tick: Tick, (): &(), (): &mut ()) -> Progress {
        self.left -= tick.dt();
        if self.left <= 0.0
            && let Some(order) = self.orders.take(tick.now)
        {
            (self.amount, self.left) = (self.amount + order.data.amount, self.pace);
        }
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        vec![headline("amount", "", self.amount)]
    }
}

#[derive(Outputs)]
struct CustomerOutputs {
    /// The clerk's queue.
    #[calls("Orders")]
    orders: Calls<QueueMessage, Receipt>,
}

/// Hands in some orders, and is done when all of them are accepted.
struct Customer {
    count: u64,
    priority: u8,
    client: QueueClient<Order>,
    sent: u64,
    accepted: u64,
    is_waiting: bool,
}

impl Controller for Customer {
    type Inputs = ();
    type Outputs = CustomerOutputs;
    const TYPE: &'static str = "Customer";

    fn about() -> About {
        const ORDERS: &[Parameter] = &[
            Parameter::new("name", Kind::Text(&[])),
            Parameter::new("count", Kind::Number(0.0, 1e6)).or("1"),
            Parameter::new("priority", Kind::Number(0.0, 255.0)).or("0"),
        ];
        About::task("Hands in orders.").every(Duration::from_millis(5)).with(ORDERS)
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "both are within their ranges")]
    fn new(arguments: &Arguments) -> Result<Self, String> {
        let client = QueueClient::new(arguments.text("name")).map_err(|cause| cause.to_string())?;
        let (count, priority) = (arguments.number("count") as u64, arguments.number("priority") as u8);
        Ok(Self { count, priority, client, sent: 0, accepted: 0, is_waiting: false })
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut CustomerOutputs) -> Progress {
        self.client.work(tick.now, &mut outputs.orders);
        while let Some((_, end)) = self.client.end_of() {
            self.is_waiting = false;
            match end {
                SendEnd::Accepted => self.accepted += 1,
                // The clerk is busy: the order is handed in once more.
                SendEnd::Rejected(_) => self.sent -= 1,
                SendEnd::Unknown(error) => return Progress::Aborted(format!("there is no clerk: {error}")),
                SendEnd::Deadline => return Progress::Aborted("the clerk does not answer".to_owned()),
            }
        }
        if self.accepted >= self.count {
            return Progress::Done(Vec::new());
        }
        if !self.is_waiting && self.sent < self.count {
            let sent = self.client.send(tick.now, ("order", self.priority, 0), (&Order { amount: 1.0 }, None), WITHIN);
            if let Err(why) = sent {
                return Progress::Aborted(why);
            }
            (self.sent, self.is_waiting) = (self.sent + 1, true);
        }
        Progress::Continue
    }
}

/// Adds the controllers of this example.
pub(crate) fn add(registry: &mut Registry) {
    registry.add::<Clerk>().add::<Customer>();
}
