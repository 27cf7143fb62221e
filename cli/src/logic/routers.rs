//! The table of routers: `dca router`.

use crate::logic::queues::Shown;
use comms::logic::messaging::router::{Filter, SubscriberStatus};
use comms::logic::messaging::wire::RouterStatus;
use node::logic::printable::printable;
use node::logic::table::table;
use serde_json::{Value, json};

/// Formats the filters of a subscriber: `category motion or priority 5`.
fn filters(subscriber: &SubscriberStatus) -> String {
    if subscriber.filters.is_empty() {
        return Filter::default().to_string();
    }
    Vec::from_iter(subscriber.filters.iter().map(Filter::to_string)).join(" or ")
}

impl Shown for RouterStatus {
    fn table(rows: &[(String, String, Self)]) -> String {
        const HEAD: [&str; 10] =
            ["ROUTER", "TYPE", "SENT", "GONE", "SUBSCRIBER", "MATCHED", "DELIVERED", "WAITING", "LOST", "FILTERS"];
        let mut lines = vec![HEAD.map(str::to_owned).to_vec()];
        for (process, name, router) in rows {
            let counters = &router.counters;
            let count = |number: u64| number.to_string();
            let start = [
                format!("{process}.{name}"),
                router.type_name.clone(),
                count(counters.published),
                count(counters.dropped_subscribers),
            ];
            let none = || ["-"; 6].map(str::to_owned);
            let mut ends: Vec<[String; 6]> = Vec::new();
            for one in &router.subscribers {
                ends.push([
                    one.queue.clone(),
                    count(one.matched),
                    count(one.delivered),
                    count(one.waiting),
                    count(one.lost + one.refused),
                    filters(one),
                ]);
            }
            if ends.is_empty() {
                ends.push(none());
            }
            for end in ends {
                lines.push(start.iter().chain(&end).map(|cell| printable(cell).to_string()).collect());
            }
        }
        table(&lines)
    }

    fn fields(&self) -> Value {
        let subscriber = |one: &SubscriberStatus| {
            json!({
                "name": one.queue,
                "filters": one.filters.iter().map(Filter::to_string).collect::<Vec<_>>(),
                "matched": one.matched,
                "delivered": one.delivered,
                "waiting": one.waiting,
                "lost": one.lost,
                "refused": one.refused,
                "unreachable": one.is_unreachable,
            })
        };
        json!({
            "type": self.type_name,
            "fields": self.fields,
            "sent": self.counters.published,
            "gone": self.counters.dropped_subscribers,
            "subscribers": self.subscribers.iter().map(subscriber).collect::<Vec<_>>(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::messaging::router::RouterCounters;

    #[test]
    fn routers_are_shown() {
        let filter = Filter { category: Some("order".into()), ..Filter::default() };
        let subscriber = |queue: &str, filters| SubscriberStatus {
            queue: queue.into(),
            filters,
            matched: 6,
            delivered: 3,
            lost: 1,
            refused: 1,
            waiting: 1,
            is_unreachable: false,
        };
        let subscribers = vec![subscriber("calm", vec![filter]), subscriber("all", vec![])];
        let counters = RouterCounters { published: 9, dropped_subscribers: 2 };
        let router =
            |subscribers| RouterStatus { type_name: "Order".into(), fields: String::new(), counters, subscribers };
        let row = |subscribers| ("d:main/a".to_owned(), "news".to_owned(), router(subscribers));
        let text = RouterStatus::table(&[row(subscribers.clone()), row(vec![])]);
        let lines: Vec<String> =
            text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
        assert_eq!(
            lines[1..],
            [
                "d:main/a.news Order 9 2 calm 6 3 1 2 category order",
                "d:main/a.news Order 9 2 all 6 3 1 2 everything",
                "d:main/a.news Order 9 2 - - - - - -",
            ]
        );
        let json = RouterStatus::json(&[row(subscribers)]);
        assert_eq!(json[0]["subscribers"][0]["filters"][0], "category order");
    }
}
