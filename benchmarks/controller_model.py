"""The real controller's own model from its target_moment and target_current, checked on logs it was not fitted to.

    python benchmarks/controller_model.py LOGS

LOGS is a folder with one folder per movement. Prints the fit on all of them, which is what models/ur5_controller.toml
and models/target_current.toml hold, and for each log what a fit on all the others predicts of it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ur5_twin.arm.parameters import load_model
from ur5_twin.evaluation.tables import JOINT_COLUMNS, markdown
from ur5_twin.identification.controller import fit_rigid, fit_target_current, held_out_moment
from ur5_twin.recording import read
from ur5_twin.recording.table import Recording


def errors_table(recordings: list[Recording], errors: np.ndarray) -> str:
    """One row a log, (n_logs, 6) errors."""
    rows = zip(recordings, errors, strict=True)
    return markdown(("log", *JOINT_COLUMNS), [(log.source, *(f"{value:.2f}" for value in row)) for log, row in rows])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, help="a folder with one folder per movement")
    options = parser.parse_args()
    if not any(options.logs.glob("Movement_*")):
        parser.error(f"no Movement_* folder in {options.logs}")
    recordings = [read(folder) for folder in sorted(options.logs.glob("Movement_*"))]

    fit = fit_rigid(recordings, load_model("c"))
    print(f"{len(recordings)} logs. One standard deviation of the fit behind each number.\n")
    print(f"gravity          {fit.gravity:.7f} +- {fit.gravity_std:.0e} m/s^2")
    print(f"share of tensors {fit.tensor_share:.0e} +- {fit.tensor_share_std:.0e}")
    print(f"link 6 centre z  {fit.link6_z * 1e6:.3f} +- {fit.link6_z_std * 1e6:.3f} um")
    print("rotor inertia    " + ", ".join(f"{value:.7f}" for value in fit.rotor_inertia) + " kg m^2")
    print("              +- " + ", ".join(f"{value:.0e}    " for value in fit.rotor_inertia_std) + "\n")
    print("MAE of target_moment in uNm, predicted by a fit on all other logs:\n")
    print(errors_table(recordings, held_out_moment(recordings, load_model("c")) * 1e6))

    moving = [r for r in recordings if (np.abs(r.robot["target_qd"]).max(axis=0) > 0).all()]
    law = fit_target_current(moving)
    mean = law.viscous_mean
    print("\ntarget_current, on the logs in which every joint moves:\n")
    print("torque constant    " + ", ".join(f"{value:.4f}" for value in law.torque_constant) + " Nm/A")
    print("load               " + ", ".join(f"{value:.5f}" for value in law.load) + " A/Nm")
    print("viscous driving    " + ", ".join(f"{value:.4f}" for value in mean[0]) + " A s/rad, mean over logs")
    print("viscous backdriven " + ", ".join(f"{value:.4f}" for value in mean[1]) + " A s/rad, mean over logs\n")
    for title, mae in (
        ("with each log's own viscous coefficients", law.mae),
        ("with their mean", law.mae_common),
    ):
        print(f"MAE of target_current in mA {title}:\n")
        print(errors_table(moving, mae * 1e3) + "\n")


if __name__ == "__main__":
    main()
