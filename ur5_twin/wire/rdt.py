"""What goes over the wire of an ATI Net F/T: RDT's datagrams and the page that says what they mean.

Knows no socket; the port (``wire.net_ft``) and the client (``sources.net_ft``) use it, one at each end, so that they
cannot disagree.
"""

from __future__ import annotations

import struct
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from xml.sax.saxutils import escape

import numpy as np

from ur5_twin.errors import WireError, unknown

#: UDP port of RDT, TCP port of the page.
RDT_PORT, HTTP_PORT = 49152, 80
PAGE = "/netftapi2.xml"
_REQUEST = struct.Struct(">HHI")
_HEADER = 0x1234
_RECORD = struct.Struct(">IIIiiiiii")
#: Bytes of a record; several may come in one datagram.
RECORD_BYTES = _RECORD.size
_DTYPE = np.dtype([("rdt", ">u4"), ("ft", ">u4"), ("status", ">u4"), ("counts", ">i4", 6)])
#: A page longer than this is none, bytes.
LONGEST_PAGE = 256 * 1024
#: Rate at which a Net F/T samples and counts ``ft_sequence``, Hz.
INTERNAL_RATE = 7000.0
#: Status bits: any error at all, and what is wrong.
ERROR, SATURATED = 1 << 31, 1 << 17
_FORCE_UNITS = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "klbf": 4448.2216152605, "kgf": 9.80665, "gf": 9.80665e-3}
_TORQUE_UNITS = {
    "Nm": 1.0,
    "kNm": 1e3,
    "Nmm": 1e-3,
    "lbfft": 1.3558179483314,
    "lbfin": 0.1129848290276,
    "kgfm": 9.80665,
    "kgfcm": 9.80665e-2,
}


class Command(IntEnum):
    """What a client may ask for."""

    STOP = 0
    REAL_TIME = 2
    BUFFERED = 3
    MULTI_UNIT = 4
    RESET_LATCH = 0x41
    BIAS = 0x42


_COMMANDS = frozenset(map(int, Command))


def request(command: Command, samples: int = 0) -> bytes:
    """A request; ``samples`` 0 asks for records without end."""
    return _REQUEST.pack(_HEADER, command, samples)


def parse_request(data: bytes) -> tuple[Command, int] | None:
    """Command and number of samples; None for what is no request, however it came about."""
    if len(data) != _REQUEST.size:
        return None
    header, command, samples = _REQUEST.unpack(data)
    if header != _HEADER or command not in _COMMANDS:
        return None
    return Command(command), samples


@dataclass(frozen=True)
class Records:
    """Some records, in order.

    Attributes:
        rdt_sequence: (n,) the client's records since it asked, from 1; what is missing was lost on the way.
        ft_sequence: (n,) the sensor's own samples.
        status: (n,) bits, 0 for a sound reading.
        counts: (n, 6) force and moment.
    """

    rdt_sequence: np.ndarray
    ft_sequence: np.ndarray
    status: np.ndarray
    counts: np.ndarray


def pack_record(rdt_sequence: int, ft_sequence: int, status: int, counts: Sequence[int] | np.ndarray) -> bytes:
    """One record; counters wrap at 32 bits."""
    return _RECORD.pack(rdt_sequence & 0xFFFFFFFF, ft_sequence & 0xFFFFFFFF, status, *map(int, counts))


def parse_records(data: bytes) -> Records | None:
    """The records of a datagram; None if it is none of a Net F/T."""
    if not data or len(data) % RECORD_BYTES:
        return None
    found = np.frombuffer(data, dtype=_DTYPE)
    return Records(*(found[name].astype(np.int64) for name in ("rdt", "ft", "status", "counts")))


@dataclass(frozen=True)
class Calibration:
    """What counts mean, as the page says.

    Attributes:
        counts_per_force, counts_per_torque: counts per unit.
        force_unit, torque_unit: the units, as the page writes them.
        rate: records that are sent in a second.
        internal_rate: samples that the sensor takes and counts in a second.
        name: of the calibration that is in use.

    Raises:
        WireError: no such calibration can be.
    """

    counts_per_force: float = 1e6
    counts_per_torque: float = 1e6
    force_unit: str = "N"
    torque_unit: str = "Nm"
    rate: float = INTERNAL_RATE
    internal_rate: float = INTERNAL_RATE
    name: str = ""

    def __post_init__(self) -> None:
        for what in ("counts_per_force", "counts_per_torque", "rate", "internal_rate"):
            value = getattr(self, what)
            if not 0.0 < value < 1e12:
                raise WireError(f"Net F/T: {what} is {value}; it must be positive")
        _unit("force", self.force_unit, _FORCE_UNITS)
        _unit("torque", self.torque_unit, _TORQUE_UNITS)

    @property
    def per_count(self) -> np.ndarray:
        """(6,) N and Nm that a count is worth."""
        force = _unit("force", self.force_unit, _FORCE_UNITS) / self.counts_per_force
        torque = _unit("torque", self.torque_unit, _TORQUE_UNITS) / self.counts_per_torque
        return np.repeat([force, torque], 3)

    def page(self) -> bytes:
        """The page that says so."""
        entries = {
            "cfgcalsel": escape(self.name),
            "cfgnam": escape(self.name),
            "scfgfu": escape(self.force_unit),
            "scfgtu": escape(self.torque_unit),
            "cfgcpf": f"{self.counts_per_force:.15g}",
            "cfgcpt": f"{self.counts_per_torque:.15g}",
            "comrdte": "1",
            "comrdtrate": f"{self.rate:.15g}",
            "runrate": f"{self.internal_rate:.15g}",
        }
        lines = "".join(f"<{key}>{value}</{key}>\n" for key, value in entries.items())
        return f'<?xml version="1.0" encoding="ISO-8859-1"?>\n<netft>\n{lines}</netft>\n'.encode("latin-1", "replace")

    @staticmethod
    def of_page(page: bytes) -> Calibration:
        """Read the page of any Net F/T.

        Raises:
            WireError: it is none, or lacks what counts are worth.
        """
        if len(page) > LONGEST_PAGE or b"<!" in page.replace(b"<!--", b""):
            # No sensor writes those; entities could be made to grow without end.
            raise WireError(f"{PAGE} is no page of a Net F/T: too long, or with a document type of its own")
        try:
            root = ElementTree.fromstring(page)
        except ElementTree.ParseError as error:
            raise WireError(f"{PAGE} is no XML ({error})") from None
        found = {str(e.tag).rsplit("}", 1)[-1]: (e.text or "").strip() for e in root.iter() if isinstance(e.tag, str)}
        missing = [key for key in ("cfgcpf", "cfgcpt") if not found.get(key)]
        if missing:
            raise WireError(f"{PAGE} lacks {' and '.join(missing)}, the counts per unit: it is not a Net F/T's")
        return Calibration(
            counts_per_force=_positive(found, "cfgcpf", None),
            counts_per_torque=_positive(found, "cfgcpt", None),
            force_unit=found.get("scfgfu") or "N",
            torque_unit=found.get("scfgtu") or "Nm",
            rate=_positive(found, "comrdtrate", INTERNAL_RATE),
            internal_rate=_positive(found, "runrate", INTERNAL_RATE),
            name=found.get("cfgnam", ""),
        )


def _positive(found: dict[str, str], key: str, default: float | None) -> float:
    text = found.get(key, "")
    if not text and default is not None:
        return default
    try:
        value = float(text)
    except ValueError:
        raise WireError(f"{PAGE}: {key} is '{text}', no number") from None
    if value == 0.0 and default is not None:
        # Firmware that does not know it says 0.
        return default
    return value


def _unit(kind: str, text: str, known: dict[str, float]) -> float:
    """What a unit is worth in N or Nm, however it is spelt: N-m, Nm, N-mm, lbf-in."""
    spelt = {name.lower(): value for name, value in known.items()}
    plain = "".join(letter for letter in text if letter.isalpha()).lower()
    if plain not in spelt:
        raise WireError(f"Net F/T: {unknown(f'unit of {kind}', text, known)}")
    return spelt[plain]
