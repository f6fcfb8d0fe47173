"""Port 30004: real-time data exchange, both versions of the protocol."""

from __future__ import annotations

import asyncio
import logging
import math
import struct
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

import numpy as np

from ur5_twin.errors import WireError
from ur5_twin.wire.messages import Message, News
from ur5_twin.wire.rtde_signals import Type, input_type, output_type
from ur5_twin.wire.state import State, Value
from ur5_twin.wire.streams import Client, CutOff, TcpPort

if TYPE_CHECKING:
    from ur5_twin.wire.controller import VirtualController

log = logging.getLogger(__name__)

_HEADER = struct.Struct(">HB")
#: What the two bytes of a package's size can say.
_LARGEST = 0xFFFF
#: Recipes that one client may set up for each direction: their number is one byte. ur_rtde has 23 for its inputs.
_MOST_RECIPES = 255
#: Packages of input that wait for the tick; when more come the oldest go, as a controller reads only the newest.
_MOST_WAITING = 256
#: Levels of text messages.
_ERROR, _WARNING, _INFO = 1, 2, 3
#: The level of each kind of the controller's messages.
_LEVELS = {"text": _INFO, "popup": _WARNING, "error": _ERROR}
#: Who a text message comes from: this interface, the controller.
_HERE, _CONTROLLER = b"RTDE", b"URControl"
#: Bytes of a text: its length is one byte.
_LONGEST_TEXT = 255


class OutputRecipe:
    """Variables that a client wants, in its order, at its frequency.

    Args:
        number: it begins each package with; None for version 1 of the protocol, which has none.
        fields: names and types.
        frequency: packages a second; what is no frequency or more than the controller's asks for every tick.
        rate: the controller's, Hz.
    """

    def __init__(self, number: int | None, fields: Sequence[tuple[str, Type]], frequency: float, rate: float) -> None:
        self._fields = fields
        prefix = "" if number is None else "B"
        self._number = [] if number is None else [number]
        self._values = struct.Struct(f">HB{prefix}" + "".join(type.format for _, type in fields))
        wanted = math.isfinite(frequency) and 0 < frequency < rate
        self._ratio = frequency / rate if wanted else 1.0

    @property
    def size(self) -> int:
        """Bytes of a package."""
        return self._values.size

    def due(self, tick: int) -> bool:
        """Whether a package goes out at a tick: evenly, and on average as often as was asked for."""
        # The little extra keeps a product that should be whole from being just below it.
        return math.floor(tick * self._ratio + 1e-9) != math.floor((tick - 1) * self._ratio + 1e-9)

    def package(self, signals: Mapping[str, Value]) -> bytes:
        """The package of a tick; what the cell does not know is zero."""
        values: list[Any] = [self._values.size, ord("U"), *self._number]
        for name, type in self._fields:
            _append(values, signals.get(name), type)
        try:
            return self._values.pack(*values)
        except struct.error:
            # A value that its type cannot hold: the nearest that it can.
            head = len(self._number) + 2
            codes = [code for _, type in self._fields for code in type.format]
            return self._values.pack(*values[:head], *map(_held, codes, values[head:]))


def _append(values: list[Any], value: Value | None, type: Type) -> None:
    if value is None:
        values.extend([0] * type.width)
    elif type.width > 1:
        elements = np.asarray(value).ravel()[: type.width].tolist()
        elements += [0] * (type.width - len(elements))
        values.extend(elements if type.code == "d" else map(_whole, elements))
    elif type.code == "d":
        values.append(float(value))
    elif type.code == "?":
        values.append(bool(value))
    else:
        values.append(_whole(value))


def _whole(value: Any) -> int:
    """The nearest whole number; zero for what is none."""
    number = float(value) if not isinstance(value, int) else value
    if isinstance(number, float) and not math.isfinite(number):
        return 0
    return round(number)


_LIMITS = {"B": (0, 2**8 - 1), "I": (0, 2**32 - 1), "Q": (0, 2**64 - 1), "i": (-(2**31), 2**31 - 1)}


def _held(code: str, value: Any) -> Any:
    if code not in _LIMITS:
        return value
    low, high = _LIMITS[code]
    return min(max(value, low), high)


class InputRecipe:
    """Variables that a client writes, in its order."""

    def __init__(self, fields: Sequence[tuple[str, Type]]) -> None:
        self.names = [name for name, _ in fields]
        self._fields = [(name, type, struct.Struct(">" + type.format)) for name, type in fields]

    def values(self, data: bytes) -> list[tuple[str, Value]]:
        """What a package says: as many whole variables as are in it; bytes beyond the last are left."""
        found: list[tuple[str, Value]] = []
        place = 0
        for name, type, layout in self._fields:
            if place + layout.size > len(data):
                break
            elements = layout.unpack_from(data, place)
            found.append((name, np.array(elements) if type.width > 1 else elements[0]))
            place += layout.size
        # What says which bits count must be there before the bits.
        return sorted(found, key=lambda pair: not pair[0].endswith(("_mask", "_type")))


class RtdeClient(Client):
    """One client: its protocol's version, its recipes, and whether it listens."""

    port: RtdePort

    def __init__(self, port: RtdePort) -> None:
        super().__init__(port)
        self._protocol = 1
        self._outputs: list[OutputRecipe] = []
        self._inputs: list[InputRecipe] = []
        self._started = False
        self._buffer = bytearray()
        self._inbox: deque[list[tuple[str, Value]]] = deque(maxlen=_MOST_WAITING)
        self._posted = False

    def received(self, data: bytes) -> None:
        self._buffer += data
        place = 0
        while len(self._buffer) - place >= _HEADER.size:
            size, kind = _HEADER.unpack_from(self._buffer, place)
            if size < _HEADER.size:
                raise CutOff(f"a package of {size} bytes: its header alone has {_HEADER.size}")
            if len(self._buffer) - place < size:
                break
            self._handle(chr(kind), bytes(self._buffer[place + _HEADER.size : place + size]))
            place += size
        # What is left is part of one package: below 64 kB.
        del self._buffer[:place]

    def ended(self, *, by_client: bool) -> None:
        self.port.release(self)

    def publish(self, state: State) -> None:
        """Send what is due at a tick."""
        if self._started:
            for recipe in self._outputs:
                if recipe.due(state.tick):
                    self.send_package(recipe.package(state.signals))

    def text(self, message: str, level: int) -> None:
        """Tell the client what is wrong with what it sent."""
        self.reply(self._text(message, level, _HERE))

    def tell(self, message: Message) -> None:
        """Forward what the controller says, if the client listens and has taken all that came before.

        While it sets up its recipes a client expects answers and nothing else. Some only write and never read: for
        them a text must not wait, or they would be taken for stuck.
        """
        if self._started and not self.unsent:
            self.send_package(self._text(message.text, _LEVELS.get(message.kind, _INFO), _CONTROLLER))

    def _text(self, message: str, level: int, source: bytes) -> bytes:
        # Cut between two characters.
        words = message.encode("utf-8", "replace")[:_LONGEST_TEXT].decode("utf-8", "ignore").encode()
        if self._protocol == 1:
            payload = bytes([level]) + words
        else:
            payload = bytes([len(words)]) + words + bytes([len(source)]) + source + bytes([level])
        return _package("M", payload)

    def _answer(self, kind: str, payload: bytes) -> None:
        self.reply(_package(kind, payload))

    def _handle(self, kind: str, payload: bytes) -> None:
        match kind:
            case "V":
                wanted = struct.unpack(">H", payload[:2])[0] if len(payload) >= 2 else 0
                if wanted in (1, 2):
                    self._protocol = wanted
                self._answer("V", bytes([wanted in (1, 2)]))
            case "v":
                version = self.port.controller.version
                self._answer("v", struct.pack(">4I", version.major, version.minor, version.bugfix, version.build))
            case "O":
                self._set_outputs(payload)
            case "I":
                self._set_inputs(payload)
            case "S":
                ready = bool(self._outputs or self._inputs)
                self._started = ready
                self._answer("S", bytes([ready]))
            case "P":
                self._started = False
                self._answer("P", b"\x01")
            case "U":
                self._take(payload)
            case "M":
                log.info("RTDE client says: %s", payload[:255].decode("utf-8", "replace"))
            case _:
                self.text(f"a package of type {ord(kind)}, which RTDE has not got", _ERROR)

    def _set_outputs(self, payload: bytes) -> None:
        rate = 1.0 / self.port.controller.version.period
        frequency = rate
        names = payload
        if self._protocol == 2:
            if len(payload) < 8:
                self._answer("O", b"\x00")
                return
            frequency = struct.unpack(">d", payload[:8])[0]
            names = payload[8:]
        asked = _names(names)
        types = [output_type(name, self.port.controller.version) for name in asked]
        fields = [(name, type) for name, type in zip(asked, types, strict=True) if type is not None]
        number = len(self._outputs) + 1 if self._protocol == 2 else None
        recipe = OutputRecipe(number, fields, frequency, rate)
        good = len(fields) == len(asked)
        before = sum(other.size for other in self._outputs) if self._protocol == 2 else 0
        if good and before + recipe.size > _LARGEST:
            self.text(f"{before + recipe.size} bytes a tick are asked for: {_LARGEST} at most", _ERROR)
            good = False
        if good and self._protocol == 2 and len(self._outputs) >= _MOST_RECIPES:
            self.text(f"more than {_MOST_RECIPES} output recipes", _ERROR)
            good = False
        if good:
            # Version 1 has one recipe, and a new one takes its place.
            self._outputs = [*self._outputs, recipe] if self._protocol == 2 else [recipe]
        words = ",".join("NOT_FOUND" if type is None else type.name for type in types).encode()
        if self._protocol == 2:
            words = bytes([number if good and number is not None else 0]) + words
        self._answer("O", words[: _LARGEST - _HEADER.size])

    def _set_inputs(self, payload: bytes) -> None:
        asked = _names(payload)
        types = [input_type(name, self.port.controller.version) for name in asked]
        fields = [(name, type) for name, type in zip(asked, types, strict=True) if type is not None]
        words = [
            "NOT_FOUND" if type is None else "IN_USE" if self.port.taken(name, self) else type.name
            for name, type in zip(asked, types, strict=True)
        ]
        good = not {"NOT_FOUND", "IN_USE"} & set(words)
        if good and len(self._inputs) >= _MOST_RECIPES:
            self.text(f"more than {_MOST_RECIPES} input recipes", _ERROR)
            good = False
        if good:
            self.port.take([name for name, _ in fields], self)
            self._inputs.append(InputRecipe(fields))
        number = len(self._inputs) if good else 0
        self._answer("I", (bytes([number]) + ",".join(words).encode())[: _LARGEST - _HEADER.size])

    def _take(self, payload: bytes) -> None:
        """Values for the controller: they are there at the next tick."""
        number = payload[0] if payload else 0
        if not 1 <= number <= len(self._inputs):
            self.text(f"data for input recipe {number}, which is not set up", _WARNING)
            return
        self._inbox.append(self._inputs[number - 1].values(payload[1:]))
        if self._posted:
            return
        # Before the action is posted: the tick may carry it out, and take this back, before post has even returned.
        self._posted = True
        try:
            future = self.port.controller.post(self._write)
        except WireError as error:
            self._posted = False
            self._inbox.clear()
            self.text(str(error), _ERROR)
            return
        loop = asyncio.get_running_loop()
        future.add_done_callback(lambda done: loop.call_soon_threadsafe(self._written, done))

    def _write(self) -> None:
        """Tick thread: hand the controller all that has come in, in its order."""
        self._posted = False
        failure: Exception | None = None
        while self._inbox:
            for name, value in self._inbox.popleft():
                try:
                    self.port.controller.write_input(name, value)
                except WireError as error:
                    failure = error
        if failure is not None:
            raise failure

    def _written(self, done: Future[None]) -> None:
        error = None if done.cancelled() else done.exception()
        if error is not None:
            self.text(str(error), _WARNING)


class RtdePort(TcpPort[RtdeClient]):
    """Real-time data exchange: clients choose what they read and what they write.

    A variable of the inputs belongs to the first client that asks for it, until it leaves.
    """

    name = "rtde"
    # What is asked for is answered: who does not read must not ask.
    reads_while_full = False

    def __init__(self, controller: VirtualController, bind: str = "127.0.0.1", number: int = 30004) -> None:
        super().__init__(controller, bind, number)
        self._owners: dict[str, RtdeClient] = {}
        self._news = News(controller)

    def new_client(self) -> RtdeClient:
        return RtdeClient(self)

    def publish(self, state: State) -> None:
        super().publish(state)
        fresh = self._news.fresh()
        for client in list(self.clients):
            client.publish(state)
            for message in fresh:
                client.tell(message)

    def taken(self, name: str, client: RtdeClient) -> bool:
        """Whether an input belongs to another client."""
        return self._owners.get(name, client) is not client

    def take(self, names: Sequence[str], client: RtdeClient) -> None:
        """Give inputs to a client."""
        self._owners.update(dict.fromkeys(names, client))

    def release(self, client: RtdeClient) -> None:
        """Take a client's inputs back."""
        self._owners = {name: owner for name, owner in self._owners.items() if owner is not client}


def _package(kind: str, payload: bytes) -> bytes:
    return _HEADER.pack(_HEADER.size + len(payload), ord(kind)) + payload


def _names(data: bytes) -> list[str]:
    """The names of a recipe; ur_rtde ends its list with a comma."""
    return [name.strip() for name in data.decode("ascii", "replace").rstrip("\x00, ").split(",")]
