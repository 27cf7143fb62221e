"""The messages of `rcl_interfaces`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field
    from typing import ClassVar

    from . import builtin as _builtin
    from ._standard import Message, Numbers, Octets

    @dataclass(eq=False)
    class FloatingPointRange(Message):
        """A message of the type `rcl_interfaces/msg/FloatingPointRange`."""

        from_value: float = 0.0
        to_value: float = 0.0
        step: float = 0.0

    @dataclass(eq=False)
    class IntegerRange(Message):
        """A message of the type `rcl_interfaces/msg/IntegerRange`."""

        from_value: int = 0
        to_value: int = 0
        step: int = 0

    @dataclass(eq=False)
    class ListParametersResult(Message):
        """A message of the type `rcl_interfaces/msg/ListParametersResult`."""

        names: list[str] = field(default_factory=list)
        prefixes: list[str] = field(default_factory=list)

    @dataclass(eq=False)
    class Log(Message):
        """A message of the type `rcl_interfaces/msg/Log`."""

        DEBUG: ClassVar[int] = 10
        INFO: ClassVar[int] = 20
        WARN: ClassVar[int] = 30
        ERROR: ClassVar[int] = 40
        FATAL: ClassVar[int] = 50

        stamp: _builtin.Time = field(default_factory=lambda: _builtin.Time())
        level: int = 0
        name: str = ""
        msg: str = ""
        file: str = ""
        function: str = ""
        line: int = 0

    @dataclass(eq=False)
    class LoggerLevel(Message):
        """A message of the type `rcl_interfaces/msg/LoggerLevel`."""

        LOG_LEVEL_UNKNOWN: ClassVar[int] = 0
        LOG_LEVEL_DEBUG: ClassVar[int] = 10
        LOG_LEVEL_INFO: ClassVar[int] = 20
        LOG_LEVEL_WARN: ClassVar[int] = 30
        LOG_LEVEL_ERROR: ClassVar[int] = 40
        LOG_LEVEL_FATAL: ClassVar[int] = 50

        name: str = ""
        level: int = 0

    @dataclass(eq=False)
    class ParameterValue(Message):
        """A message of the type `rcl_interfaces/msg/ParameterValue`."""

        type: int = 0
        bool_value: bool = False
        integer_value: int = 0
        double_value: float = 0.0
        string_value: str = ""
        byte_array_value: Octets = Octets()
        bool_array_value: list[bool] = field(default_factory=list)
        integer_array_value: Numbers[int] = Numbers[int]()
        double_array_value: Numbers[float] = Numbers[float]()
        string_array_value: list[str] = field(default_factory=list)

    @dataclass(eq=False)
    class Parameter(Message):
        """A message of the type `rcl_interfaces/msg/Parameter`."""

        name: str = ""
        value: ParameterValue = field(default_factory=lambda: ParameterValue())

    @dataclass(eq=False)
    class ParameterDescriptor(Message):
        """A message of the type `rcl_interfaces/msg/ParameterDescriptor`."""

        name: str = ""
        type: int = 0
        description: str = ""
        additional_constraints: str = ""
        read_only: bool = False
        dynamic_typing: bool = False
        floating_point_range: list[FloatingPointRange] = field(default_factory=list)
        integer_range: list[IntegerRange] = field(default_factory=list)

    @dataclass(eq=False)
    class ParameterEvent(Message):
        """A message of the type `rcl_interfaces/msg/ParameterEvent`."""

        stamp: _builtin.Time = field(default_factory=lambda: _builtin.Time())
        node: str = ""
        new_parameters: list[Parameter] = field(default_factory=list)
        changed_parameters: list[Parameter] = field(default_factory=list)
        deleted_parameters: list[Parameter] = field(default_factory=list)

    @dataclass(eq=False)
    class ParameterEventDescriptors(Message):
        """A message of the type `rcl_interfaces/msg/ParameterEventDescriptors`."""

        new_parameters: list[ParameterDescriptor] = field(default_factory=list)
        changed_parameters: list[ParameterDescriptor] = field(default_factory=list)
        deleted_parameters: list[ParameterDescriptor] = field(default_factory=list)

    @dataclass(eq=False)
    class ParameterType(Message):
        """A message of the type `rcl_interfaces/msg/ParameterType`."""

        PARAMETER_NOT_SET: ClassVar[int] = 0
        PARAMETER_BOOL: ClassVar[int] = 1
        PARAMETER_INTEGER: ClassVar[int] = 2
        PARAMETER_DOUBLE: ClassVar[int] = 3
        PARAMETER_STRING: ClassVar[int] = 4
        PARAMETER_BYTE_ARRAY: ClassVar[int] = 5
        PARAMETER_BOOL_ARRAY: ClassVar[int] = 6
        PARAMETER_INTEGER_ARRAY: ClassVar[int] = 7
        PARAMETER_DOUBLE_ARRAY: ClassVar[int] = 8
        PARAMETER_STRING_ARRAY: ClassVar[int] = 9

    @dataclass(eq=False)
    class SetLoggerLevelsResult(Message):
        """A message of the type `rcl_interfaces/msg/SetLoggerLevelsResult`."""

        successful: bool = False
        reason: str = ""

    @dataclass(eq=False)
    class SetParametersResult(Message):
        """A message of the type `rcl_interfaces/msg/SetParametersResult`."""

        successful: bool = False
        reason: str = ""

    @dataclass(eq=False)
    class DescribeParameters_Request(Message):
        """A message of the type `rcl_interfaces/srv/DescribeParameters_Request`."""

        names: list[str] = field(default_factory=list)

    @dataclass(eq=False)
    class DescribeParameters_Response(Message):
        """A message of the type `rcl_interfaces/srv/DescribeParameters_Response`."""

        descriptors: list[ParameterDescriptor] = field(default_factory=list)

    @dataclass(eq=False)
    class GetParameterTypes_Request(Message):
        """A message of the type `rcl_interfaces/srv/GetParameterTypes_Request`."""

        names: list[str] = field(default_factory=list)

    @dataclass(eq=False)
    class GetParameterTypes_Response(Message):
        """A message of the type `rcl_interfaces/srv/GetParameterTypes_Response`."""

        types: Octets = Octets()

    @dataclass(eq=False)
    class GetParameters_Request(Message):
        """A message of the type `rcl_interfaces/srv/GetParameters_Request`."""

        names: list[str] = field(default_factory=list)

    @dataclass(eq=False)
    class GetParameters_Response(Message):
        """A message of the type `rcl_interfaces/srv/GetParameters_Response`."""

        values: list[ParameterValue] = field(default_factory=list)

    @dataclass(eq=False)
    class ListParameters_Request(Message):
        """A message of the type `rcl_interfaces/srv/ListParameters_Request`."""

        DEPTH_RECURSIVE: ClassVar[int] = 0

        prefixes: list[str] = field(default_factory=list)
        depth: int = 0

    @dataclass(eq=False)
    class ListParameters_Response(Message):
        """A message of the type `rcl_interfaces/srv/ListParameters_Response`."""

        result: ListParametersResult = field(default_factory=lambda: ListParametersResult())

    @dataclass(eq=False)
    class SetParameters_Request(Message):
        """A message of the type `rcl_interfaces/srv/SetParameters_Request`."""

        parameters: list[Parameter] = field(default_factory=list)

    @dataclass(eq=False)
    class SetParameters_Response(Message):
        """A message of the type `rcl_interfaces/srv/SetParameters_Response`."""

        results: list[SetParametersResult] = field(default_factory=list)

    @dataclass(eq=False)
    class SetParametersAtomically_Request(Message):
        """A message of the type `rcl_interfaces/srv/SetParametersAtomically_Request`."""

        parameters: list[Parameter] = field(default_factory=list)

    @dataclass(eq=False)
    class SetParametersAtomically_Response(Message):
        """A message of the type `rcl_interfaces/srv/SetParametersAtomically_Response`."""

        result: SetParametersResult = field(default_factory=lambda: SetParametersResult())

    @dataclass(eq=False)
    class GetLoggerLevels_Request(Message):
        """A message of the type `rcl_interfaces/srv/GetLoggerLevels_Request`."""

        names: list[str] = field(default_factory=list)

    @dataclass(eq=False)
    class GetLoggerLevels_Response(Message):
        """A message of the type `rcl_interfaces/srv/GetLoggerLevels_Response`."""

        levels: list[LoggerLevel] = field(default_factory=list)

    @dataclass(eq=False)
    class SetLoggerLevels_Request(Message):
        """A message of the type `rcl_interfaces/srv/SetLoggerLevels_Request`."""

        levels: list[LoggerLevel] = field(default_factory=list)

    @dataclass(eq=False)
    class SetLoggerLevels_Response(Message):
        """A message of the type `rcl_interfaces/srv/SetLoggerLevels_Response`."""

        results: list[SetLoggerLevelsResult] = field(default_factory=list)

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
