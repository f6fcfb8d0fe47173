"""The lab's layout: what is broken in it, what each error says, what each repair does, and the writer."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ur5_twin.errors import RecordingError
from ur5_twin.recording import Recording, Table, read, write_lab_csv

Q = "log_q_actual.csv"
M = "log_m_target.csv"


@pytest.fixture(scope="session")
def lab_template(made_recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_lab_csv(made_recording, tmp_path_factory.mktemp("lab") / "run")


@pytest.fixture
def lab(lab_template: Path, tmp_path: Path) -> Path:
    """A sound folder of the lab's layout, 40 rows, to be broken."""
    return Path(shutil.copytree(lab_template, tmp_path / "run"))


def _edit(folder: Path, name: str, change: Callable[[list[str]], object]) -> None:
    """Change the rows of one file, in place."""
    path = folder / "csv_files" / name
    rows = path.read_text().splitlines()
    change(rows)
    path.write_text("".join(f"{row}\n" for row in rows))


def _edit_all(folder: Path, change: Callable[[list[str]], object]) -> None:
    for path in (folder / "csv_files").glob("log_*.csv"):
        if "force_sensor" not in path.name:
            _edit(folder, path.name, change)


def _put(row: int, field: int, value: str) -> Callable[[list[str]], None]:
    def change(rows: list[str]) -> None:
        fields = rows[row - 1].split(", ")
        fields[field] = value
        rows[row - 1] = ", ".join(fields)

    return change


def _said(recording: Recording) -> str:
    return "\n".join(map(str, recording.notes))


def _repairs(recording: Recording) -> list[str]:
    return [str(note) for note in recording.notes if note.repaired]


def test_sound_folder(lab: Path, made_recording: Recording) -> None:
    recording = read(lab)
    assert _repairs(recording) == []
    for device, table in made_recording.tables.items():
        found = recording.tables[device]
        np.testing.assert_allclose(found.time, table.time, atol=1e-9)
        for name, values in table.columns.items():
            # The made values have six decimals, as the files do.
            np.testing.assert_allclose(found[name], values, atol=1e-12)
    assert recording.robot.host_start == made_recording.robot.host_start
    assert recording.source == "run"
    assert recording.format == "lab_csv"


# ---------------------------------------------------------------- errors and their repairs


def test_missing_file(lab: Path) -> None:
    (lab / "csv_files" / M).unlink()
    with pytest.raises(RecordingError, match=r"run: no log_m_target\.csv; the lab's layout has 12 robot files.*repair"):
        read(lab)
    recording = read(lab, repair=True)
    assert "target_moment" not in recording.robot
    assert len(recording.robot) == 40
    assert any("log_m_target.csv: the file is missing" in note for note in _repairs(recording))


@pytest.mark.parametrize("name", ["log_q_actual.csv", "log_q_target.csv"])
@pytest.mark.parametrize("repair", [False, True])
def test_positions_cannot_be_done_without(lab: Path, name: str, repair: bool) -> None:
    (lab / "csv_files" / name).unlink()
    with pytest.raises(RecordingError, match=rf"no {name}.*cannot be done without"):
        read(lab, repair=repair)


@pytest.mark.parametrize(
    ("value", "what"),
    [
        ("1.2.3", r"'1\.2\.3' in target_moment_2 is not a number"),
        ("", "'' in target_moment_2 is not a number"),
        ("1_000", "'1_000' in target_moment_2 is not a number"),
        ("nan", "'nan' in target_moment_2 is not a finite number"),
        ("-inf", "'-inf' in target_moment_2 is not a finite number"),
        ("1e999", "'1e999' in target_moment_2 is not a finite number"),
    ],
)
def test_broken_number(lab: Path, value: str, what: str) -> None:
    before = read(lab).robot
    _edit(lab, M, _put(17, 3, value))
    with pytest.raises(RecordingError, match=rf"run/log_m_target\.csv, row 17: {what}"):
        read(lab)
    recording = read(lab, repair=True)
    # The row goes from every file, no other row does.
    np.testing.assert_array_equal(recording.robot["actual_q"], np.delete(before["actual_q"], 16, axis=0))
    np.testing.assert_array_equal(recording.robot["target_moment"], np.delete(before["target_moment"], 16, axis=0))
    assert any("the first is row 17" in note for note in _repairs(recording))


@pytest.mark.parametrize(("row", "columns"), [("0.128000, 1.0", 2), ("", 0), ("0.128000" + ", 1.000000" * 7, 8)])
def test_wrong_number_of_columns(lab: Path, row: str, columns: int) -> None:
    _edit(lab, M, lambda rows: rows.__setitem__(16, row))
    with pytest.raises(RecordingError, match=rf"log_m_target\.csv, row 17: {columns} columns where 7 belong"):
        read(lab)
    assert len(read(lab, repair=True).robot) == 39


def test_file_of_another_signal(lab: Path) -> None:
    """Every row has three columns too few: the file is left out, not all rows of the run."""
    shutil.copy(lab / "csv_files" / "log_tool_acc.csv", lab / "csv_files" / M)
    with pytest.raises(RecordingError, match=r"log_m_target\.csv, row 1: 4 columns where 7 belong"):
        read(lab)
    recording = read(lab, repair=True)
    assert len(recording.robot) == 40
    assert "target_moment" not in recording.robot
    assert any("most rows are broken: its signal is left out" in note for note in _repairs(recording))


def test_broken_positions_are_beyond_repair(lab: Path) -> None:
    shutil.copy(lab / "csv_files" / "log_tool_acc.csv", lab / "csv_files" / Q)
    with pytest.raises(RecordingError, match=r"log_q_actual\.csv: no sound row; .*nothing to repair"):
        read(lab, repair=True)


def test_time_runs_backwards(lab: Path) -> None:
    _edit_all(lab, _put(20, 0, "0.001000"))
    with pytest.raises(
        RecordingError, match=r"log_q_actual\.csv, row 20: time runs backwards \(0\.001000 s after 0\.144000 s\)"
    ):
        read(lab)
    recording = read(lab, repair=True)
    # The one stray row goes, not the twenty that "do not follow" it.
    assert len(recording.robot) == 39
    assert any("1 row left out, the first is row 20" in note for note in _repairs(recording))


def test_one_stray_stamp_far_ahead(lab: Path) -> None:
    _edit_all(lab, _put(20, 0, "9000.000000"))
    with pytest.raises(RecordingError, match="row 21: time runs backwards"):
        read(lab)
    assert len(read(lab, repair=True).robot) == 39


def test_duplicate_stamp_with_other_values(lab: Path) -> None:
    _edit_all(lab, _put(20, 0, "0.144000"))
    with pytest.raises(RecordingError, match=r"log_q_actual\.csv, row 20: the stamp 0\.144000 s repeats"):
        read(lab)
    assert len(read(lab, repair=True).robot) == 39


def test_exactly_repeated_row_is_dropped_with_a_note(lab: Path) -> None:
    before = read(lab).robot
    _edit_all(lab, lambda rows: rows.insert(20, rows[19]))
    recording = read(lab)
    assert any("1 row repeat the row before" in note and "row 21" in note for note in _repairs(recording))
    np.testing.assert_array_equal(recording.robot["actual_q"], before["actual_q"])


@pytest.mark.parametrize("name", [M, Q])
def test_row_missing_in_one_file(lab: Path, name: str) -> None:
    before = read(lab).robot
    _edit(lab, name, lambda rows: rows.pop(9))
    with pytest.raises(
        RecordingError, match=rf"run/{name}, row 10: the stamp is 0\.080000 s where the other files have 0\.072000 s"
    ):
        read(lab)
    recording = read(lab, repair=True)
    np.testing.assert_array_equal(recording.robot.time, np.delete(before.time, 9))
    for column in ("actual_q", "target_moment", "actual_TCP_pose"):
        np.testing.assert_array_equal(recording.robot[column], np.delete(before[column], 9, axis=0))


def test_row_missing_in_all_files_is_reported(lab: Path) -> None:
    _edit_all(lab, lambda rows: rows.pop(9))
    assert "1 gap longer than 1.5 periods, the longest 16 ms: about 1 row missing" in _said(read(lab))


@pytest.mark.parametrize("content", [b"", b"\n \n"])
def test_empty_file(lab: Path, content: bytes) -> None:
    (lab / "csv_files" / M).write_bytes(content)
    with pytest.raises(RecordingError, match=r"run/log_m_target\.csv: the file is empty"):
        read(lab)
    recording = read(lab, repair=True)
    assert "target_moment" not in recording.robot
    (lab / "csv_files" / Q).write_bytes(content)
    with pytest.raises(RecordingError, match=r"run/log_q_actual\.csv: the file is empty"):
        read(lab, repair=True)


def test_not_text(lab: Path) -> None:
    path = lab / "csv_files" / M
    raw = bytearray(path.read_bytes())
    raw[raw.index(b"\n", 200) + 3] = 0xFF
    row = raw.count(b"\n", 0, raw.index(0xFF)) + 1
    path.write_bytes(raw)
    with pytest.raises(RecordingError, match=rf"run/log_m_target\.csv, row {row}: byte 0xff is not text"):
        read(lab)
    assert len(read(lab, repair=True).robot) == 39
    path.write_bytes(bytes(range(128, 256)) * 20)
    recording = read(lab, repair=True)
    assert "target_moment" not in recording.robot
    assert len(recording.robot) == 40


@pytest.mark.parametrize("cut", [1, 3, 7, 8, 15, 40])
def test_last_row_cut_off(lab: Path, cut: int) -> None:
    """Whatever is cut, short of the newline alone, the row goes: without a repair, with a note."""
    path = lab / "csv_files" / M
    path.write_bytes(path.read_bytes()[: -1 - cut])
    recording = read(lab)
    assert len(recording.robot) == 39
    assert "the last row of 1 file is cut off in mid-row and left out: log_m_target.csv row 40" in _said(recording)


def test_last_row_without_newline_is_whole(lab: Path) -> None:
    path = lab / "csv_files" / M
    path.write_bytes(path.read_bytes()[:-1])
    assert len(read(lab).robot) == 40


def test_windows_line_ends(lab: Path) -> None:
    before = read(lab)
    for path in (lab / "csv_files").iterdir():
        path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    after = read(lab)
    assert after.notes == before.notes
    np.testing.assert_array_equal(after.robot["actual_q"], before.robot["actual_q"])


def test_broken_sensor(lab: Path) -> None:
    _edit(lab, "log_force_sensor.csv", _put(5, 2, "x"))
    with pytest.raises(RecordingError, match=r"run/log_force_sensor\.csv, row 5: 'x' in ft_wrench_1 is not a number"):
        read(lab)
    recording = read(lab, repair=True)
    assert len(recording.tables["ft"]) == 65
    (lab / "csv_files" / "log_force_sensor.csv").write_text("what\nis\nthis\n")
    recording = read(lab, repair=True)
    assert "ft" not in recording.tables
    assert any("the sensor is left out" in note for note in _repairs(recording))


def test_sensor_that_was_silent_for_a_while(lab: Path) -> None:
    _edit(lab, "log_force_sensor.csv", lambda rows: rows.__setitem__(slice(9, 14), ["no values recorded"] * 5))
    recording = read(lab)
    assert len(recording.tables["ft"]) == 61
    assert "5 rows read 'no values recorded' and are left out, the first is row 10" in _said(recording)


@pytest.mark.parametrize("end", ["\n", "\nno val"])
def test_sensor_that_was_silent_throughout(lab: Path, end: str) -> None:
    (lab / "csv_files" / "log_force_sensor.csv").write_text("\n".join(["no values recorded"] * 9) + end)
    recording = read(lab)
    assert "ft" not in recording.tables
    assert f"all {9 + end.count('val')} rows read 'no values recorded'" in _said(recording)


def test_sensor_clock_runs_backwards(lab: Path) -> None:
    _edit(lab, "acc_data.csv", _put(30, 0, "1.0"))
    with pytest.raises(RecordingError, match=r"run/acc_data\.csv, row 30: time runs backwards"):
        read(lab)
    assert len(read(lab, repair=True).tables["imu"]) == 84


@pytest.mark.parametrize(
    ("content", "start"),
    [
        ("1386689097.8\n" * 40, 1386689097.8),
        ("1386689097.8\n1386", 1386689097.8),
        ("1386689097.8" * 40 + "138", 1386689097.8),
        ("1386689097.8", 1386689097.8),
        # A twin's recording may count from zero.
        ("0.000000\n" * 40, 0.0),
    ],
)
def test_host_time(lab: Path, content: str, start: float) -> None:
    (lab / "csv_files" / "start_time.csv").write_text(content)
    assert read(lab).robot.host_start == start


def test_unknown_host_times(lab: Path) -> None:
    (lab / "csv_files" / "start_time.csv").write_text("5.12e+07")
    recording = read(lab)
    assert recording.robot.host_start is None
    assert "start_time.csv: no POSIX time in it" in _said(recording)
    assert "the offset between the two clocks is unknown: aligned() takes it for 0" in _said(recording)


# ---------------------------------------------------------------- the writer


def test_writer_replaces_its_own_and_nothing_else(lab: Path, made_recording: Recording, tmp_path: Path) -> None:
    write_lab_csv(made_recording, lab)
    assert len(read(lab).robot) == 40
    (lab / "csv_files" / "thesis.txt").write_text("precious")
    with pytest.raises(RecordingError, match=r"holds 'csv_files/thesis\.txt', which is not of the lab's layout"):
        write_lab_csv(made_recording, lab)
    assert (lab / "csv_files" / "thesis.txt").read_text() == "precious"
    with pytest.raises(RecordingError, match="is a file"):
        write_lab_csv(made_recording, lab / "csv_files" / Q)
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_writer_leaves_predictions_out(made_recording: Recording, tmp_path: Path) -> None:
    robot = made_recording.robot
    more = robot.with_columns({"sim_actual_q": robot["actual_q"], "truth_wrench": robot["actual_q"]})
    recording = read(write_lab_csv(made_recording.with_table(more), tmp_path / "out"))
    assert set(recording.robot.columns) == set(robot.columns)


def test_writer_needs_every_signal(made_recording: Recording, tmp_path: Path) -> None:
    robot = made_recording.robot
    columns = {name: values for name, values in robot.columns.items() if name != "target_moment"}
    with pytest.raises(RecordingError, match="made: no target_moment in the robot table"):
        write_lab_csv(made_recording.with_table(Table("robot", robot.time, columns)), tmp_path / "out")
    broken = robot["actual_q"].copy()
    broken[6, 2] = np.nan
    with pytest.raises(RecordingError, match="actual_q is not finite in row 7"):
        write_lab_csv(made_recording.with_table(robot.with_columns({"actual_q": broken})), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, 30), scale=st.sampled_from([1e-6, 1.0, 1e4]))
def test_round_trip(made_recording: Recording, seed: int, rows: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    columns = {
        name: rng.normal(scale=scale, size=(rows, values.shape[1]))
        for name, values in made_recording.robot.columns.items()
    }
    time = np.cumsum(rng.uniform(1e-4, 0.01, size=rows))
    recording = Recording({"robot": Table("robot", time, columns, 1.4e9)}, "made", "test")
    with tempfile.TemporaryDirectory() as folder:
        again = read(write_lab_csv(recording, Path(folder) / "run"))
    # Six decimals: half a unit in the last, and a whole one to be safe against its rounding.
    np.testing.assert_allclose(again.robot.time, time, rtol=0, atol=1e-6)
    for name, values in columns.items():
        np.testing.assert_allclose(again.robot[name], values, rtol=0, atol=1e-6)
    assert again.robot.host_start == pytest.approx(1.4e9, abs=1e-6)


# ---------------------------------------------------------------- whatever happens to a folder


@st.composite
def _damage(draw: st.DrawFn) -> Callable[[bytes], bytes]:
    kind = draw(st.sampled_from(["flip", "delete rows", "insert", "nan", "truncate", "repeat", "swap"]))
    at = draw(st.floats(0, 1, exclude_max=True))
    byte = draw(st.integers(0, 255))
    length = draw(st.integers(1, 5))

    def change(raw: bytes) -> bytes:
        if not raw:
            return raw
        i = int(at * len(raw))
        rows = raw.split(b"\n")
        r = int(at * len(rows))
        if kind == "flip":
            return raw[:i] + bytes([byte]) + raw[i + 1 :]
        if kind == "insert":
            return raw[:i] + bytes([byte]) * length + b", " + raw[i:]
        if kind == "nan":
            return raw[:i] + b"nan" + raw[i + length :]
        if kind == "truncate":
            return raw[:i]
        if kind == "delete rows":
            del rows[r : r + length]
        elif kind == "repeat":
            rows[r:r] = rows[r : r + 1] * length
        else:
            rows[r], rows[r - 1] = rows[r - 1], rows[r]
        return b"\n".join(rows)

    return change


def _read_or_refusal(path: Path, repair: bool) -> Recording | str:
    try:
        return read(path, repair=repair)
    except RecordingError as error:
        return str(error)


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data(), repair=st.booleans())
def test_any_damage_is_read_or_refused(lab_template: Path, data: st.DataObject, repair: bool) -> None:
    names = sorted(p.name for p in (lab_template / "csv_files").iterdir())
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(shutil.copytree(lab_template, Path(scratch) / "run"))
        for _ in range(data.draw(st.integers(1, 3))):
            path = folder / "csv_files" / data.draw(st.sampled_from(names))
            path.write_bytes(data.draw(_damage())(path.read_bytes()))
        recording = _read_or_refusal(folder, repair)
    if isinstance(recording, str):
        assert "run" in recording
        assert "\n" not in recording
        return
    # What was read is fit for use, repaired or not.
    assert 1 <= len(recording.robot) <= 50
    assert (np.diff(recording.robot.time) > 0).all()
    for table in recording.tables.values():
        for values in table.columns.values():
            assert np.isfinite(values).all()


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_repair_never_moves_a_value_to_another_time(
    lab_template: Path, made_recording: Recording, data: st.DataObject
) -> None:
    """Rows lost from files: every row left holds, for every signal, the values that were logged at its stamp."""
    names = sorted(p.name for p in (lab_template / "csv_files").glob("log_*.csv"))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(shutil.copytree(lab_template, Path(scratch) / "run"))
        for _ in range(data.draw(st.integers(1, 3))):
            path = folder / "csv_files" / data.draw(st.sampled_from(names))
            rows = path.read_text().splitlines(keepends=True)
            start = data.draw(st.integers(0, len(rows)))
            del rows[start : start + data.draw(st.integers(1, 4))]
            path.write_text("".join(rows))
        try:
            robot = read(folder, repair=True).robot
        except RecordingError:
            return
    logged = made_recording.robot
    at = np.rint(robot.time / 0.008).astype(int)
    np.testing.assert_allclose(robot.time, logged.time[at], atol=1e-9)
    for name, values in robot.columns.items():
        np.testing.assert_allclose(values, logged[name][at], atol=1e-9)
