//! What touches the disk.
