"""RTDE data in one CSV, in the layouts of ur_rtde's file recording and of Universal Robots' record.py."""

from __future__ import annotations

import csv
import io
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin.errors import RecordingError
from ur5_twin.recording import COLUMN_WIDTHS, Recording, read

N = 50
#: Order and widths of some of what ur_rtde records: known vectors, one it has that we have no name for, scalars.
SIGNALS = {
    "target_q": 6,
    "target_qd": 6,
    "target_qdd": 6,
    "target_current": 6,
    "target_moment": 6,
    "actual_q": 6,
    "actual_qd": 6,
    "actual_current": 6,
    "joint_control_output": 6,
    "actual_TCP_pose": 6,
    "actual_TCP_speed": 6,
    "actual_TCP_force": 6,
    "actual_tool_accelerometer": 3,
    "speed_scaling": 1,
    "actual_digital_input_bits": 1,
    "standard_analog_input0": 1,
    "output_int_register_2": 1,
}


def _signals(n: int = N) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    rng = np.random.default_rng(5)
    # The robot's clock counts from its start, not from the recording's.
    time = np.round(1234.0 + 0.002 * np.arange(n), 6)
    return time, {name: np.round(rng.normal(size=(n, width)), 6) for name, width in SIGNALS.items()}


def _header() -> list[str]:
    return ["timestamp"] + [
        label
        for name, width in SIGNALS.items()
        for label in ([name] if width == 1 else [f"{name}_{i}" for i in range(width)])
    ]


def _ur_rtde(rows: Sequence[int] = range(N)) -> str:
    """As ur_rtde writes it: commas, one header row, six decimals; ``rows`` as its own timer picked them."""
    time, signals = _signals()
    values = np.column_stack([time, *signals.values()])
    lines = [",".join(_header()), *(",".join(f"{v:.6f}" for v in values[row]) for row in rows)]
    return "\n".join(lines) + "\n"


def _record_py(dialect: dict[str, object] | None = None) -> str:
    """As record.py writes it: Python's csv module, spaces, \\r\\n, numbers in full."""
    time, signals = _signals()
    out = io.StringIO(newline="")
    writer = csv.writer(out, **{"delimiter": " ", **(dialect or {})})  # pyright: ignore[reportArgumentType]
    writer.writerow(_header())
    for row in np.column_stack([time, *signals.values()]).tolist():
        writer.writerow(row)
    return out.getvalue()


def _read(folder: Path, text: str | bytes, *, repair: bool = False) -> Recording:
    path = folder / "robot_data.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read(path, repair=repair)


def _row(text: str, row: int, old: str, new: str) -> str:
    """Change the first ``old`` of a 1-based row."""
    lines = text.split("\n")
    assert old in lines[row - 1]
    lines[row - 1] = lines[row - 1].replace(old, new, 1)
    return "\n".join(lines)


def _expect(recording: Recording, rows: Sequence[int] = range(N)) -> None:
    time, signals = _signals()
    np.testing.assert_array_equal(recording.robot.time, time[list(rows)])
    assert set(recording.robot.columns) == set(SIGNALS)
    for name, values in signals.items():
        np.testing.assert_array_equal(recording.robot[name], values[list(rows)])


def _said(recording: Recording) -> str:
    return "\n".join(map(str, recording.notes))


def test_ur_rtde(tmp_path: Path) -> None:
    recording = _read(tmp_path, _ur_rtde())
    _expect(recording)
    assert recording.format == "ur_rtde_csv"
    assert recording.source == "robot_data"
    assert recording.notes == ()
    assert recording.robot.host_start is None


@pytest.mark.parametrize(
    "dialect",
    [
        {},
        {"quoting": csv.QUOTE_ALL},
        {"quoting": csv.QUOTE_NONNUMERIC},
        {"lineterminator": "\r\r\n"},
        {"delimiter": "\t"},
    ],
)
def test_record_py(tmp_path: Path, dialect: dict[str, object]) -> None:
    recording = _read(tmp_path, _record_py(dialect))
    _expect(recording)
    assert recording.format == "record_py_csv"
    assert recording.notes == ()


@pytest.mark.parametrize("both", [True, False])
def test_trailing_separators_and_byte_order_mark(tmp_path: Path, both: bool) -> None:
    head, *rows = _ur_rtde().rstrip("\n").split("\n")
    text = "\n".join([head + ("," if both else ""), *(f"{row}," for row in rows)]) + "\n"
    _expect(_read(tmp_path, b"\xef\xbb\xbf" + text.encode()))
    head, *rows = _record_py({"lineterminator": "\n"}).rstrip("\n").split("\n")
    _expect(_read(tmp_path, "\n".join([head, *(f"{row} " for row in rows)]) + "\n"))


def test_booleans_are_numbers(tmp_path: Path) -> None:
    lines = _record_py({"lineterminator": "\n"}).rstrip("\n").split("\n")
    lines = [lines[0] + " input_bit_register_64"] + [f"{row} {i % 2 == 0}" for i, row in enumerate(lines[1:])]
    recording = _read(tmp_path, "\n".join(lines) + "\n")
    np.testing.assert_array_equal(recording.robot["input_bit_register_64"][:, 0], [1.0, 0.0] * 25)


def test_columns_of_text_are_left_out(tmp_path: Path) -> None:
    lines = _ur_rtde().rstrip("\n").split("\n")
    lines = ["operator," + lines[0]] + [f"Ann {i}," + row for i, row in enumerate(lines[1:])]
    recording = _read(tmp_path, "\n".join(lines) + "\n")
    _expect(recording)
    assert "no numbers in operator: left out" in _said(recording)


def test_rows_that_its_timer_repeats_and_misses(tmp_path: Path) -> None:
    rows = [*range(10), 9, 9, *range(10, 20), *range(22, 40), 39, *range(40, N)]
    recording = _read(tmp_path, _ur_rtde(rows))
    _expect(recording, sorted(set(rows)))
    # Row 1 is the header: sample 9 stands in row 11, and again in 12 and 13.
    assert "3 rows repeat the row before, stamp and values (the first is row 12): dropped" in _said(recording)
    assert "1 gap longer than 1.5 periods, the longest 6 ms: about 2 rows missing" in _said(recording)


def test_last_row_cut_off(tmp_path: Path) -> None:
    text = _ur_rtde()
    for cut in (1, 3, 60):
        recording = _read(tmp_path, text[: -1 - cut])
        _expect(recording, range(N - 1))
        assert f"the last row ({N + 1}) is cut off in mid-row and left out" in _said(recording)
    # Where the decimals vary a cut cannot be told from an end: the row goes even if all of it may be there.
    _expect(_read(tmp_path, _record_py().rstrip()), range(N - 1))
    _expect(_read(tmp_path, text[:-1]))


def test_vectors_keep_their_shape(tmp_path: Path) -> None:
    recording = _read(tmp_path, _ur_rtde())
    assert {name: recording.robot[name].shape[1] for name in SIGNALS} == SIGNALS
    assert all(recording.robot[name].shape[1] == w for name, w in COLUMN_WIDTHS.items() if name in recording.robot)


# ---------------------------------------------------------------- errors and their repairs


def test_no_clock(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"robot_data\.csv, row 1: no column 'timestamp' in the header"):
        _read(tmp_path, _ur_rtde().replace("timestamp", "time", 1), repair=True)


def test_no_rows(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"robot_data\.csv: a header but no rows"):
        _read(tmp_path, ",".join(_header()) + "\n")
    with pytest.raises(RecordingError, match=r"robot_data\.csv: the file is empty"):
        _read(tmp_path, "")


def test_no_positions(tmp_path: Path) -> None:
    text = _ur_rtde().replace("actual_q_", "actual_p_").replace("target_q_", "target_p_")
    with pytest.raises(RecordingError, match="row 1: no joint positions"):
        _read(tmp_path, text, repair=True)


def test_part_of_a_vector(tmp_path: Path) -> None:
    text = _ur_rtde().replace("target_moment_5", "target_moment_6", 1)
    with pytest.raises(
        RecordingError, match=r"row 1: target_moment has the parts .* it needs target_moment_0 to target_moment_5"
    ):
        _read(tmp_path, text)
    recording = _read(tmp_path, text, repair=True)
    assert "target_moment" not in recording.robot
    assert len(recording.robot) == N


def test_column_twice(tmp_path: Path) -> None:
    text = _ur_rtde().replace("speed_scaling", "target_q_0", 1)
    with pytest.raises(RecordingError, match="row 1: column 'target_q_0' appears twice"):
        _read(tmp_path, text)
    np.testing.assert_array_equal(_read(tmp_path, text, repair=True).robot["target_q"], _signals()[1]["target_q"])


@pytest.mark.parametrize(
    ("new", "what"),
    [("x.5", "'x.5' in timestamp is not a number"), ("nan", "'nan' in timestamp is not a finite number")],
)
def test_broken_number(tmp_path: Path, new: str, what: str) -> None:
    text = _row(_ur_rtde(), 20, "1234.036000", new)
    with pytest.raises(RecordingError, match=rf"robot_data\.csv, row 20: {what}"):
        _read(tmp_path, text)
    recording = _read(tmp_path, text, repair=True)
    _expect(recording, [*range(18), *range(19, N)])
    assert "1 row unreadable and left out, the first is row 20" in _said(recording)


def test_wrong_number_of_columns(tmp_path: Path) -> None:
    text = _row(_ur_rtde(), 20, ",", ",7,")
    width = len(_header())
    with pytest.raises(RecordingError, match=rf"row 20: {width + 1} columns where {width} belong"):
        _read(tmp_path, text)
    _expect(_read(tmp_path, text, repair=True), [*range(18), *range(19, N)])


def test_a_column_broken_throughout_is_left_out(tmp_path: Path) -> None:
    lines = _ur_rtde().rstrip("\n").split("\n")
    place = _header().index("target_current_2")
    for i in range(5, len(lines)):
        fields = lines[i].split(",")
        fields[place] = "nan"
        lines[i] = ",".join(fields)
    text = "\n".join(lines) + "\n"
    with pytest.raises(RecordingError, match="row 6: 'nan' in target_current_2"):
        _read(tmp_path, text)
    recording = _read(tmp_path, text, repair=True)
    assert len(recording.robot) == N
    assert set(SIGNALS) - set(recording.robot.columns) == {"target_current"}
    assert "target_current unreadable in most rows: left out" in _said(recording)


def test_time_runs_backwards(tmp_path: Path) -> None:
    text = _ur_rtde([*range(10), 3, *range(10, N)])
    with pytest.raises(RecordingError, match=r"row 12: time runs backwards \(1234\.006000 s after 1234\.018000 s\)"):
        _read(tmp_path, text)
    _expect(_read(tmp_path, text, repair=True))


def test_stamp_repeated_with_other_values(tmp_path: Path) -> None:
    text = _row(_ur_rtde(), 20, "1234.036000", "1234.034000")
    with pytest.raises(
        RecordingError, match=r"row 20: the stamp 1234\.034000 s repeats that of the row before, with other"
    ):
        _read(tmp_path, text)
    assert len(_read(tmp_path, text, repair=True).robot) == N - 1


def test_not_text(tmp_path: Path) -> None:
    raw = bytearray(_ur_rtde().encode())
    raw[len(raw) // 2] = 0xE9
    row = raw.count(b"\n", 0, len(raw) // 2) + 1
    with pytest.raises(RecordingError, match=rf"robot_data\.csv, row {row}: byte 0xe9 is not text"):
        _read(tmp_path, bytes(raw))
    assert len(_read(tmp_path, bytes(raw), repair=True).robot) == N - 1


def _read_or_refusal(folder: Path, raw: bytes, repair: bool) -> Recording | str:
    try:
        return _read(folder, raw, repair=repair)
    except RecordingError as error:
        return str(error)


@settings(max_examples=150, deadline=None)
@given(data=st.data(), repair=st.booleans(), spaces=st.booleans())
def test_any_damage_is_read_or_refused(data: st.DataObject, repair: bool, spaces: bool) -> None:
    raw = (_record_py() if spaces else _ur_rtde()).encode()
    for _ in range(data.draw(st.integers(1, 3))):
        at = int(data.draw(st.floats(0, 1)) ** 2 * len(raw))  # more often near the header
        drop = data.draw(st.integers(0, 40))
        put = data.draw(
            st.one_of(st.binary(max_size=6), st.sampled_from([b"nan", b",", b" ", b"\n", b'"', b"True", b"\r"]))
        )
        raw = raw[:at] + put + raw[at + drop :]
    if data.draw(st.booleans()):
        raw = raw[: int(data.draw(st.floats(0, 1)) * len(raw))]
    with tempfile.TemporaryDirectory() as folder:
        recording = _read_or_refusal(Path(folder), raw, repair)
    if isinstance(recording, str):
        assert "robot_data.csv" in recording
        assert "\n" not in recording
        return
    assert (np.diff(recording.robot.time) > 0).all()
    assert all(np.isfinite(values).all() for values in recording.robot.columns.values())
