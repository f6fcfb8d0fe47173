"""The lab's real logs: every quirk is taken, and said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ur5_twin.recording import Recording, read, write_lab_csv, write_parquet

#: Movement: rows of robot, ft and imu that are left. The robot's is the shortest complete file's.
ROWS = {
    "Movement_No3_Acc": (1251, None, 5559),
    "Movement_No4_Acc": (2806, None, 6123),
    "Movement_No5_Acc_slow_no_disturbance": (3229, None, 7059),
    "Movement_No5_Acc_slow_w_disturbance": (4032, None, 8657),
    "Movement_No6_Acc_slow_Verify_Model": (10264, None, 21948),
    "Movement_No9_Singularity_Free_ForceSensor": (4296, 7160, None),
    "Movement_No9_Singularity_Free_NoDist": (2707, None, 5906),
    "Movement_No9_Singularity_Free_WDist": (2624, None, 5728),
    "Movement_No10_Standstill_ForceSensor_All": (3468, 5905, None),
    "Movement_No10_Standstill_ForceSensor_Fx": (2804, 4675, None),
}
FILES = {
    "log_q_target": "target_q",
    "log_qd_target": "target_qd",
    "log_qdd_target": "target_qdd",
    "log_m_target": "target_moment",
    "log_i_target": "target_current",
    "log_q_actual": "actual_q",
    "log_qd_actual": "actual_qd",
    "log_i_actual": "actual_current",
    "log_tcp_force": "actual_TCP_force",
    "log_tool_vector": "actual_TCP_pose",
    "log_tcp_speed": "actual_TCP_speed",
    "log_tool_acc": "actual_tool_accelerometer",
}


def _said(recording: Recording) -> str:
    return "\n".join(map(str, recording.notes))


@pytest.mark.parametrize("movement", ROWS)
def test_rows_of_every_log(lab_logs: Path, movement: str) -> None:
    recording = read(lab_logs / movement)
    found = tuple(len(recording.tables[d]) if d in recording.tables else None for d in ("robot", "ft", "imu"))
    assert found == ROWS[movement]
    assert recording.source == movement
    assert set(recording.robot.columns) == set(FILES.values())
    for table in recording.tables.values():
        assert all(np.isfinite(values).all() for values in table.columns.values())
        assert (np.diff(table.time) > (0 if table.device == "robot" else -1e-12)).all()


@pytest.mark.parametrize("movement", ROWS)
def test_nothing_in_the_logs_needs_a_repair(lab_logs: Path, movement: str) -> None:
    plain, repaired = read(lab_logs / movement), read(lab_logs / movement / "csv_files", repair=True)
    assert plain.notes == repaired.notes
    for name, values in plain.robot.columns.items():
        np.testing.assert_array_equal(values, repaired.robot[name])


@pytest.mark.parametrize(("file", "column"), FILES.items())
def test_each_file_becomes_its_column(lab_logs: Path, file: str, column: str) -> None:
    movement = lab_logs / "Movement_No6_Acc_slow_Verify_Model"
    raw = np.genfromtxt(movement / "csv_files" / f"{file}.csv", delimiter=",")
    robot = read(movement).robot
    np.testing.assert_array_equal(robot[column], raw[:, 1:])
    np.testing.assert_array_equal(robot.time, raw[:, 0])


def test_units_and_host_times(lab_logs: Path) -> None:
    recording = read(lab_logs / "Movement_No9_Singularity_Free_ForceSensor")
    assert recording.robot.host_start == 1386689097.8
    assert recording.tables["ft"].host_start == 1386689097.794387
    imu = read(lab_logs / "Movement_No6_Acc_slow_Verify_Model").tables["imu"]
    # The file's first row begins "6, -0.00221844, -9.86922": ms, m/s^2.
    assert imu.time[0] == 0.006
    np.testing.assert_array_equal(imu["imu_acc"][0], [-0.00221844, -9.86922, -0.0514393])
    np.testing.assert_array_equal(imu["imu_gyro"][0], [-0.0309354, 0.0291538, 0.0259847])
    assert imu.host_start is None


def test_files_of_different_length(lab_logs: Path) -> None:
    notes = read(lab_logs / "Movement_No5_Acc_slow_no_disturbance").notes
    cut = next(note for note in notes if "end at different rows" in note.what)
    assert "from 3,229 (log_tool_acc.csv) to 3,293 (log_q_actual.csv): all are cut to 3,229 rows" in cut.what
    assert cut.repaired


def test_last_rows_cut_in_mid_number(lab_logs: Path) -> None:
    said = _said(read(lab_logs / "Movement_No10_Standstill_ForceSensor_All"))
    # "..., -5.914016, -0.0": seven numbers, the last one cut, which a count of fields would not find.
    assert "log_q_actual.csv row 3512" in said
    # "28.056000, -0.000000, 2.111390, ": cut between numbers.
    assert "log_i_target.csv row 3508" in said
    # log_i_actual.csv and log_tcp_force.csv end in a newline: nothing of them is cut.
    assert "log_i_actual.csv row" not in said
    assert "log_tcp_force.csv row" not in said


def test_no3_clock(lab_logs: Path) -> None:
    recording = read(lab_logs / "Movement_No3_Acc")
    said = _said(recording)
    raw = np.genfromtxt(lab_logs / "Movement_No3_Acc" / "csv_files" / "log_q_actual.csv", delimiter=",")
    np.testing.assert_array_equal(recording.robot.time, raw[:1251, 0])
    assert recording.robot.host_start == 1380031898.58
    assert "start_time.csv: its stamps stand without anything between them" in said
    assert "up to 84 us apart" in said
    assert "median period 8.151 ms" in said
    assert "612 gaps longer than 1.5 periods, the longest 24.37 ms" in said


def test_even_clocks_are_not_worth_a_word(lab_logs: Path) -> None:
    assert "uneven" not in _said(read(lab_logs / "Movement_No6_Acc_slow_Verify_Model"))


@pytest.mark.parametrize(
    ("movement", "why"),
    [
        ("Movement_No3_Acc", "all 1,293 rows read 'no values recorded'"),
        ("Movement_No4_Acc", "no log_force_sensor.csv"),
        ("Movement_No6_Acc_slow_Verify_Model", "all 17,350 rows are zero"),
    ],
)
def test_no_force_sensor(lab_logs: Path, movement: str, why: str) -> None:
    recording = read(lab_logs / movement)
    assert "ft" not in recording.tables
    assert why in _said(recording)


@pytest.mark.parametrize(
    ("movement", "rate", "distinct"),
    [
        ("Movement_No9_Singularity_Free_ForceSensor", "207.6 Hz", "95.3 %"),
        ("Movement_No10_Standstill_ForceSensor_All", "207.6 Hz", "78.6 %"),
        ("Movement_No10_Standstill_ForceSensor_Fx", "207.8 Hz", "74.6 %"),
    ],
)
def test_force_sensor_rate_and_repeated_values(lab_logs: Path, movement: str, rate: str, distinct: str) -> None:
    said = _said(read(lab_logs / movement))
    assert rate in said
    assert f"{distinct} of the rows are distinct" in said


def test_repeated_stamps_of_the_imu_are_kept(lab_logs: Path) -> None:
    recording = read(lab_logs / "Movement_No3_Acc")
    assert np.sum(np.diff(recording.tables["imu"].time) == 0) == 4
    assert "4 stamps repeated" in _said(recording)
    assert np.isfinite(recording.aligned()["imu_acc"][1:-1]).all()


def test_the_writer_writes_what_the_lab_wrote(lab_logs: Path, tmp_path: Path) -> None:
    """Byte by byte, on a log whose files all end whole."""
    source = lab_logs / "Movement_No10_Standstill_ForceSensor_Fx" / "csv_files"
    write_lab_csv(read(source), tmp_path / "again")
    for name in (*(f"{file}.csv" for file in FILES), "log_force_sensor.csv", "log_force_sensor_start_time.csv"):
        assert (tmp_path / "again" / "csv_files" / name).read_bytes() == (source / name).read_bytes(), name


def test_parquet_holds_a_real_log_bit_for_bit(lab_logs: Path, tmp_path: Path) -> None:
    recording = read(lab_logs / "Movement_No9_Singularity_Free_ForceSensor")
    again = read(write_parquet(recording, tmp_path / "log.parquet"))
    assert again.notes == recording.notes
    for device, table in recording.tables.items():
        for name, values in table.columns.items():
            assert again.tables[device][name].tobytes() == values.tobytes()
