//! The messages of `std_msgs`, written by `tests/all/typed.rs`.

super::message! {
    Bool, "std_msgs/msg/Bool", "ros.std.Bool";
    data: bool,
}

super::message! {
    Byte, "std_msgs/msg/Byte", "ros.std.Byte";
    data: u8,
}

super::message! {
    ByteMultiArray, "std_msgs/msg/ByteMultiArray", "ros.std.ByteMultiArray";
    layout: MultiArrayLayout,
    data: Vec<u8>,
}

super::message! {
    Char, "std_msgs/msg/Char", "ros.std.Char";
    data: u8,
}

super::message! {
    ColorRGBA, "std_msgs/msg/ColorRGBA", "ros.std.ColorRGBA";
    r: f32,
    g: f32,
    b: f32,
    a: f32,
}

super::message! {
    Empty, "std_msgs/msg/Empty", "ros.std.Empty";
}

super::message! {
    Float32, "std_msgs/msg/Float32", "ros.std.Float32";
    data: f32,
}

super::message! {
    Float32MultiArray, "std_msgs/msg/Float32MultiArray", "ros.std.Float32MultiArray";
    layout: MultiArrayLayout,
    data: Vec<f32>,
}

super::message! {
    Float64, "std_msgs/msg/Float64", "ros.std.Float64";
    data: f64,
}

super::message! {
    Float64MultiArray, "std_msgs/msg/Float64MultiArray", "ros.std.Float64MultiArray";
    layout: MultiArrayLayout,
    data: Vec<f64>,
}

super::message! {
    Header, "std_msgs/msg/Header", "ros.std.Header";
    stamp: super::builtin_interfaces::Time,
    frame_id: std::string::String,
}

super::message! {
    Int16, "std_msgs/msg/Int16", "ros.std.Int16";
    data: i16,
}

super::message! {
    Int16MultiArray, "std_msgs/msg/Int16MultiArray", "ros.std.Int16MultiArray";
    layout: MultiArrayLayout,
    data: Vec<i16>,
}

super::message! {
    Int32, "std_msgs/msg/Int32", "ros.std.Int32";
    data: i32,
}

super::message! {
    Int32MultiArray, "std_msgs/msg/Int32MultiArray", "ros.std.Int32MultiArray";
    layout: MultiArrayLayout,
    data: Vec<i32>,
}

super::message! {
    Int64, "std_msgs/msg/Int64", "ros.std.Int64";
    data: i64,
}

super::message! {
    Int64MultiArray, "std_msgs/msg/Int64MultiArray", "ros.std.Int64MultiArray";
    layout: MultiArrayLayout,
    data: Vec<i64>,
}

super::message! {
    Int8, "std_msgs/msg/Int8", "ros.std.Int8";
    data: i8,
}

super::message! {
    Int8MultiArray, "std_msgs/msg/Int8MultiArray", "ros.std.Int8MultiArray";
    layout: MultiArrayLayout,
    data: Vec<i8>,
}

super::message! {
    MultiArrayDimension, "std_msgs/msg/MultiArrayDimension", "ros.std.MultiArrayDimension";
    label: std::string::String,
    size: u32,
    stride: u32,
}

super::message! {
    MultiArrayLayout, "std_msgs/msg/MultiArrayLayout", "ros.std.MultiArrayLayout";
    dim: Vec<MultiArrayDimension>,
    data_offset: u32,
}

super::message! {
    String, "std_msgs/msg/String", "ros.std.String";
    data: std::string::String,
}

super::message! {
    UInt16, "std_msgs/msg/UInt16", "ros.std.UInt16";
    data: u16,
}

super::message! {
    UInt16MultiArray, "std_msgs/msg/UInt16MultiArray", "ros.std.UInt16MultiArray";
    layout: MultiArrayLayout,
    data: Vec<u16>,
}

super::message! {
    UInt32, "std_msgs/msg/UInt32", "ros.std.UInt32";
    data: u32,
}

super::message! {
    UInt32MultiArray, "std_msgs/msg/UInt32MultiArray", "ros.std.UInt32MultiArray";
    layout: MultiArrayLayout,
    data: Vec<u32>,
}

super::message! {
    UInt64, "std_msgs/msg/UInt64", "ros.std.UInt64";
    data: u64,
}

super::message! {
    UInt64MultiArray, "std_msgs/msg/UInt64MultiArray", "ros.std.UInt64MultiArray";
    layout: MultiArrayLayout,
    data: Vec<u64>,
}

super::message! {
    UInt8, "std_msgs/msg/UInt8", "ros.std.UInt8";
    data: u8,
}

super::message! {
    UInt8MultiArray, "std_msgs/msg/UInt8MultiArray", "ros.std.UInt8MultiArray";
    layout: MultiArrayLayout,
    data: Vec<u8>,
}
