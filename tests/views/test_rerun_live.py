"""The live view: what is sent is in the file, with the ends of the intervals, and nothing twice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ur5_twin.arm.parameters import load_model
from ur5_twin.errors import WireError
from ur5_twin.recording import Table, read
from ur5_twin.resources import data_dir
from ur5_twin.views.rerun_live import RerunLive, intervals
from ur5_twin.views.wrenches import Wrench

chunk = pytest.importorskip("rerun.chunk", reason="the extra 'view' is not installed")


def test_the_ends_of_an_interval_of_90_percent() -> None:
    table = Table("robot", np.zeros(2), {"est_direct_deviation": np.full((2, 6), 2.0)})
    found = [Wrench(key, key, "#000000", np.ones((2, 6))) for key in ("est_direct_wrench", "truth")]
    low, high = intervals(found, table)
    assert (low.key, high.key) == ("est_direct_wrench_low", "est_direct_wrench_high")
    np.testing.assert_allclose(low.values, 1.0 - 1.645 * 2.0, atol=1e-3)
    np.testing.assert_allclose(high.values, 1.0 + 1.645 * 2.0, atol=1e-3)


def test_rows_sent_in_pieces_are_all_in_the_file(tmp_path: Path) -> None:
    demo = read(data_dir("replay") / "demo").robot
    n = 130
    columns = {name: values[:n] for name, values in demo.columns.items()}
    columns |= {"sim_actual_q": columns["actual_q"] + 1e-3}
    columns |= {"est_direct_wrench": np.full((n, 6), 5.0), "est_direct_deviation": np.ones((n, 6))}
    path = tmp_path / "live.rrd"
    view = RerunLive(load_model("plant"), "live", save=path)
    for first in range(0, n, 13):
        part = slice(first, first + 13)
        view.show(Table("robot", demo.time[:n][part], {name: values[part] for name, values in columns.items()}))
    view.close()
    view.close()
    reader = chunk.RrdReader(path)
    (store,) = reader.recordings()
    rows, names, seen = {"/signals": 0, "/wrench": 0}, set(), set()
    for piece in reader.stream(store=store):
        batch = piece.to_record_batch()
        seen.add(piece.entity_path)
        if piece.entity_path in rows:
            rows[piece.entity_path] += batch.num_rows
            names |= set(batch.schema.names)
    assert rows == {"/signals": n, "/wrench": n}
    assert {"ur5:est_direct_wrench_low", "ur5:est_direct_wrench_high"} <= names
    assert "ur5:actual_q_minus_sim_actual_q_mrad" in names
    assert {"/scene/twin/link_6", "/scene/measured/link_6", "/scene/measured/force/est_direct_wrench"} <= seen
    assert reader.blueprints()


@pytest.mark.parametrize(
    ("url", "said"), [("http://127.0.0.1", "no viewer's URL"), ("rerun+http://127.0.0.1:1/proxy", "no Rerun viewer at")]
)
def test_a_viewer_that_is_not_there_is_said_at_once(url: str, said: str) -> None:
    with pytest.raises(WireError, match=said):
        RerunLive(load_model("plant"), "live", connect=url)
