//! The messages of `lifecycle_msgs`, written by `tests/all/typed.rs`.

super::message! {
    State, "lifecycle_msgs/msg/State", "ros.lifecycle.State";
    id: u8,
    label: String,
    ;
    const PRIMARY_STATE_UNKNOWN: u8 = 0;
    const PRIMARY_STATE_UNCONFIGURED: u8 = 1;
    const PRIMARY_STATE_INACTIVE: u8 = 2;
    const PRIMARY_STATE_ACTIVE: u8 = 3;
    const PRIMARY_STATE_FINALIZED: u8 = 4;
    const TRANSITION_STATE_CONFIGURING: u8 = 10;
    const TRANSITION_STATE_CLEANINGUP: u8 = 11;
    const TRANSITION_STATE_SHUTTINGDOWN: u8 = 12;
    const TRANSITION_STATE_ACTIVATING: u8 = 13;
    const TRANSITION_STATE_DEACTIVATING: u8 = 14;
    const TRANSITION_STATE_ERRORPROCESSING: u8 = 15;
}

super::message! {
    Transition, "lifecycle_msgs/msg/Transition", "ros.lifecycle.Transition";
    id: u8,
    label: String,
    ;
    const TRANSITION_CREATE: u8 = 0;
    const TRANSITION_CONFIGURE: u8 = 1;
    const TRANSITION_CLEANUP: u8 = 2;
    const TRANSITION_ACTIVATE: u8 = 3;
    const TRANSITION_DEACTIVATE: u8 = 4;
    const TRANSITION_UNCONFIGURED_SHUTDOWN: u8 = 5;
    const TRANSITION_INACTIVE_SHUTDOWN: u8 = 6;
    const TRANSITION_ACTIVE_SHUTDOWN: u8 = 7;
    const TRANSITION_DESTROY: u8 = 8;
    const TRANSITION_ON_CONFIGURE_SUCCESS: u8 = 10;
    const TRANSITION_ON_CONFIGURE_FAILURE: u8 = 11;
    const TRANSITION_ON_CONFIGURE_ERROR: u8 = 12;
    const TRANSITION_ON_CLEANUP_SUCCESS: u8 = 20;
    const TRANSITION_ON_CLEANUP_FAILURE: u8 = 21;
    const TRANSITION_ON_CLEANUP_ERROR: u8 = 22;
    const TRANSITION_ON_ACTIVATE_SUCCESS: u8 = 30;
    const TRANSITION_ON_ACTIVATE_FAILURE: u8 = 31;
    const TRANSITION_ON_ACTIVATE_ERROR: u8 = 32;
    const TRANSITION_ON_DEACTIVATE_SUCCESS: u8 = 40;
    const TRANSITION_ON_DEACTIVATE_FAILURE: u8 = 41;
    const TRANSITION_ON_DEACTIVATE_ERROR: u8 = 42;
    const TRANSITION_ON_SHUTDOWN_SUCCESS: u8 = 50;
    const TRANSITION_ON_SHUTDOWN_FAILURE: u8 = 51;
    const TRANSITION_ON_SHUTDOWN_ERROR: u8 = 52;
    const TRANSITION_ON_ERROR_SUCCESS: u8 = 60;
    const TRANSITION_ON_ERROR_FAILURE: u8 = 61;
    const TRANSITION_ON_ERROR_ERROR: u8 = 62;
    const TRANSITION_CALLBACK_SUCCESS: u8 = 97;
    const TRANSITION_CALLBACK_FAILURE: u8 = 98;
    const TRANSITION_CALLBACK_ERROR: u8 = 99;
}

super::message! {
    TransitionDescription, "lifecycle_msgs/msg/TransitionDescription", "ros.lifecycle.TransitionDescription";
    transition: Transition,
    start_state: State,
    goal_state: State,
}

super::message! {
    TransitionEvent, "lifecycle_msgs/msg/TransitionEvent", "ros.lifecycle.TransitionEvent";
    timestamp: u64,
    transition: Transition,
    start_state: State,
    goal_state: State,
}

super::message! {
    ChangeStateRequest, "lifecycle_msgs/srv/ChangeState_Request", "ros.lifecycle.ChangeState_Request";
    transition: Transition,
}

super::message! {
    ChangeStateResponse, "lifecycle_msgs/srv/ChangeState_Response", "ros.lifecycle.ChangeState_Response";
    success: bool,
}

super::message! {
    GetStateRequest, "lifecycle_msgs/srv/GetState_Request", "ros.lifecycle.GetState_Request";
}

super::message! {
    GetStateResponse, "lifecycle_msgs/srv/GetState_Response", "ros.lifecycle.GetState_Response";
    current_state: State,
}

super::message! {
    GetAvailableStatesRequest, "lifecycle_msgs/srv/GetAvailableStates_Request", "ros.lifecycle.GetAvailableStates_Request";
}

super::message! {
    GetAvailableStatesResponse, "lifecycle_msgs/srv/GetAvailableStates_Response", "ros.lifecycle.GetAvailableStates_Response";
    available_states: Vec<State>,
}

super::message! {
    GetAvailableTransitionsRequest, "lifecycle_msgs/srv/GetAvailableTransitions_Request", "ros.lifecycle.GetAvailableTransitions_Request";
}

super::message! {
    GetAvailableTransitionsResponse, "lifecycle_msgs/srv/GetAvailableTransitions_Response", "ros.lifecycle.GetAvailableTransitions_Response";
    available_transitions: Vec<TransitionDescription>,
}
