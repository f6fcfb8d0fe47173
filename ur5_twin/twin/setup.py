"""From a scenario to what a cell is made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ur5_twin.arm import inertia
from ur5_twin.arm.drive import JointDrives, drives_of
from ur5_twin.arm.parameters import ArmModel, Tool
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.errors import ScenarioError
from ur5_twin.recording import force_sensor, read
from ur5_twin.scenario.pushes import LogPush
from ur5_twin.scenario.scenario import Scenario
from ur5_twin.twin.cell import Payload, Setup
from ur5_twin.twin.closed_loop import Limits
from ur5_twin.twin.measured_push import MeasuredPush


def setup_of(scenario: Scenario) -> Setup:
    """What a scenario's cell is made of.

    Raises:
        TwinError: a model, tool, gain set or log that the scenario names cannot be had.
    """
    controller, plant = scenario.controller_model(), scenario.plant_model()
    told = [
        (payload.declared_at, carrying(controller, payload.mass, payload.center, payload.inertia))
        for payload in scenario.payloads
        if payload.declared_at is not None
    ]
    return Setup(
        controller=controller,
        plant=plant,
        gains=load_gains(scenario.arm.gains),
        law=load_target_current_law(),
        drives=_drives(scenario, plant),
        limits=Limits(scenario.limits.deviation, scenario.limits.speed, scenario.limits.force),
        q_start=scenario.q_start,
        obstacles=scenario.obstacles,
        pushes=tuple(_logged(push, plant) if isinstance(push, LogPush) else push for push in scenario.pushes),
        payloads=tuple(Payload(p.at, p.mass, p.center, p.inertia) for p in scenario.payloads),
        told=tuple(sorted(told, key=lambda item: item[0])),
        warm_for=scenario.temperature.warm_for,
    )


def carrying(model: ArmModel, mass: float, center: np.ndarray, tensor: np.ndarray) -> ArmModel:
    """An arm model with a payload beside its tool: kg, (3,) m in the flange frame, (3, 3) kg m^2 about its centre."""
    if mass == 0.0:
        return model
    payload = Tool(
        name="payload",
        title="payload",
        mass=mass,
        center=np.asarray(center),
        inertia=np.asarray(tensor),
        parts=(),
        sensors={},
        tops={},
        height=None,
        source="scenario",
    )
    if model.tool is None:
        return model.with_tool(payload)
    together = inertia.combine(
        np.array([model.tool.mass, mass]),
        np.array([model.tool.center, payload.center]),
        np.array([model.tool.inertia, payload.inertia]),
    )
    tool = replace(model.tool, mass=together[0], center=together[1], inertia=together[2])
    return model.with_tool(tool)


def _drives(scenario: Scenario, plant: ArmModel) -> JointDrives:
    known, mismatch, warmth = drives_of(plant), scenario.mismatch, scenario.temperature
    friction = known.friction.scaled(mismatch.friction_scale)
    if warmth.cold is not None:
        friction = replace(friction, cold=warmth.cold)
    if warmth.warming_time is not None:
        friction = replace(friction, warming_time=warmth.warming_time)
    return replace(
        known,
        torque_constant=known.torque_constant * mismatch.torque_constant_scale,
        offset=known.offset + mismatch.offset,
        friction=friction,
        ripple=replace(known.ripple, phase=known.ripple.phase + mismatch.ripple_phase),
    )


def _logged(push: LogPush, plant: ArmModel) -> MeasuredPush:
    """The wrench that a real log's force sensor measured, on the arm again from a time on."""
    recording = read(push.path, repair=True)
    aligned, wrench = force_sensor.measured_wrench(recording, plant)
    known = np.isfinite(wrench).all(axis=1)
    time = aligned.time[known]
    last = time[-1] if push.last is None else push.last
    inside = (time >= push.first) & (time <= last)
    if inside.sum() < 2:
        raise ScenarioError(
            f"push.log: {recording.source} has its force sensor's readings from {time[0]:.3f} to {time[-1]:.3f} s; "
            f"nothing between {push.first:g} and {last:g} s"
        )
    at = time[inside] - push.first + push.at
    return MeasuredPush(at, push.scale * wrench[known][inside], push.body, push.point)
