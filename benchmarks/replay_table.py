"""Servo replay of every log in a folder: mean absolute error per joint of all that the twin predicts.

    python benchmarks/replay_table.py LOGS [--model NAME] [--mode servo|shadow]

LOGS is a folder with one folder per movement. Prints Markdown.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from ur5_twin.arm.parameters import load_model
from ur5_twin.control.gains import load_gains
from ur5_twin.control.target_current import load_target_current_law
from ur5_twin.drives.current_map import load_current_map
from ur5_twin.evaluation.replay_report import short_number, summarise, table_rows
from ur5_twin.evaluation.tables import JOINT_COLUMNS, markdown
from ur5_twin.recording import read
from ur5_twin.twin.replay import MODES, ReplaySettings, replay


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", type=Path, help="a folder with one folder per movement")
    parser.add_argument("--model", default="controller")
    parser.add_argument("--mode", default="servo", choices=MODES)
    options = parser.parse_args()
    folders = sorted(options.logs.glob("Movement_*"))
    if not folders:
        parser.error(f"no Movement_* folder in {options.logs}")
    model = load_model(options.model)
    drive = load_current_map()
    settings = ReplaySettings(model, model, load_gains(), drive, load_target_current_law(), mode=options.mode)
    reports = []
    for folder in folders:
        reports.append(summarise(replay(read(folder), settings), settings))
    for k, (label, unit, _) in enumerate(table_rows(reports[0])):
        print(f"**{label[0].upper()}{label[1:]}, {unit}**\n")
        rows = [(report["source"], *map(short_number, table_rows(report)[k][2])) for report in reports]
        print(markdown(("log", *JOINT_COLUMNS), rows) + "\n")


if __name__ == "__main__":
    main()
