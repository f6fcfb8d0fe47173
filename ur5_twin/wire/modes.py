"""RTDE's numbers for the states of robot, safety and program."""

from __future__ import annotations

from enum import IntEnum


class RobotMode(IntEnum):
    """``robot_mode``."""

    POWER_OFF = 3
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7


class SafetyMode(IntEnum):
    """``safety_mode`` and ``safety_status``."""

    NORMAL = 1
    PROTECTIVE_STOP = 3
    FAULT = 9


class JointMode(IntEnum):
    """``joint_mode``."""

    POWER_OFF = 239
    IDLE = 255
    RUNNING = 253


class RuntimeState(IntEnum):
    """``runtime_state``."""

    STOPPED = 1
    PLAYING = 2
    PAUSED = 4


#: Bits of ``robot_status_bits``.
POWER_ON, PROGRAM_RUNNING = 1, 2
#: Bits of ``safety_status_bits``.
NORMAL_MODE, PROTECTIVE_STOPPED, FAULT = 1, 4, 512
