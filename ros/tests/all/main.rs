//! Tests of this room, one module for each subject.

mod golden;
mod rosbags;
mod text;
mod typed;
