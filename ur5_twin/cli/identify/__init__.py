"""``ur5-twin identify``: model files from logs, one module a command or a pair."""

import typer

from ur5_twin.cli.identify import controller, drive, excite, flange, noise, plant, servo
from ur5_twin.cli.identify.options import EXAMPLES

app = typer.Typer(help="Turn logs of your arm into model files for the twin.", no_args_is_help=True)
app.command("controller", epilog=EXAMPLES)(controller.identify_controller)
app.command("controller-current", epilog=EXAMPLES)(controller.identify_controller_current)
app.command("drive", epilog=EXAMPLES)(drive.identify_drive)
app.command("servo", epilog=EXAMPLES)(servo.identify_servo)
app.command("plant", epilog=EXAMPLES)(plant.identify_plant)
app.command("payload", epilog=EXAMPLES)(flange.identify_payload)
app.command("sensor", epilog=EXAMPLES)(flange.identify_sensor)
app.command("excite", epilog=excite.EXCITE_EXAMPLES)(excite.identify_excite)
app.command("noise", epilog=EXAMPLES)(noise.identify_noise)
