//! Orders through a queue, and news of them through a router: a clerk that takes the most urgent
//! order first, and customers that order, and are told when their own orders are ready.

use crate::headline;
use controllers::sdk::messaging::{
    Delivery, Filter, Full, Label, Queue, QueueClient, QueueMessage, Receipt, Router, RouterRefusal, RouterUser,
    SendEnd, Subscribed, Subscription,
};
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Calls, Controller, Exports, Kind, Message, ObjectError, Outputs, Parameter, Progress, Quantity,
    Registry, Signal, Tick,
};
use std::collections::BTreeSet;
use std::time::Duration;

/// How many orders wait for the clerk.
const ORDERS_MAX: usize = 8;
/// How many news wait for a customer.
const NEWS_MAX: usize = 64;
/// How long a customer tries to hand in an order.
const WITHIN: Duration = Duration::from_secs(30);

/// An order.
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
    /// The customer of the present order, and its marker.
    of: Option<(String, u64, Order)>,
    ready: Router<Order>,
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
            of: None,
            ready: Router::new("clerk", NEWS_MAX).map_err(|cause| cause.to_string())?,
            amount: 0.0,
        })
    }

    fn exports(exports: &mut Exports<Self>) {
        exports
            .procedure("Orders", "Takes an order.", |clerk: &mut Self, message| Ok(clerk.orders.receive(message)))
            .state("orders", "The orders that wait.", |clerk| clerk.orders.status())
            .procedure_later("Ready", "Tells of orders that are ready.", |clerk: &mut Self, subscription, reply| {
                clerk.ready.ask(subscription, reply);
            })
            .state("ready", "The customers that are told of orders that are ready.", |clerk| clerk.ready.status());
    }

    fn main_calc(&mut self, tick: Tick, (): &(), (): &mut ()) -> Progress {
        self.left -= tick.dt();
        if self.left <= 0.0 {
            if let Some((customer, marker, order)) = self.of.take() {
                self.amount += order.amount;
                // Its category is the customer, by which the customers filter.
                if let Err(why) = self.ready.send(tick.now, Label { category: &customer, priority: 0, marker }, &order)
                {
                    return Progress::Aborted(why);
                }
            }
            if let Some(order) = self.orders.take(tick.now) {
                self.of = Some((order.header.sender, order.header.marker, order.data));
                self.left = self.pace;
            }
        }
        self.ready.work(tick.now);
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
    /// The clerk's router.
    #[calls("Ready", optional)]
    ready: Calls<Subscription, Delivery>,
}

/// Sends some orders, and is done when all orders are ready. If it is not connected to a router, it
/// is done when all orders are accepted.
struct Customer {
    count: u64,
    priority: u8,
    client: QueueClient<Order>,
    user: RouterUser,
    news: Queue<Order>,
    /// The markers of orders that are ready.
    ready: BTreeSet<u64>,
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

    fn exports(exports: &mut Exports<Self>) {
        exports.state("news", "The news that wait.", |customer| customer.news.status());
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "both are within their ranges")]
    fn new(arguments: &Arguments) -> Result<Self, String> {
        let name = arguments.text("name");
        let client = QueueClient::new(name).map_err(|cause| cause.to_string())?;
        let own = Filter { category: Some(name.to_owned()), ..Filter::default() };
        let user = RouterUser::new(name, vec![own]).map_err(|cause| cause.to_string())?;
        let (news, ready) = (Queue::new(NEWS_MAX, Full::Reject), BTreeSet::new());
        let (count, priority) = (arguments.number("count") as u64, arguments.number("priority") as u8);
        Ok(Self { count, priority, client, user, news, ready, sent: 0, accepted: 0, is_waiting: false })
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut CustomerOutputs) -> Progress {
        self.user.work(tick.now, &mut outputs.ready, &mut self.news);
        while let Some(news) = self.news.take(tick.now) {
            self.ready.insert(news.header.marker);
        }
        self.client.work(tick.now, &mut outputs.orders);
        while let Some((_, end)) = self.client.end_of() {
            self.is_waiting = false;
            match end {
                SendEnd::Accepted => self.accepted += 1,
                // The clerk is busy: the order is sent again.
                SendEnd::Rejected(_) => self.sent -= 1,
                SendEnd::Unknown(error) => return Progress::Aborted(format!("there is no clerk: {error}")),
                SendEnd::Deadline | SendEnd::Gone => return Progress::Aborted("the clerk does not answer".to_owned()),
            }
        }
        // A customer that does not receive news yet would miss an order that is ready before.
        let hears = match self.user.state() {
            Subscribed::Yes => true,
            // A spec need not connect it.
            Subscribed::Unknown(ObjectError::NotConnected { .. }) => false,
            // The connected process is not a router of orders, and never will be.
            Subscribed::Refused(why @ RouterRefusal::WrongType { .. }) => return Progress::Aborted(why.to_string()),
            Subscribed::Unknown(why @ (ObjectError::WrongType { .. } | ObjectError::NoSuchProcedure { .. })) => {
                return Progress::Aborted(why.to_string());
            }
            Subscribed::Asking | Subscribed::Refused(_) | Subscribed::Unknown(_) => return Progress::Continue,
        };
        let done = if hears { u64::try_from(self.ready.len()).unwrap_or(u64::MAX) } else { self.accepted };
        if done >= self.count {
            return Progress::Done(Vec::new());
        }
        if !self.is_waiting && self.sent < self.count {
            let sent = self.client.send(
                tick.now,
                Label { category: "order", priority: self.priority, marker: self.sent + 1 },
                &Order { amount: 1.0 },
                None,
                WITHIN,
            );
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
