"""Draw the pictures of ``docs/viewing.md`` out of a replay.

    ur5-twin replay lab_logs/kufieta2014/Movement_No9_Singularity_Free_ForceSensor --out out/no9
    xvfb-run -a -s "-screen 0 6800x4400x24" python docs/pictures/render_views.py out/no9

(without ``xvfb-run -a -s ...`` where there is a screen). Needs Rerun's viewer on the PATH.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from ur5_twin.arm.parameters import load_model
from ur5_twin.recording import Recording, Table, read
from ur5_twin.views.figures import write_figures
from ur5_twin.views.rerun_view import write_rrd

_WIDTH, _HEIGHT = 1600, 1000


def main() -> None:
    """Write replay_rerun.png and replay_figures_*.png."""
    parser = argparse.ArgumentParser(description="Draw the pictures of docs/viewing.md.")
    parser.add_argument("replay", type=Path, help="output folder of ur5-twin replay")
    parser.add_argument("--folder", type=Path, default=Path(__file__).parent, help="where to write")
    parser.add_argument("--start", type=float, default=9.9, help="what the viewer's picture begins with, s")
    parser.add_argument("--tool", default="ati_gamma", help="the tool to draw")
    options = parser.parse_args()
    recording = read(options.replay)
    model = load_model("controller", options.tool)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path in write_figures(recording, folder, title=recording.source, tool=model.tool):
            if path.stem in ("position", "wrench"):
                path.replace(options.folder / f"replay_figures_{path.name}")
        rrd = write_rrd(from_time(recording, options.start), model, folder / "twin.rrd", title=recording.source)
        screenshot(rrd, folder / "shot.png", options.folder / "replay_rerun.png")


def from_time(recording: Recording, start: float) -> Recording:
    """The same without the robot's rows before a time: the viewer opens where a recording begins."""
    robot = recording.robot
    row = int(np.searchsorted(robot.time, start))
    columns = {name: values[row:] for name, values in robot.columns.items()}
    return recording.with_table(Table(robot.device, robot.time[row:], columns, robot.host_start))


def screenshot(rrd: Path, shot: Path, path: Path) -> None:
    size = f"{_WIDTH}x{_HEIGHT}"
    command = ["rerun", "--renderer", "vulkan", "--window-size", size, "--screenshot-to", str(shot), str(rrd)]
    subprocess.run(command, check=True, timeout=180, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    picture = Image.open(shot).convert("RGB").resize((_WIDTH, _HEIGHT), Image.Resampling.LANCZOS)
    picture.quantize(256, method=Image.Quantize.FASTOCTREE, kmeans=4).save(path, optimize=True)


if __name__ == "__main__":
    main()
