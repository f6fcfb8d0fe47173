"""Draw the pictures of ``docs/cell.md``: a run in the viewer, and a log of the lab beside one of the twin.

    ur5-twin run press_plate --out out/press_plate
    ur5-twin run push_moving --out out/push_moving
    ur5-twin replay out/push_moving/log --tool ati_gamma --wrench measured --out out/twin_log
    ur5-twin replay lab_logs/kufieta2014/Movement_No9_Singularity_Free_ForceSensor --tool ati_gamma --wrench measured \\
        --out out/lab_log
    xvfb-run -a -s "-screen 0 6800x4400x24" \\
        python docs/pictures/render_run.py out/press_plate out/lab_log out/twin_log

(without ``xvfb-run -a -s ...`` where there is a screen; a large one keeps the pointer off the picture). Needs Rerun's
viewer on the PATH.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from PIL import Image
from render_views import from_time, screenshot  # beside this file

from ur5_twin.arm.parameters import load_model
from ur5_twin.recording import read
from ur5_twin.scenario import load_scenario
from ur5_twin.views.figures import write_figures
from ur5_twin.views.rerun_view import write_rrd

#: Width of each of two pictures side by side.
_HALF = 1100


def main() -> None:
    """Write run_rerun.png, run_figures_wrench.png and lab_and_twin.png."""
    parser = argparse.ArgumentParser(description="Draw the pictures of docs/cell.md.")
    parser.add_argument("run", type=Path, help="output folder of ur5-twin run")
    parser.add_argument("replays", type=Path, nargs=2, help="output folders of two replays: the lab's log, the twin's")
    parser.add_argument("--start", type=float, default=9.9, help="what the viewer's pictures begin with, s")
    parser.add_argument("--folder", type=Path, default=Path(__file__).parent, help="where to write")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        draw_run(options.run, options.start, Path(name), options.folder)
        shots = []
        for number, replay in enumerate(options.replays):
            piece = from_time(read(replay), options.start)
            model = load_model("plant", "ati_gamma")
            rrd = write_rrd(
                piece, model, Path(name) / f"{number}.rrd", title=("the lab's log", "the twin's log")[number]
            )
            shots.append(Path(name) / f"{number}.png")
            screenshot(rrd, Path(name) / "shot.png", shots[-1])
        pictures = [Image.open(shot).convert("RGB") for shot in shots]
        height = _HALF * pictures[0].height // pictures[0].width
        both = Image.new("RGB", (2 * _HALF + 8, height), "white")
        for number, picture in enumerate(pictures):
            both.paste(picture.resize((_HALF, height), Image.Resampling.LANCZOS), (number * (_HALF + 8), 0))
        both.quantize(256, kmeans=4).save(options.folder / "lab_and_twin.png", optimize=True)


def draw_run(run: Path, start: float, scratch: Path, folder: Path) -> None:
    """The viewer's picture of a run, and its wrench figure."""
    scenario = load_scenario(json.loads((run / "report.json").read_text(encoding="utf-8"))["scenario"])
    recording, model = read(run), scenario.plant_model()
    names = [obstacle.name for obstacle in scenario.obstacles]
    for path in write_figures(recording, scratch, title=scenario.title, tool=model.tool, obstacles=names):
        if path.stem == "wrench":
            path.replace(folder / f"run_figures_{path.name}")
    rrd = write_rrd(
        from_time(recording, start), model, scratch / "run.rrd", title=scenario.title, obstacles=scenario.obstacles
    )
    screenshot(rrd, scratch / "shot.png", folder / "run_rerun.png")


if __name__ == "__main__":
    main()
