"""The .rrd file, read back: entities, timelines, rows, poses, arrows and a layout that finds its columns."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pytest

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.arm.parameters import JOINT_NAMES, ArmModel, load_model
from ur5_twin.errors import MissingExtraError
from ur5_twin.recording import Recording, Table, force_sensor
from ur5_twin.views import rerun_view

rr = pytest.importorskip("rerun", reason="the extra 'view' is not installed")
chunk = pytest.importorskip("rerun.chunk")

Batches = dict[str, pa.Table]


def _read(path: Path, kind: str = "recording") -> Batches:
    """Everything in a file, by entity."""
    reader = chunk.RrdReader(path)
    (store,) = reader.recordings() if kind == "recording" else reader.blueprints()
    found: dict[str, list[pa.RecordBatch]] = {}
    for piece in reader.stream(store=store):
        found.setdefault(piece.entity_path, []).append(piece.to_record_batch())
    return {
        path: pa.Table.from_batches(batches)
        if len({b.schema for b in batches}) == 1
        else pa.concat_tables([pa.Table.from_batches([b]) for b in batches], promote_options="default")
        for path, batches in found.items()
    }


def _nanoseconds(table: pa.Table) -> np.ndarray:
    return np.asarray(table["time"].cast(pa.int64()))


def _flat(table: pa.Table, column: str) -> np.ndarray:
    """A column of one value a row, without the list around each, as an array."""
    values = table[column].combine_chunks().flatten()
    while pa.types.is_fixed_size_list(values.type):
        width, values = values.type.list_size, values.flatten()
        return np.asarray(values).reshape(-1, width)
    return np.asarray(values)


def _joints(table: pa.Table, column: str) -> np.ndarray:
    struct = table[f"ur5:{column}"].combine_chunks().flatten()
    return np.stack([np.asarray(struct.field(name)) for name in JOINT_NAMES], axis=1)


def _data(table: pa.Table) -> dict[str, str]:
    """What was sent over time, in its order and as text, in which a NaN equals a NaN; or what is static."""
    kept = [name for name in table.column_names if not name.startswith(("rerun.", "log_"))]
    if "tick" in kept:
        table = table.filter(pc.is_valid(table["tick"])).sort_by("tick")
        table = table.set_column(table.column_names.index("time"), "time", table["time"].cast("int64"))
    return {name: repr(table[name].to_pylist()) for name in kept}


@pytest.fixture(scope="module")
def written(replayed: Recording, model: ArmModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return rerun_view.write_rrd(replayed, model, tmp_path_factory.mktemp("rrd") / "twin.rrd", title="made")


@pytest.fixture(scope="module")
def content(written: Path) -> Batches:
    return _read(written)


def test_entities(content: Batches) -> None:
    links = {f"/scene/{arm}/link_{i}" for arm in ("twin", "measured") for i in range(1, 7)}
    shapes = {f"{link}/body" for link in links} | {f"/scene/{arm}/link_6/tool" for arm in ("twin", "measured")}
    forces = {f"/scene/measured/force/{key}" for key in ("controller", "sensor", "truth_wrench")}
    paths = {"/scene/twin/path", "/scene/measured/path"}
    assert links | shapes | forces | paths | {"/signals", "/wrench"} <= set(content)


def test_signals_at_full_rate_on_both_timelines(content: Batches, replayed: Recording) -> None:
    signals, robot = content["/signals"], replayed.robot
    np.testing.assert_allclose(_nanoseconds(signals), robot.time * 1e9, atol=1.0)
    np.testing.assert_array_equal(np.asarray(signals["tick"]), np.arange(len(robot)))
    for name in ("actual_q", "target_q", "sim_actual_q", "actual_qd", "target_moment", "sim_moment", "actual_current"):
        # Single precision.
        np.testing.assert_allclose(_joints(signals, name), robot[name], rtol=1e-6, atol=1e-7)
    error = (robot["actual_q"] - robot["sim_actual_q"]) * 1e3
    np.testing.assert_allclose(_joints(signals, "actual_q_minus_sim_actual_q_mrad"), error, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(("arm", "column"), [("twin", "sim_actual_q"), ("measured", "actual_q")])
def test_poses_are_the_kinematics(
    content: Batches, replayed: Recording, model: ArmModel, arm: str, column: str
) -> None:
    robot = replayed.robot
    for i in range(1, 7):
        table = content[f"/scene/{arm}/link_{i}"]
        rows = np.asarray(table["tick"])
        np.testing.assert_array_equal(rows, np.arange(0, len(robot), 5))  # 25 Hz of 125
        np.testing.assert_allclose(_nanoseconds(table), robot.time[rows] * 1e9, atol=1.0)
        X = kinematics.link_frames(model, robot[column][rows])[:, i]
        # Single precision: 6e-8 of a metre, and of a quaternion.
        np.testing.assert_allclose(_flat(table, "Transform3D:translation"), X[:, :3, 3], atol=2e-7)
        x, y, z, w = _flat(table, "Transform3D:quaternion").astype(float).T
        vector = 2 * np.arctan2(np.linalg.norm([x, y, z], axis=0), w) / np.linalg.norm([x, y, z], axis=0)
        R = spatial.rotation_from_vector(np.stack([x, y, z], axis=1) * vector[:, None])
        np.testing.assert_allclose(R, X[:, :3, :3], atol=1e-6)


def test_shapes_are_the_model_s_cylinders(content: Batches, model: ArmModel) -> None:
    for i, link in enumerate(model.links, start=1):
        body = content[f"/scene/twin/link_{i}/body"]
        lengths, radii = (_flat(body, f"Cylinders3D:{name}") for name in ("lengths", "radii"))
        np.testing.assert_allclose(lengths, [part.height for part in link.cylinders], rtol=1e-6)
        np.testing.assert_allclose(radii, [part.radius for part in link.cylinders], rtol=1e-6)


def test_arrows_only_where_there_is_a_force(
    content: Batches, replayed: Recording, push: Callable[[np.ndarray], np.ndarray]
) -> None:
    from ur5_twin.views.rerun_scene import ARROW_SCALE

    arrows = content["/scene/measured/force/truth_wrench"]
    moving = arrows.filter(pc.is_valid(arrows["tick"]))
    force = push(replayed.robot.time[np.asarray(moving["tick"])])[:, :3]
    shown = np.linalg.norm(force, axis=1) >= 3.0
    drawn = np.asarray([len(vectors) for vectors in moving["Arrows3D:vectors"].to_pylist()])
    np.testing.assert_array_equal(drawn, shown.astype(int))
    assert 10 < shown.sum() < len(shown)
    np.testing.assert_allclose(_flat(moving, "Arrows3D:vectors"), force[shown] * ARROW_SCALE, rtol=1e-5, atol=1e-6)


def test_the_layout_only_asks_for_columns_that_are_there(content: Batches, written: Path) -> None:
    asked: set[str] = set()
    views = set()
    for path, table in _read(written, "blueprint").items():
        if "/visualizers/" in path:
            entity = path.split("/overrides/")[1].split("/")[0]
            maps = (m for row in table["VisualizerInstruction:component_map"].to_pylist() for m in row or ())
            asked |= {f"{entity} {mapping['source_component']}" for mapping in maps}
        if path.startswith("/view/"):
            views.add(path.split("/")[2])
    there = {f"{entity} {name}" for entity in ("signals", "wrench") for name in content[f"/{entity}"].column_names}
    assert len(views) == 1 + 1 + 4 * 12 + 6  # arms, force, four quantities of six joints twice, six parts of a wrench
    assert len(asked) == 13 + 9 + 3
    assert asked <= there


def test_pieces_are_the_whole(replayed: Recording, model: ArmModel, content: Batches, tmp_path: Path) -> None:
    stream = rerun_view.new_stream(replayed, "pieces")
    stream.save(tmp_path / "pieces.rrd")
    rerun_view.log_static(stream, replayed, model, rerun_view.new_stage(replayed, model))
    bias = force_sensor.sensor_bias(replayed)
    for start, end in ((0, 250), (250, 500)):
        piece = Recording({**replayed.tables, "robot": _rows(replayed.robot, start, end)}, "made", "test")
        rerun_view.log_rows(stream, piece, model, first_tick=start, sensor_bias=bias)
    stream.disconnect()
    pieces = _read(tmp_path / "pieces.rrd")
    for entity in ("/signals", "/wrench", "/scene/twin/link_6", "/scene/measured/force/sensor"):
        assert _data(pieces[entity]) == _data(content[entity]), entity


@pytest.mark.parametrize(
    ("columns", "arms"),
    [
        ((), set()),
        (("actual_q",), {"measured"}),
        (("sim_actual_q",), {"twin"}),
        (("actual_q", "sim_actual_q"), {"measured", "twin"}),
    ],
)
def test_what_is_missing_is_left_out(
    replayed: Recording, columns: tuple[str, ...], arms: set[str], tmp_path: Path
) -> None:
    robot = replayed.robot
    part = Recording({"robot": Table("robot", robot.time, {n: robot[n] for n in columns})}, "part", "test")
    found = _read(rerun_view.write_rrd(part, load_model("a"), tmp_path / "part.rrd", title="part"))
    assert {path.split("/")[2] for path in found if path.startswith("/scene/")} == arms
    assert ("/signals" in found) == bool(columns)


def test_rows_without_a_pose_are_left_out(replayed: Recording, model: ArmModel, tmp_path: Path) -> None:
    robot = replayed.robot
    q = robot["actual_q"].copy()
    q[100:200, 3] = np.nan
    holed = replayed.with_table(robot.with_columns({"actual_q": q}))
    found = _read(rerun_view.write_rrd(holed, model, tmp_path / "holed.rrd", title="holed"))
    assert len(found["/scene/measured/link_1"]) == 80
    assert len(found["/scene/twin/link_1"]) == 100
    assert len(found["/signals"]) == 500


def test_equal_recordings_have_equal_ids_and_data(
    replayed: Recording, model: ArmModel, written: Path, content: Batches, tmp_path: Path
) -> None:
    again = rerun_view.write_rrd(replayed, model, tmp_path / "again.rrd", title="made")
    ids = [chunk.RrdReader(path).recordings()[0].recording_id for path in (written, again)]
    assert ids[0] == ids[1]
    other = replayed.with_table(replayed.robot.with_columns({"actual_q": replayed.robot["actual_q"] + 1e-9}))
    assert rerun_view.new_stream(other, "x").get_recording_id() != ids[0]
    second = _read(again)
    assert set(second) == set(content)
    for path, table in content.items():
        assert _data(second[path]) == _data(table), path


def test_an_overlaid_ghost_stands_where_the_twin_stands(replayed: Recording, model: ArmModel) -> None:
    assert not rerun_view.new_stage(replayed, model, overlaid=True).beside.any()
    beside = rerun_view.new_stage(replayed, model).beside
    assert np.linalg.norm(beside) > 0.8
    assert beside[2] == 0.0


def test_ten_minutes_stay_below_100_megabytes(model: ArmModel, tmp_path: Path) -> None:
    rows = 75_000
    rng = np.random.default_rng(3)
    names = [f"{who}_{what}" for who in ("actual", "target") for what in ("q", "qd", "current")] + ["target_moment"]
    names += [f"sim_{name}" for name in ("actual_q", "actual_qd", "actual_current", "target_current", "target_moment")]
    names += ["sim_moment", "actual_TCP_force"]
    # White noise, which no compression makes smaller.
    columns = {name: rng.normal(size=(rows, 6)) for name in names}
    ft = Table("ft", np.arange(rows) * 0.008, {"ft_wrench": 20.0 * rng.normal(size=(rows, 6))})
    long = Recording({"robot": Table("robot", np.arange(rows) * 0.008, columns), "ft": ft}, "long", "test")
    assert rerun_view.write_rrd(long, model, tmp_path / "long.rrd", title="long").stat().st_size < 100e6


def test_nothing_global_is_left(written: Path) -> None:
    assert written.exists()
    assert rr.get_global_data_recording() is None
    assert rr.get_thread_local_data_recording() is None


def test_spawn_opens_a_viewer_with_everything(
    replayed: Recording, model: ArmModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def to_file(stream: Any, *, default_blueprint: Any) -> None:
        stream.save(tmp_path / "spawned.rrd", default_blueprint=default_blueprint)

    monkeypatch.setattr(rr.RecordingStream, "spawn", to_file)
    rerun_view.spawn(replayed, model)
    assert len(_read(tmp_path / "spawned.rrd")["/signals"]) == len(replayed.robot)


def test_without_rerun_it_says_what_to_install(
    replayed: Recording, model: ArmModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rerun_view, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"ur5-twin\[view\]"):
        rerun_view.write_rrd(replayed, model, tmp_path / "none.rrd", title="none")
    assert list(tmp_path.iterdir()) == []


def test_importing_the_module_does_not_import_rerun() -> None:
    import subprocess

    code = "import sys; from ur5_twin.views import rerun_view, figures; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def _rows(table: Table, start: int, end: int) -> Table:
    columns = {name: values[start:end] for name, values in table.columns.items()}
    return Table(table.device, table.time[start:end], columns, table.host_start)
