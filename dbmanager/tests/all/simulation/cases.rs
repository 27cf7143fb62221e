//! Named cases: one thing goes wrong at a time, and the required result is known.
//!
//! These are the cases that need a team of replicas. The other cases of the study are next to the code that they test:
//!
//! | where | cases |
//! |---|---|
//! | `logic/clock.rs` | `clock_1970_boot`, `clock_2099_boot_then_heal`, `clock_steps_back_during_commit`, `hlc_counter_overflow` |
//! | `logic/gc.rs` | `delete_vs_concurrent_put_gc_race`, `last_member_standing` |
//! | `logic/state/tests.rs` | `100_way_conflict_one_key`, `utf8_prefix_edge` |
//! | `logic/txn.rs` | `max_key_value_sizes` |
//! | `logic/replica/tests.rs`, `logic/view` | owners and takeovers, watches that resume, slow watchers, snapshots held for long |
//! | `tests/all/store/` | disks: `crash_during_checkpoint_rename`, `conf_file_empty`, `open_twice_same_dir`, `witness_missing_db_present`,
//! `key_written_1M_times` |
//! | not built | `cas_decided_minority` (no decided keys), `wrong_team_key`, `revoked_robot_replays_old_tx`, `secret_nonce_after_rollback`
//! |

#[path = "cases/clocks.rs"]
mod clocks;
#[path = "cases/identity.rs"]
mod identity;
#[path = "cases/links.rs"]
mod links;
#[path = "cases/members.rs"]
mod members;
#[path = "cases/writes.rs"]
mod writes;

use super::world::{Faults, World};

/// Returns a calm team of this many robots, all of them members.
fn team(count: usize) -> World {
    let mut world = World::new(1, Faults::default());
    world.gather(count);
    world
}
