"""What the command line shows: progress and tables. Rich is imported where something is shown."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ur5_twin.live.session import Status
    from ur5_twin.live.test_stand import DeviceStatus
    from ur5_twin.recording.table import Note, Recording
    from ur5_twin.wire.server import Statistics


@contextmanager
def progress(label: str, total: int | None) -> Iterator[Callable[..., None]]:
    """A progress bar on stderr, shown if that is a terminal.

    Gives a function to call with the number done, and with of how many if that was not known before.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as shown:
        task = shown.add_task(label, total=total)
        yield lambda done, of=total: shown.update(task, completed=done, total=of)


@contextmanager
def _line(waiting: str, said: Sequence[str]) -> Iterator[Callable[[str, Sequence[str]], None]]:
    """A line on stderr that is written anew, if that is a terminal; what is said before and meanwhile is printed in
    any case.

    Gives a function to call with the line and with what has happened since.
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.status import Status as Line

    console = Console(stderr=True)

    def say(words: Sequence[str]) -> None:
        for what in words:
            console.print(what, highlight=False, markup=False, soft_wrap=True)

    say(said)
    line = Line(waiting, console=console, spinner="line")
    if console.is_terminal:
        line.start()

    def tell(words: str, news: Sequence[str]) -> None:
        say([f"- {what}" for what in news])
        line.update(escape(words))

    try:
        yield tell
    finally:
        line.stop()


@contextmanager
def live_line(title: str, estimator: str | None) -> Iterator[Callable[[Status, list[str]], None]]:
    """A status line of a live run on stderr, if that is a terminal; what happens is printed in any case.

    Gives a function to call with how it goes and what has happened since.
    """
    with _line("waiting for rows", [f"{title}; Ctrl-C stops"]) as tell:
        yield lambda status, news: tell(live_words(status, estimator), news)


def live_words(status: Status, estimator: str | None) -> str:
    """How a live run goes: rate, what is wrong with the rows, the estimate with its 90 % interval, the twin's error."""
    from ur5_twin.evaluation.scores import NINETY

    counts = status.counts
    said = [f"{status.rate:.0f} Hz", f"{counts.rows:,} rows", f"lost {counts.lost}", f"late {counts.late}"]
    beside = {"repeated": counts.repeated, "broken": counts.broken, "jumps": counts.jumps, "silences": counts.silences}
    said += [f"{what} {count}" for what, count in beside.items() if count]
    if status.wrench is not None and status.deviation is not None:
        width = NINETY * status.deviation
        force = " ".join(f"{value:+.1f}\u00b1{wide:.1f}" for value, wide in zip(status.wrench[:3], width, strict=False))
        said.append(f"{estimator} [{force}] N")
    if status.error is not None:
        said.append(f"twin off by {1e3 * float(status.error.max()):.2f} mrad")
    if status.latency[0] == status.latency[0]:
        said.append(f"{1e3 * status.latency[0]:.0f} ms behind")
    return ", ".join(said)


def show_live(status: Status, notes: Sequence[Note], folder: Path | None) -> None:
    """What a live run has seen, and where it is."""
    from rich.console import Console

    console = Console()
    said = [live_words(status, "last estimate"), *(f"- {note.what}" for note in notes)]
    if folder is not None:
        said.append(f"written to {folder}")
    for line in said:
        console.print(line, highlight=False, markup=False, soft_wrap=True)


@contextmanager
def record_line(
    devices: Sequence[str], folder: Path
) -> Iterator[Callable[[Sequence[DeviceStatus], Sequence[str]], None]]:
    """A status line of a recording on stderr, if that is a terminal; what happens is printed in any case.

    Gives a function to call with how each device goes and what has happened since.
    """
    with _line("waiting for rows", [*devices, f"recording into {folder}; Ctrl-C stops"]) as tell:
        yield lambda status, news: tell(record_words(status), news)


def record_words(status: Sequence[DeviceStatus]) -> str:
    """How a recording goes: each device's rate and rows, and what is wrong with them."""
    said = []
    for one in status:
        words = f"{one.device} {one.rate:.0f} Hz, {one.rows:,} rows, lost {one.lost}"
        if one.disturbed:
            words += f", disturbed {one.disturbed}"
        said.append(words if one.connected else f"{words}, NOT CONNECTED")
    return " | ".join(said)


def show_recorded(recording: Recording, folder: Path) -> None:
    """What was recorded, and where it is."""
    from rich.console import Console

    console = Console()
    said = []
    for device, table in recording.tables.items():
        span = float(table.time[-1] - table.time[0])
        rate = f" at {(len(table) - 1) / span:.1f} Hz" if span > 0.0 else ""
        said.append(f"{device}: {len(table):,} rows in {span:.1f} s{rate}")
    said += [f"- {note}" for note in recording.notes]
    for line in (*said, f"written to {folder}"):
        console.print(line, highlight=False, markup=False, soft_wrap=True)


@contextmanager
def serve_line() -> Iterator[Callable[[Statistics, float, str], None]]:
    """A status line of a served controller on stderr, if that is a terminal.

    Gives a function to call with the server's statistics, ticks a second, and what the controller does.
    """
    with _line("the controller ticks", []) as tell:
        yield lambda statistics, rate, doing: tell(serve_words(statistics, rate, doing), [])


def serve_words(statistics: Statistics, rate: float, doing: str) -> str:
    """How a served controller goes: ticks, those that came late, packages that were left out, clients by port."""
    said = [doing, f"{rate:.0f} ticks/s", f"behind {statistics.behind}"]
    if statistics.packages_dropped or statistics.not_published:
        said.append(f"packages left out {statistics.packages_dropped + statistics.not_published}")
    clients = " ".join(f"{name} {count}" for name, count in statistics.clients.items() if count)
    return ", ".join([*said, f"clients: {clients or 'none'}"])


def show_run(report: dict[str, Any], folder: Path) -> None:
    """What happened in a run of a scenario, how well the devices tell the truth, and where the rest is."""
    from rich.console import Console

    from ur5_twin.evaluation.reporting import short_number

    lines = [
        f"{report['title']}: {report['description']}",
        f"{report['samples']:,} samples in {report['duration_s']:.1f} s, seed {report['seed']}",
    ]
    lines += [f"- {said}" for said in (report["ending"]["stop_reason"], report["ending"]["failure"]) if said]
    for touch in report["contact"]["touches"]:
        lines.append(
            f"- {touch['obstacle']} on {touch['link']}: up to {short_number(touch['largest_force_n'])} N, "
            f"{touch['duration_s']:.2f} s"
        )
    for who, label in (("sensor", "the force sensor"), ("controller", "the controller's own estimate")):
        errors = report["wrench"][who]["overall"]
        if errors is not None:
            force, moment = (", ".join(map(short_number, errors[key])) for key in ("force_mae_n", "moment_mae_nm"))
            lines.append(f"- {label} is off the truth by [{force}] N and [{moment}] Nm (MAE)")
    console = Console()
    for line in (*lines, f"written to {folder}"):
        console.print(line, highlight=False, markup=False)


def show_replay(report: dict[str, Any], folder: Path) -> None:
    """The table of a replay's report, what was found in the log, and where the rest is."""
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    from ur5_twin.arm.parameters import N_JOINTS
    from ur5_twin.evaluation.replay_report import short_number, table_rows

    table = Table(box=SIMPLE, padding=(0, 1), pad_edge=False)
    table.add_column("MAE per joint", no_wrap=True)
    for joint in range(1, N_JOINTS + 1):
        table.add_column(f"{joint}", justify="right", no_wrap=True)
    for label, unit, values in table_rows(report):
        table.add_row(f"{label}, {unit}", *map(short_number, values))
    console = Console()
    console.print(
        f"{report['source']}: {report['mode']} replay with model {report['model']}, gains {report['gains']}, "
        f"{report['samples']:,} samples in {report['duration_s']:.1f} s",
        highlight=False,
        markup=False,
    )
    console.print(table)
    for item in (*report["notes"], *report["repairs"]):
        console.print(f"- {item['where']}: {item['what']}", highlight=False, markup=False)
    console.print(f"written to {folder}", highlight=False, markup=False)


def show_estimates(report: dict[str, Any], folder: Path) -> None:
    """The errors of each estimator, and where the rest is."""
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    from ur5_twin.evaluation.estimate_report import estimate_rows
    from ur5_twin.spatial import WRENCH_AXES

    compared = report["against"] is not None
    title = f"MAE against {report['against']}" if compared else "99th percentile"
    table = Table(box=SIMPLE, padding=(0, 1), pad_edge=False)
    table.add_column(f"{title}, N and Nm", no_wrap=True)
    for axis in WRENCH_AXES:
        table.add_column(axis, justify="right", no_wrap=True)
    for row in estimate_rows(report, "mae" if compared else "percentile_99"):
        table.add_row(*row)
    console = Console()
    console.print(f"{report['source']}: {report['rows']:,} rows", highlight=False, markup=False)
    console.print(table)
    console.print(f"written to {folder}", highlight=False, markup=False)


def show_benchmark(board: dict[str, Any], folder: Path) -> None:
    """The order of the estimators at each level, and where the rest is."""
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table

    from ur5_twin.evaluation.reporting import short_number

    console = Console()
    for level, found in board["levels"].items():
        table = Table(box=SIMPLE, padding=(0, 1), pad_edge=False)
        table.add_column(f"level {level}", no_wrap=True)
        for head in ("error N", "force N", "Nm", "found", "missed", "false/h"):
            table.add_column(head, justify="right", no_wrap=True)
        for name in found["ranking"]:
            item = found["estimators"][name]
            hits, mae = item["detection"], item["mae"]
            errors = [] if mae is None else [item["error_n"], sum(mae[:3]) / 3, sum(mae[3:]) / 3]
            hourly = hits["false_alarms_per_hour"]
            table.add_row(
                name,
                *(map(short_number, errors) if errors else ["-"] * 3),
                f"{hits['found']}/{hits['touches']}",
                str(hits["missed"]),
                "-" if hourly is None else f"{hourly:.0f}",
            )
        console.print(table)
    for item in board["failed"]:
        line = f"- {item['scenario']}, {item['level']}, seed {item['seed']}: {item['failure']}"
        console.print(line, highlight=False, markup=False)
    for name, value in board.get("lab", {}).get("kendall_tau", {}).items():
        console.print(f"- order on the real logs and {name}: Kendall's tau {value:.2f}", highlight=False, markup=False)
    console.print(f"written to {folder}", highlight=False, markup=False)
