"""Scenarios: TOML files that say what a cell is made of and what happens in it, as typed objects in SI units."""

from ur5_twin.scenario.loading import load_scenario, scenario_names
from ur5_twin.scenario.motions import Motion, MoveJ, MoveL, ServoJ, Wait, Waypoints
from ur5_twin.scenario.pushes import LogPush, Push
from ur5_twin.scenario.scenario import Arm, Mismatch, Payload, Scenario, Sensors, StopLimits, Temperature

__all__ = [
    "Arm",
    "LogPush",
    "Mismatch",
    "Motion",
    "MoveJ",
    "MoveL",
    "Payload",
    "Push",
    "Scenario",
    "Sensors",
    "ServoJ",
    "StopLimits",
    "Temperature",
    "Wait",
    "Waypoints",
    "load_scenario",
    "scenario_names",
]
