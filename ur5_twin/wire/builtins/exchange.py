"""What a program exchanges with others and with time: registers, inputs and outputs, messages, waiting."""

from __future__ import annotations

from collections.abc import Generator
from typing import TYPE_CHECKING, Any

from ur5_twin.errors import ScriptError
from ur5_twin.wire.builtins.arguments import number
from ur5_twin.wire.urscript import shown

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

Waiting = Generator[None, None, None]
#: Outputs of each kind, and the first one's bit among all.
_OUTPUTS = {"standard": (8, 0), "configurable": (8, 8), "tool": (2, 16)}


class Exchange:
    def __init__(self, controller: VirtualController) -> None:
        self._controller = controller

    # Waiting

    def sync(self) -> Waiting:
        """Until the next tick."""
        yield

    def sleep(self, t: Any) -> Waiting:
        """So many s, in whole ticks."""
        for _ in range(max(1, round(number("sleep: t", t) / self._controller.version.period))):
            yield

    def get_steptime(self) -> float:
        """The tick, s."""
        return self._controller.version.period

    # Messages

    def textmsg(self, s1: Any = "", s2: Any = "") -> None:
        """A line in the log."""
        self._controller.say("text", shown(s1) + shown(s2))

    def popup(
        self, s: Any, title: Any = "Popup", warning: Any = False, error: Any = False, blocking: Any = False
    ) -> None:
        """A window; it does not hold the program up."""
        self._controller.say("popup", f"{shown(title)}: {shown(s)}")

    def protective_stop(self) -> Waiting:
        """Stop, and end the program."""
        self._controller.protective_stop("by the program")
        yield

    # Registers

    def read_input_integer_register(self, address: Any) -> int:
        return int(self._read("input", "int", address))

    def read_input_float_register(self, address: Any) -> float:
        return float(self._read("input", "double", address))

    def read_input_boolean_register(self, address: Any) -> bool:
        return bool(self._read("input", "bit", address))

    def read_output_integer_register(self, address: Any) -> int:
        return int(self._read("output", "int", address))

    def read_output_float_register(self, address: Any) -> float:
        return float(self._read("output", "double", address))

    def read_output_boolean_register(self, address: Any) -> bool:
        return bool(self._read("output", "bit", address))

    def write_output_integer_register(self, address: Any, value: Any) -> None:
        self._write("int", address, value)

    def write_output_float_register(self, address: Any, value: Any) -> None:
        self._write("double", address, value)

    def write_output_boolean_register(self, address: Any, value: Any) -> None:
        self._write("bit", address, value)

    def rtde_set_watchdog(self, variable_name: Any, min_frequency: Any, action: Any = "pause") -> None:
        """What becomes of the program if clients do not write an input so often, Hz: ignore, pause or stop."""
        frequency = number("rtde_set_watchdog: min_frequency", min_frequency)
        self._controller.watch(shown(variable_name), frequency, shown(action))

    # Inputs and outputs

    def set_standard_digital_out(self, n: Any, b: Any) -> None:
        self._set("standard", n, b)

    def set_configurable_digital_out(self, n: Any, b: Any) -> None:
        self._set("configurable", n, b)

    def set_tool_digital_out(self, n: Any, b: Any) -> None:
        self._set("tool", n, b)

    def get_standard_digital_out(self, n: Any) -> bool:
        return self._get("standard", n)

    def get_configurable_digital_out(self, n: Any) -> bool:
        return self._get("configurable", n)

    def get_tool_digital_out(self, n: Any) -> bool:
        return self._get("tool", n)

    def get_standard_digital_in(self, n: Any) -> bool:
        """Nothing is connected."""
        return False

    def get_configurable_digital_in(self, n: Any) -> bool:
        """Nothing is connected."""
        return False

    def get_tool_digital_in(self, n: Any) -> bool:
        """Nothing is connected."""
        return False

    def set_standard_analog_out(self, n: Any, f: Any) -> None:
        """Nothing is connected."""

    # Names of the first series, which scripts still use

    def set_digital_out(self, n: Any, b: Any) -> None:
        """Standard outputs 0 to 7, the tool's as 8 and 9."""
        self._set(*self._old(n), b)

    def get_digital_out(self, n: Any) -> bool:
        """As numbered by ``set_digital_out``."""
        return self._get(*self._old(n))

    def get_digital_in(self, n: Any) -> bool:
        """Nothing is connected."""
        return False

    def set_analog_out(self, n: Any, f: Any) -> None:
        """Nothing is connected."""

    def set_tool_voltage(self, voltage: Any) -> None:
        """Nothing is connected."""

    def zero_ftsensor(self) -> None:
        """The cell's force sensor is a device of its own; the controller has none to zero."""

    def _read(self, way: str, kind: str, address: Any) -> int | float | bool:
        return self._controller.registers.read(way, kind, address)

    def _write(self, kind: str, address: Any, value: Any) -> None:
        if kind != "bit":
            value = number(f"the register's value ({kind})", value)
        elif not isinstance(value, bool):
            raise ScriptError(f"a boolean register holds True or False, not {shown(value)[:40]}")
        self._controller.registers.write("output", kind, address, value)

    def _bit(self, which: str, n: Any) -> int:
        size, first = _OUTPUTS[which]
        k = number("the output's number", n)
        if k != int(k) or not 0 <= k < size:
            raise ScriptError(f"there is no {which} output {shown(n)}; they are 0 to {size - 1}")
        return 1 << first + int(k)

    def _old(self, n: Any) -> tuple[str, float]:
        k = number("the output's number", n)
        return ("tool", k - 8) if k >= 8 else ("standard", k)

    def _set(self, which: str, n: Any, b: Any) -> None:
        bit = self._bit(which, n)
        self._controller.outputs = self._controller.outputs | bit if b else self._controller.outputs & ~bit

    def _get(self, which: str, n: Any) -> bool:
        return bool(self._controller.outputs & self._bit(which, n))
