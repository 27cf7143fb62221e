//! Changes the messages of a topic: the names of frames, and static transforms, which are merged.

use super::arrivals::{Refused, short};
use super::statics::Statics;
use ros::logic::cdr;
use ros::logic::frame::{FramePrefix, renamed};
use ros::logic::route::Route;
use ros::logic::schema::Schema;
use std::borrow::Cow;

/// Checks and changes the messages of a topic.
#[derive(Debug)]
pub(crate) struct Conversion {
    schema: Schema,
    frames: Option<FramePrefix>,
    is_outward: bool,
    statics: Option<Statics>,
}

impl Conversion {
    /// Returns the conversion of the messages of a route with this schema.
    pub(crate) fn new(route: &Route, schema: Schema) -> Self {
        let statics = route.has_static_transforms().then(Statics::default);
        Self { schema, frames: route.frames.clone(), is_outward: route.way.is_outward(), statics }
    }

    /// Returns the conversion that only checks messages of this schema.
    pub(crate) fn none(schema: Schema) -> Self {
        Self { schema, frames: None, is_outward: false, statics: None }
    }

    /// Returns whether each message has all that earlier messages had, so an earlier message is not missed.
    pub(crate) fn is_cumulative(&self) -> bool {
        self.statics.is_some()
    }

    /// Returns the message that is passed on for a message.
    ///
    /// # Errors
    /// The message is refused.
    pub(crate) fn convert<'m>(&mut self, message: Cow<'m, [u8]>) -> Result<Cow<'m, [u8]>, Refused> {
        let mut message = short(message)?;
        cdr::check(&self.schema, &message)?;
        if let Some(prefix) = &self.frames {
            let name = |frame: &str| if self.is_outward { prefix.outward(frame) } else { prefix.inward(frame) };
            message = Cow::Owned(short(renamed(&self.schema, &message, name)?)?);
        }
        match &mut self.statics {
            Some(statics) => Ok(Cow::Owned(statics.merge(&self.schema, &message)?)),
            None => Ok(message),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use controllers::ros::tf2_msgs::TFMessage;
    use controllers::ros::{geometry_msgs::TransformStamped, std_msgs::String as Text};
    use ros::logic::library;
    use ros::logic::name::TypeName;
    use ros::typed::Message;

    fn conversion(route: &str) -> Conversion {
        let route = Route::list(route).unwrap().remove(0);
        let schema = library::schema(&route.of).unwrap();
        Conversion::new(&route, schema)
    }

    fn transform(parent: &str, child: &str) -> Vec<u8> {
        let mut transform = TransformStamped { child_frame_id: child.to_owned(), ..TransformStamped::default() };
        transform.header.frame_id = parent.to_owned();
        TFMessage { transforms: vec![transform] }.to_cdr().unwrap()
    }

    fn convert(conversion: &mut Conversion, message: &[u8]) -> Result<Vec<u8>, Refused> {
        conversion.convert(Cow::Borrowed(message)).map(Cow::into_owned)
    }

    #[test]
    fn a_message_without_frames_is_not_copied() {
        let mut plain = conversion("</chatter std_msgs/msg/String ::,10:,:,:,,");
        let message = Text { data: "hello".to_owned() }.to_cdr().unwrap();
        assert!(matches!(plain.convert(Cow::Borrowed(&message)), Ok(Cow::Borrowed(_))));
        assert!(matches!(plain.convert(Cow::Borrowed(&message[1..])), Err(Refused::Bytes(_))));
        assert!(!plain.is_cumulative());
        assert_eq!(TypeName::parse(Text::NAME), Some(plain.schema.name().clone()));
    }

    #[test]
    fn transforms_change_on_both_ways() {
        let mut out = conversion(">/tf tf2_msgs/msg/TFMessage ::,100:,:,:,, r1/");
        let mut back = conversion("</tf tf2_msgs/msg/TFMessage ::,100:,:,:,, r1/");
        let (inside, outside) = (transform("/map", "odom"), transform("map", "r1/odom"));
        assert_eq!(convert(&mut out, &inside).as_ref(), Ok(&outside));
        assert_eq!(convert(&mut back, &outside), Ok(inside));
        assert_eq!(convert(&mut back, &transform("map", "r2/odom")), Ok(transform("/map", "/r2/odom")));
    }

    #[test]
    fn static_transforms_are_merged_with_the_names_that_they_get() {
        let mut back = conversion("</tf_static tf2_msgs/msg/TFMessage :1:,1:,:,:,, r1/");
        assert!(back.is_cumulative());
        convert(&mut back, &transform("r1/base", "r1/laser")).unwrap();
        let all = convert(&mut back, &transform("r2/base", "r2/laser")).unwrap();
        let children = TFMessage::from_cdr(&all).unwrap().transforms.into_iter().map(|one| one.child_frame_id);
        assert_eq!(children.collect::<Vec<_>>(), ["/r2/laser", "laser"]);
    }
}
