"""The messages of `example_interfaces`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass

    from ._standard import Message, Numbers

    @dataclass(eq=False)
    class Fibonacci_Goal(Message):
        """A message of the type `example_interfaces/action/Fibonacci_Goal`."""

        order: int = 0

    @dataclass(eq=False)
    class Fibonacci_Result(Message):
        """A message of the type `example_interfaces/action/Fibonacci_Result`."""

        sequence: Numbers[int] = Numbers[int]()

    @dataclass(eq=False)
    class Fibonacci_Feedback(Message):
        """A message of the type `example_interfaces/action/Fibonacci_Feedback`."""

        sequence: Numbers[int] = Numbers[int]()

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
