"""``ur5-twin identify``: model files from logs. One module a command; heavy imports stay inside the functions."""

from __future__ import annotations

import typer

from ur5_twin.cli.identify import controller, drive, excite, noise, plant, servo

_EXAMPLES = """[bold]Examples[/bold]

ur5-twin identify controller monday.csv tuesday.csv --out out/mine

ur5-twin replay wednesday.csv --model out/mine/controller.toml

ur5-twin identify drive monday.csv tuesday.csv wednesday.csv --out out/drive

ur5-twin replay thursday.csv --joints out/drive/joints.toml

ur5-twin identify servo pushed.csv monday.csv tuesday.csv --out out/servo

ur5-twin replay thursday.csv --gains out/servo/gains.toml

ur5-twin identify plant monday.csv tuesday.csv --tool ati_gamma --out out/plant

ur5-twin replay thursday.csv --plant out/plant/plant.toml --joints plant
"""

app = typer.Typer(help="Turn logs of your arm into model files for the twin.", no_args_is_help=True)

# In the order of the help.
for _name, _command, _examples in (
    ("controller", controller.identify_controller, _EXAMPLES),
    ("controller-current", controller.identify_controller_current, _EXAMPLES),
    ("drive", drive.identify_drive, _EXAMPLES),
    ("servo", servo.identify_servo, _EXAMPLES),
    ("plant", plant.identify_plant, _EXAMPLES),
    ("excite", excite.identify_excite, excite.EXAMPLES),
    ("noise", noise.identify_noise, None),
):
    app.command(_name, epilog=_examples)(_command)
