"""The file for the Rerun viewer, read back by its own reader."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from probevo.errors import InputError
from probevo.output.run_result import RunResult
from probevo.output.viewer_file import write_viewer_file

ENTITIES = {
    "/world",
    "/world/estimate",
    "/world/truth",
    "/world/camera",
    "/world/camera_3_sigma",
    "/step/sigma_translation_m",
    "/step/sigma_rotation_deg",
    "/step/tracks",
    "/step/inliers",
    "/status",
}


def test_every_entity_is_read_back(tmp_path: Path, make_run: Callable[..., RunResult]) -> None:
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    run = make_run(45)
    path = tmp_path / "run.rrd"
    write_viewer_file(path, run, run.T_world_cam)
    assert [each.name for each in tmp_path.iterdir()] == ["run.rrd"]
    rows: dict[str, int] = {}
    for chunk in RrdReader(path).stream():
        rows[chunk.entity_path] = rows.get(chunk.entity_path, 0) + chunk.num_rows
    found = {name: count for name, count in rows.items() if not name.startswith("/__")}
    assert set(found) == ENTITIES
    assert found["/world/camera"] == found["/world/camera_3_sigma"] == 45
    assert found["/step/tracks"] == 44
    assert found["/status"] == 1  # the gap
    assert found["/world/estimate"] == found["/world/truth"] == 1


def test_without_the_extra_the_message_says_what_to_install(
    tmp_path: Path, make_run: Callable[..., RunResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(InputError, match=r"pip install 'probevo\[viewer\]'"):
        write_viewer_file(tmp_path / "run.rrd", make_run(3))
    with pytest.raises(InputError, match=r"does not end in \.rrd"):
        write_viewer_file(tmp_path / "run.txt", make_run(3))
