//! The spec of a small mission: a visitor pushes the hand of the simulated robot until the force is noticeable.

/// The text of the process `HitDetector`. It ends when the force exceeds a threshold, such as `"2 N"`.
#[macro_export]
macro_rules! hit_detector {
    ($threshold:literal) => {
        concat!(
            "process HitDetector(host1){
    host{host1}
    instantiated_processes{
        force instof ForceTorque(host1);
        threshold instof ForceThreshold(host1, threshold = ",
            $threshold,
            ");
    }
    internal_connections(force, lbl1){
        force, Out -> threshold, In;
    }
    internal_event_actions{
        force[lbl1], threshold
    }
}
"
        )
    };
}
