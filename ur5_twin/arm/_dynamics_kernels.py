"""Compiled rigid-body dynamics of a serial arm with six revolute joints and any standard DH parameters.

Everything is written in joint frames: frame J_i sits at o_{i-1} with z along joint i's axis and turns with link i. In
it the link's inertia is constant and joint i is a turn about z, so the DH twist and offsets only enter as one constant
step to the next joint. ``Packed`` holds those constants.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit


class Packed(NamedTuple):
    """An arm's dynamic parameters for the compiled kernels; pass it on as one argument.

    Attributes:
        links: (6, 15), one row a link: cos alpha, sin alpha, a, d (the step to the next joint), mass, m c (3), the
            tensor about J_i's origin (xx, xy, xz, yy, yz, zz), all in J_i; the rotor's reflected inertia.
        gravity: m/s^2 along -z of the base.
    """

    links: np.ndarray
    gravity: float


@njit(cache=True, inline="always")
def _out(link, cs, qd, qdd, motion):
    """One joint outwards: motion of DH frame i-1 -> wrench of link i about J_i and motion of DH frame i.

    w angular velocity, u angular acceleration, a linear acceleration with gravity's reaction.
    """
    ca, sa, px, pz, m, hx, hy, hz, ixx, ixy, ixz, iyy, iyz, izz = link
    c, s = cs
    wx, wy, wz, ux, uy, uz, ax, ay, az = motion
    # Turn by -q about z, then add the joint's own motion.
    x = c * wx + s * wy
    y = c * wy - s * wx
    gx = c * ux + s * uy + y * qd
    gy = c * uy - s * ux - x * qd
    gz = uz + qdd
    z = wz + qd
    bx = c * ax + s * ay
    by = c * ay - s * ax
    # The matrix S(u) + S(w)^2 takes a point to its acceleration relative to the origin.
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz = x * y, x * z, y * z
    axx = -yy - zz
    ayy = -xx - zz
    azz = -xx - yy
    axy, ayx = xy - gz, xy + gz
    axz, azx = xz + gy, xz - gy
    ayz, azy = yz - gx, yz + gx
    fx = m * bx + axx * hx + axy * hy + axz * hz
    fy = m * by + ayx * hx + ayy * hy + ayz * hz
    fz = m * az + azx * hx + azy * hy + azz * hz
    lx = ixx * x + ixy * y + ixz * z
    ly = ixy * x + iyy * y + iyz * z
    lz = ixz * x + iyz * y + izz * z
    nx = ixx * gx + ixy * gy + ixz * gz + y * lz - z * ly + hy * az - hz * by
    ny = ixy * gx + iyy * gy + iyz * gz + z * lx - x * lz + hz * bx - hx * az
    nz = ixz * gx + iyz * gy + izz * gz + x * ly - y * lx + hx * by - hy * bx
    # On to the next joint: by (a, 0, d), then the twist alpha about x.
    ex = bx + axx * px + axz * pz
    ey = by + ayx * px + ayz * pz
    ez = az + azx * px + azz * pz
    return (
        (fx, fy, fz, nx, ny, nz),
        (
            x,
            ca * y + sa * z,
            ca * z - sa * y,
            gx,
            ca * gy + sa * gz,
            ca * gz - sa * gy,
            ex,
            ca * ey + sa * ez,
            ca * ez - sa * ey,
        ),
    )


@njit(cache=True, inline="always")
def _back(link, cs, child, own):
    """One joint inwards: the wrench on link i+1 about J_{i+1} moved to J_i and added to link i's own.

    cs belongs to joint i+1.
    """
    c, s = cs
    ca, sa, px, pz = link[0], link[1], link[2], link[3]
    fx, fy, fz, nx, ny, nz = child
    tx = c * fx - s * fy
    ty = s * fx + c * fy
    ry = ca * ty - sa * fz
    rz = sa * ty + ca * fz
    kx = c * nx - s * ny
    ky = s * nx + c * ny
    my = ca * ky - sa * nz
    mz = sa * ky + ca * nz
    return (
        own[0] + tx,
        own[1] + ry,
        own[2] + rz,
        own[3] + kx - pz * ry,
        own[4] + my + pz * tx - px * rz,
        own[5] + mz + px * ry,
    )


@njit(cache=True, inline="always")
def _row(links, i):
    p = links[i]
    return p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11], p[12], p[13]


@njit(cache=True, inline="always")
def _trig(q):
    """Cosines and sines of the six joints, so that several passes at one configuration share them."""
    return (
        (math.cos(q[0]), math.sin(q[0])),
        (math.cos(q[1]), math.sin(q[1])),
        (math.cos(q[2]), math.sin(q[2])),
        (math.cos(q[3]), math.sin(q[3])),
        (math.cos(q[4]), math.sin(q[4])),
        (math.cos(q[5]), math.sin(q[5])),
    )


@njit(cache=True, nogil=True)
def _newton_euler(links, gravity, trig, qd, qdd, out):
    """Recursive Newton-Euler, one sample: out = M qdd + C qd + g.

    The six joints are written out: the wrenches then live in registers and no scratch array is needed.
    """
    cs0, cs1, cs2, cs3, cs4, cs5 = trig
    l0, l1, l2 = _row(links, 0), _row(links, 1), _row(links, 2)
    l3, l4, l5 = _row(links, 3), _row(links, 4), _row(links, 5)
    # A base accelerating upwards with g feels like gravity.
    f0, v = _out(l0, cs0, qd[0], qdd[0], (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, gravity))
    f1, v = _out(l1, cs1, qd[1], qdd[1], v)
    f2, v = _out(l2, cs2, qd[2], qdd[2], v)
    f3, v = _out(l3, cs3, qd[3], qdd[3], v)
    f4, v = _out(l4, cs4, qd[4], qdd[4], v)
    f5, v = _out(l5, cs5, qd[5], qdd[5], v)
    f4 = _back(l4, cs5, f5, f4)
    f3 = _back(l3, cs4, f4, f3)
    f2 = _back(l2, cs3, f3, f2)
    f1 = _back(l1, cs2, f2, f1)
    f0 = _back(l0, cs1, f1, f0)
    out[0] = f0[5] + links[0, 14] * qdd[0]
    out[1] = f1[5] + links[1, 14] * qdd[1]
    out[2] = f2[5] + links[2, 14] * qdd[2]
    out[3] = f3[5] + links[3, 14] * qdd[3]
    out[4] = f4[5] + links[4, 14] * qdd[4]
    out[5] = f5[5] + links[5, 14] * qdd[5]


@njit(cache=True, nogil=True)
def rnea_into(packed, q, qd, qdd, out):
    """Inverse dynamics of one sample, out (6,) = M(q) qdd + C(q, qd) qd + g(q), Nm.

    Args:
        packed: ``Dynamics.packed``.
        q, qd, qdd, out: contiguous (6,) arrays; ``out`` may not be one of the others.
    """
    _newton_euler(packed.links, packed.gravity, _trig(q), qd, qdd, out)


@njit(cache=True, nogil=True)
def mass_matrix_into(packed, q, out):
    """M(q) of one sample into out (6, 6), kg m^2, by composite rigid bodies about the base's origin.

    M_ij = z_i . L_j + (o_i x z_i) . P_j for i <= j, with P_j, L_j the momentum of links j to 6 when joint j alone turns
    at 1 rad/s.
    """
    links = packed.links
    bodies = np.empty(
        (6, 10)
    )  # mass, m c (3), tensor (xx, xy, xz, yy, yz, zz), about the base's origin and in its axes
    axes = np.empty((6, 6))  # z_i and o_i x z_i
    rxx, rxy, rxz, ryx, ryy, ryz, rzx, rzy, rzz = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    ox, oy, oz = 0.0, 0.0, 0.0
    for i in range(6):
        ca, sa, px, pz, m, hx, hy, hz, ixx, ixy, ixz, iyy, iyz, izz = _row(links, i)
        axes[i, 0], axes[i, 1], axes[i, 2] = rxz, ryz, rzz
        axes[i, 3], axes[i, 4], axes[i, 5] = oy * rzz - oz * ryz, oz * rxz - ox * rzz, ox * ryz - oy * rxz
        c, s = math.cos(q[i]), math.sin(q[i])
        rxx, rxy = c * rxx + s * rxy, c * rxy - s * rxx
        ryx, ryy = c * ryx + s * ryy, c * ryy - s * ryx
        rzx, rzy = c * rzx + s * rzy, c * rzy - s * rzx
        gx, gy, gz = (rxx * hx + rxy * hy + rxz * hz, ryx * hx + ryy * hy + ryz * hz, rzx * hx + rzy * hy + rzz * hz)
        # R I first, then (R I) R' and the parallel axes with the first moment g = m (c - o).
        ax, bx, cx = (
            rxx * ixx + rxy * ixy + rxz * ixz,
            rxx * ixy + rxy * iyy + rxz * iyz,
            rxx * ixz + rxy * iyz + rxz * izz,
        )
        ay, by, cy = (
            ryx * ixx + ryy * ixy + ryz * ixz,
            ryx * ixy + ryy * iyy + ryz * iyz,
            ryx * ixz + ryy * iyz + ryz * izz,
        )
        az, bz, cz = (
            rzx * ixx + rzy * ixy + rzz * ixz,
            rzx * ixy + rzy * iyy + rzz * iyz,
            rzx * ixz + rzy * iyz + rzz * izz,
        )
        kx, ky, kz = 2.0 * gx + m * ox, 2.0 * gy + m * oy, 2.0 * gz + m * oz
        bodies[i, 0] = m
        bodies[i, 1], bodies[i, 2], bodies[i, 3] = gx + m * ox, gy + m * oy, gz + m * oz
        bodies[i, 4] = ax * rxx + bx * rxy + cx * rxz + oy * ky + oz * kz
        bodies[i, 5] = ax * ryx + bx * ryy + cx * ryz - ox * gy - oy * gx - m * ox * oy
        bodies[i, 6] = ax * rzx + bx * rzy + cx * rzz - ox * gz - oz * gx - m * ox * oz
        bodies[i, 7] = ay * ryx + by * ryy + cy * ryz + ox * kx + oz * kz
        bodies[i, 8] = ay * rzx + by * rzy + cy * rzz - oy * gz - oz * gy - m * oy * oz
        bodies[i, 9] = az * rzx + bz * rzy + cz * rzz + ox * kx + oy * ky
        ox, oy, oz = ox + rxx * px + rxz * pz, oy + ryx * px + ryz * pz, oz + rzx * px + rzz * pz
        rxy, rxz = ca * rxy + sa * rxz, ca * rxz - sa * rxy
        ryy, ryz = ca * ryy + sa * ryz, ca * ryz - sa * ryy
        rzy, rzz = ca * rzy + sa * rzz, ca * rzz - sa * rzy
    for j in range(5, -1, -1):
        if j < 5:
            for k in range(10):
                bodies[j, k] += bodies[j + 1, k]
        m, hx, hy, hz = bodies[j, 0], bodies[j, 1], bodies[j, 2], bodies[j, 3]
        ixx, ixy, ixz, iyy, iyz, izz = (
            bodies[j, 4],
            bodies[j, 5],
            bodies[j, 6],
            bodies[j, 7],
            bodies[j, 8],
            bodies[j, 9],
        )
        zx, zy, zz, vx, vy, vz = axes[j, 0], axes[j, 1], axes[j, 2], axes[j, 3], axes[j, 4], axes[j, 5]
        fx, fy, fz = m * vx + zy * hz - zz * hy, m * vy + zz * hx - zx * hz, m * vz + zx * hy - zy * hx
        nx = ixx * zx + ixy * zy + ixz * zz + hy * vz - hz * vy
        ny = ixy * zx + iyy * zy + iyz * zz + hz * vx - hx * vz
        nz = ixz * zx + iyz * zy + izz * zz + hx * vy - hy * vx
        for i in range(j + 1):
            out[i, j] = out[j, i] = (
                axes[i, 0] * nx
                + axes[i, 1] * ny
                + axes[i, 2] * nz
                + axes[i, 3] * fx
                + axes[i, 4] * fy
                + axes[i, 5] * fz
            )
        out[j, j] += links[j, 14]


@njit(cache=True, nogil=True)
def bias_into(packed, q, qd, out):
    """C(q, qd) qd + g(q) of one sample into out (6,), Nm."""
    _newton_euler(packed.links, packed.gravity, _trig(q), qd, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0), out)


@njit(cache=True, nogil=True)
def gravity_into(packed, q, out):
    """g(q) of one sample into out (6,), Nm."""
    still = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    _newton_euler(packed.links, packed.gravity, _trig(q), still, still, out)


@njit(cache=True, nogil=True)
def coriolis_into(packed, q, qd, out):
    """C(q, qd) of one sample into out (6, 6), the one of the Christoffel symbols (thesis equations 2.65, 2.66).

    b(qd) = C qd is quadratic in qd with the symmetric coefficients c_ijk, so column j is half its derivative by qd_j
    and the central difference (b(qd + h e_j) - b(qd - h e_j)) / 4h is that exactly, whatever h. h = |qd| keeps the
    rounding even.
    """
    trig = _trig(q)
    still = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    h = math.sqrt(qd[0] ** 2 + qd[1] ** 2 + qd[2] ** 2 + qd[3] ** 2 + qd[4] ** 2 + qd[5] ** 2)
    if h == 0.0:
        out[:, :] = 0.0
        return
    plus, minus, rate = np.empty(6), np.empty(6), np.empty(6)
    for j in range(6):
        rate[:] = qd
        rate[j] = qd[j] + h
        _newton_euler(packed.links, 0.0, trig, rate, still, plus)
        rate[j] = qd[j] - h
        _newton_euler(packed.links, 0.0, trig, rate, still, minus)
        for i in range(6):
            out[i, j] = (plus[i] - minus[i]) / (4.0 * h)


@njit(cache=True, nogil=True)
def forward_into(packed, q, qd, tau, out):
    """Forward dynamics of one sample, out (6,) = M^-1 (tau - C qd - g), rad/s^2, by Cholesky's factors of M."""
    L = np.empty((6, 6))
    mass_matrix_into(packed, q, L)
    bias_into(packed, q, qd, out)
    for i in range(6):
        for j in range(i + 1):
            for k in range(j):
                L[i, j] -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(L[i, i]) if i == j else L[i, j] / L[j, j]
        out[i] = tau[i] - out[i]
        for k in range(i):
            out[i] -= L[i, k] * out[k]
        out[i] /= L[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            out[i] -= L[k, i] * out[k]
        out[i] /= L[i, i]


@njit(cache=True, nogil=True)
def potential(packed, q):
    """Potential energy of one sample, J, zero where the mass centre is at the base's origin (thesis equation 2.63)."""
    height = 0.0
    oz = 0.0
    rzx, rzy, rzz = 0.0, 0.0, 1.0
    for i in range(6):
        ca, sa, px, pz, m, hx, hy, hz = _row(packed.links, i)[:8]
        c, s = math.cos(q[i]), math.sin(q[i])
        rzx, rzy = c * rzx + s * rzy, c * rzy - s * rzx
        height += m * oz + rzx * hx + rzy * hy + rzz * hz
        oz += rzx * px + rzz * pz
        rzy, rzz = ca * rzy + sa * rzz, ca * rzz - sa * rzy
    return packed.gravity * height


@njit(cache=True, nogil=True)
def rnea_rows(packed, q, qd, qdd, out):
    """``rnea_into`` for every row of (n, 6) arrays."""
    for k in range(q.shape[0]):
        rnea_into(packed, q[k], qd[k], qdd[k], out[k])


@njit(cache=True, nogil=True)
def mass_matrix_rows(packed, q, out):
    """``mass_matrix_into`` for every row of q (n, 6) into out (n, 6, 6)."""
    for k in range(q.shape[0]):
        mass_matrix_into(packed, q[k], out[k])


@njit(cache=True, nogil=True)
def bias_rows(packed, q, qd, out):
    """``bias_into`` for every row of (n, 6) arrays."""
    for k in range(q.shape[0]):
        bias_into(packed, q[k], qd[k], out[k])


@njit(cache=True, nogil=True)
def gravity_rows(packed, q, out):
    """``gravity_into`` for every row of (n, 6) arrays."""
    for k in range(q.shape[0]):
        gravity_into(packed, q[k], out[k])


@njit(cache=True, nogil=True)
def coriolis_rows(packed, q, qd, out):
    """``coriolis_into`` for every row of (n, 6) arrays into out (n, 6, 6)."""
    for k in range(q.shape[0]):
        coriolis_into(packed, q[k], qd[k], out[k])


@njit(cache=True, nogil=True)
def forward_rows(packed, q, qd, tau, out):
    """``forward_into`` for every row of (n, 6) arrays."""
    for k in range(q.shape[0]):
        forward_into(packed, q[k], qd[k], tau[k], out[k])


@njit(cache=True, nogil=True)
def potential_rows(packed, q, out):
    """``potential`` for every row of q (n, 6) into out (n,)."""
    for k in range(q.shape[0]):
        out[k] = potential(packed, q[k])
