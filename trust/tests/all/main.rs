//! The room as its users see it: a small team, and strangers who try to get into it.

mod audit;
mod bundle;
mod forms;
mod heads;
mod hostile;
mod invite;
mod policy;
mod renewal;
mod request;
mod revocation;
mod seal;
mod team;
mod world;
