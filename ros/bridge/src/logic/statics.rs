//! The static transforms of a topic: its messages are merged into one, in which each frame has its last transform.
//!
//! A latched topic keeps one message of each publisher, and a latched wire keeps one message. So each message that the bridge passes on
//! has all transforms, like a message of a `StaticTransformBroadcaster` of `tf2_ros`.

use super::arrivals::{Refused, short};
use controllers::ros::geometry_msgs::TransformStamped;
use controllers::ros::tf2_msgs::TFMessage;
use ros::logic::cdr;
use ros::logic::schema::Schema;
use ros::typed::Message as _;
use std::collections::BTreeMap;

/// The most transforms that are merged. A humanoid robot has about 200.
const TRANSFORMS_MAX: usize = 10_000;

/// The last transform of each frame.
#[derive(Debug, Default)]
pub(crate) struct Statics {
    by_child: BTreeMap<String, TransformStamped>,
}

impl Statics {
    /// Takes a message with transforms of this schema; returns the message with all transforms.
    ///
    /// # Errors
    /// The message is refused, and changes nothing. One number that is not finite would make consumers refuse all transforms.
    pub(crate) fn merge(&mut self, schema: &Schema, message: &[u8]) -> Result<Vec<u8>, Refused> {
        if !cdr::is_finite(schema, message)? {
            return Err(Refused::NotFinite);
        }
        let mut merged = self.by_child.clone();
        for transform in TFMessage::from_cdr(message)?.transforms {
            merged.insert(transform.child_frame_id.clone(), transform);
        }
        if merged.len() > TRANSFORMS_MAX {
            return Err(Refused::Many(TRANSFORMS_MAX));
        }
        let whole = TFMessage { transforms: merged.into_values().collect() };
        let message = short(whole.to_cdr()?)?;
        self.by_child = whole.transforms.into_iter().map(|one| (one.child_frame_id.clone(), one)).collect();
        Ok(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::random::Random;
    use ros::logic::library;
    use ros::logic::name::TypeName;

    fn schema() -> Schema {
        library::schema(&TypeName::parse(TFMessage::NAME).unwrap()).unwrap()
    }

    fn transform(child: &str, x: f64) -> TransformStamped {
        let mut transform = TransformStamped { child_frame_id: child.to_owned(), ..TransformStamped::default() };
        transform.transform.translation.x = x;
        transform
    }

    fn message(transforms: Vec<TransformStamped>) -> Vec<u8> {
        TFMessage { transforms }.to_cdr().unwrap()
    }

    #[test]
    fn each_frame_has_its_last_transform() {
        for seed in 0..100 {
            let (mut random, mut statics) = (Random::new(seed), Statics::default());
            let mut model = Vec::<(String, f64)>::new();
            for number in 0..8 {
                let mut sent = Vec::new();
                for _ in 0..random.below(4) {
                    let child = ["a", "b", "c", "d"][usize::try_from(random.below(4)).unwrap()];
                    model.retain(|(other, _)| other != child);
                    model.push((child.to_owned(), f64::from(number)));
                    sent.push(transform(child, f64::from(number)));
                }
                let merged = statics.merge(&schema(), &message(sent)).unwrap();
                let merged = TFMessage::from_cdr(&merged).unwrap().transforms.into_iter();
                let found = merged.map(|one| (one.child_frame_id, one.transform.translation.x));
                model.sort_by(|one, other| one.0.cmp(&other.0));
                assert_eq!(found.collect::<Vec<_>>(), model, "seed {seed}");
            }
        }
    }

    #[test]
    fn a_refused_message_changes_nothing() {
        let (schema, mut statics) = (schema(), Statics::default());
        let first = message(vec![transform("a", 1.0)]);
        assert_eq!(statics.merge(&schema, &first).as_ref(), Ok(&first));
        let nan = message(vec![transform("b", 2.0), transform("c", f64::NAN)]);
        assert_eq!(statics.merge(&schema, &nan), Err(Refused::NotFinite));
        let many = message((0..TRANSFORMS_MAX).map(|number| transform(&number.to_string(), 0.0)).collect());
        assert_eq!(statics.merge(&schema, &many), Err(Refused::Many(TRANSFORMS_MAX)));
        let long = "x".repeat(40 << 20);
        assert!(statics.merge(&schema, &message(vec![transform(&long, 0.0)])).is_ok());
        let mut second = transform("a", 3.0);
        second.header.frame_id = long;
        assert!(matches!(statics.merge(&schema, &message(vec![second])), Err(Refused::Long(_))));
        assert!(matches!(statics.merge(&schema, &first[..first.len() - 1]), Err(Refused::Bytes(_))));
        let last = statics.merge(&schema, &message(Vec::new())).unwrap();
        let children = TFMessage::from_cdr(&last).unwrap().transforms.into_iter().map(|one| one.child_frame_id.len());
        assert_eq!(children.collect::<Vec<_>>(), [1, 40 << 20]);
    }
}
