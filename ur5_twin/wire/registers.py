"""What programs and clients leave for one another: registers, inputs and outputs, by RTDE's names."""

from __future__ import annotations

import re

from ur5_twin.errors import ScriptError, WireError
from ur5_twin.wire.state import Value

#: Registers of whole numbers, of floats, and bits.
INTEGERS, DOUBLES, BITS = 48, 48, 128
#: The first bits come as words; those from here on also one by one.
_SINGLE_BITS = 64
_WORDS = ("0_to_31", "32_to_63")
_NAME = re.compile(r"(input|output)_(int|double|bit)_register_(\d+)|(input|output)_bit_registers(0_to_31|32_to_63)")
_SIZE = {"int": INTEGERS, "double": DOUBLES, "bit": BITS}
#: Whole numbers of a register.
_INT = 2**31


class Registers:
    """All of them, at zero at first.

    Attributes:
        signals: RTDE's name -> value; a new mapping whenever one changes.
    """

    def __init__(self) -> None:
        self._values: dict[tuple[str, str], list] = {
            (way, kind): [{"int": 0, "double": 0.0, "bit": False}[kind]] * size
            for way in ("input", "output")
            for kind, size in _SIZE.items()
        }
        self.signals: dict[str, Value] = {}
        for way in ("input", "output"):
            for kind, first in (("int", 0), ("double", 0), ("bit", _SINGLE_BITS)):
                for k in range(first, _SIZE[kind]):
                    self.signals[f"{way}_{kind}_register_{k}"] = self._values[way, kind][k]
            for word in _WORDS:
                self.signals[f"{way}_bit_registers{word}"] = 0

    def read(self, way: str, kind: str, address: int) -> int | float | bool:
        """The value of a register.

        Args:
            way: ``input`` or ``output``.
            kind: ``int``, ``double`` or ``bit``.
            address: its number.

        Raises:
            ScriptError: there is none of that number.
        """
        return self._values[way, kind][_place(kind, address)]

    def write(self, way: str, kind: str, address: int, value: float) -> None:
        """Set a register; arguments and errors as of ``read``, and for a value that is none."""
        k = _place(kind, address)
        if kind == "bit":
            new: int | float | bool = bool(value)
        elif kind == "int":
            if int(value) != value or not -_INT <= value < _INT:
                raise ScriptError(f"{way} integer register {k}: {value} is no whole number of 32 bits")
            new = int(value)
        else:
            new = float(value)
        self._values[way, kind][k] = new
        changed: dict[str, Value] = {f"{way}_{kind}_register_{k}": new}
        if kind == "bit" and k < _SINGLE_BITS:
            first = 32 * (k // 32)
            bits = self._values[way, kind][first : first + 32]
            changed = {f"{way}_bit_registers{_WORDS[k // 32]}": sum(1 << i for i, bit in enumerate(bits) if bit)}
        self.signals = {**self.signals, **changed}

    def write_named(self, name: str, value: float) -> bool:
        """Set a register by RTDE's name; False if the name is none of a register that clients write."""
        found = _NAME.fullmatch(name)
        if found is None or "output" in (found[1], found[4]):
            return False
        if found[5]:
            first = 32 * _WORDS.index(found[5])
            for i in range(32):
                self.write("input", "bit", first + i, int(value) >> i & 1)
            return True
        kind, address = found[2], int(found[3])
        if address >= _SIZE[kind] or (kind == "bit" and address < _SINGLE_BITS):
            raise WireError(f"there is no register '{name}'")
        self.write("input", kind, address, value)
        return True


def _place(kind: str, address: int) -> int:
    if isinstance(address, bool) or not isinstance(address, int | float) or not 0 <= address < _SIZE[kind]:
        raise ScriptError(f"there is no register {address!r}; they are 0 to {_SIZE[kind] - 1}")
    return int(address)
