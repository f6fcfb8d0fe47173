"""Our own Parquet: what is written comes back bit for bit, what is damaged is refused."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ur5_twin.errors import RecordingError
from ur5_twin.recording import Note, Recording, Table, read, read_parquet_metadata, write_parquet


def _assert_same(found: Recording, expected: Recording) -> None:
    """Bit for bit, so that NaN equals NaN and 0.0 differs from -0.0."""
    assert list(found.tables) == list(expected.tables)
    assert (found.source, found.format, found.notes) == (expected.source, expected.format, expected.notes)
    for device, table in expected.tables.items():
        assert found.tables[device].host_start == table.host_start
        assert found.tables[device].time.tobytes() == table.time.tobytes()
        assert list(found.tables[device].columns) == list(table.columns)
        for name, values in table.columns.items():
            assert found.tables[device][name].shape == values.shape
            assert found.tables[device][name].tobytes() == values.tobytes()


@pytest.fixture
def file(made_recording: Recording, tmp_path: Path) -> Path:
    return write_parquet(made_recording, tmp_path / "log.parquet")


def test_round_trip(made_recording: Recording, tmp_path: Path) -> None:
    recording = made_recording.with_notes([Note("a file, row 3", "something µ odd", True), Note("b", "c")])
    _assert_same(read(write_parquet(recording, tmp_path / "log.parquet")), recording)


def test_layout_of_the_file(file: Path) -> None:
    """What another program finds in it."""
    frame = pl.read_parquet(file)
    assert frame.columns[:3] == ["device", "time", "target_q_0"]
    assert frame["device"].unique(maintain_order=True).to_list() == ["robot", "ft", "imu"]
    assert frame.filter(pl.col("device") == "ft")["target_q_0"].null_count() == 66
    assert frame.filter(pl.col("device") == "ft")["ft_wrench_5"].null_count() == 0


def test_output_folder_of_a_replay(file: Path, made_recording: Recording, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    file.rename(tmp_path / "out" / "recording.parquet")
    (tmp_path / "out" / "report.md").write_text("a report")
    _assert_same(read(tmp_path / "out"), made_recording)


def test_format_is_told_by_content(file: Path, made_recording: Recording) -> None:
    _assert_same(read(file.rename(file.with_suffix(".csv"))), made_recording)


def test_predictions_may_be_nan(made_recording: Recording, tmp_path: Path) -> None:
    robot = made_recording.robot
    unsettled = np.full((40, 6), np.nan)
    recording = made_recording.with_table(robot.with_columns({"est_momentum_wrench": unsettled}))
    _assert_same(read(write_parquet(recording, tmp_path / "log.parquet")), recording)


def test_measurements_may_not_be_nan(made_recording: Recording, tmp_path: Path) -> None:
    robot = made_recording.robot
    broken = robot["actual_q"].copy()
    broken[6, 2] = np.nan
    path = write_parquet(made_recording.with_table(robot.with_columns({"actual_q": broken})), tmp_path / "log.parquet")
    with pytest.raises(RecordingError, match=r"log\.parquet/robot, row 7: actual_q is no finite number"):
        read(path)
    recording = read(path, repair=True)
    np.testing.assert_array_equal(recording.robot["target_q"], np.delete(robot["target_q"], 6, axis=0))
    assert [str(note) for note in recording.notes if note.repaired] == [
        "log.parquet/robot: values that are not finite: 1 row left out, the first is row 7, in all columns"
    ]


def test_clock_runs_backwards(made_recording: Recording, tmp_path: Path) -> None:
    robot = made_recording.robot
    time = robot.time.copy()
    time[12] = 0.0
    path = write_parquet(made_recording.with_table(Table("robot", time, robot.columns)), tmp_path / "log.parquet")
    with pytest.raises(RecordingError, match=r"log\.parquet/robot, row 13: time runs backwards"):
        read(path)
    assert len(read(path, repair=True).robot) == 39


def test_edited_numbers_are_found(file: Path) -> None:
    entries = pl.read_parquet_metadata(file)
    frame = pl.read_parquet(file).with_columns(pl.col("actual_q_3") + 1e-9)
    frame.write_parquet(file, metadata={"ur5_twin": entries["ur5_twin"]})
    with pytest.raises(RecordingError, match=r"log\.parquet: the numbers of device 'robot' differ from their checksum"):
        read(file)
    assert "taken as they are" in str(read(file, repair=True).notes[0])


@pytest.mark.parametrize("repair", [False, True])
@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda frame: frame.drop("imu_acc_1"), "should have column 'imu_acc_1'"),
        (lambda frame: frame.head(100), "should have the rows 41 to 106"),
        (lambda frame: pl.concat([frame, frame.tail(1)]), "192 rows where its metadata has 191"),
        (lambda frame: frame.with_columns(pl.lit("ft").alias("device")), "device 'robot' should have the rows 1 to 40"),
        (
            lambda frame: frame.with_columns(pl.col("time").cast(pl.String)),
            "should have column 'time' of 64-bit floats",
        ),
    ],
)
def test_edited_layout(file: Path, change, what: str, repair: bool) -> None:
    entries = pl.read_parquet_metadata(file)
    change(pl.read_parquet(file)).write_parquet(file, metadata={"ur5_twin": entries["ur5_twin"]})
    with pytest.raises(RecordingError, match=rf"log\.parquet: .*{what}"):
        read(file, repair=repair)


def test_not_ours(tmp_path: Path) -> None:
    pl.DataFrame({"timestamp": [1.0], "actual_q_0": [0.0]}).write_parquet(tmp_path / "log.parquet")
    with pytest.raises(RecordingError, match=r"log\.parquet: a Parquet file, but not one of ours"):
        read(tmp_path / "log.parquet")


def test_newer_schema(file: Path) -> None:
    entry = pl.read_parquet_metadata(file)["ur5_twin"].replace('"schema":1', '"schema":2')
    pl.read_parquet(file).write_parquet(file, metadata={"ur5_twin": entry})
    with pytest.raises(RecordingError, match="written in schema 2, this version reads 1"):
        read(file)


@pytest.mark.parametrize("entry", ["", "{}", '{"schema": 1}', "[" * 3000])
def test_damaged_metadata(file: Path, entry: str) -> None:
    pl.read_parquet(file).write_parquet(file, metadata={"ur5_twin": entry})
    with pytest.raises(RecordingError, match="the entry 'ur5_twin' of its metadata is damaged"):
        read(file)


def test_cut_off(file: Path) -> None:
    raw = file.read_bytes()
    for length in (4, 5, 100, len(raw) // 2, len(raw) - 1):
        file.write_bytes(raw[:length])
        with pytest.raises(RecordingError, match=r"log\.parquet: the Parquet file is damaged or cut off"):
            read(file, repair=True)


def test_metadata(made_recording: Recording, tmp_path: Path) -> None:
    path = write_parquet(made_recording, tmp_path / "log.parquet", metadata={"command": "ur5-twin replay x"})
    assert read_parquet_metadata(path) == {"command": "ur5-twin replay x"}
    with pytest.raises(RecordingError, match="must not use the name 'ur5_twin'"):
        write_parquet(made_recording, path, metadata={"ur5_twin": ""})


def test_a_failed_write_leaves_the_old_file(file: Path, made_recording: Recording, monkeypatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(pl.DataFrame, "write_parquet", fail)
    with pytest.raises(RecordingError, match="No space left on device"):
        write_parquet(made_recording, file)
    monkeypatch.undo()
    _assert_same(read(file), made_recording)
    assert [p.name for p in file.parent.iterdir()] == ["log.parquet"]


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    """Any recording that keeps the rules: finite measurements, clocks that increase (the sensors' may repeat)."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    names = st.text("abcdefgh_0123456789", min_size=1, max_size=6)
    tables = {}
    for device in ("robot", *draw(st.lists(st.sampled_from(["ft", "imu"]), unique=True))):
        rows = draw(st.integers(1, 12))
        columns = {}
        for name in draw(st.lists(names, max_size=4, unique=True)):
            values = rng.normal(size=(rows, draw(st.integers(0, 4)))) * 10.0 ** rng.integers(-300, 300)
            values[rng.random(values.shape) < 0.1] = -0.0
            columns[name] = values
        steps = rng.uniform(1e-6, 0.1, size=rows)
        if device != "robot":
            steps[rng.random(rows) < 0.3] = 0.0
        start = draw(st.none() | st.floats(0, 2e9))
        tables[device] = Table(device, np.cumsum(steps), columns, start)
    text = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
    notes = draw(st.lists(st.builds(Note, text, text, st.booleans()), max_size=3))
    return Recording(tables, draw(text), draw(text), tuple(notes))


@settings(max_examples=80, deadline=None)
@given(recording=recordings())
def test_any_recording_comes_back(recording: Recording) -> None:
    with tempfile.TemporaryDirectory() as folder:
        _assert_same(read(write_parquet(recording, Path(folder) / "log.parquet")), recording)


def _read_or_refusal(path: Path, repair: bool) -> Recording | str:
    try:
        return read(path, repair=repair)
    except RecordingError as error:
        return str(error)


@settings(max_examples=250, deadline=None)
@given(data=st.data(), repair=st.booleans())
def test_any_damage_is_read_or_refused(
    made_bytes: bytes, made_recording: Recording, data: st.DataObject, repair: bool
) -> None:
    raw = bytearray(made_bytes)
    for _ in range(data.draw(st.integers(1, 4))):
        # From the end: half of the flips hit the footer, where they do most harm.
        at = len(raw) - 1 - int(data.draw(st.floats(0, 1, exclude_max=True)) ** 2 * (len(raw) - 4))
        raw[at] = data.draw(st.integers(0, 255))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.parquet"
        path.write_bytes(raw)
        recording = _read_or_refusal(path, repair)
    if isinstance(recording, str):
        assert "log.parquet" in recording
        assert "\n" not in recording
        return
    assert (np.diff(recording.robot.time) > 0).all()
    if not repair:
        # What is read without a repair has the numbers that were written.
        np.testing.assert_array_equal(recording.robot["actual_q"], made_recording.robot["actual_q"])


@pytest.fixture(scope="session")
def made_bytes(made_recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write_parquet(made_recording, tmp_path_factory.mktemp("parquet") / "log.parquet").read_bytes()
