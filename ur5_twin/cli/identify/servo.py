"""The servo. Heavy imports stay inside the commands."""

from __future__ import annotations

from pathlib import Path

from ur5_twin.cli.common import command_line, read_all
from ur5_twin.cli.identify.options import Logs, Out, Repair, write_result
from ur5_twin.terminal import progress


def identify_servo(
    logs: Logs,
    out: Out = Path("out/servo"),
    repair: Repair = False,
) -> None:
    """Find your servo's gains: from logs of pushes at standstill, from tracking errors of moving ones, or both.

    Writes gains.toml for 'replay --gains', and a report: what each joint's logs tell, the tracking error on each moving
    log by a servo from all the others, and whether the thesis' fit of PD gains to free motion can tell any.
    """
    from ur5_twin.arm.parameters import load_model
    from ur5_twin.control.gains import load_gains
    from ur5_twin.control.target_current import load_target_current_law
    from ur5_twin.identification import servo_nlse, servo_result, servo_tracking
    from ur5_twin.views import servo as views

    recordings = read_all(logs, repair)
    moving = [recording for recording in recordings if not servo_tracking.is_standstill(recording)]
    knowledge = load_gains("servo"), load_model("controller"), load_target_current_law()
    servo = servo_result.fit(recordings, *knowledge)
    with progress("replay", len(moving)) as advance:
        checked = servo_result.held_out(recordings, *knowledge, advance)
    nlse = servo_nlse.fit_nlse(moving) if moving else None
    result = servo_result.servo_result(servo, checked, nlse, recordings, command_line())
    write_result(result, out, views.draw(checked, nlse, out / "figures"))
