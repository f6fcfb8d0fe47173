"""A scenario: what a cell is made of, what the arm does in it and what is done to the arm, in SI units."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ur5_twin.arm.mjcf.obstacles import Obstacle
from ur5_twin.arm.parameters import ArmModel, load_model
from ur5_twin.scenario.motions import Motion
from ur5_twin.scenario.pushes import LogPush, Push


@dataclass(frozen=True)
class Arm:
    """Names of what the arm and its controller are, or paths of files of the user's.

    Attributes:
        controller: model that the controller linearises with.
        plant: model that is simulated.
        tool: what is bolted to the plant's flange (``load_tool``).
        declared: the tool that the controller was told of.
        gains: the controller's servo.
    """

    controller: str | Path
    plant: str | Path
    tool: str
    declared: str
    gains: str | Path


@dataclass(frozen=True)
class Payload:
    """Something that hangs on the flange from a time on, beside the tool.

    Attributes:
        at: s.
        mass: kg; 0 puts it down again.
        center: (3,) in the flange frame, m.
        inertia: (3, 3) about its centre in the flange's axes, kg m^2.
        declared_at: when the controller is told of it, s; None if never.
    """

    at: float
    mass: float
    center: np.ndarray
    inertia: np.ndarray
    declared_at: float | None


@dataclass(frozen=True)
class Mismatch:
    """How the simulated arm differs from the plant's model as it is known.

    Attributes:
        link_mass_scale: (6,) factors on links' masses, and with them their tensors.
        link_center_shift: (6, 3) added to links' mass centres in their DH frames, m.
        rotor_scale: (6,) factors on the rotors' inertia.
        friction_scale: (6,) factors on the joints' friction.
        torque_constant_scale: (6,) factors on the motors' torque constants.
        offset: (6,) torque of joints at rest without load, added to the drives' own, Nm.
        ripple_phase: (6,) added to the phases of every term of the gears' ripple, rad.
        gravity_scale: factor on gravity.
    """

    link_mass_scale: np.ndarray = field(default_factory=lambda: np.ones(6))
    link_center_shift: np.ndarray = field(default_factory=lambda: np.zeros((6, 3)))
    rotor_scale: np.ndarray = field(default_factory=lambda: np.ones(6))
    friction_scale: np.ndarray = field(default_factory=lambda: np.ones(6))
    torque_constant_scale: np.ndarray = field(default_factory=lambda: np.ones(6))
    offset: np.ndarray = field(default_factory=lambda: np.zeros(6))
    ripple_phase: np.ndarray = field(default_factory=lambda: np.zeros(6))
    gravity_scale: float = 1.0

    def of_links(self, model: ArmModel) -> ArmModel:
        """The arm model with what concerns its links, rotors and gravity; drives take the rest."""
        links = tuple(
            replace(link, mass=link.mass * scale, inertia=link.inertia * scale, center=link.center + shift)
            for link, scale, shift in zip(model.links, self.link_mass_scale, self.link_center_shift, strict=True)
        )
        return replace(
            model,
            links=links,
            rotor_inertia=model.rotor_inertia * self.rotor_scale,
            gravity=model.gravity * self.gravity_scale,
        )


@dataclass(frozen=True)
class Temperature:
    """How warm the joints are, which their viscous friction shows.

    Attributes:
        warm_for: s of motion before the scenario begins; infinity for joints that are warm through.
        cold: viscous friction of a cold joint over that of a warm one; None for the drives' own.
        warming_time: time constant of warming, s; None for the drives' own.
    """

    warm_for: float = np.inf
    cold: float | None = None
    warming_time: float | None = None


@dataclass(frozen=True)
class Sensors:
    """What the devices do to the signals.

    Attributes:
        preset: as the lab's were, or without any fault, or a file of the user's (``sensing.load_sensors``).
        late_packages: whether the robot's packages come late now and then.
    """

    preset: str = "lab"
    late_packages: bool = False


@dataclass(frozen=True)
class StopLimits:
    """When the controller makes a protective stop; infinity switches a limit off.

    Attributes:
        force: of the controller's own estimate at the flange, N.
        deviation: of a joint from its target, rad.
        speed: of a joint over the arm's limit, as a factor.
    """

    force: float = np.inf
    deviation: float = np.inf
    speed: float = np.inf


@dataclass(frozen=True)
class Scenario:
    """A scenario, checked.

    Attributes:
        name: of the file, without its ending.
        path: the file.
        seed: of the noise.
        duration: s; None for what motions and pushes take, and ``settle``.
        settle: s after the last of them.
        q_start: (6,) where the arm stands at first, rad.
        motions: what it does, one after the other.
        obstacles: what stands around it.
        pushes: wrenches on it.
        payloads: what it picks up and puts down, in order of time.
    """

    name: str
    path: Path
    title: str
    description: str
    seed: int
    duration: float | None
    settle: float
    arm: Arm
    q_start: np.ndarray
    motions: tuple[Motion, ...]
    obstacles: tuple[Obstacle, ...]
    pushes: tuple[Push | LogPush, ...]
    payloads: tuple[Payload, ...]
    mismatch: Mismatch
    temperature: Temperature
    sensors: Sensors
    limits: StopLimits

    def controller_model(self) -> ArmModel:
        """What the controller linearises with, the tool it was told of included."""
        return load_model(self.arm.controller, self.arm.declared)

    def plant_model(self) -> ArmModel:
        """What is simulated: the plant with its tool and the scenario's mismatch."""
        return self.mismatch.of_links(load_model(self.arm.plant, self.arm.tool))

    def last_event(self) -> float:
        """When the last push is over or the last payload changes, s; motions, and pushes from logs, not counted."""
        ends = [push.end for push in self.pushes if isinstance(push, Push)]
        changes = [at for payload in self.payloads for at in (payload.at, payload.declared_at) if at is not None]
        return max([0.0, *ends, *changes])
