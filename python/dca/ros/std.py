"""The messages of `std_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field

    from . import builtin as _builtin
    from ._standard import Message, Numbers, Octets

    @dataclass(eq=False)
    class Header(Message):
        """A message of the type `std_msgs/msg/Header`."""

        stamp: _builtin.Time = field(default_factory=lambda: _builtin.Time())
        frame_id: str = ""

    @dataclass(eq=False)
    class Bool(Message):
        """A message of the type `std_msgs/msg/Bool`."""

        data: bool = False

    @dataclass(eq=False)
    class Byte(Message):
        """A message of the type `std_msgs/msg/Byte`."""

        data: int = 0

    @dataclass(eq=False)
    class MultiArrayDimension(Message):
        """A message of the type `std_msgs/msg/MultiArrayDimension`."""

        label: str = ""
        size: int = 0
        stride: int = 0

    @dataclass(eq=False)
    class MultiArrayLayout(Message):
        """A message of the type `std_msgs/msg/MultiArrayLayout`."""

        dim: list[MultiArrayDimension] = field(default_factory=list)
        data_offset: int = 0

    @dataclass(eq=False)
    class ByteMultiArray(Message):
        """A message of the type `std_msgs/msg/ByteMultiArray`."""

        layout: MultiArrayLayout = field(default_factory=lambda: MultiArrayLayout())
        data: Octets = Octets()

    @dataclass(eq=False)
    class Char(Message):
        """A message of the type `std_msgs/msg/Char`."""

        data: int = 0

    @dataclass(eq=False)
    class ColorRGBA(Message):
        """A message of the type `std_msgs/msg/ColorRGBA`."""

        r: float = 0.0
        g: float = 0.0
        b: float = 0.0
        a: float = 0.0

    @dataclass(eq=False)
    class Empty(Message):
        """A message of the type `std_msgs/msg/Empty`."""

    @dataclass(eq=False)
    class Float32(Message):
        """A message of the type `std_msgs/msg/Float32`."""

        data: float = 0.0

    @dataclass(eq=False)
    class Float32MultiArray(Message):
        """A message of the type `std_msgs/msg/Float32MultiArray`."""

        layout: MultiArrayLayout = field(default_factory=lambda: MultiArrayLayout())
        data: Numbers[float] = Numbers[float]()

    @dataclass(eq=False)
    class Float64(Message):
        """A message of the type `std_msgs/msg/Float64`."""

        data: float = 0.0

    @dataclass(eq=False)
    class Float64MultiArray(Message):
        """A message of the type `std_msgs/msg/Float64MultiArray`."""

        layout: MultiArrayLayout = field(default_factory=lambda: MultiArrayLayout())
        data: Numbers[float] = Numbers[float]()

    @dataclass(eq=False)
    class Int16(Message):
        """A message of the type `std_msgs/msg/Int16`."""

        data: int = 0

    @dataclass(eq=False)
    class Int16MultiArray(Message):
        """A message of the type `std_msgs/msg/Int16MultiArray`."""

        layout: MultiArrayLayout = field(default_factory=lambda: MultiArrayLayout())
        data: Numbers[int] = Numbers[int]()

    @dataclass(eq=False)
    class Int32(Message):
        """A message of the type `std_msgs/msg/Int32`."""

        data: int = 0

    @dataclass(eq=False)
    class Int32MultiArray(Message):
        """A message of the type `std_msgs/msg/Int32MultiArray`."""

        layout: MultiArrayLayout = field(default_factory=lambda: MultiArrayLayout())
        data: Numbers[int] = Numbers[int]()

    @dataclass(eq=False)
    class Int64(Message):
        """A message of the type `std_msgs/msg/Int64`."""

        data: int = 0

    @dataclass(eq=False)
    class Int64MultiArray(Message):
        """A message of the type `std_msgs/msg/Int64MultiArray`."""

        layout: MultiArrayLayout = field(default_factory=lambda: MultiArrayLayout())
        data: Numbers[int] = Numbers[int]()

    @dataclass(eq=False)
    class Int8(Message):
        """A message of the type `std_msgs/msg/Int8`."""

        data: int = 0

    @dataclass(eq=False)
    class Int8MultiArray(Message):
        """A message of the type `std_msgs/msg/Int8MultiArray`."""

        layout: MultiArrayLayout = field(default_factory=lambda: MultiArrayLayout())
        data: Numbers[int] = Numbers[int]()

    @dataclass(eq=False)
    class String(Message):
        """A message of the type `std_msgs/msg/String`."""

        data: str = ""

    @dataclass(eq=False)
    class UInt16(Message):
        """A message of the type `std_msgs/msg/UInt16`."""

        data: int = 0

    @dataclass(eq=False)
    class UInt16MultiArray(Message):
        """A message of the type `std_msgs/msg/UInt16MultiArray`."""

        layout: MultiArrayLayout = field(default_factory=lambda: MultiArrayLayout())
        data: Numbers[int] = Numbers[int]()

    @dataclass(eq=False)
    class UInt32(Message):
        """A message of the type `std_msgs/msg/UInt32`."""

        data: int = 0

    @dataclass(eq=False)
    class UInt32MultiArray(Message):
        """A message of the type `std_msgs/msg/UInt32MultiArray`."""

        layout: MultiArrayLayout = field(default_factory=lambda: MultiArrayLayout())
        data: Numbers[int] = Numbers[int]()

    @dataclass(eq=False)
    class UInt64(Message):
        """A message of the type `std_msgs/msg/UInt64`."""

        data: int = 0

    @dataclass(eq=False)
    class UInt64MultiArray(Message):
        """A message of the type `std_msgs/msg/UInt64MultiArray`."""

        layout: MultiArrayLayout = field(default_factory=lambda: MultiArrayLayout())
        data: Numbers[int] = Numbers[int]()

    @dataclass(eq=False)
    class UInt8(Message):
        """A message of the type `std_msgs/msg/UInt8`."""

        data: int = 0

    @dataclass(eq=False)
    class UInt8MultiArray(Message):
        """A message of the type `std_msgs/msg/UInt8MultiArray`."""

        layout: MultiArrayLayout = field(default_factory=lambda: MultiArrayLayout())
        data: Octets = Octets()

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
