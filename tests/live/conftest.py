"""A robot made of a log: its rows in pieces, with whatever should be wrong with them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ur5_twin.arm.drive import drives_of, load_drive
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.estimation import NominalModel, load_nominal
from ur5_twin.recording import Recording, read
from ur5_twin.resources import data_dir
from ur5_twin.sources.device import Rows
from ur5_twin.twin.replay import ReplaySettings


@pytest.fixture(scope="session")
def demo() -> Recording:
    """The log that ships."""
    return read(data_dir("replay") / "demo")


@pytest.fixture(scope="session")
def nominal() -> NominalModel:
    """What the estimators believe."""
    return load_nominal()


@pytest.fixture(scope="session")
def settings() -> ReplaySettings:
    """The twin as ``live`` has it by default."""
    plant = load_model("plant")
    return ReplaySettings(
        model=load_model("controller"),
        plant=plant,
        gains=load_gains("servo"),
        drive=load_drive("thesis"),
        target_current=load_target_current_law(),
        joints=drives_of(plant),
    )


@pytest.fixture(scope="session")
def spoken(demo: Recording) -> Callable[..., list[Rows]]:
    """Rows of the log as pieces of ``size`` rows; those of ``broken`` hold a NaN, those of ``twice`` come twice,
    those of ``lost`` never; from ``restart`` on the controller's clock begins anew."""

    def made(
        rows: int = 600,
        size: int = 7,
        *,
        broken: tuple[int, ...] = (),
        twice: tuple[int, ...] = (),
        lost: tuple[int, ...] = (),
        restart: int | None = None,
    ) -> list[Rows]:
        robot = demo.robot
        index = np.array([k for k in range(rows) for _ in range(1 + (k in twice)) if k not in lost])
        stamp = 100.0 + robot.time[index]
        arrival = 10.0 + robot.time[index]
        if restart is not None:
            later = index >= restart
            arrival[later] += 45.0
            stamp[later] -= robot.time[restart] + 95.0
        columns = {name: values[index].copy() for name, values in robot.columns.items()}
        for k in broken:
            columns["actual_qd"][index == k, 3] = np.nan
        return [
            Rows(stamp[a : a + size], arrival[a : a + size], {name: v[a : a + size] for name, v in columns.items()})
            for a in range(0, len(index), size)
        ]

    return made
