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
