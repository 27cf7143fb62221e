//! Clocks, sockets and zenoh.
