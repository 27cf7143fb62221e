//! Tests of this room, one module for each subject.

mod golden;
mod hiroz;
mod python;
mod rosbags;
mod text;
mod typed;
