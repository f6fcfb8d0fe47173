"""The layout of the lab's CSV folder, for its reader and its writer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ur5_twin.recording.table import COLUMN_WIDTHS

CSV_FOLDER = "csv_files"
START_TIME = "start_time.csv"
FT_FILE = "log_force_sensor.csv"
FT_START_TIME = "log_force_sensor_start_time.csv"
IMU_FILE = "acc_data.csv"
IMU_START_TIME = "acc_start_time.csv"
#: Whatever is written about these files: the last three columns turn with the joints, the middle ones with the field.
IMU_COLUMNS = ("imu_acc", "imu_mag", "imu_gyro")
#: What the force sensor's file holds where no values came.
NO_VALUES = "no values recorded"


@dataclass(frozen=True)
class RobotFile:
    """One file of the robot's log: time, then one vector.

    Attributes:
        name: the file.
        column: RTDE's name of the vector.
        decimals: as the lab writes them.
    """

    name: str
    column: str
    decimals: int = 6

    @property
    def width(self) -> int:
        return COLUMN_WIDTHS[self.column]


#: The clock of the robot's table is the first file's.
ROBOT_FILES: tuple[RobotFile, ...] = (
    RobotFile("log_q_actual.csv", "actual_q"),
    RobotFile("log_q_target.csv", "target_q"),
    RobotFile("log_qd_actual.csv", "actual_qd"),
    RobotFile("log_qd_target.csv", "target_qd"),
    RobotFile("log_qdd_target.csv", "target_qdd"),
    RobotFile("log_m_target.csv", "target_moment"),
    RobotFile("log_i_target.csv", "target_current"),
    RobotFile("log_i_actual.csv", "actual_current"),
    RobotFile("log_tcp_force.csv", "actual_TCP_force"),
    RobotFile("log_tool_vector.csv", "actual_TCP_pose"),
    RobotFile("log_tcp_speed.csv", "actual_TCP_speed"),
    RobotFile("log_tool_acc.csv", "actual_tool_accelerometer", decimals=10),
)
#: Files that no repair can do without: a log without positions is not a log of a motion.
NEEDED = ("log_q_actual.csv", "log_q_target.csv")
KNOWN_FILES = frozenset({f.name for f in ROBOT_FILES} | {START_TIME, FT_FILE, FT_START_TIME, IMU_FILE, IMU_START_TIME})


def holds_log(folder: Path) -> bool:
    """Whether a folder is a log in this layout: a movement's, or the one with its files."""
    inner = folder / CSV_FOLDER
    within = inner if inner.is_dir() else folder
    return any((within / name).is_file() for name in KNOWN_FILES)


def parts(column: str, width: int) -> tuple[str, ...]:
    """What the fields of a vector are called in messages."""
    return tuple(f"{column}_{i}" for i in range(width))
