"""Obstacles around the arm with a contact stiffness and damping in N/m and N s/m, and payloads changed at run time.

MuJoCo's soft contact is brought to the spring and damper of a surface, f = k r + b r', with r the penetration in m.
Along the normal of a contact, with v = -r' and a = -r'', its solver gives (manual, "Computation: constraint model")

    f = (a_ref - a) / R,   a_ref = -B v + K d r,   R = (1 - d) / d * A

with d the impedance, constant where solimp's dmin = dmax, A the sum of both bodies' ``body_invweight0`` (a model
constant, not the inertia in the present pose) and, for solref = (-s, -c), K = s / d^2, B = c / d. Hence

    f = (s r + c r') / ((1 - d) A) + m_v r'',   m_v = d / ((1 - d) A)

and s = k (1 - d) A, c = b (1 - d) A make it a spring k and a damper b in every pose. What remains, m_v, is a mass that
the surface seems to have; d is chosen such that it is ``SKIN_MASS``.

Friction is Coulomb's in an elliptic cone. While it sticks, MuJoCo lets the contact creep with a viscosity of
m_v * impratio * B_t; ``impratio`` is large so that this is slow. Sliding at v_t adds m_v mu B_t v_t to the normal
force (the cone's dilation), which a small m_v keeps below the accuracy of anything else.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np

from ur5_twin import spatial
from ur5_twin.arm.parameters import ArmModel, Box
from ur5_twin.errors import ModelError

Shape = Literal["plate", "wall", "box", "sphere", "cylinder"]

#: Numbers in ``Obstacle.size``: edges x, y, z of what is a box; radius of a sphere; radius and height of a cylinder.
SIZES: dict[Shape, int] = {"plate": 3, "wall": 3, "box": 3, "sphere": 1, "cylinder": 2}

#: Mass that a surface seems to move along with the arm in contact, kg; the arm is felt as 2 to 20 kg there.
SKIN_MASS = 0.01
#: The stiffest surface, N/m, and the strongest damper, N s/m, for physics steps of 2 ms. The lightest that a UR5 with
#: its rotors is felt at a tool's tip is 1.8 kg; a step is stable while h^2 k + 2 h b < 4 m, which allows 1.8e6 N/m, and
#: twice this stiffness is left for a second contact beside the first.
MAX_STIFFNESS = 5e5
MAX_DAMPING = 500.0
MAX_FRICTION = 10.0

# Rate at which sliding that has come to rest decays, 1/s: a fifth of what a step of 2 ms could follow.
_STICK_RATE = 100.0
# Ratio of tangential to normal inverse regularisation: 20 N creep 0.3 mm/s at most.
_IMPRATIO = 1e5
# MuJoCo's own bounds of solimp.
_LEAST_IMPEDANCE, _MOST_IMPEDANCE = 1e-4, 0.9999
_PREFIX = "obstacle_"
_COLOUR = [0.72, 0.53, 0.33, 1.0]
_PAYLOAD = "payload"


@dataclass(frozen=True)
class Obstacle:
    """Something that does not move and that the arm can touch.

    Attributes:
        name: unique in its scene.
        shape: ``plate``, ``wall``, ``box``, ``sphere`` or ``cylinder``.
        position: (3,) of its frame's origin in B, m. The origin is in the middle of the body, but for a plate, where it
            is in the middle of the top face (normal +z), and a wall, where it is in that of the face it shows (+x).
        rotation: (3,) rotation vector of its frame in B, rad.
        size: m; edges (x, y, z), or (radius,) of a sphere, or (radius, height) of a cylinder along z.
        stiffness: k, N/m, of force over penetration where one part of the arm touches it.
        damping: b, N s/m. A contact pushes only: it never pulls on an arm that leaves faster than the surface.
        friction: coefficient mu of Coulomb friction.

    Raises:
        ModelError: a value is impossible; the message names the attribute.
    """

    name: str
    shape: Shape
    position: np.ndarray
    rotation: np.ndarray
    size: np.ndarray
    stiffness: float
    damping: float
    friction: float

    def __post_init__(self) -> None:
        def check(good: bool, what: str) -> None:
            if not good:
                raise ModelError(f"obstacle '{self.name}': {what}")

        for key in ("position", "rotation", "size"):
            object.__setattr__(self, key, np.asarray(getattr(self, key), dtype=float))
        check(bool(re.fullmatch(r"\w+", self.name)), "name must be of letters, digits and '_'")
        check(self.shape in SIZES, f"shape '{self.shape}' is none of {', '.join(SIZES)}")
        for key, count in (("position", 3), ("rotation", 3), ("size", SIZES[self.shape])):
            value = getattr(self, key)
            check(value.shape == (count,), f"{key} of a {self.shape} has {count} numbers, not {value.size}")
            check(bool(np.isfinite(value).all()), f"{key} must be finite")
        check(bool((self.size > 0).all()), "size must be positive")
        check(
            0 < self.stiffness <= MAX_STIFFNESS,
            f"stiffness must be above 0 and at most {MAX_STIFFNESS:g} N/m, not {self.stiffness:g}: "
            "a stiffer contact does not hold in physics steps of 2 ms",
        )
        check(
            0 <= self.damping <= MAX_DAMPING,
            f"damping must be between 0 and {MAX_DAMPING:g} N s/m, not {self.damping:g}",
        )
        check(
            0 <= self.friction <= MAX_FRICTION,
            f"friction must be between 0 and {MAX_FRICTION:g}, not {self.friction:g}",
        )

    @property
    def pose(self) -> np.ndarray:
        """X_BO (4, 4), the obstacle's frame in the base."""
        return spatial.pose(spatial.rotation_from_vector(self.rotation), self.position)

    def center(self) -> np.ndarray:
        """(3,) middle of the body in B, m."""
        behind = {"plate": [0.0, 0.0, -0.5], "wall": [-0.5, 0.0, 0.0]}.get(self.shape)
        return self.position if behind is None else spatial.transform_point(self.pose, np.array(behind) * self.size)


def geom_name(obstacle: Obstacle) -> str:
    """The name of an obstacle's geom in MuJoCo."""
    return _PREFIX + obstacle.name


def add(root: Any, model: ArmModel, bodies: Sequence[str], obstacles: Sequence[Obstacle]) -> None:
    """Put obstacles into the world, and a contact pair for each of them and each moving part of the arm.

    The geoms themselves collide with nothing. A pair has one contact point: what is a box on the arm gets a hull beside
    its geom, because MuJoCo would give two boxes up to eight points, each with the full stiffness.

    Args:
        root: the MJCF root with the arm in it.
        model: the arm's numbers.
        bodies: names of the moving links' bodies, base to flange.
        obstacles: what to add.

    Raises:
        ModelError: two obstacles have one name.
    """
    if not obstacles:
        return
    names = [obstacle.name for obstacle in obstacles]
    for name in names:
        if names.count(name) > 1:
            raise ModelError(f"two obstacles are named '{name}'; each needs a name of its own")
    root.option.cone = "elliptic"
    root.option.impratio = _IMPRATIO
    root.option.flag.multiccd = "disable"
    for obstacle in obstacles:
        _geom(root, obstacle)
    for part in _arm_geoms(root, model, bodies):
        for obstacle in obstacles:
            root.contact.add(
                "pair",
                geom1=part,
                geom2=geom_name(obstacle),
                # A cone of no width has no friction directions; MuJoCo would widen it a little instead.
                condim=3 if obstacle.friction > 0 else 1,
                friction=[obstacle.friction, obstacle.friction, 0.0, 0.0, 0.0],
            )


def tune(mj_model: mujoco.MjModel, obstacles: Sequence[Obstacle]) -> None:
    """Give the compiled model's contact pairs the stiffness and damping of their obstacles.

    Needed once after compiling: the scaling depends on ``body_invweight0``, which the compiler finds.
    """
    by_geom = {mj_model.geom(geom_name(obstacle)).id: obstacle for obstacle in obstacles}
    for pair in range(mj_model.npair):
        geoms = mj_model.pair_geom1[pair], mj_model.pair_geom2[pair]
        obstacle = next((by_geom[geom] for geom in geoms if geom in by_geom), None)
        if obstacle is None:
            continue
        A = sum(mj_model.body_invweight0[mj_model.geom_bodyid[geom], 0] for geom in geoms)
        d = float(np.clip(SKIN_MASS * A / (1.0 + SKIN_MASS * A), _LEAST_IMPEDANCE, _MOST_IMPEDANCE))
        scale = (1.0 - d) * A
        mj_model.pair_solref[pair] = -obstacle.stiffness * scale, -obstacle.damping * scale
        # Friction has no position to go back to; only its rate counts, and MuJoCo reads both numbers or none.
        mj_model.pair_solreffriction[pair] = -1.0, -_STICK_RATE * d
        mj_model.pair_solimp[pair] = d, d, 1.0, 0.5, 1.0


def add_payload(body: Any) -> None:
    """Weld a body without mass to the flange, for ``set_payload``."""
    payload = body.add("body", name=_PAYLOAD)
    payload.add("inertial", mass=0.0, pos=[0.0, 0.0, 0.0], diaginertia=[0.0, 0.0, 0.0])


def set_payload(
    mj_model: mujoco.MjModel,
    data: mujoco.MjData,
    mass: float,
    center: np.ndarray,
    inertia: np.ndarray,
) -> None:
    """Hang a payload on the flange, or take it off with a mass of 0, while the simulation stands between two steps.

    The state in ``data`` stays as it is; its derived quantities follow with the next step or ``mj_forward``. Contacts
    keep their stiffness.

    Args:
        mj_model: compiled with ``payload=True``; changed in place.
        data: its data, or None.
        mass: kg.
        center: (3,) mass centre in the flange frame, m.
        inertia: (3, 3) tensor about ``center`` in the flange's axes, kg m^2; zero for a point mass.

    Raises:
        ModelError: the model was compiled without a payload, or mass or tensor are impossible.
    """
    body = mujoco.mj_name2id(mj_model, mujoco.mjtObj.mjOBJ_BODY, _PAYLOAD)
    if body < 0:
        raise ModelError("this MuJoCo model has no body 'payload': compile it with payload=True")
    moments, axes = np.linalg.eigh(np.asarray(inertia, dtype=float))
    if not (np.isfinite(mass) and mass >= 0 and np.isfinite(center).all()):
        raise ModelError(f"a payload needs a mass that is not negative and a finite centre, not {mass:g} kg")
    if moments[0] < -1e-12 or moments[2] > (moments[0] + moments[1]) * (1 + 1e-9) + 1e-12:
        raise ModelError(f"no body has the payload's principal moments of inertia {moments} kg m^2")
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1.0
    mj_model.body_mass[body] = mass
    mj_model.body_ipos[body] = center
    mj_model.body_inertia[body] = np.maximum(moments, 0.0)
    mujoco.mju_mat2Quat(mj_model.body_iquat[body], axes.flatten())
    # mj_setConst works in the reference pose and leaves its data there, hence data of its own. It also finds the
    # weights anew that the contacts were tuned with.
    weights = mj_model.body_invweight0.copy()
    mujoco.mj_setConst(mj_model, mujoco.MjData(mj_model))
    mj_model.body_invweight0[:] = weights


def _geom(root: Any, obstacle: Obstacle) -> None:
    if obstacle.shape == "sphere":
        kind, size = "sphere", [obstacle.size[0]]
    elif obstacle.shape == "cylinder":
        kind, size = "cylinder", [obstacle.size[0], obstacle.size[1] / 2]
    else:
        kind, size = "box", obstacle.size / 2
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, obstacle.pose[:3, :3].flatten())
    root.worldbody.add(
        "geom",
        name=geom_name(obstacle),
        type=kind,
        size=size,
        pos=obstacle.center(),
        quat=quaternion,
        group=0,
        rgba=_COLOUR,
        contype=0,
        conaffinity=0,
    )


def _arm_geoms(root: Any, model: ArmModel, bodies: Sequence[str]) -> Iterator[str]:
    """Names of the geoms that obstacles can touch; the foot does not move and touches nothing new."""
    for name, link in zip(bodies, model.links, strict=True):
        yield from (f"{name}_{part.name}" for part in link.cylinders)
    if model.tool is None:
        return
    body = root.find("body", "tool")
    for part in model.tool.parts:
        name = f"tool_{part.name}"
        if isinstance(part, Box):
            corners = np.stack(np.meshgrid(*([-0.5, 0.5],) * 3, indexing="ij"), axis=-1).reshape(-1, 3) * part.size
            root.asset.add("mesh", name=f"{name}_hull", vertex=corners.ravel())
            body.add(
                "geom",
                name=f"{name}_hull",
                type="mesh",
                mesh=f"{name}_hull",
                pos=part.center,
                mass=0.0,
                group=3,
                contype=0,
                conaffinity=0,
            )
            name = f"{name}_hull"
        yield name
