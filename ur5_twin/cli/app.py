"""The command line. Heavy imports stay inside the commands, so that ``--help`` answers at once."""

from __future__ import annotations

import sys
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ur5_twin import __version__
from ur5_twin.cli import benchmark, estimate, identify, live, record, serve
from ur5_twin.cli.common import (
    complete_gains,
    complete_models,
    complete_tools,
    quiet_engine,
    replay_settings,
    shipped,
    writable,
)
from ur5_twin.errors import TwinError
from ur5_twin.terminal import progress

if TYPE_CHECKING:
    from ur5_twin.arm.parameters import ArmModel

app = typer.Typer(
    name="ur5-twin",
    help="A digital twin of a UR5: replay logs in lockstep with a MuJoCo model, look at both, measure the difference.",
    epilog="First: [bold]ur5-twin replay demo[/bold]. Real logs: [bold]ur5-twin fetch kufieta2014[/bold].",
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_REPLAY_EXAMPLES = """[bold]Examples[/bold]

ur5-twin replay lab_logs/kufieta2014/Movement_No6_Acc_slow_Verify_Model --rerun

ur5-twin replay robot_data.csv --mode shadow --model plant --out out/shadow

ur5-twin replay out/shadow --model c   [dim]# the same log again, another model[/dim]

ur5-twin replay lab_logs/kufieta2014/Movement_No10_Standstill_ForceSensor_All --tool ati_gamma --wrench measured
"""

_RUN_EXAMPLES = """[bold]Examples[/bold]

ur5-twin run --list

ur5-twin run press_plate --rerun

ur5-twin run mine.toml --seed 7 --out out/mine

ur5-twin replay out/press_plate/log --tool ati_gamma+ball_probe   [dim]# its log, as if it were the lab's[/dim]
"""

_MODEL_EXAMPLES = """[bold]Examples[/bold]

ur5-twin model c

ur5-twin model plant --tool ati_gamma --export cell.xml --scene
"""

#: Exit code of a command that Ctrl-C ended, as shells have it; Typer returns it, or raises Abort while it prompts.
_INTERRUPTED = 130


class Mode(StrEnum):
    """How the twin follows a log."""

    servo = "servo"
    shadow = "shadow"


class Wrench(StrEnum):
    """What pushes the simulated arm in a replay."""

    none = "none"
    measured = "measured"


def main() -> None:
    """Run the command line; anything the user got wrong becomes one line on stderr and exit code 2."""
    try:
        code = app(standalone_mode=False)
    except TwinError as error:
        _stop(str(error), 2)
    except (typer.Abort, KeyboardInterrupt):
        code = _INTERRUPTED
    except typer.TyperException as error:
        context = getattr(error, "ctx", None)
        _stop(f"{error.format_message()} (see '{context.command_path if context else 'ur5-twin'} --help')", 2)
    except OSError as error:
        _stop(f"{error.strerror or error}{f': {error.filename}' if error.filename else ''}", 2)
    if code == _INTERRUPTED:
        _stop("stopped", _INTERRUPTED)
    sys.exit(code if isinstance(code, int) else 0)


def _stop(message: str, code: int) -> None:
    print(f"ur5-twin: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(code)


def _version(asked: bool) -> None:
    if asked:
        print(f"ur5-twin {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    pass


def _complete_scenarios(incomplete: str) -> list[str]:
    from ur5_twin.scenario import scenario_names

    return [name for name in scenario_names() if name.startswith(incomplete)]


@app.command(epilog=_REPLAY_EXAMPLES)
def replay(
    path: Annotated[
        Path,
        typer.Argument(
            help="A folder of the lab's CSV files, a CSV by ur_rtde or record.py, a Parquet file of ours, the output "
            "folder of an earlier replay, or 'demo' for the log that ships."
        ),
    ],
    model: Annotated[
        str,
        typer.Option(
            "--model", "-m", autocompletion=complete_models, help="Model the controller linearises with: name or TOML."
        ),
    ] = "controller",
    plant: Annotated[
        str | None,
        typer.Option(
            autocompletion=complete_models,
            help="Model that is simulated. Default: the controller's; with --joints, plant.",
        ),
    ] = None,
    gains: Annotated[
        str | None,
        typer.Option(
            "--gains",
            "-g",
            autocompletion=complete_gains,
            help="Gains of the servo: a preset's name or a TOML. Default: thesis_c; with --joints, servo.",
        ),
    ] = None,
    joints: Annotated[
        str | None,
        typer.Option(
            help="Motors, gears and friction of the simulated arm: 'plant' for those that --plant names (joints_from), "
            "a TOML, or 'none' for motors that give what the controller asks for. Default: none; with --wrench "
            "measured, plant."
        ),
    ] = None,
    wrench: Annotated[
        Wrench,
        typer.Option(
            help="[bold]measured[/bold]: what the log's force sensor read pushes the simulated arm; needs --tool "
            "ati_gamma or another that carries the sensor."
        ),
    ] = Wrench.none,
    ft_delay: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=1.0,
            help="By how many seconds the force sensor's rows are late beside the robot's. Default: the lab's, by the "
            "motors' answer to pushes.",
        ),
    ] = None,
    target_current: Annotated[
        Path | None, typer.Option(help="TOML of the controller's current law. Default: the one that ships.")
    ] = None,
    drive: Annotated[
        str | None,
        typer.Option(
            help="Map from torque and motion to motor current: lab, lab_following, thesis or a TOML. Default: lab; "
            "thesis where the log lacks what that needs."
        ),
    ] = None,
    tool: Annotated[
        str,
        typer.Option(autocompletion=complete_tools, help="Tool at the flange of the simulated arm: a name or a TOML."),
    ] = "none",
    payload: Annotated[
        str,
        typer.Option(
            autocompletion=complete_tools,
            help="Tool that the real controller was told of, a name or a TOML: part of target_moment.",
        ),
    ] = "none",
    mode: Annotated[
        Mode,
        typer.Option(
            help="[bold]servo[/bold]: the closed loop follows the log's targets. [bold]shadow[/bold]: the twin is put "
            "into the measured state each tick and says what torque and current the motion needs."
        ),
    ] = Mode.servo,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Output folder. Default: out/<name of the log>.", callback=writable),
    ] = None,
    rerun: Annotated[
        bool | None,
        typer.Option("--rerun/--no-rerun", help="Write twin.rrd. Default: if the Rerun SDK is installed."),
    ] = None,
    spawn: Annotated[bool, typer.Option("--spawn", help="Open the Rerun viewer at the end.")] = False,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures/*.png.")] = True,
    repair: Annotated[
        bool, typer.Option("--repair", help="Repair what is broken in the log and report it, instead of refusing.")
    ] = False,
) -> None:
    """Replay a log through the twin, in lockstep, and report how they differ."""
    from ur5_twin.drives import terms
    from ur5_twin.recording import read
    from ur5_twin.terminal import show_replay
    from ur5_twin.twin.replay import replay as run
    from ur5_twin.views import rerun_view
    from ur5_twin.views.output import output_folder, write_replay

    if rerun or spawn:
        rerun_view.need_rerun()
    quiet_engine()
    source = shipped(path)
    recording = read(source, repair=repair)
    drive = drive or ("thesis" if terms.missing(recording) else "lab")
    settings = replay_settings(
        model, plant, gains, joints, wrench, ft_delay, drive, target_current, tool, payload, mode
    )
    folder = output_folder(out, recording, source)
    with progress("replay", len(recording.robot)) as advance:
        replayed = run(recording, settings, advance)
    report = write_replay(
        replayed,
        settings,
        folder,
        log=source,
        rerun=rerun_view.has_rerun() if rerun is None else rerun,
        figures=figures,
    )
    show_replay(report, folder)
    if spawn:
        rerun_view.spawn(replayed, settings.plant)


@app.command(epilog=_RUN_EXAMPLES)
def run(
    scenario: Annotated[
        str | None,
        typer.Argument(autocompletion=_complete_scenarios, help="A scenario that ships, or the path of a TOML file."),
    ] = None,
    listed: Annotated[bool, typer.Option("--list", help="List the scenarios that ship, and leave.")] = False,
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Of the sensors' noise. Default: the scenario's. The motion stays the same."),
    ] = None,
    sensors: Annotated[
        str | None,
        typer.Option(help="The devices: a preset's name or a TOML ('identify sensor'). Default: the scenario's."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Output folder. Default: out/<name of the scenario>.", callback=writable),
    ] = None,
    rerun: Annotated[
        bool | None,
        typer.Option("--rerun/--no-rerun", help="Write twin.rrd. Default: if the Rerun SDK is installed."),
    ] = None,
    spawn: Annotated[bool, typer.Option("--spawn", help="Open the Rerun viewer at the end.")] = False,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures/*.png.")] = True,
) -> None:
    """Run a scenario in the simulated cell: the log that the real robot and sensors would write, and the truth."""
    from ur5_twin.scenario import load_scenario

    if listed:
        _list_scenarios()
        return
    if scenario is None:
        raise typer.BadParameter("give a scenario, or --list to see those that ship", param_hint="SCENARIO")
    from ur5_twin.errors import SimulationError
    from ur5_twin.terminal import show_run
    from ur5_twin.twin.scenario_run import ScenarioRun
    from ur5_twin.views import rerun_view
    from ur5_twin.views.run_output import run_folder, write_run

    if rerun or spawn:
        rerun_view.need_rerun()
    quiet_engine()
    loaded = load_scenario(scenario)
    if sensors is not None:
        loaded = replace(loaded, sensors=replace(loaded.sensors, preset=sensors))
    folder = run_folder(out, loaded.name)
    running = ScenarioRun(loaded, seed)
    with progress("run", len(running)) as advance:
        recording = running.finish(advance)
    report = write_run(
        running, recording, folder, rerun=rerun_view.has_rerun() if rerun is None else rerun, figures=figures
    )
    show_run(report, folder)
    if spawn:
        rerun_view.spawn(recording, running.setup.plant, title=loaded.title, obstacles=running.setup.obstacles)
    if running.cell.failure is not None:
        raise SimulationError(f"{running.cell.failure}; what came before it is in {folder}")


def _list_scenarios() -> None:
    from ur5_twin.scenario import load_scenario, scenario_names

    names = scenario_names()
    width = max(map(len, names))
    for name in names:
        print(f"{name:<{width}}  {load_scenario(name).title}")


@app.command(epilog=_MODEL_EXAMPLES)
def model(
    name: Annotated[
        str, typer.Argument(autocompletion=complete_models, help="A model that ships, or the path of a TOML file.")
    ] = "plant",
    tool: Annotated[
        str, typer.Option(autocompletion=complete_tools, help="Tool at the flange: a name or a TOML.")
    ] = "none",
    export: Annotated[Path | None, typer.Option(help="Write the model as MJCF to this file.")] = None,
    scene: Annotated[bool, typer.Option("--scene", help="With --export or --view: put it on its stand, lit.")] = False,
    view: Annotated[bool, typer.Option("--view", help="Show it in MuJoCo's viewer.")] = False,
) -> None:
    """Print an arm's masses, centres, inertias and their sources; export it as MJCF; show it."""
    from ur5_twin.arm import describe
    from ur5_twin.arm.parameters import load_model

    arm = load_model(name, tool)
    if export is not None:
        from ur5_twin.arm import mjcf

        mjcf.export(arm, export, scene=scene)
        print(f"wrote {export}")
    elif not view:
        print(describe.render_markdown(arm))
    if view:
        _view(arm, scene)


app.add_typer(identify.app, name="identify")
app.command(epilog=estimate.EXAMPLES)(estimate.estimate)
app.command(epilog=benchmark.EXAMPLES)(benchmark.benchmark)
app.command(epilog=live.EXAMPLES)(live.live)
app.command(epilog=record.EXAMPLES)(record.record)
app.command(epilog=serve.EXAMPLES)(serve.serve)


@app.command()
def fetch(
    name: Annotated[str, typer.Argument(help="Which public logs.")] = "kufieta2014",
    source: Annotated[
        str | None, typer.Option("--from", help="Another git URL, a local clone, or a folder that holds the logs.")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to put them in.", callback=writable)] = Path(
        "lab_logs"
    ),
) -> None:
    """Fetch public logs of a real UR5, at a pinned commit, and check every file."""
    from ur5_twin.fetch import fetch as run

    with progress("check", None) as advance:
        folder = run(name, source=source, out=out, progress=advance)
    first = next(iter(sorted(p for p in folder.iterdir() if p.is_dir())))
    print(f"the logs lie in {folder}\nnext: ur5-twin replay {first} --rerun")


def _view(arm: ArmModel, scene: bool) -> None:
    import mujoco.viewer

    from ur5_twin.arm import mjcf

    mujoco.viewer.launch(mjcf.compile(arm, scene=scene))
