//! The messages of `example_interfaces`, written by `tests/all/typed.rs`.

super::message! {
    FibonacciGoal, "example_interfaces/action/Fibonacci_Goal", "ros.example.Fibonacci_Goal";
    order: i32,
}

super::message! {
    FibonacciResult, "example_interfaces/action/Fibonacci_Result", "ros.example.Fibonacci_Result";
    sequence: Vec<i32>,
}

super::message! {
    FibonacciFeedback, "example_interfaces/action/Fibonacci_Feedback", "ros.example.Fibonacci_Feedback";
    sequence: Vec<i32>,
}
