"""The time series of the Rerun view and the layout of its window.

All signals are columns of three entities, ``signals``, ``wrench`` and ``contact``, a struct of the six joints or axes
each: that is a tenth of the bytes that an entity per line would take. Each plot picks its lines out of them. What is
so or is not, a contact or a protective stop, is a lane of ``state``.
Needs ``rerun``; import it through ``rerun_view``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from ur5_twin.arm.parameters import JOINT_NAMES
from ur5_twin.evaluation import contacts
from ur5_twin.evaluation.contacts import Touch
from ur5_twin.evaluation.run_report import PROTECTIVE_STOP
from ur5_twin.recording.table import Table
from ur5_twin.spatial import WRENCH_AXES, WRENCH_UNITS
from ur5_twin.views import rerun_scene as scene
from ur5_twin.views.style import CONTACTS, PUSHES, QUANTITIES, STOPPED, Quantity, has, rgb
from ur5_twin.views.wrenches import Wrench

SIGNALS = "signals"
WRENCH = "wrench"
CONTACT = "contact"
STATE = "state"
#: The part of a wrench that is the size of its force.
SIZE = "F"
_PARTS = {SIGNALS: JOINT_NAMES, WRENCH: (*WRENCH_AXES, SIZE), CONTACT: (SIZE, *WRENCH_AXES[:3])}
#: The parts whose plot has a legend: the first of each column of plots; in the others it would hide the lines.
_WITH_LEGEND = (JOINT_NAMES[0], WRENCH_AXES[0], WRENCH_AXES[3], SIZE)
#: While no protective stop holds the arm.
_RUNS = "#3c5a78"
#: What the columns are grouped under in the viewer.
_ARCHETYPE = "ur5"


class _Axes(NamedTuple):
    """The axes of all plots: the time they show, and whether that is all there will be, so that limits are known."""

    time: rrb.TimeAxis
    whole: bool


@dataclass(frozen=True)
class _Line:
    """One line of each plot of a page.

    Attributes:
        component: the column it is sent as.
        values: (n, parts) what is sent, for the limits of the plots.
    """

    component: str
    values: np.ndarray
    label: str
    colour: str
    width: float


def log_signals(stream: rr.RecordingStream, table: Table, ticks: np.ndarray) -> None:
    """Send every series at the robot's full rate under its column's name, and the differences with their unit in it."""
    columns = {}
    for quantity in QUANTITIES:
        columns |= {item.column: table[item.column] for item in quantity.series_in(table)}
        errors = quantity.differences_in(table)
        columns |= {quantity.error_name(item): quantity.error(item, table) for item in errors}
    _send(stream, SIGNALS, columns, table, ticks)


def log_wrenches(stream: rr.RecordingStream, wrenches: Sequence[Wrench], table: Table, ticks: np.ndarray) -> None:
    """Send every wrench, in base axes at the flange, and the size of its force."""
    _send(stream, WRENCH, {wrench.key: _with_size(wrench) for wrench in wrenches}, table, ticks)


def log_contacts(
    stream: rr.RecordingStream, touched: Sequence[Touch], obstacles: Sequence[str], table: Table, ticks: np.ndarray
) -> None:
    """Send the force of each link on each obstacle, and of pushes, while any acts and beside that."""
    if not touched or not len(table):
        return
    n = len(table)
    active = contacts.acting(touched, n)
    # A row of zeros before and after: a line is drawn from one row to the next.
    beside = active | np.append(active[1:], True) | np.append(True, active[:-1])
    rows = np.flatnonzero(beside)
    columns = {_touch_key(touch, obstacles): _force(touch, n)[rows] for touch in touched}
    _send(stream, CONTACT, columns, Table(table.device, table.time[rows], {}), ticks[rows])


def log_states(
    stream: rr.RecordingStream, touched: Sequence[Touch], obstacles: Sequence[str], table: Table, ticks: np.ndarray
) -> None:
    """Send when each link touches each obstacle, when it is pushed, and when a protective stop holds the arm."""
    if not len(table):
        return
    for touch, colour in zip(touched, _touch_colours(touched), strict=True):
        state = "pushed" if touch.is_push else "touches"
        changes: dict[int, str | None] = {0: None}
        for rows in touch.episodes():
            changes[int(rows[0])] = state
            if rows[-1] + 1 < len(table):
                changes[int(rows[-1]) + 1] = None
        _send_states(stream, _touch_key(touch, obstacles), changes, {state: colour}, table, ticks)
    if has(table, "safety_mode"):
        stopped = table["safety_mode"][:, 0] == PROTECTIVE_STOP
        at = np.flatnonzero(np.diff(stopped, prepend=~stopped[:1]))
        words: dict[int, str | None] = {int(row): "protective stop" if stopped[row] else "runs" for row in at}
        _send_states(stream, "controller", words, {"runs": _RUNS, "protective stop": STOPPED}, table, ticks)


def _send_states(
    stream: rr.RecordingStream,
    lane: str,
    changes: dict[int, str | None],
    colours: dict[str, str],
    table: Table,
    ticks: np.ndarray,
) -> None:
    rows = sorted(changes)
    style = rr.StateConfiguration(values=list(colours), colors=[rgb(colour) for colour in colours.values()])
    stream.log(f"{STATE}/{lane}", style, static=True)
    columns = rr.StateChange.columns(state=pa.array([changes[row] for row in rows], pa.utf8()))
    stream.send_columns(f"{STATE}/{lane}", scene.indexes(table.time[rows], ticks[rows]), columns, strict=True)


def blueprint(
    table: Table,
    wrenches: Sequence[Wrench],
    stage: scene.Stage,
    touched: Sequence[Touch] = (),
    obstacles: Sequence[str] = (),
) -> rrb.Blueprint:
    """The window: the arms, the size of the force and states on the left; on the right a tab per quantity."""
    axes = _Axes(_time_axis(table.time), whole=True)
    tabs: list[rrb.Container] = [
        tab for quantity in QUANTITIES if (tab := _joint_tab(quantity, table, axes)) is not None
    ]
    left: list[rrb.View] = [_space(stage, len(scene.arms_in(table)))]
    shares = [3.0]
    if wrenches:
        lines = [_Line(item.key, _with_size(item), item.label, item.colour, 1.6) for item in wrenches]
        tabs.append(_wrench_tab(lines, axes))
        left.append(_view("Size of the force on the arm, N", WRENCH, SIZE, lines, axes))
        shares.append(1.0)
    if touched:
        tabs.append(_contact_tab(touched, len(table), obstacles, axes))
    lanes = len(touched) + has(table, "safety_mode")
    if lanes:
        left.append(
            rrb.StateTimelineView(origin=STATE, name="Contacts, pushes and the controller", time_view=axes.time)
        )
        shares.append(min(1.6, 0.32 + 0.24 * lanes))
    return _window(left, shares, tabs, rrb.TimePanel(state="collapsed", timeline="time", loop_mode="all"))


def live_blueprint(
    table: Table, wrenches: Sequence[Wrench], bands: Sequence[Wrench], stage: scene.Stage, seconds: float
) -> rrb.Blueprint:
    """The window beside a running robot: as for a recording, but it shows the last seconds and goes with them.

    Args:
        table: some rows, for the columns that there are.
        wrenches: the wrenches that there are.
        bands: lower and upper ends of intervals, thin lines in the plots of the wrench's axes.
        stage: as for a recording.
        seconds: how much of the past the plots show, s.
    """
    past = rr.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-seconds), end=rr.TimeRangeBoundary.cursor_relative()
    )
    axes = _Axes(rrb.TimeAxis(link=rrb.components.LinkAxis.Independent, view_range=past), whole=False)
    left: list[rrb.View] = [_space(stage, len(scene.arms_in(table)))]
    tabs: list[rrb.Container] = []
    if wrenches:
        lines = [_Line(item.key, _with_size(item), item.label, item.colour, 1.6) for item in wrenches]
        ends = [_Line(item.key, _with_size(item), item.label, item.colour, 0.7) for item in bands]
        tabs.append(_wrench_tab([*ends, *lines], axes))
        left.append(_view("Size of the force on the arm, N", WRENCH, SIZE, lines, axes))
    tabs += [tab for quantity in QUANTITIES if (tab := _joint_tab(quantity, table, axes)) is not None]
    panel = rrb.TimePanel(state="collapsed", timeline="time", play_state="following")
    return _window(left, [3.0, 1.0][: len(left)], tabs, panel)


def _window(
    left: Sequence[rrb.View], shares: Sequence[float], tabs: Sequence[rrb.Container], panel: rrb.TimePanel
) -> rrb.Blueprint:
    window = rrb.Horizontal(
        rrb.Vertical(*left, row_shares=list(shares)),
        *([rrb.Tabs(*tabs, active_tab=0)] if tabs else []),
        column_shares=[1.0, 1.15] if tabs else [1.0],
    )
    return rrb.Blueprint(
        window,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        panel,
        auto_layout=False,
        auto_views=False,
    )


def _space(stage: scene.Stage, arms: int) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin=scene.ROOT,
        name="Twin and measured arm" if arms > 1 else "The arm",
        background=rrb.Background(kind="SolidColor", color=[27, 30, 36]),
        line_grid=rrb.LineGrid3D(
            visible=True,
            spacing=0.25,
            plane=rr.components.Plane3D.XY.with_distance(scene.FLOOR_Z),
            stroke_width=1.0,
            color=[255, 255, 255, 14],
        ),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=stage.eye, look_target=stage.target, eye_up=(0.0, 0.0, 1.0)
        ),
    )


def _joint_tab(quantity: Quantity, table: Table, axes: _Axes) -> rrb.Horizontal | None:
    """A row per joint: the signal on the left, the differences of its lines on the right, as in the figures."""
    widths = (1.2, 1.4, 1.4, 1.4) if quantity.noisy else (4.0, 2.4, 1.2, 1.2, 1.2)
    series = quantity.series_in(table)
    if len(series) == 1:
        widths = (1.6,)
    signals = [
        _Line(item.column, table[item.column], item.label, item.colour, width)
        for item, width in zip(series, widths, strict=False)
    ]
    errors = [
        _Line(quantity.error_name(item), quantity.error(item, table), item.label, item.colour, 1.2)
        for item in quantity.differences_in(table)[::-1]  # the twin's own above the others
    ]
    columns = [
        rrb.Vertical(*(_view(f"{joint}, {unit}", SIGNALS, joint, lines, axes) for joint in JOINT_NAMES))
        for lines, unit in ((signals, quantity.unit), (errors, f"error, {quantity.error_unit}"))
        if lines
    ]
    return rrb.Horizontal(*columns, name=quantity.key.replace("_", " ").capitalize()) if columns else None


def _wrench_tab(lines: Sequence[_Line], axes: _Axes) -> rrb.Horizontal:
    rows = [
        _view(f"{name}, {unit}", WRENCH, name, lines, axes)
        for name, unit in zip(WRENCH_AXES, WRENCH_UNITS, strict=True)
    ]
    return rrb.Horizontal(rrb.Vertical(*rows[:3]), rrb.Vertical(*rows[3:]), name="Wrench")


def _contact_tab(touched: Sequence[Touch], n: int, obstacles: Sequence[str], axes: _Axes) -> rrb.Vertical:
    """A row for the size of the force and one per base axis; a line per link and obstacle."""
    lines = [
        _Line(_touch_key(touch, obstacles), _force(touch, n), touch.name(obstacles), colour, 1.6)
        for touch, colour in zip(touched, _touch_colours(touched), strict=True)
    ]
    rows = [
        _view(f"{'size of the force' if part == SIZE else part}, N", CONTACT, part, lines, axes)
        for part in _PARTS[CONTACT]
    ]
    return rrb.Vertical(*rows, name="Contact")


def _touch_key(touch: Touch, obstacles: Sequence[str]) -> str:
    return touch.name(obstacles).replace(" ", "_")


def _touch_colours(touched: Sequence[Touch]) -> list[str]:
    """A colour for each; they repeat where there are more pairs than colours."""
    met = {False: 0, True: 0}
    found = []
    for touch in touched:
        family = PUSHES if touch.is_push else CONTACTS
        found.append(family[met[touch.is_push] % len(family)])
        met[touch.is_push] += 1
    return found


def _force(touch: Touch, n: int) -> np.ndarray:
    """(n, 4) size and axes of its force at each row, N; 0 where it does not act."""
    force = np.zeros((n, 4))
    force[touch.rows] = np.column_stack([touch.size, touch.force])
    return force


def _view(title: str, entity: str, part: str, lines: Sequence[_Line], axes: _Axes) -> rrb.TimeSeriesView:
    """One plot: the same part, a joint or an axis, of several columns of an entity."""
    limits = None
    if axes.whole:
        limits = rrb.ScalarAxis(range=_limits([line.values[:, _PARTS[entity].index(part)] for line in lines]))
    return rrb.TimeSeriesView(
        origin=entity,
        contents=[f"/{entity}"],
        name=title,
        axis_x=axes.time,
        axis_y=limits,
        plot_legend=rrb.PlotLegend(visible=part in _WITH_LEGEND, corner=rrb.Corner2D.LeftTop),
        overrides={entity: [_picked(line, part) for line in lines]},
    )


def _picked(line: _Line, part: str) -> rrb.Visualizer:
    mapping = VisualizerComponentMapping(
        target="Scalars:scalars",
        source_kind=ComponentSourceKind.SourceComponent,
        source_component=f"{_ARCHETYPE}:{line.component}",
        selector=f".{part}",
    )
    return rr.SeriesLines(names=line.label, colors=rgb(line.colour), widths=line.width).visualizer(mappings=[mapping])


def _time_axis(time: np.ndarray) -> rrb.TimeAxis:
    """All of the recording. Linked axes would show half a minute around the cursor instead."""
    start, end = (rrb.TimeRangeBoundary.absolute(seconds=float(time[row])) for row in (0, -1))
    return rrb.TimeAxis(link=rrb.components.LinkAxis.Independent, view_range=rr.TimeRange(start=start, end=end))


def _limits(values: Sequence[np.ndarray]) -> tuple[float, float]:
    """What holds all lines with some room; not less than 2e-3, so that standing still looks like it."""
    known = [line[np.isfinite(line)] for line in values]
    low, high = (float(f([f(line) for line in known if len(line)] or [0.0])) for f in (np.min, np.max))
    room = max(0.06 * (high - low), 1e-3)
    return low - room, high + room


def _with_size(wrench: Wrench) -> np.ndarray:
    return np.column_stack([wrench.values, np.linalg.norm(wrench.values[:, :3], axis=1)])


def _send(
    stream: rr.RecordingStream, entity: str, columns: dict[str, np.ndarray], table: Table, ticks: np.ndarray
) -> None:
    if columns and len(table):
        structs = {name: _struct(values, _PARTS[entity]) for name, values in columns.items()}
        sent = rr.DynamicArchetype.columns(archetype=_ARCHETYPE, components=structs)
        stream.send_columns(entity, scene.indexes(table.time, ticks), sent, strict=True)


def _struct(values: np.ndarray, names: Sequence[str]) -> pa.StructArray:
    # Single precision: a tenth of a microradian, and half the bytes.
    return pa.StructArray.from_arrays([pa.array(column) for column in values.T.astype(np.float32)], names=list(names))
