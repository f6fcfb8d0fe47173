"""Inertia tensors of homogeneous bodies and how they add up (thesis section 2.2.4)."""

from __future__ import annotations

import numpy as np

_AXES = {"x": 0, "y": 1, "z": 2}


def cylinder(mass: float, radius: float, height: float, axis: str) -> np.ndarray:
    """Tensor (3, 3) of a homogeneous cylinder about its centre, kg m^2.

    Along its axis m r^2 / 2, across it m (3 r^2 + h^2) / 12 (thesis equation 2.48).
    """
    tensor = np.eye(3) * (mass * (3.0 * radius**2 + height**2) / 12.0)
    along = _AXES[axis]
    tensor[along, along] = mass * radius**2 / 2.0
    return tensor


def box(mass: float, size: np.ndarray) -> np.ndarray:
    """Tensor (3, 3) of a homogeneous box with edges ``size`` (3,) in m about its centre, kg m^2."""
    squares = np.asarray(size) ** 2
    return np.diag(mass / 12.0 * (squares.sum() - squares))


def shift(tensor: np.ndarray, mass: float, offset: np.ndarray) -> np.ndarray:
    """Parallel axes: the tensor about a point ``offset`` (3,) away, I + m (|p|^2 1 - p p') (equations 2.45, 2.46)."""
    offset = np.asarray(offset)
    return tensor + mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))


def combine(masses: np.ndarray, centers: np.ndarray, tensors: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Mass, mass centre (3,) and tensor about it (3, 3) of n bodies.

    Args:
        masses: (n,) kg.
        centers: (n, 3) m, all in one frame.
        tensors: (n, 3, 3) kg m^2, each about its body's own centre, in the axes of that frame.
    """
    mass = float(masses.sum())
    center = masses @ centers / mass
    about_center = [shift(tensor, m, p - center) for m, p, tensor in zip(masses, centers, tensors, strict=True)]
    return mass, center, np.sum(about_center, axis=0)
