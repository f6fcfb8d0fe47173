"""Where along the arm a contact is, from joint torques alone."""

from __future__ import annotations

import numpy as np
import pytest

from ur5_twin.arm import kinematics
from ur5_twin.estimation import NominalModel, create, load_nominal, samples_of
from ur5_twin.estimation.localisation import TOOL, Localiser, surface_of

Q = np.array([0.4, -1.3, 1.3, -0.8, 1.2, 0.5])
KNOWN = np.full(6, 0.01)


def test_points_lie_on_the_surface(nominal: NominalModel) -> None:
    """Each on one of its link's cylinders, inside none, with the normal outwards; and areas add up."""
    surface = surface_of(nominal.arm, 0.02, 24)
    assert set(surface.link) == {1, 2, 3, 4, 5, 6, TOOL}
    np.testing.assert_allclose(np.linalg.norm(surface.normal, axis=1), 1.0, rtol=1e-12)
    for link, part in [(2, nominal.arm.links[1].cylinders[2]), (6, nominal.arm.links[5].cylinders[0])]:
        away = surface.point[surface.link == link] - part.center
        axis = "xyz".index(part.axis)
        across = np.linalg.norm(np.delete(away, axis, axis=1), axis=1)
        on_side = np.isclose(across, part.radius) & (np.abs(away[:, axis]) < part.height / 2)
        assert on_side.sum() > 20
        outwards = np.delete(surface.normal[surface.link == link], axis, axis=1)[on_side]
        np.testing.assert_allclose(outwards, np.delete(away, axis, axis=1)[on_side] / part.radius, atol=1e-9)
    alone = nominal.arm.links[5].cylinders[0]
    # Link 6 is a single cylinder.
    area = 2 * np.pi * alone.radius * (alone.radius + alone.height)
    assert surface.area[surface.link == 6].sum() == pytest.approx(area, rel=1e-12)


@pytest.mark.parametrize("link", [3, 4, 5, 6, TOOL])
def test_a_push_on_a_link_is_found(nominal: NominalModel, link: int) -> None:
    """Normal pushes all over a link: joints beyond carry nothing, and the link is found; at the wrist, the place."""
    localiser = Localiser(nominal)
    surface = surface_of(nominal.arm, 0.031, 17)
    rows = np.flatnonzero(surface.link == link)[::7]
    frame = min(link, 6)
    X = kinematics.link_frames(nominal.arm, Q)[frame]
    right, away = [], []
    for k in rows:
        J = kinematics.point_jacobian(nominal.arm, Q, frame, surface.point[k])
        force = -40.0 * X[:3, :3] @ surface.normal[k]
        tau = J[:3].T @ force
        if np.abs(tau[min(link, 5) - 1]) < 0.5:
            # Along the last joint's axis or through it: that joint cannot tell.
            continue
        place = localiser.locate(Q, tau, KNOWN)
        assert place is not None
        # Link 6 and the tool are round about joint 6, which a push through its axis does not load.
        right.append(place.link == link or (link >= 6 and place.link >= 5))
        away.append(np.linalg.norm(place.mean - (X[:3, :3] @ surface.point[k] + X[:3, 3])))
    assert len(right) >= 4
    assert np.mean(right) > 0.8
    # Joint torques leave a line on the forearm and a patch on the wrist.
    assert np.median(away) < (0.12 if link == 3 else 0.08)


def test_joints_that_carry_nothing_end_the_chain(nominal: NominalModel) -> None:
    place = Localiser(nominal).locate(Q, np.array([12.0, -15.0, 0.0, 0.0, 0.0, 0.0]), np.full(6, 0.05))
    assert place is not None
    assert place.link == 2
    assert place.links.sum() == pytest.approx(1.0)
    assert place.links[3:].sum() < 0.05


@pytest.mark.parametrize("preset", ["ideal", "lab"])
def test_the_forearm_on_a_bar(run_of, preset: str) -> None:
    """The scenario forearm_contact, with friction, and noise: link 3, within a hand's breadth."""
    recording = run_of("forearm_contact", preset)
    nominal = load_nominal("plant", "ati_gamma")
    estimator, localiser = create("momentum_observer", nominal), Localiser(nominal)
    contact = recording.tables["contact"]
    link, away = [], []
    for k, sample in enumerate(samples_of(recording)):
        found = estimator.update(sample)
        rows = np.abs(contact.time - sample.time) < 1e-4
        if k % 25 or np.linalg.norm(contact["contact_force"][rows].sum(axis=0)) < 15.0:
            continue
        assert set(contact["contact_link"][rows, 0]) == {3.0}
        place = localiser.locate(sample.actual_q, found.tau_ext, estimator.variance)
        assert place is not None
        link.append(place.link)
        away.append(np.linalg.norm(place.mean - contact["contact_point"][rows].mean(axis=0)))
    assert len(link) > 20
    assert np.mean(np.array(link) == 3) > 0.85
    assert np.median(away) < 0.12


def test_the_elbow_against_a_post(run_of) -> None:
    """Sideways at the elbow only joint 1 and the friction of the others are loaded: nothing beyond link 3."""
    recording = run_of("elbow_contact")
    nominal = load_nominal("plant", "ati_gamma")
    estimator, localiser = create("momentum_observer", nominal), Localiser(nominal)
    contact = recording.tables["contact"]
    link = []
    for k, sample in enumerate(samples_of(recording)):
        found = estimator.update(sample)
        rows = np.abs(contact.time - sample.time) < 1e-4
        if k % 25 or np.linalg.norm(contact["contact_force"][rows].sum(axis=0)) < 15.0:
            continue
        place = localiser.locate(sample.actual_q, found.tau_ext, estimator.variance)
        assert place is not None
        link.append(abs(place.link - contact["contact_link"][rows][0, 0]))
    assert len(link) > 20
    # The elbow's housing is on both links' side of joint 3, which a push through its axis does not load.
    assert np.mean(np.array(link) <= 1) > 0.9
