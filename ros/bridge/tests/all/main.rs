//! Tests of the bridge against a peer that speaks plain Zenoh by the rules of `rmw_zenoh`.

mod actions;
mod hostile;
mod peer;
mod publishing;
mod sdk;
mod sdk_services;
mod services;
mod subscribing;
mod transforms;
