"""The devices that look at the arm: what they do to a signal, in pieces of any length."""

from __future__ import annotations

from ur5_twin.sensing.measuring import Measuring
from ur5_twin.sensing.signals import Load, Signals
from ur5_twin.sensing.specs import SensorSuite, load_sensors

__all__ = ["Load", "Measuring", "SensorSuite", "Signals", "load_sensors"]
