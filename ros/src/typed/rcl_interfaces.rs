//! The messages of `rcl_interfaces`, written by `tests/all/typed.rs`.

super::message! {
    FloatingPointRange, "rcl_interfaces/msg/FloatingPointRange", "ros.rcl.FloatingPointRange";
    from_value: f64,
    to_value: f64,
    step: f64,
}

super::message! {
    IntegerRange, "rcl_interfaces/msg/IntegerRange", "ros.rcl.IntegerRange";
    from_value: i64,
    to_value: i64,
    step: u64,
}

super::message! {
    ListParametersResult, "rcl_interfaces/msg/ListParametersResult", "ros.rcl.ListParametersResult";
    names: Vec<String>,
    prefixes: Vec<String>,
}

super::message! {
    Log, "rcl_interfaces/msg/Log", "ros.rcl.Log";
    stamp: super::builtin_interfaces::Time,
    level: u8,
    name: String,
    msg: String,
    file: String,
    function: String,
    line: u32,
    ;
    const DEBUG: u8 = 10;
    const INFO: u8 = 20;
    const WARN: u8 = 30;
    const ERROR: u8 = 40;
    const FATAL: u8 = 50;
}

super::message! {
    LoggerLevel, "rcl_interfaces/msg/LoggerLevel", "ros.rcl.LoggerLevel";
    name: String,
    level: u32,
    ;
    const LOG_LEVEL_UNKNOWN: u8 = 0;
    const LOG_LEVEL_DEBUG: u8 = 10;
    const LOG_LEVEL_INFO: u8 = 20;
    const LOG_LEVEL_WARN: u8 = 30;
    const LOG_LEVEL_ERROR: u8 = 40;
    const LOG_LEVEL_FATAL: u8 = 50;
}

super::message! {
    Parameter, "rcl_interfaces/msg/Parameter", "ros.rcl.Parameter";
    name: String,
    value: ParameterValue,
}

super::message! {
    ParameterDescriptor, "rcl_interfaces/msg/ParameterDescriptor", "ros.rcl.ParameterDescriptor";
    name: String,
    r#type: u8,
    description: String,
    additional_constraints: String,
    read_only: bool,
    dynamic_typing: bool,
    floating_point_range: super::AtMost<FloatingPointRange, 1>,
    integer_range: super::AtMost<IntegerRange, 1>,
}

super::message! {
    ParameterEvent, "rcl_interfaces/msg/ParameterEvent", "ros.rcl.ParameterEvent";
    stamp: super::builtin_interfaces::Time,
    node: String,
    new_parameters: Vec<Parameter>,
    changed_parameters: Vec<Parameter>,
    deleted_parameters: Vec<Parameter>,
}

super::message! {
    ParameterEventDescriptors, "rcl_interfaces/msg/ParameterEventDescriptors", "ros.rcl.ParameterEventDescriptors";
    new_parameters: Vec<ParameterDescriptor>,
    changed_parameters: Vec<ParameterDescriptor>,
    deleted_parameters: Vec<ParameterDescriptor>,
}

super::message! {
    ParameterType, "rcl_interfaces/msg/ParameterType", "ros.rcl.ParameterType";
    ;
    const PARAMETER_NOT_SET: u8 = 0;
    const PARAMETER_BOOL: u8 = 1;
    const PARAMETER_INTEGER: u8 = 2;
    const PARAMETER_DOUBLE: u8 = 3;
    const PARAMETER_STRING: u8 = 4;
    const PARAMETER_BYTE_ARRAY: u8 = 5;
    const PARAMETER_BOOL_ARRAY: u8 = 6;
    const PARAMETER_INTEGER_ARRAY: u8 = 7;
    const PARAMETER_DOUBLE_ARRAY: u8 = 8;
    const PARAMETER_STRING_ARRAY: u8 = 9;
}

super::message! {
    ParameterValue, "rcl_interfaces/msg/ParameterValue", "ros.rcl.ParameterValue";
    r#type: u8,
    bool_value: bool,
    integer_value: i64,
    double_value: f64,
    string_value: String,
    byte_array_value: Vec<u8>,
    bool_array_value: Vec<bool>,
    integer_array_value: Vec<i64>,
    double_array_value: Vec<f64>,
    string_array_value: Vec<String>,
}

super::message! {
    SetLoggerLevelsResult, "rcl_interfaces/msg/SetLoggerLevelsResult", "ros.rcl.SetLoggerLevelsResult";
    successful: bool,
    reason: String,
}

super::message! {
    SetParametersResult, "rcl_interfaces/msg/SetParametersResult", "ros.rcl.SetParametersResult";
    successful: bool,
    reason: String,
}

super::message! {
    DescribeParametersRequest, "rcl_interfaces/srv/DescribeParameters_Request", "ros.rcl.DescribeParameters_Request";
    names: Vec<String>,
}

super::message! {
    DescribeParametersResponse, "rcl_interfaces/srv/DescribeParameters_Response", "ros.rcl.DescribeParameters_Response";
    descriptors: Vec<ParameterDescriptor>,
}

super::message! {
    GetParameterTypesRequest, "rcl_interfaces/srv/GetParameterTypes_Request", "ros.rcl.GetParameterTypes_Request";
    names: Vec<String>,
}

super::message! {
    GetParameterTypesResponse, "rcl_interfaces/srv/GetParameterTypes_Response", "ros.rcl.GetParameterTypes_Response";
    types: Vec<u8>,
}

super::message! {
    GetParametersRequest, "rcl_interfaces/srv/GetParameters_Request", "ros.rcl.GetParameters_Request";
    names: Vec<String>,
}

super::message! {
    GetParametersResponse, "rcl_interfaces/srv/GetParameters_Response", "ros.rcl.GetParameters_Response";
    values: Vec<ParameterValue>,
}

super::message! {
    ListParametersRequest, "rcl_interfaces/srv/ListParameters_Request", "ros.rcl.ListParameters_Request";
    prefixes: Vec<String>,
    depth: u64,
    ;
    const DEPTH_RECURSIVE: u64 = 0;
}

super::message! {
    ListParametersResponse, "rcl_interfaces/srv/ListParameters_Response", "ros.rcl.ListParameters_Response";
    result: ListParametersResult,
}

super::message! {
    SetParametersRequest, "rcl_interfaces/srv/SetParameters_Request", "ros.rcl.SetParameters_Request";
    parameters: Vec<Parameter>,
}

super::message! {
    SetParametersResponse, "rcl_interfaces/srv/SetParameters_Response", "ros.rcl.SetParameters_Response";
    results: Vec<SetParametersResult>,
}

super::message! {
    SetParametersAtomicallyRequest, "rcl_interfaces/srv/SetParametersAtomically_Request", "ros.rcl.SetParametersAtomically_Request";
    parameters: Vec<Parameter>,
}

super::message! {
    SetParametersAtomicallyResponse, "rcl_interfaces/srv/SetParametersAtomically_Response", "ros.rcl.SetParametersAtomically_Response";
    result: SetParametersResult,
}

super::message! {
    GetLoggerLevelsRequest, "rcl_interfaces/srv/GetLoggerLevels_Request", "ros.rcl.GetLoggerLevels_Request";
    names: Vec<String>,
}

super::message! {
    GetLoggerLevelsResponse, "rcl_interfaces/srv/GetLoggerLevels_Response", "ros.rcl.GetLoggerLevels_Response";
    levels: Vec<LoggerLevel>,
}

super::message! {
    SetLoggerLevelsRequest, "rcl_interfaces/srv/SetLoggerLevels_Request", "ros.rcl.SetLoggerLevels_Request";
    levels: Vec<LoggerLevel>,
}

super::message! {
    SetLoggerLevelsResponse, "rcl_interfaces/srv/SetLoggerLevels_Response", "ros.rcl.SetLoggerLevels_Response";
    results: Vec<SetLoggerLevelsResult>,
}
