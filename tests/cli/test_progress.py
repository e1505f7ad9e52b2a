"""Progress where stderr is no terminal."""

from __future__ import annotations

import pytest

from probevo.cli import progress


def test_a_log_gets_a_line_every_half_a_minute(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    times_s = iter([0.0, *(4.0 * k for k in range(1, 21))])  # four seconds a frame
    monkeypatch.setattr(progress, "monotonic", lambda: next(times_s))
    with progress.progress_bar("drive", "starting") as show:
        for done in range(1, 21):
            show(done, 50)
    assert capsys.readouterr().err.splitlines() == [
        "probevo: drive: 8 of 50 frames, 0.2 frames/s, 168 s left",
        "probevo: drive: 16 of 50 frames, 0.2 frames/s, 136 s left",
    ]


def test_the_slow_frames_at_the_start_do_not_count(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Code is compiled for 100 s; then, ten frames take a second."""
    times_s = iter([0.0, 40.0, 100.0, *(100.0 + 0.1 * k for k in range(1, 1000))])
    monkeypatch.setattr(progress, "monotonic", lambda: next(times_s))
    with progress.progress_bar("drive", "starting") as show:
        for done in range(1, 400):
            show(done, 1000)
    assert capsys.readouterr().err.splitlines() == [
        "probevo: drive: 1 of 1000 frames",
        "probevo: drive: 2 of 1000 frames",
        "probevo: drive: 302 of 1000 frames, 10.0 frames/s, 70 s left",
    ]
