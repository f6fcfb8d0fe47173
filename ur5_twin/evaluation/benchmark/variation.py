"""A scenario's variations: the same kind of contact, elsewhere, harder or softer, sooner or later."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ur5_twin import spatial
from ur5_twin.arm.mjcf.obstacles import Obstacle
from ur5_twin.evaluation.benchmark.arms import generator
from ur5_twin.scenario import Motion, MoveJ, MoveL, Push, Scenario, Wait

#: A push: factor on its size, turn of its direction in rad, shift in time in s; none begins before _EARLIEST s.
_SIZE, _TURN, _SHIFT, _EARLIEST = (0.5, 1.25), 0.5, 0.4, 0.5
#: Factor on the speed of each motion and on the length of each wait.
_SPEED, _WAIT = (0.8, 1.2), (0.8, 1.2)
#: Turn of the whole motion about the base's axis where nothing stands around, rad: singular postures stay singular.
_BASE = 0.7
#: An obstacle: factor on its stiffness, damping and friction, and its shift up or down in m, a part of the 1 mm that
#: the shipped scenarios press at least.
_SURFACE, _HEIGHT = (0.6, 1.4), 3e-4


def varied(scenario: Scenario, seed: int) -> Scenario:
    """The scenario's variation for a seed.

    Pushes change size, direction and time; motions their speed; obstacles their stiffness, friction and height; where
    there are none and all motions are of the joints, joint 1 is turned throughout, by which everything is turned about
    the vertical.
    """
    rng = generator(seed, "scenario", scenario.name)
    pushes = tuple(_push(push, rng) if isinstance(push, Push) else push for push in scenario.pushes)
    obstacles = tuple(_obstacle(obstacle, rng) for obstacle in scenario.obstacles)
    motions = tuple(_motion(motion, rng) for motion in scenario.motions)
    turn = rng.uniform(-_BASE, _BASE) * np.eye(6)[0]
    q_start = scenario.q_start
    if not obstacles and all(isinstance(motion, MoveJ | Wait) for motion in motions):
        q_start = q_start + turn
        motions = tuple(replace(m, q=m.q + turn) if isinstance(m, MoveJ) else m for m in motions)
    return replace(scenario, pushes=pushes, obstacles=obstacles, motions=motions, q_start=q_start)


def _push(push: Push, rng: np.random.Generator) -> Push:
    size, shift = rng.uniform(*_SIZE), rng.uniform(-_SHIFT, _SHIFT)
    turn = spatial.rotation_from_vector(rng.uniform(-_TURN, _TURN, 3))
    peak = size * spatial.rotate_wrench(turn, push.peak)
    return replace(push, peak=peak, at=max(min(push.at, _EARLIEST), push.at + shift))


def _obstacle(obstacle: Obstacle, rng: np.random.Generator) -> Obstacle:
    stiffness, damping, friction = rng.uniform(*_SURFACE, 3)
    return replace(
        obstacle,
        position=obstacle.position + rng.uniform(-_HEIGHT, _HEIGHT) * np.eye(3)[2],
        stiffness=obstacle.stiffness * stiffness,
        damping=obstacle.damping * damping,
        friction=obstacle.friction * friction,
    )


def _motion(motion: Motion, rng: np.random.Generator) -> Motion:
    speed, wait = rng.uniform(*_SPEED), rng.uniform(*_WAIT)
    if isinstance(motion, MoveJ | MoveL):
        return replace(motion, speed=motion.speed * speed)
    if isinstance(motion, Wait):
        return replace(motion, duration=motion.duration * wait)
    return motion
