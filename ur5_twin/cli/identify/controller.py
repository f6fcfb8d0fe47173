"""The controller's own model and current law. Heavy imports stay inside the commands."""

from __future__ import annotations

from pathlib import Path

from ur5_twin.cli.common import command_line, read_all
from ur5_twin.cli.identify.options import Logs, Out, Repair, error_figure, write_result


def identify_controller(
    logs: Logs,
    out: Out = Path("out/controller"),
    repair: Repair = False,
) -> None:
    """Find the model your controller linearises with, from its target_moment.

    Writes controller.toml for 'replay --model', and a report with the error on each log of a fit to all the others.
    """
    from ur5_twin.arm.parameters import load_model
    from ur5_twin.identification import controller, results

    recordings = read_all(logs, repair)
    model = load_model("c")
    fit = controller.fit_rigid(recordings, model)
    held_out = controller.held_out_moment(recordings, model) if len(recordings) > 1 else None
    result = results.controller_result(fit, held_out, load_model("controller"), recordings, command_line())
    write_result(result, out, error_figure(result, out))


def identify_controller_current(
    logs: Logs,
    out: Out = Path("out/controller-current"),
    repair: Repair = False,
) -> None:
    """Find how your controller's target_current follows from its target_moment and target_qd.

    Writes target_current.toml for 'replay --target-current', and a report.
    """
    from ur5_twin.identification import controller, results

    recordings = read_all(logs, repair)
    fit = controller.fit_target_current(recordings)
    result = results.current_result(fit, recordings, command_line())
    write_result(result, out, error_figure(result, out))
