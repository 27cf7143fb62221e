//! Values of wires and messages of ROS 2. Both are CDR bytes. A value on a wire has its length before the bytes.

use comms::logic::decode::Source;

/// The largest size of a length, in bytes.
const LENGTH_MAX: usize = 10;

/// Returns the value of a wire that carries a message.
pub(crate) fn of_message(message: &[u8]) -> Vec<u8> {
    of_parts(&[message])
}

/// Returns the value of a wire for a message in parts, as a long message comes from the network.
pub(crate) fn of_parts(parts: &[&[u8]]) -> Vec<u8> {
    let (mut length, size) = ([0; LENGTH_MAX], parts.iter().map(|part| part.len()).sum::<usize>());
    let length = postcard::to_slice(&size, &mut length).expect("a length has at most ten bytes");
    let mut value = Vec::with_capacity(length.len() + size);
    value.extend_from_slice(length);
    parts.iter().for_each(|part| value.extend_from_slice(part));
    value
}

/// Returns the message in the value of a wire; none if the length in front is wrong.
pub(crate) fn message_in(value: &[u8]) -> Option<&[u8]> {
    let (length, message) = postcard::take_from_bytes::<usize>(value).ok()?;
    (message.len() == length).then_some(message)
}

/// Returns the message in a value that can only be copied; none if the length in front is wrong.
pub(crate) fn message_of(source: &mut dyn Source) -> Option<Vec<u8>> {
    let mut length = Vec::with_capacity(LENGTH_MAX);
    while length.last().is_none_or(|last| last & 0x80 != 0) {
        if length.len() == LENGTH_MAX || !source.append(1, &mut length) {
            return None;
        }
    }
    let length = postcard::from_bytes::<usize>(&length).ok().filter(|length| *length == source.left())?;
    let mut message = Vec::with_capacity(length);
    source.append(length, &mut message).then_some(message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use controllers::ros::geometry_msgs::Twist;
    use controllers::ros::sensor_msgs::Image;
    use ros::typed::Message as _;

    #[test]
    fn both_sides_have_the_same_bytes() {
        let mut twist = Twist::default();
        twist.linear.x = 0.5;
        let image = Image { data: vec![7; 300], ..Image::default() };
        for (value, message) in [
            (postcard::to_stdvec(&twist).unwrap(), twist.to_cdr().unwrap()),
            (postcard::to_stdvec(&image).unwrap(), image.to_cdr().unwrap()),
        ] {
            assert_eq!(message_in(&value), Some(&message[..]));
            assert_eq!(of_message(&message), value);
            assert_eq!(of_parts(&[&message[..5], &[], &message[5..]]), value);
            assert_eq!(message_of(&mut &value[..]), Some(message));
            assert_eq!(message_of(&mut &value[1..]), None);
            assert_eq!(message_in(&value[..value.len() - 1]), None);
            assert_eq!(message_in(&[&value[..], &[0]].concat()), None);
        }
        for nonsense in [&[][..], &[255; 11], &[5]] {
            assert_eq!((message_in(nonsense), message_of(&mut &*nonsense)), (None, None));
        }
    }
}
