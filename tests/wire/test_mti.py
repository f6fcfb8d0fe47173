"""The MTi of the cell and its client, and lines on which anything may come."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import serial
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin.errors import WireError
from ur5_twin.sources.mti import MTiSource
from ur5_twin.wire import xbus
from ur5_twin.wire.mti import MTiPort
from ur5_twin.wire.xbus import Configuration, ErrorCode, Frame, Frames, Layout, Message

RATE = 100.0


def readings(first: int, n: int, rate: float = RATE) -> dict[str, np.ndarray]:
    """Of an IMU: each sample its own number."""
    numbers = np.arange(first, first + n)
    return {
        "time": 3.0 + numbers / rate,
        "imu_acc": np.stack([numbers, -numbers, numbers * 0.5], axis=1),
        "imu_gyro": np.stack([numbers * 0.25] * 3, axis=1),
        "imu_mag": np.full((n, 3), 0.5),
    }


class Line:
    """A client that knows frames only."""

    def __init__(self, path: str) -> None:
        self._serial = serial.Serial(path, timeout=0.05)
        self._frames = Frames()
        self._waiting: list[Frame] = []

    def send(self, data: bytes) -> None:
        self._serial.write(data)

    def next(self, wait: float = 2.0) -> Frame | None:
        """The next frame; None if none comes."""
        end = time.monotonic() + wait
        while not self._waiting and time.monotonic() < end:
            self._waiting += self._frames.feed(self._serial.read(max(1, self._serial.in_waiting)))
        return self._waiting.pop(0) if self._waiting else None

    def ask(self, message: int, data: bytes = b"") -> Frame | None:
        """The answer to a message."""
        self.send(xbus.pack(message, data))
        return self.next()

    def close(self) -> None:
        self._serial.close()


@pytest.fixture
def served(bench: Callable[..., Any]) -> Any:
    return bench(MTiPort(RATE))


@pytest.fixture
def line(served: Any) -> Any:
    opened = Line(served.port.address)
    yield opened
    opened.close()


def test_a_frame_is_as_the_manual_has_it() -> None:
    assert xbus.pack(Message.GO_TO_CONFIG) == bytes.fromhex("FA FF 30 00 D1")
    assert xbus.pack(Message.GO_TO_MEASUREMENT) == bytes.fromhex("FA FF 10 00 F1")
    vectors = {name: np.arange(3.0) for name in Layout().columns}
    data = xbus.pack(Message.DATA, Layout().pack(vectors, 0x1234))
    assert len(data) == 43
    assert data[:4] == bytes.fromhex("FA FF 32 26")
    assert data[8:12] == bytes.fromhex("3F 80 00 00")
    assert data[40:42] == bytes.fromhex("12 34")
    assert sum(data[1:]) % 256 == 0


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=400)), min_size=1, max_size=8),
    st.lists(st.integers(1, 60), min_size=1),
)
def test_frames_come_whole_however_the_stream_is_cut(sent: list[tuple[int, bytes]], cuts: list[int]) -> None:
    stream = b"".join(xbus.pack(*frame) for frame in sent)
    frames, found, at = Frames(), [], 0
    while at < len(stream):
        step = cuts[at % len(cuts)]
        found += frames.feed(stream[at : at + step])
        at += step
    assert found == [Frame(*frame) for frame in sent]
    assert frames.skipped == 0


@settings(deadline=None, max_examples=60)
@given(st.binary(max_size=300), st.binary(max_size=60))
def test_after_garbage_frames_are_found_again(garbage: bytes, data: bytes) -> None:
    frames = Frames()
    frames.feed(garbage)
    # What the garbage announced has to be over: no frame is longer than this.
    rest = [frame for _ in range(60) for frame in frames.feed(xbus.pack(0x55, data))]
    assert rest[-1] == Frame(0x55, data)
    assert len(frames._buffer) <= xbus.LONGEST + 8


def test_a_frame_behind_a_broken_one_is_not_lost() -> None:
    whole = xbus.pack(0x32, b"12345")
    broken = bytearray(whole)
    broken[5] ^= 1
    frames = Frames()
    assert frames.feed(bytes(broken) + whole) == [Frame(0x32, b"12345")]
    # A length that is too long is no frame's.
    assert frames.feed(bytes.fromhex("FA FF 32 FF FF FF") + whole) == [Frame(0x32, b"12345")]


def test_extended_length() -> None:
    data = bytes(range(256)) * 2
    frame = xbus.pack(0x32, data)
    assert frame[:6] == bytes.fromhex("FA FF 32 FF 02 00")
    assert Frames().feed(frame) == [Frame(0x32, data)]
    with pytest.raises(ValueError, match="a frame holds up to 2048"):
        xbus.pack(0x32, bytes(2049))


def test_it_measures_until_told_to_go_to_its_configuration(served: Any, line: Line) -> None:
    served.publish(imu=readings(0, 3))
    first, second = line.next(), line.next()
    assert first is not None
    assert second is not None
    assert Layout().parse(first.data)[1] == 0
    vectors, counter = Layout().parse(second.data)
    assert counter == 1
    np.testing.assert_array_equal(vectors["imu_acc"], [1.0, -1.0, 0.5])
    np.testing.assert_array_equal(vectors["imu_gyro"], [0.25] * 3)
    # While it measures it hears nothing else.
    line.send(xbus.pack(Message.REQ_CONFIGURATION))
    assert line.next(0.2) is None
    assert line.ask(Message.GO_TO_CONFIG) == Frame(Message.GO_TO_CONFIG + 1, b"")
    served.publish(imu=readings(3, 3))
    known = line.ask(Message.REQ_CONFIGURATION)
    assert known is not None
    assert Configuration.parse(known.data).interval == pytest.approx(1 / RATE)
    assert line.ask(Message.REQ_DATA_LENGTH) == Frame(Message.REQ_DATA_LENGTH + 1, b"\x00\x26")
    assert line.ask(Message.GO_TO_MEASUREMENT) == Frame(Message.GO_TO_MEASUREMENT + 1, b"")
    served.publish(imu=readings(6, 2))
    third = line.next()
    assert third is not None
    # The device's clock went on.
    assert Layout().parse(third.data)[1] == 5


def test_settings_change_what_it_sends(served: Any, line: Line) -> None:
    line.ask(Message.GO_TO_CONFIG)
    settings_ = xbus.COUNTER | xbus.NO_MAG
    assert line.ask(Message.SET_OUTPUT_SETTINGS, settings_.to_bytes(4, "big")) == Frame(0xD3, b"")
    assert line.ask(Message.SET_PERIOD, (2304).to_bytes(2, "big")) == Frame(0x05, b"")
    assert line.ask(Message.SET_PERIOD) == Frame(0x05, (2304).to_bytes(2, "big"))
    assert line.ask(Message.SET_PERIOD, b"\x00\x01") == Frame(Message.ERROR, bytes([ErrorCode.PERIOD]))
    assert line.ask(Message.SET_OUTPUT_MODE, b"\x00\x04") == Frame(Message.ERROR, bytes([ErrorCode.PARAMETER]))
    assert line.ask(Message.SET_OUTPUT_SKIP_FACTOR, b"\x00\x00\x00") == Frame(Message.ERROR, bytes([0x21]))
    assert line.ask(0x77) == Frame(Message.ERROR, bytes([ErrorCode.MESSAGE]))
    line.ask(Message.GO_TO_MEASUREMENT)
    # 50 of 100 readings a second.
    served.publish(imu=readings(0, 8))
    layout = Layout(xbus.CALIBRATED, settings_)
    found = []
    while (frame := line.next(0.3)) is not None:
        found.append(layout.parse(frame.data))
    assert [counter for _, counter in found] == [0, 1, 2, 3]
    assert [vectors["imu_acc"][0] for vectors, _ in found] == [0.0, 2.0, 4.0, 6.0]
    assert list(found[0][0]) == ["imu_acc", "imu_gyro"]


def test_our_client_sets_it_up_and_reads_it(bench: Callable[..., Any]) -> None:
    served = bench(MTiPort(266.27))
    at = Line(served.port.address)
    at.ask(Message.GO_TO_CONFIG)
    at.ask(Message.SET_OUTPUT_SETTINGS, (xbus.NO_ACC).to_bytes(4, "big"))
    at.ask(Message.SET_OUTPUT_SKIP_FACTOR, b"\x00\x03")
    at.close()
    source = MTiSource(served.port.address, rate=200.0)
    sent, rows = 0, []

    def feed() -> None:
        nonlocal sent
        served.publish(imu=readings(sent, 4, 200.0))
        sent += 4

    feeding = _Feeding(feed)
    try:
        source.start()
        end = time.monotonic() + 5.0
        while sum(len(r.time) for r in rows) < 40 and time.monotonic() < end:
            time.sleep(0.01)
            rows += source.rows()
    finally:
        feeding.stop()
        source.close()
    stamps = np.concatenate([r.time for r in rows])
    acc = np.concatenate([r.columns["imu_acc"] for r in rows])
    assert len(stamps) >= 40
    np.testing.assert_allclose(np.diff(stamps), 1 / 200.0, rtol=1e-9)
    np.testing.assert_array_equal(np.diff(acc[:, 0]), 1.0)
    assert source.configuration == Configuration(0x00300CE1, 576, 0, Layout())
    assert source.lost == 0


class _Feeding:
    def __init__(self, feed: Callable[[], None]) -> None:
        import threading

        self._stop = threading.Event()

        def run() -> None:
            while not self._stop.wait(0.02):
                feed()

        self._thread = threading.Thread(target=run)
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()


def test_the_counter_wraps_and_lost_samples_are_counted() -> None:
    source = MTiSource("nowhere")
    assert [source._unwrapped(k) for k in (65534, 65535, 0, 3)] == [0, 1, 2, 5]
    assert source.lost == 2


def test_nobody_reads_and_it_goes_on(served: Any) -> None:
    for k in range(40):
        served.publish(imu=readings(20 * k, 20))
    assert served.port.overruns > 0
    late = Line(served.port.address)
    late.ask(Message.GO_TO_CONFIG)
    late._serial.reset_input_buffer()
    late._waiting.clear()
    assert late.ask(Message.GO_TO_CONFIG) == Frame(Message.GO_TO_CONFIG + 1, b"")
    late.close()


def test_anything_on_the_line_leaves_it_alive(served: Any, line: Line) -> None:
    noise = np.random.default_rng(3)
    line.ask(Message.GO_TO_CONFIG)
    for _ in range(50):
        data = noise.integers(0, 256, 40, dtype=np.uint8).tobytes()
        line.send(data)
        # Whole frames with nonsense in them too; not one that makes it measure.
        message = int(noise.choice([m for m in range(256) if m not in (0x10, 0x40)]))
        line.send(xbus.pack(message, data[: int(noise.integers(0, 8))]))
    served.settle()
    line.send(bytes(xbus.LONGEST + 10))
    while line.next(0.2) is not None:
        pass
    line.ask(Message.GO_TO_CONFIG)
    assert line.ask(Message.REQ_DEVICE_ID) == Frame(0x01, bytes.fromhex("00300CE1"))


def test_who_is_not_there_is_said(tmp_path: Any) -> None:
    with pytest.raises(WireError, match=r"nothing: no MTi, the serial port cannot be used"):
        MTiSource(str(tmp_path / "nothing")).start()
    master, slave = os.openpty()
    try:
        with pytest.raises(WireError, match="no answer of an MTi to GO_TO_CONFIG at 115200 baud"):
            MTiSource(os.ttyname(slave)).start()
    finally:
        os.close(master)
        os.close(slave)
    with pytest.raises(WireError, match="2000 samples/s; it takes 10 to 512"):
        MTiPort(2000.0)
