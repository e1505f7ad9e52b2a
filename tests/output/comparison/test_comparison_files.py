"""A comparison as CSV and JSON: every metric, at full precision."""

import csv
import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.geometry import se3
from probevo.measurements.imu_reason import ImuFault, ImuReason
from probevo.output.comparison.comparison import Comparison, Entry
from probevo.output.comparison.comparison_files import (
    document,
    flat_record,
    ranking_records,
    write_csv,
)
from probevo.output.json_file import write_json
from probevo.output.run_result import RunRecorder, RunResult
from probevo.run_config import RunConfig


def entry(run: RunResult, *, truth: bool, name: str = 'hill, "a"') -> Entry:
    T_true = (
        se3.exp(np.array([0.1, 0.0, 0.0, 0.0, 0.01, 0.0]))
        @ run.T_world_cam
        @ se3.exp(np.full(6, 0.01))
    )
    metrics = evaluate(run.T_world_cam, T_true, run.T_curr_prev, cov=run.cov) if truth else None
    return Entry(
        name,
        "fixed",
        run,
        metrics=metrics,
        report=Path("out/runs/a/report.html"),
        config=RunConfig(seed=3),
    )


def test_a_line_holds_every_metric_as_it_is(
    make_run: Callable[..., RunResult], tmp_path: Path
) -> None:
    known = entry(make_run(60), truth=True)
    assert known.metrics is not None
    with_window = replace(known.metrics, smoothed=known.metrics.of_path())
    known = replace(known, metrics=with_window)
    unknown = entry(make_run(60), truth=False, name="dale")
    write_csv(tmp_path / "c.csv", map(flat_record, (known, unknown)))
    with (tmp_path / "c.csv").open(encoding="utf-8") as file:
        first, second = csv.DictReader(file)
    assert known.metrics is not None
    for key, value in known.metrics.as_dict().items():
        if key == "faults":  # of all kinds together: the gap of frame 39
            assert first[key] == second[key] == "1"
        elif isinstance(value, dict):
            assert key not in first
            assert {part: float(first[f"{key}_{part}"]) for part in value} == value
            assert {second[f"{key}_{part}"] for part in value} == {""}
        else:
            assert first[key] == ("" if value is None else repr(value)), key
    assert {first["sequence"], second["sequence"]} == {'hill, "a"', "dale"}
    assert all(
        second[field.name] == ""
        for field in fields(Metrics)
        if field.name not in ("nees_coverage", "smoothed", "faults")
    )
    assert [first[f"steps_{name}"] for name in ("ok", "gap", "degenerate")] == ["58", "1", "0"]
    assert (first["frames"], float(first["ms_per_frame"])) == (
        "60",
        float(np.median(known.result.total_ms)),
    )
    assert set(first) == set(second)


def test_the_share_out_of_domain_needs_no_truth(
    make_run: Callable[..., RunResult], tmp_path: Path
) -> None:
    entries = [entry(make_run(9, outside=25), truth=known) for known in (True, False)]
    assert [flat_record(each)["out_of_domain"] for each in entries] == [0.25, 0.25]
    runs: Any = document(entries, tmp_path)["runs"]
    assert [run["out_of_domain"] for run in runs] == [0.25, 0.25]


def test_a_step_without_an_imu_is_one_fault(make_run: Callable[..., RunResult]) -> None:
    """It is counted by its cause, too."""
    recorder = RunRecorder()
    faults = [None, ImuFault.HOLE, ImuFault.GATED, ImuFault.HOLE, None]
    for frame, fault in enumerate(faults):
        motion = MotionEstimate(
            np.eye(4),
            np.eye(6),
            Status.OK if frame else Status.FIRST,
            num_tracks=9,
            imu_reason=None if fault is None else ImuReason(fault, "…"),
        )
        recorder.add(100 * frame, motion, imu_is_in_window=True)
    result = recorder.result()
    assert sum(result.faults.values()) == 6
    without_imu = replace(entry(make_run(5), truth=False), result=result)
    assert flat_record(without_imu)["faults"] == 3


def test_every_status_has_a_column(make_run: Callable[..., RunResult]) -> None:
    columns = flat_record(entry(make_run(3), truth=True))
    assert {f"steps_{status.name.lower()}" for status in Status} - {"steps_first"} <= set(columns)


def test_json_has_metrics_settings_and_the_way_to_the_report(
    make_run: Callable[..., RunResult], tmp_path: Path
) -> None:
    known = entry(make_run(60), truth=True)
    unknown = entry(make_run(1), truth=False)
    write_json(tmp_path / "c.json", document((known, unknown), Path("out")))
    first, second = json.loads((tmp_path / "c.json").read_text())["runs"]
    assert known.metrics is not None
    assert first["metrics"] == known.metrics.as_dict()
    assert first["report"] == "runs/a/report.html"
    assert RunConfig.model_validate(first["settings"]) == known.config
    assert first["steps"]["ok"] == 58
    assert (second["metrics"], second["ms_per_frame"], second["frames"]) == (None, None, 1)


def test_rankings_say_who_is_best_and_by_how_much(make_run: Callable[..., RunResult]) -> None:
    good = entry(make_run(40), truth=True)
    assert good.metrics is not None
    motions = se3.exp(np.array([0, 0, 0, 0, 0.002, 0])) @ good.result.T_curr_prev
    run = replace(good.result, T_curr_prev=motions, T_world_cam=se3.chain_motions(motions))
    truth = good.result.T_world_cam
    entries = [
        replace(
            good,
            estimator=name,
            result=result,
            truth=truth,
            metrics=evaluate(result.T_world_cam, truth),
        )
        for name, result in (("good", good.result), ("bad", run), ("same", good.result))
    ]
    records: Any = ranking_records(Comparison(tuple(entries)))
    drift = records[good.sequence]["short_r_deg_per_m"]
    assert drift["best"] == "good"
    assert drift["against"]["bad"]["is_significant"]
    assert abs(drift["against"]["bad"]["reduction_percent"] - 100.0) < 1e-6
    # Of so few blocks, some exchanges leave all as it is.
    assert 0.001 <= drift["against"]["bad"]["p_value"] < 0.01
    assert not drift["against"]["same"]["is_significant"]
    assert json.loads(json.dumps(records, allow_nan=False)) == records
