"""How well ``identify payload`` finds known payloads of simulated arms that are not quite what the fit believes.

    python benchmarks/payload_recovery.py [SEEDS]

Each seed draws another arm (link masses by 2 %, rotors by 3 %, torque constants by 3 %, friction by 10 %, one standard
deviation) and other sensor noise. The fit knows the shipped numbers. Prints found and true values with 95 % intervals,
and how many of the intervals hold.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from ur5_twin.arm.drive import load_joint_drives
from ur5_twin.arm.parameters import load_model
from ur5_twin.cli.common import quiet_engine
from ur5_twin.evaluation.tables import markdown
from ur5_twin.identification import payload
from ur5_twin.identification.spread import NINETY_FIVE
from ur5_twin.recording.table import Recording
from ur5_twin.scenario import load_scenario
from ur5_twin.scenario.scenario import Mismatch, Payload
from ur5_twin.twin.scenario_run import ScenarioRun

_TOOL = "ati_gamma"
#: kg, m and kg m^2: a small gripper, a part off the axis, a heavy part.
_LOADS = (
    (0.5, np.array([0.0, 0.0, 0.10]), np.diag([8e-4, 8e-4, 5e-4])),
    (2.0, np.array([0.03, -0.02, 0.12]), np.diag([3.3e-3, 3.3e-3, 3.3e-3])),
    (4.0, np.array([-0.05, 0.04, 0.15]), np.diag([1.5e-2, 1.5e-2, 1e-2])),
)


def main() -> None:
    """Print the table."""
    quiet_engine()
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    rows, held, bound = [], {}, {}
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        arm = Mismatch(
            link_mass_scale=1.0 + 0.02 * rng.standard_normal(6),
            rotor_scale=1.0 + 0.03 * rng.standard_normal(6),
            torque_constant_scale=1.0 + 0.03 * rng.standard_normal(6),
            friction_scale=1.0 + 0.1 * rng.standard_normal(6),
        )
        bare = _run("free_motion", seed, arm, None)
        for mass, center, tensor in _LOADS:
            load = Payload(0.0, mass, center, tensor, 0.0)
            log = _run("free_motion", seed + 100, arm, load)
            told = payload.fit_told([log], load_model("controller", _TOOL))
            alone = payload.fit_carried([log], [], load_model("plant", _TOOL), load_joint_drives())
            beside = payload.fit_carried([log], [bare], load_model("plant", _TOOL), load_joint_drives())
            for how, fit in (("target_moment", told), ("currents", alone), ("currents, bare log", beside)):
                rows.append(_row(how, seed, fit, mass, center, held, bound))
        mass, center, tensor = 2.0, np.array([0.0, 0.0, 0.103]), np.diag([3.3e-3] * 3)
        log = payload.between(_run("payload_pickup", seed, arm, "its own"), 6.0, 13.5)
        for how, others in (("pick-up, currents", []), ("pick-up, bare log", [bare])):
            fit = payload.fit_carried([log], others, load_model("plant", _TOOL), load_joint_drives())
            rows.append(_row(how, seed, fit, mass, center, held, bound))
    head = ("from", "seed", "true kg", "found kg", "true mm", "found mm")
    print(markdown(head, rows, words=2))
    print()
    summary = [(how, f"{np.mean(held[how]):.2f}", f"{np.median(bound[how]):.3g}", str(len(held[how]))) for how in held]
    print(markdown(("from", "share of intervals that hold", "median half width, kg", "numbers"), summary))


def _run(name: str, seed: int, arm: Mismatch, load: Payload | str | None) -> Recording:
    scenario = replace(load_scenario(name), mismatch=arm)
    if not isinstance(load, str):
        scenario = replace(scenario, payloads=() if load is None else (load,))
    return ScenarioRun(scenario, seed).finish()


def _row(
    how: str, seed: int, fit: payload.PayloadFit, mass: float, center: np.ndarray, held: dict, bound: dict
) -> tuple[str, ...]:
    found, std = fit.mass
    place, place_std = fit.center
    inside = [abs(found - mass) <= NINETY_FIVE * std, *(np.abs(place - center) <= NINETY_FIVE * place_std)]
    if how != "target_moment":
        held.setdefault(how, []).extend(inside)
        bound.setdefault(how, []).append(NINETY_FIVE * std)
    digits = 6 if how == "target_moment" else 3
    places = ", ".join(f"{x:.1f} ± {NINETY_FIVE * s:.1f}" for x, s in zip(1e3 * place, 1e3 * place_std, strict=True))
    return (
        how,
        str(seed),
        f"{mass:g}",
        f"{found:.{digits}f} ± {NINETY_FIVE * std:.{digits}f}",
        ", ".join(f"{1e3 * x:g}" for x in center),
        places,
    )


if __name__ == "__main__":
    main()
