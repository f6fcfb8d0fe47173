"""The real-time interface's reader: every layout, any cut of the stream, garbage, lost connections."""

from __future__ import annotations

import socket
import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin.errors import WireError
from ur5_twin.sources.realtime import RealtimeSource, Reassembler, decode
from ur5_twin.wire.realtime_layout import SIZES, encode, fields

ALL_SIZES = sorted(SIZES)


def made(size: int, n: int) -> list[bytes]:
    return [encode(size, {"timestamp": 100.0 + 0.008 * k, "actual_q": np.full(6, float(k))}) for k in range(n)]


def gathered(source: RealtimeSource, rows: int, seconds: float = 10.0) -> list:
    """What a source gives until it has given so many rows."""
    found, end = [], time.monotonic() + seconds
    while sum(len(piece.time) for piece in found) < rows and time.monotonic() < end:
        found += source.rows()
        time.sleep(0.005)
    return found


@given(
    size=st.sampled_from(ALL_SIZES),
    cuts=st.lists(st.integers(0, 5 * 1220), max_size=30),
)
def test_any_cut_of_the_stream_gives_the_same_packets(size: int, cuts: list[int]) -> None:
    packets = made(size, 5)
    stream = b"".join(packets)
    places = sorted({0, len(stream), *(cut for cut in cuts if cut < len(stream))})
    reader = Reassembler()
    found = [packet for a, b in pairwise(places) for packet in reader.feed(stream[a:b])]
    assert found == packets
    assert (reader.size, reader.skipped) == (size, 0)


@settings(max_examples=50)
@given(garbage=st.binary(min_size=1, max_size=3000), at=st.integers(0, 3), size=st.sampled_from(ALL_SIZES))
def test_what_is_no_packet_is_passed_over(garbage: bytes, at: int, size: int) -> None:
    packets = made(size, 8)
    reader = Reassembler()
    found = reader.feed(b"".join([*packets[:at], garbage, *packets[at:]]))
    # The garbage may look like a beginning and take the next packet with it, and the last one has none behind it.
    assert set(found[at:]) <= set(packets) | {packet for packet in found if garbage[:4] == packet[:4]}
    assert set(packets[at + 2 : 7]) <= set(found)


def test_a_port_that_sends_something_else_is_named() -> None:
    reader = Reassembler()
    with pytest.raises(WireError, match="756 to 1220 bytes"):
        reader.feed(b"Connected: Universal Robots Dashboard Server\n" * 3000)


def test_memory_is_bounded_while_nothing_fits() -> None:
    reader = Reassembler()
    reader.feed(made(1108, 1)[0])
    for _ in range(60):
        reader.feed(bytes(1000))
        assert len(reader._buffer) < 10_000
    assert reader.skipped >= 59_000


@pytest.mark.parametrize("size", ALL_SIZES)
def test_every_layout_says_what_was_put_in(size: int) -> None:
    rng = np.random.default_rng(size)
    signals = {field.name: rng.integers(0, 9, field.width) * 0.5 for field in fields(size)} | {"robot_mode": 7}
    rows = decode([encode(size, {**signals, "timestamp": 100.0 + k}) for k in range(3)], [0.0, 1.0, 2.0])
    assert rows.time.tolist() == [100.0, 101.0, 102.0]
    assert rows.arrival.tolist() == [0.0, 1.0, 2.0]
    for field in fields(size):
        if field.name != "timestamp":
            expected = np.broadcast_to(np.asarray(signals[field.name], float), (3, field.width))
            np.testing.assert_array_equal(rows.columns[field.name], expected, field.name)


def test_the_pose_of_1_x_is_the_measured_one() -> None:
    """At byte 588 the first series has the measured pose, the third the target's."""
    first = decode([encode(756, {"actual_TCP_pose": np.arange(6.0)})], [0.0]).columns
    assert first["actual_TCP_pose"][0].tolist() == [0, 1, 2, 3, 4, 5]
    assert "target_TCP_pose" not in first


def test_a_layout_of_the_future_gives_what_is_known_once_it_repeats() -> None:
    newer = [(1300).to_bytes(4, "big") + packet[4:] + bytes(80) for packet in made(1220, 3)]
    reader = Reassembler()
    assert reader.feed(newer[0]) == []
    assert reader.feed(newer[1]) == newer[:1]
    assert decode(newer[:1], [0.0]).columns["actual_q"].shape == (1, 6)


def test_late_and_split_packets_come_whole_and_in_order(stream, packets) -> None:
    sent = packets(756, slice(0, 90))
    script = []
    for k in range(0, 90, 3):
        # As the thesis' robot does: the third is late, comes with the next, and that one's end is later still.
        both = sent[k + 1] + sent[k + 2]
        script += [sent[k], both[:-62], both[-62:]]
    server = stream(script)
    source = RealtimeSource("127.0.0.1", server.port)
    source.start()
    pieces = gathered(source, 90)
    source.close()
    assert np.concatenate([piece.time for piece in pieces]).size == 90
    assert (np.diff(np.concatenate([piece.time for piece in pieces])) > 0).all()
    assert (np.diff(np.concatenate([piece.arrival for piece in pieces])) >= 0).all()
    assert "756 bytes" in source.describe()


def test_a_lost_connection_is_made_again(stream, packets) -> None:
    first, second = packets(1108, slice(0, 20)), packets(1116, slice(20, 40), start=5.0)
    server = stream([*first, None, *second])
    source = RealtimeSource("127.0.0.1", server.port)
    source.start()
    pieces = gathered(source, 40)
    news = source.news()
    source.close()
    assert source.connections == 2
    assert sum(len(piece.time) for piece in pieces) == 40
    assert "lost" in news[0]
    assert "again" in news[1]


def test_a_silent_robot_counts_as_lost(stream, packets, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ur5_twin.sources.realtime.SILENCE", 0.3)
    server = stream(packets(1108, slice(0, 5)))
    source = RealtimeSource("127.0.0.1", server.port)
    source.start()
    end = time.monotonic() + 10.0
    news: list[str] = []
    while not news and time.monotonic() < end:
        news += source.news()
        time.sleep(0.01)
    source.close()
    assert "silent" in news[0]
    assert not source.connected


def test_nobody_there_is_said() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(WireError, match=f"127.0.0.1:{port}: no real-time interface"):
        RealtimeSource("127.0.0.1", port).start()


def test_a_port_that_says_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ur5_twin.sources.realtime._TIMEOUT", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as mute, pytest.raises(WireError, match="no packet came"):
        RealtimeSource("127.0.0.1", mute.getsockname()[1]).start()
