"""Figures and viewer of a scenario's run: truth beside measured, forces at their points, obstacles in their place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from ur5_twin import spatial
from ur5_twin.arm import kinematics
from ur5_twin.arm.mjcf import Obstacle
from ur5_twin.arm.parameters import ArmModel
from ur5_twin.evaluation import contacts
from ur5_twin.recording import Recording, Table
from ur5_twin.views import figures, paper, rerun_view

rr = pytest.importorskip("rerun", reason="the extra 'view' is not installed")
chunk = pytest.importorskip("rerun.chunk")

Obstacles = tuple[Obstacle, ...]
Rows = list[tuple[int, dict[str, Any]]]


def _read(path: Path, kind: str = "recording") -> dict[str, Rows]:
    """What was sent to each entity: the tick, -1 for what is static, and the components of each row, nulls left out."""
    reader = chunk.RrdReader(path)
    (store,) = reader.recordings() if kind == "recording" else reader.blueprints()
    found: dict[str, Rows] = {}
    for piece in reader.stream(store=store):
        batch = piece.to_record_batch()
        # The host's clock, which Python's datetime cannot hold.
        kept = [name for name in batch.column_names if not pa.types.is_timestamp(batch.schema.field(name).type)]
        for row in batch.select(kept).to_pylist():
            values = {name: value for name, value in row.items() if value is not None}
            found.setdefault(piece.entity_path, []).append((values.get("tick", -1), values))
    return found


@pytest.fixture(scope="module")
def written(run: Recording, probe: ArmModel, obstacles: Obstacles, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.rrd"
    return rerun_view.write_rrd(run, probe, path, title="made", obstacles=obstacles)


@pytest.fixture(scope="module")
def content(written: Path) -> dict[str, Rows]:
    return _read(written)


@pytest.mark.parametrize(("key", "obstacle"), [("contact", 0), ("push", -1)])
def test_arrows_begin_at_the_points_and_are_as_long_as_the_forces(
    content: dict[str, Rows], run: Recording, key: str, obstacle: int
) -> None:
    table = run.tables["contact"]
    mine = table["contact_obstacle"][:, 0] == obstacle
    rows = sorted((row for row in content[f"/scene/measured/force/{key}"] if row[0] >= 0), key=lambda row: row[0])
    acting = [row for row in rows if row[1]["Arrows3D:vectors"]]
    np.testing.assert_array_equal([tick for tick, _ in acting], np.round(table.time[mine] / 0.008))
    # Single precision: 6e-8 of a metre.
    origins, vectors = (np.array([row[f"Arrows3D:{name}"][0] for _, row in acting]) for name in ("origins", "vectors"))
    np.testing.assert_allclose(origins, table["contact_point"][mine], atol=1e-7)
    np.testing.assert_allclose(vectors, 0.006 * table["contact_force"][mine], atol=1e-7)
    strongest = int(np.argmax(np.linalg.norm(vectors, axis=1)))
    assert acting[strongest][1]["Arrows3D:labels"] == [{0: "45 N", -1: "30 N"}[obstacle]]
    # None before it, and gone at the tick after it.
    assert [tick for tick, row in rows if not row["Arrows3D:vectors"]] == [0, acting[-1][0] + 1]


def test_two_contacts_of_one_tick_are_two_arrows(
    run: Recording, probe: ArmModel, obstacles: Obstacles, tmp_path: Path
) -> None:
    table = run.tables["contact"]
    first = {name: values[:1] for name, values in table.columns.items()}
    moved = {**first, "contact_point": first["contact_point"] + 0.1}
    both = {name: np.concatenate([first[name], moved[name]]) for name in first}
    twice = run.with_table(replace(table, time=table.time[[0, 0]], columns=both))
    path = rerun_view.write_rrd(twice, probe, tmp_path / "twice.rrd", title="twice", obstacles=obstacles)
    (drawn,) = [row for _, row in _read(path)["/scene/measured/force/contact"] if row.get("Arrows3D:vectors")]
    np.testing.assert_allclose(drawn["Arrows3D:origins"], both["contact_point"], atol=1e-7)


def test_at_the_flange_are_the_devices_and_not_the_truth(content: dict[str, Rows]) -> None:
    forces = {path.split("/")[-1] for path in content if path.startswith("/scene/measured/force/")}
    assert forces == {"sensor", "controller", "contact", "push"}


def test_obstacles_stand_in_their_place(content: dict[str, Rows], obstacles: Obstacles) -> None:
    for obstacle in obstacles:
        row = {
            name: value
            for _, values in content[f"/scene/measured/obstacles/{obstacle.name}"]
            for name, value in values.items()
        }
        np.testing.assert_allclose(row["Transform3D:translation"][0], obstacle.center(), atol=1e-7)
        np.testing.assert_allclose(np.reshape(row["Transform3D:mat3x3"][0], (3, 3)), np.eye(3), atol=1e-7)
        if obstacle.shape == "sphere":
            np.testing.assert_allclose(row["Ellipsoids3D:half_sizes"][0], np.repeat(obstacle.size, 3), rtol=1e-6)
        elif obstacle.shape == "cylinder":
            drawn = row["Cylinders3D:radii"][0], row["Cylinders3D:lengths"][0]
            np.testing.assert_allclose(drawn, obstacle.size, rtol=1e-6)
        else:
            np.testing.assert_allclose(row["Boxes3D:half_sizes"][0], obstacle.size / 2, rtol=1e-6)


def test_a_turned_wall_is_behind_its_face(run: Recording, probe: ArmModel, tmp_path: Path) -> None:
    turn = np.array([0.0, 0.0, np.pi / 2])
    wall = Obstacle("wall", "wall", np.array([0.4, 0.5, 0.2]), turn, np.array([0.1, 0.6, 0.8]), 1e4, 10.0, 0.2)
    path = rerun_view.write_rrd(run, probe, tmp_path / "wall.rrd", title="wall", obstacles=(wall,))
    row = {name: value for _, values in _read(path)["/scene/measured/obstacles/wall"] for name, value in values.items()}
    # Its face shows along B's y, so its middle is half its thickness behind that.
    np.testing.assert_allclose(row["Transform3D:translation"][0], [0.4, 0.45, 0.2], atol=1e-7)
    # Rerun keeps columns one after the other.
    R = np.reshape(row["Transform3D:mat3x3"][0], (3, 3)).T
    np.testing.assert_allclose(R, spatial.rotation_from_vector(turn), atol=1e-7)


def test_one_arm_is_solid_and_two_are_not(
    content: dict[str, Rows], run: Recording, probe: ArmModel, tmp_path: Path
) -> None:
    def opacity(found: dict[str, Rows]) -> set[int]:
        (row,) = found["/scene/measured/link_2/body"]
        return {colour & 0xFF for colour in row[1]["Cylinders3D:colors"]}

    assert opacity(content) == {255}
    assert "/scene/measured/name" not in content
    twin = run.with_table(run.robot.with_columns({"sim_actual_q": run.robot["actual_q"]}))
    two = _read(rerun_view.write_rrd(twin, probe, tmp_path / "two.rrd", title="two"))
    assert max(opacity(two)) < 128
    assert {"/scene/measured/name", "/scene/twin/name"} < set(two)
    assert not rerun_view.new_stage(run, probe).beside.any()


def test_the_ball_of_the_probe_is_drawn(content: dict[str, Rows], probe: ArmModel) -> None:
    assert probe.tool is not None
    (row,) = content["/scene/measured/link_6/tool/spheres"]
    np.testing.assert_allclose(row[1]["Ellipsoids3D:half_sizes"], [[0.01] * 3], rtol=1e-6)
    np.testing.assert_allclose(row[1]["Ellipsoids3D:centers"], [probe.tool.parts[-1].center], rtol=1e-6)


def test_the_stop_and_what_touches_are_lanes(content: dict[str, Rows], run: Recording) -> None:
    def lane(name: str) -> list[tuple[int, str | None]]:
        rows = sorted((row for row in content[f"/state/{name}"] if row[0] >= 0), key=lambda row: row[0])
        return [(tick, row.get("StateChange:state", [None])[0]) for tick, row in rows]

    stop = int(np.flatnonzero(run.robot["safety_mode"][:, 0] == 3)[0])
    assert lane("controller") == [(0, "runs"), (stop, "protective stop")]
    for touch, state in zip(contacts.touches(run), ("touches", "pushed"), strict=True):
        (rows,) = touch.episodes()
        assert lane(touch.name(["plate"]).replace(" ", "_")) == [(0, None), (rows[0], state), (rows[-1] + 1, None)]


def test_contacts_over_time_are_zero_beside_them(content: dict[str, Rows], run: Recording) -> None:
    (touch,) = [touch for touch in contacts.touches(run) if not touch.is_push]
    sent = {tick: row["ur5:tool_on_plate"][0]["F"] for tick, row in content["/contact"]}
    np.testing.assert_allclose([sent[row] for row in touch.rows], touch.size, rtol=1e-6)
    assert sent[touch.rows[0] - 1] == sent[touch.rows[-1] + 1] == 0.0
    # Nothing is sent while nothing acts, but the recording's ends.
    assert len(sent) < len(run.robot) / 2
    assert {0, len(run.robot) - 1} < set(sent)


def test_the_layout_has_a_tab_for_what_a_run_has(content: dict[str, Rows], written: Path) -> None:
    blueprint = _read(written, "blueprint")
    names = {
        str(values.get("ContainerBlueprint:display_name", [""])[0]) for rows in blueprint.values() for _, values in rows
    }
    assert {"Position", "Velocity", "Torque", "Current", "External torque", "Wrench", "Contact"} <= names
    asked = {
        f"{path.split('/overrides/')[1].split('/')[0]} {mapping['source_component']}"
        for path, rows in blueprint.items()
        if "/visualizers/" in path
        for _, values in rows
        for mapping in values.get("VisualizerInstruction:component_map", ())
    }
    sent = {
        f"{entity} {name}"
        for entity in ("signals", "wrench", "contact")
        for _, row in content[f"/{entity}"]
        for name in row
    }
    assert {"signals ur5:truth_q", "signals ur5:truth_tau_ext", "contact ur5:push_on_forearm"} <= asked <= sent


def test_the_eye_goes_where_no_wall_hides_the_path(run: Recording, probe: ArmModel) -> None:
    free = rerun_view.new_stage(run, probe)
    q = run.robot["actual_q"]
    path = kinematics.forward(probe, q)[:, :3, 3]
    way = free.eye - path.mean(axis=0)
    facing = np.arctan2(way[1], way[0])
    middle = path.mean(axis=0) + 0.25 * np.array([np.cos(facing), np.sin(facing), 0.0])
    size = np.array([0.05, 1.0, 2.0])
    wall = Obstacle("wall", "box", middle, np.array([0.0, 0.0, facing]), size, 1e4, 10.0, 0.2)
    away = rerun_view.new_stage(run, probe, obstacles=(wall,)).eye - path.mean(axis=0)
    cosine = (way[:2] @ away[:2]) / np.linalg.norm(way[:2]) / np.linalg.norm(away[:2])
    # The nearest other place that is tried is half of 68 degrees further.
    assert cosine < np.cos(np.radians(25.0))


def test_without_contacts_a_run_is_drawn_too(
    run: Recording, probe: ArmModel, obstacles: Obstacles, tmp_path: Path
) -> None:
    table = run.tables["contact"]
    none = run.with_table(replace(table, time=table.time[:0], columns={n: v[:0] for n, v in table.columns.items()}))
    found = _read(rerun_view.write_rrd(none, probe, tmp_path / "none.rrd", title="none", obstacles=obstacles))
    assert "/contact" not in found
    assert not any(row.get("Arrows3D:vectors") for _, row in found["/scene/measured/force/contact"])
    assert "contact.png" not in _drawn(none, tmp_path / "figures")


def _drawn(recording: Recording, folder: Path, obstacles: Sequence[Obstacle] = ()) -> list[str]:
    names = [obstacle.name for obstacle in obstacles]
    return [path.name for path in figures.write_figures(recording, folder, title="made", obstacles=names)]


def test_a_run_has_figures_of_its_own(
    run: Recording, obstacles: Obstacles, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines: dict[str, dict[str, np.ndarray]] = {}
    named: list[str] = []

    def save(figure: Any, path: Path) -> Path:
        lines[path.stem] = {line.get_label(): line.get_ydata() for panel in figure.axes for line in panel.get_lines()}
        named.extend(text.get_text() for panel in figure.axes for text in panel.texts)
        assert any("protective stop at 3.20 s" in text.get_text() for text in figure.texts)
        return path

    monkeypatch.setattr(paper, "save", save)
    expected = ["position", "velocity", "torque", "current", "external_torque", "wrench", "contact"]
    assert _drawn(run, tmp_path, obstacles) == [f"{key}.png" for key in expected]
    assert {"measured", "target", "truth", "truth - target", "measured - target"} <= set(lines["position"])
    assert {"controller", "truth: motors", "truth: friction"} <= set(lines["torque"])
    assert {"truth", "force sensor", "controller's estimate"} <= set(lines["wrench"])
    # The last row of panels is joint 6's; errors are in mrad.
    error = 1e3 * (run.robot["truth_q"] - run.robot["target_q"])[:, 5]
    np.testing.assert_allclose(lines["position"]["truth - target"], error)
    assert {"tool on plate", "push on forearm"} <= set(named)
    assert any(text.startswith("45.2 N at 1.40 s") for text in named)


def test_no_stop_no_shade(run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def save(figure: Any, path: Path) -> Path:
        assert not any("stop" in text.get_text() for text in figure.texts)
        return path

    monkeypatch.setattr(paper, "save", save)
    free = run.with_table(run.robot.with_columns({"safety_mode": np.ones((len(run.robot), 1))}))
    assert _drawn(free, tmp_path)


def test_contacts_are_found_on_the_robot_s_rows(run: Recording) -> None:
    plate, push = contacts.touches(run)
    assert (plate.link, plate.obstacle, plate.is_push) == (7, 0, False)
    assert (push.link, push.obstacle, push.is_push) == (3, -1, True)
    np.testing.assert_allclose(plate.force, run.robot["truth_wrench"][plate.rows, :3], atol=1e-12)
    later = Table("robot", run.robot.time[200:], {"actual_q": run.robot["actual_q"][200:]}, run.robot.host_start)
    (piece,) = [touch for touch in contacts.touches(run.with_table(later)) if not touch.is_push]
    np.testing.assert_array_equal(piece.rows + 200, plate.rows[plate.rows >= 200])
