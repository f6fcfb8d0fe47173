"""The sensors that a served arm carries, at their ports."""

from __future__ import annotations

from collections.abc import Mapping

from ur5_twin.arm.parameters import FT_SENSOR, IMU_SENSOR, load_tool
from ur5_twin.scenario.scenario import Scenario
from ur5_twin.sensing import load_sensors
from ur5_twin.wire.mti import MTiPort
from ur5_twin.wire.net_ft import NetFTPort
from ur5_twin.wire.rdt import RDT_PORT, Calibration

#: Ports by name; the page's is not the sensor's own 80, which only a privileged program may have and others use.
NUMBERS = {"net_ft": RDT_PORT, "net_ft_page": 49153}


def sensor_ports(
    scenario: Scenario, bind: str = "127.0.0.1", numbers: Mapping[str, int] | None = None
) -> list[NetFTPort | MTiPort]:
    """A Net F/T and an MTi, as far as the scenario's tool carries them.

    Args:
        scenario: what is served.
        bind: address to listen at.
        numbers: ``net_ft`` and ``net_ft_page`` -> port, where it is not to be 49152 and 49153; 0 takes a free one.
    """
    chosen = NUMBERS | dict(numbers or {})
    suite = load_sensors(scenario.sensors.preset, late_packages=False)
    carried = load_tool(scenario.arm.tool)
    found: list[NetFTPort | MTiPort] = []
    if carried is not None and FT_SENSOR in carried.sensors:
        found.append(
            NetFTPort(
                bind,
                chosen["net_ft"],
                http=chosen["net_ft_page"],
                calibration=Calibration(rate=suite.ft_clock.rate, name=suite.name),
                full_scale=suite.ft.full_scale,
            )
        )
    if carried is not None and IMU_SENSOR in carried.sensors:
        found.append(MTiPort(suite.imu_clock.rate))
    return found
