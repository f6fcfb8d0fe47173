"""Where along the arm something touches it, from joint torques alone.

A force f at a point p of link L loads joints 1 to L: tau = J_p' f. Candidates are points all over the links' cylinders
and the tool's, each with its normal n. A touch pushes, and along the surface only as far as friction lets it, so at
each point the force is taken for normal about none, with a standard deviation along n and ``cone`` times that across; a
candidate whose most likely force pulls is none. Its evidence is that of tau under N(0, R + J_p' S_f J_p): a link that
explains torques which are not there pays for it.

What cannot be told: force and place together have five numbers, and joints 1 to L give L torques. Contacts on links 1
and 2 give the link at best, on link 3 a line, and beyond the wrist a point, if the torques are good enough. The
spread of the posterior says which.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from ur5_twin.arm._kinematics_kernels import frames_into, jacobian_into
from ur5_twin.arm.parameters import ArmModel, Box, Cylinder, Part, Sphere
from ur5_twin.estimation.nominal import NominalModel

#: What the tool is called where links are numbered.
TOOL = 7
#: A point this far inside another body of its link is no surface, m.
_INSIDE = 1e-3
_AXES = {"x": (1, 2, 0), "y": (2, 0, 1), "z": (0, 1, 2)}


@dataclass(frozen=True)
class Surface:
    """Points that may be touched.

    Attributes:
        link: (n,) 1 to 6, or 7 for the tool.
        point: (n, 3) in the link's DH frame (the tool's: the flange's), m.
        normal: (n, 3) outwards.
        area: (n,) that a point stands for, m^2.
    """

    link: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    area: np.ndarray


@dataclass(frozen=True)
class Place:
    """Where the contact is.

    Attributes:
        link: the most probable link, 1 to 6, or 7 for the tool.
        links: (7,) probability of each.
        point: (3,) the most probable place on that link, base frame, m.
        mean: (3,) mean of the places on that link, base frame, m.
        spread: root mean square distance of the places on that link from their mean, m.
        force: (3,) most likely force on the arm at ``point``, base axes, N.
    """

    link: int
    links: np.ndarray
    point: np.ndarray
    mean: np.ndarray
    spread: float
    force: np.ndarray


def surface_of(arm: ArmModel, spacing: float, around: int) -> Surface:
    """Points on the cylinders of an arm's links and on its tool's parts.

    Args:
        arm: the model.
        spacing: of points along a cylinder and of rings on its ends, m.
        around: points in a ring.
    """
    bodies: list[tuple[int, tuple[Part, ...]]] = [(i + 1, link.cylinders) for i, link in enumerate(arm.links)]
    if arm.tool is not None:
        bodies.append((TOOL, arm.tool.parts))
    rows: list[tuple[int, np.ndarray, np.ndarray, np.ndarray]] = []
    for link, parts in bodies:
        for part in parts:
            point, normal, area = _points(part, spacing, around)
            free = ~np.any([_inside(other, point) for other in parts], axis=0)
            rows.append((link, point[free], normal[free], area[free]))
    return Surface(
        np.concatenate([np.full(len(point), link) for link, point, _, _ in rows]),
        *(np.ascontiguousarray(np.concatenate([row[i] for row in rows])) for i in (1, 2, 3)),
    )


class Localiser:
    """Finds the place of a contact.

    Args:
        nominal: whose kinematics, links, tool and ``[localisation]`` it takes.
    """

    def __init__(self, nominal: NominalModel) -> None:
        spec = nominal.settings.localisation
        self.surface = surface_of(nominal.arm, spec.spacing_mm * 1e-3, spec.around)
        self._dh = nominal.dh
        self._along, self._across = spec.prior_force_n**2, (spec.cone * spec.prior_force_n) ** 2
        self._frame = np.minimum(self.surface.link, 6).astype(np.int64)
        n = len(self.surface.link)
        self._score, self._force, self._place = np.empty(n), np.empty((n, 3)), np.empty((n, 3))

    def locate(self, q: np.ndarray, tau: np.ndarray, variance: np.ndarray) -> Place | None:
        """The place of a contact.

        Args:
            q: (6,) rad.
            tau: (6,) external torque, Nm.
            variance: (6,) of it, Nm^2.

        Returns:
            None if no push on any surface explains the torques at all.
        """
        surface = self.surface
        _score(
            self._dh,
            np.ascontiguousarray(q, dtype=float),
            np.ascontiguousarray(tau, dtype=float),
            np.maximum(variance, 1e-6),
            self._frame,
            surface.point,
            surface.normal,
            self._along,
            self._across,
            self._score,
            self._force,
            self._place,
        )
        best = self._score.max()
        if best == -np.inf:
            return None
        weight = np.exp(self._score - best) * surface.area
        weight /= weight.sum()
        links = np.bincount(surface.link, weight, minlength=TOOL + 1)[1:]
        link = int(np.argmax(links)) + 1
        on = surface.link == link
        share = weight[on] / weight[on].sum()
        mean = share @ self._place[on]
        top = int(np.argmax(np.where(on, self._score, -np.inf)))
        spread = math.sqrt(share @ np.square(self._place[on] - mean).sum(axis=1))
        return Place(link, links, self._place[top].copy(), mean, spread, self._force[top].copy())


def _points(part: Part, spacing: float, around: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 3) on a body, their normals (n, 3) and the area (n,) each stands for."""
    if isinstance(part, Cylinder):
        return _on_cylinder(part, spacing, around)
    # The sphere's directions, evenly spread (Fibonacci's lattice), cast on a box as well.
    n = around * around // 2
    k = np.arange(n) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * k / n), np.pi * (1.0 + math.sqrt(5.0)) * k
    unit = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=1)
    if isinstance(part, Sphere):
        return part.center + part.radius * unit, unit, np.full(n, 4.0 * np.pi * part.radius**2 / n)
    half = 0.5 * part.size
    reach = np.min(half / np.maximum(np.abs(unit), 1e-12), axis=1)
    axis = np.argmax(np.abs(unit) / half, axis=1)
    normal = np.zeros_like(unit)
    normal[np.arange(n), axis] = np.sign(unit[np.arange(n), axis])
    # A direction's share of the sphere falls on an area that grows with distance squared over the cosine.
    area = 4.0 * np.pi / n * reach**2 / np.abs(unit[np.arange(n), axis])
    return part.center + reach[:, None] * unit, normal, area


def _on_cylinder(part: Cylinder, spacing: float, around: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    first, second, axis = _AXES[part.axis]
    turn = 2.0 * np.pi * np.arange(around) / around
    ring = np.zeros((around, 3))
    ring[:, first], ring[:, second] = np.cos(turn), np.sin(turn)
    up = np.zeros(3)
    up[axis] = 1.0
    rings = max(2, math.ceil(part.height / spacing))
    points, normals, areas = [], [], []
    for height in (np.arange(rings) + 0.5) / rings - 0.5:
        points.append(part.radius * ring + height * part.height * up)
        normals.append(ring)
        areas.append(np.full(around, 2.0 * np.pi * part.radius * part.height / rings / around))
    circles = max(1, math.ceil(part.radius / spacing))
    for side in (-1.0, 1.0):
        for k in range(circles):
            radius = (k + 0.5) / circles * part.radius
            points.append(radius * ring + 0.5 * side * part.height * up)
            normals.append(np.tile(side * up, (around, 1)))
            areas.append(np.full(around, 2.0 * np.pi * radius * part.radius / circles / around))
    return part.center + np.concatenate(points), np.concatenate(normals), np.concatenate(areas)


def _inside(part: Part, point: np.ndarray) -> np.ndarray:
    """(n,) whether points lie inside a body by more than ``_INSIDE``."""
    away = point - part.center
    if isinstance(part, Sphere):
        return np.linalg.norm(away, axis=1) < part.radius - _INSIDE
    if isinstance(part, Box):
        return np.all(np.abs(away) < 0.5 * part.size - _INSIDE, axis=1)
    first, second, axis = _AXES[part.axis]
    across = np.hypot(away[:, first], away[:, second])
    return (across < part.radius - _INSIDE) & (np.abs(away[:, axis]) < 0.5 * part.height - _INSIDE)


@njit(cache=True, nogil=True)
def _score(dh, q, tau, variance, frame, point, normal, along, across, score, force, place):  # pragma: no cover
    """Log evidence, most likely force (base axes) and place of each candidate; -inf where the force would pull."""
    frames, J = np.empty((7, 4, 4)), np.empty((6, 6))
    frames_into(dh, q, frames)
    for c in range(frame.shape[0]):
        X = frames[frame[c]]
        jacobian_into(frames, frame[c], point[c], J)
        A, b, n = np.empty((3, 3)), np.empty(3), np.empty(3)
        for i in range(3):
            n[i] = X[i, 0] * normal[c, 0] + X[i, 1] * normal[c, 1] + X[i, 2] * normal[c, 2]
            place[c, i] = X[i, 0] * point[c, 0] + X[i, 1] * point[c, 1] + X[i, 2] * point[c, 2] + X[i, 3]
        for i in range(3):
            b[i] = 0.0
            for j in range(6):
                b[i] += J[i, j] * tau[j] / variance[j]
            for k in range(3):
                A[i, k] = (1.0 / along - 1.0 / across) * n[i] * n[k] + (1.0 / across if i == k else 0.0)
                for j in range(6):
                    A[i, k] += J[i, j] * J[k, j] / variance[j]
        f = np.linalg.solve(A, b)
        pushed = 0.0
        gain = 0.0
        for i in range(3):
            force[c, i] = f[i]
            pushed -= f[i] * n[i]
            gain += b[i] * f[i]
        score[c] = -np.inf
        if pushed > 0.0:
            score[c] = 0.5 * (gain - math.log(np.linalg.det(A) * along * across * across))
