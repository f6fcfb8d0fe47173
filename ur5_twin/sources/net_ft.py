"""An ATI Net F/T as a source: records over UDP, and the page that says what its counts are worth."""

from __future__ import annotations

import contextlib
import http.client
import socket
import time

import numpy as np

from ur5_twin.errors import WireError
from ur5_twin.sources.device import Rows
from ur5_twin.sources.link import SILENCE, Link, LinkLost
from ur5_twin.wire import rdt
from ur5_twin.wire.rdt import Calibration, Command

#: How long the page and a first record may take, s; how often records are asked for again until then, s.
_TIMEOUT, _ASK_AGAIN = 3.0, 0.5
#: How often a receiver that gets nothing looks whether it is to stop, s.
_GLANCE = 0.1
#: Datagrams that are taken in at once, and the room that the system is asked for: some seconds at 7 kHz, bytes.
_AT_ONCE, _ROOM = 256, 1 << 22
_LONGEST = 65536
_WRAP = 1 << 32


class NetFTSource(Link[Rows]):
    """The records of one Net F/T, as ``ft_wrench``, N and Nm.

    Time is the sensor's own count of samples over its rate, so it neither jitters nor knows of the way to the host.
    A connection that is made again reads the page again.

    Args:
        host: address or name of the sensor.
        port: UDP port of RDT.
        page: TCP port of the page.
        calibration: what counts are worth, if the page is not to be asked.

    Attributes:
        lost: records that the sensor sent and that never came.
        disordered: records that came after a newer one, left out.
        faulty: records whose status says that something is wrong with them; they are kept.
        calibration: what counts are worth; None before the connection.
    """

    device = "ft"

    def __init__(
        self,
        host: str,
        port: int = rdt.RDT_PORT,
        *,
        page: int = rdt.HTTP_PORT,
        calibration: Calibration | None = None,
    ) -> None:
        super().__init__(host)
        self.port, self.page = port, page
        self.calibration = calibration
        self.lost = self.disordered = self.faulty = 0
        self._asks_page = calibration is None
        self._socket: socket.socket | None = None
        self._heard = 0.0
        self._rdt_sequence = 0
        self._ft_sequence: int | None = None
        self._samples = 0
        self._status = 0

    def describe(self) -> str:
        """The stream in words, once connected."""
        known = self.calibration
        rate = "" if known is None else f", {known.rate:g} records/s"
        return f"Net F/T of {self.host}:{self.port}{rate}"

    def _open(self) -> None:
        if self._asks_page:
            calibration = Calibration.of_page(self._read_page())
            if self.calibration is not None and (calibration.per_count != self.calibration.per_count).any():
                self._say("the sensor has another calibration since the connection was made again")
            self.calibration = calibration
        try:
            self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _ROOM)
            self._socket.settimeout(_GLANCE)
            # Connected, so that nobody else's datagrams come in.
            self._socket.connect((self.host, self.port))
            self._socket.send(rdt.request(Command.STOP))
        except OSError as error:
            raise WireError(f"{self.host}:{self.port}: no Net F/T ({error.strerror or error})") from None
        self._rdt_sequence, self._heard = 0, 0.0
        now = time.monotonic()
        deadline, ask = now + _TIMEOUT, now
        while not self._heard:
            now = time.monotonic()
            if now > deadline:
                raise WireError(
                    f"{self.host}:{self.port}: no record of a Net F/T came within {_TIMEOUT:g} s; is RDT switched on?"
                )
            if self._stopping.is_set():
                raise WireError("stopped")
            try:
                if now >= ask:
                    ask = now + _ASK_AGAIN
                    self._socket.send(rdt.request(Command.REAL_TIME))
                self._take()
            except OSError as error:
                raise WireError(f"{self.host}:{self.port}: no Net F/T ({error.strerror or error})") from None

    def _read_page(self) -> bytes:
        where = f"{self.host}:{self.page}{rdt.PAGE}"
        deadline = time.monotonic() + _TIMEOUT
        connection = http.client.HTTPConnection(self.host, self.page, timeout=_TIMEOUT)
        try:
            connection.request("GET", rdt.PAGE)
            answer = connection.getresponse()
            if answer.status != http.client.OK:
                raise WireError(f"{where}: {answer.status} {answer.reason}; a Net F/T has this page")
            page = b""
            while len(page) <= rdt.LONGEST_PAGE and (piece := answer.read1(rdt.LONGEST_PAGE)):
                page += piece
                if time.monotonic() > deadline:
                    raise WireError(f"{where}: did not end within {_TIMEOUT:g} s")
            return page
        except (OSError, http.client.HTTPException) as error:
            why = getattr(error, "strerror", None) or error or type(error).__name__
            raise WireError(f"{where}: what the sensor's counts are worth cannot be read ({why})") from None
        finally:
            connection.close()

    def _receive(self) -> None:
        try:
            taken = self._take()
        except OSError as error:
            raise LinkLost(error.strerror or str(error)) from None
        if not taken and time.monotonic() - self._heard > SILENCE:
            raise LinkLost(f"silent for {SILENCE:g} s")

    def _take(self) -> bool:
        """Take in what has come, waiting for it for a while; whether there was any record."""
        assert self._socket is not None
        found: list[rdt.Records] = []
        arrival: list[float] = []
        self._socket.settimeout(_GLANCE)
        try:
            for _ in range(_AT_ONCE):
                data = self._socket.recv(_LONGEST)
                records = rdt.parse_records(data)
                if records is not None:
                    found.append(records)
                    arrival += [time.monotonic()] * len(records.status)
                self._socket.settimeout(0.0)
        except (TimeoutError, BlockingIOError):
            pass
        if not found:
            return False
        self._heard = time.monotonic()
        self._put_records(found, np.array(arrival))
        return True

    def _put_records(self, found: list[rdt.Records], arrival: np.ndarray) -> None:
        assert self.calibration is not None
        rdt_sequence = np.concatenate([records.rdt_sequence for records in found])
        ft_sequence = np.concatenate([records.ft_sequence for records in found])
        status = np.concatenate([records.status for records in found])
        counts = np.concatenate([records.counts for records in found])
        kept, samples = [], []
        for k, sequence in enumerate(rdt_sequence.tolist()):
            step = _step(sequence, self._rdt_sequence)
            if step <= 0:
                self.disordered += 1
                continue
            self.lost += step - 1
            self._rdt_sequence = sequence
            kept.append(k)
            samples.append(self._unwrapped(int(ft_sequence[k])))
        if not kept:
            return
        self._watch_status(status[kept])
        stamps = np.array(samples) / self.calibration.internal_rate
        self._put(Rows(stamps, arrival[kept], {"ft_wrench": counts[kept] * self.calibration.per_count}))

    def _unwrapped(self, sequence: int) -> int:
        """The sensor's count beyond its 32 bits; of a sensor that was started again it goes back."""
        if self._ft_sequence is None:
            self._samples = sequence
        else:
            self._samples += _step(sequence, self._ft_sequence)
        self._ft_sequence = sequence
        return self._samples

    def _watch_status(self, status: np.ndarray) -> None:
        self.faulty += int(np.count_nonzero(status))
        for bits in status.tolist():
            if bits == self._status:
                continue
            self._status = bits
            what = "saturated" if bits & rdt.SATURATED else f"status {bits:#010x}"
            self._say(
                f"the sensor's readings are sound again (status {bits})" if not bits else f"the sensor says: {what}"
            )

    def _decoded(self, pieces: list[Rows]) -> list[Rows]:
        return pieces

    def _shut(self) -> None:
        if self._socket is not None:
            # A sensor that is gone sends nothing more anyway.
            with contextlib.suppress(OSError):
                self._socket.send(rdt.request(Command.STOP))
            self._socket.close()
            self._socket = None


def _step(new: int, old: int) -> int:
    """From one 32-bit counter to another, the short way round."""
    step = (new - old) % _WRAP
    return step - _WRAP if step >= _WRAP // 2 else step
