//! Helpers for tests of the whole system. Such tests need more than one room.

pub mod cluster;
pub mod direct_hop;
pub mod made_team;
pub mod simulation;
pub mod survey;
