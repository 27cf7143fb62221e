//! The standard messages of ROS 2 as messages of ports.

use super::Message;
use ros::for_each_message;
use ros::typed::{self, Message as RosMessage};

/// Returns whether numbers in the messages of a package of ROS 2 may be infinite or NaN.
///
/// Drivers send such numbers in the messages of sensors: infinity for a ray without an echo, NaN for a quantity without
/// a measurement. Source: REP 117, <https://www.ros.org/reps/rep-0117.html>.
pub const fn allows_nan(package: &str) -> bool {
    matches!(package.as_bytes(), b"sensor_msgs")
}

macro_rules! declare {
    ($($package:ident::$name:ident,)+) => {
        $(
            impl Message for typed::$package::$name {
                const TYPE: &'static str = <Self as RosMessage>::SPEC;
                const ALLOW_NAN: bool = allows_nan(stringify!($package));
            }
        )+
    };
}

for_each_message!(declare);

#[cfg(test)]
mod tests {
    use crate::sdk::In;
    use crate::sdk::port::{AnyIn, Unfit, is_fit};
    use comms::logic::time::Time;
    use ros::typed::geometry_msgs::Twist;
    use ros::typed::sensor_msgs::LaserScan;

    #[test]
    fn a_port_takes_messages_of_ros() {
        let mut twist = Twist::default();
        twist.linear.x = 0.5;
        let mut port = In::<Twist>::default();
        let bytes = postcard::to_stdvec(&twist).unwrap();
        port.deliver(&bytes, Time::ZERO).unwrap();
        assert_eq!(port.latest(), Some(&twist));
        assert!(matches!(port.deliver(&bytes[..bytes.len() - 1], Time::ZERO), Err(Unfit::Encoding(_))));
        assert!(matches!(port.deliver(&[4, 0, 1, 0, 0], Time::ZERO), Err(Unfit::Encoding(_))), "it has no fields");
    }

    #[test]
    fn only_sensors_send_numbers_that_are_not_finite() {
        let mut twist = Twist::default();
        twist.angular.z = f64::NAN;
        assert!(!is_fit(&twist), "a command");
        assert!(is_fit(&LaserScan { ranges: vec![f32::INFINITY], ..LaserScan::default() }), "a ray without an echo");
    }
}
