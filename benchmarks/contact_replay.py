"""The twin against the lab, with contact: servo replay with the measured wrench on the simulated arm.

    python benchmarks/contact_replay.py LOGS

LOGS is the folder that holds the lab's movements. Per joint: the largest position error, measured and simulated, and
how the simulated current's change (actual_current minus target_current) follows the measured one where that is above
0.3 A: correlation and slope. Runs with the force sensor first, free ones after them.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from lab_runs import FREE, PUSHED

from ur5_twin.arm.drive import load_drive, load_joint_drives
from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.evaluation import replay_report
from ur5_twin.evaluation.tables import JOINT_COLUMNS, markdown
from ur5_twin.recording import read
from ur5_twin.recording.force_sensor import FT_DELAY
from ur5_twin.twin.replay import ReplaySettings, replay


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, help="the folder with the lab's movements")
    parser.add_argument("--gains", default="servo")
    parser.add_argument("--joints", default="plant")
    options = parser.parse_args()
    drives, gains = load_joint_drives(options.joints), load_gains(options.gains)
    for name in (f"Movement_{run}" for run in PUSHED + FREE):
        pushed = name.removeprefix("Movement_") in PUSHED
        settings = ReplaySettings(
            model=load_model("controller"),
            plant=load_model("plant", "ati_gamma" if pushed else None),
            gains=gains,
            drive=load_drive(),
            target_current=load_target_current_law(),
            joints=drives,
            wrench="measured" if pushed else "none",
            ft_delay=FT_DELAY,
        )
        report = replay_report.summarise(replay(read(options.logs / name, repair=True), settings), settings)
        rows = [
            (label, unit, *map(replay_report.short_number, values))
            for label, unit, values in replay_report.answer_rows(report)
        ]
        current = report["actual_current"]
        ratios = [a / b if b else math.nan for a, b in zip(current["mae_a"], current["controller_mae_a"], strict=True)]
        rows.append(("current, MAE of the twin's", "A", *map(replay_report.short_number, current["mae_a"])))
        rows.append(("the same over target_current's", "", *map(replay_report.short_number, ratios)))
        print(f"**{name}**{', measured wrench' if pushed else ''}\n")
        print(markdown(("quantity", "unit", *JOINT_COLUMNS), rows, words=2), end="\n\n")


if __name__ == "__main__":
    main()
