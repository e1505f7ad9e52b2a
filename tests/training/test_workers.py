"""Tasks in other processes: the same results even if processes are killed; errors stay intact."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread, Timer, active_count
from typing import Any

import pytest

from probevo.errors import InputError
from probevo.training import workers as workers_module
from probevo.training.workers import Workers

HERE = Workers()
TWO = Workers(jobs=2)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Workers]:
    """Start a Dask cluster with two workers on this machine.

    A task is given up after two lost workers, not four, to save time.
    """
    distributed = pytest.importorskip("distributed")
    dask = pytest.importorskip("dask")
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
        ) as found,
    ):
        yield Workers(cluster=found.scheduler_address)


@pytest.fixture(params=["here", "two", "cluster"])
def workers(request: pytest.FixtureRequest) -> Workers:
    found: Workers = {"here": HERE, "two": TWO}.get(request.param) or request.getfixturevalue(
        "cluster"
    )
    return found


@pytest.fixture(params=["two", "cluster"])
def others(request: pytest.FixtureRequest) -> Workers:
    """Return workers other than this process."""
    found: Workers = TWO if request.param == "two" else request.getfixturevalue("cluster")
    return found


def squared(number: int) -> tuple[int, int]:
    time.sleep(0.02 * (number % 3))
    return number**2, os.getpid()


def mapped(workers: Workers, count: int = 7) -> list[int]:
    names = [f"task {number}" for number in range(count)]
    done: list[int] = []
    found = workers.map(squared, range(count), names, done.append)
    assert sorted(done) == list(range(count))
    assert (os.getpid() in {process for _, process in found}) == (workers.are_here and count > 0)
    return [result for result, _ in found]


def test_results_come_in_the_order_of_the_tasks(
    workers: Workers, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a cluster does not get all at a time."""
    monkeypatch.setattr(workers_module, "MAX_SUBMITTED", 3)
    assert mapped(workers) == [number**2 for number in range(7)]


def test_the_environment_of_the_caller_stays_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """The workers import no module of the working directory; programs that it starts later do."""
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    mapped(Workers(jobs=2))
    assert "PYTHONSAFEPATH" not in os.environ


def test_where_no_process_can_be_started_that_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    """Joblib then has no backend of processes, as without /dev/shm."""
    joblib_parallel = pytest.importorskip("joblib.parallel")
    monkeypatch.delitem(joblib_parallel.BACKENDS, "loky")
    with pytest.raises(InputError, match=r"^--jobs: other processes cannot be used here"):
        mapped(TWO)


def test_of_no_tasks_there_are_no_results(workers: Workers) -> None:
    assert mapped(workers, 0) == []


def refuse(number: int) -> int:
    if number == 3:
        raise InputError("recording 3", "its left eye is shut.", "Open it.")
    return number


def test_an_input_error_arrives_as_it_was(workers: Workers) -> None:
    with pytest.raises(InputError) as caught:
        workers.map(refuse, range(6), [""] * 6)
    error = caught.value
    assert (error.where, error.what, error.cure) == (
        "recording 3",
        "its left eye is shut.",
        "Open it.",
    )


def die_once(task: tuple[int, Path]) -> int:
    """Kill the worker of the second task the first time."""
    number, grave = task
    if number == 1 and not grave.exists():
        grave.touch()
        os._exit(1)
    time.sleep(0.05)
    return number


def test_what_a_killed_worker_had_is_done_again(others: Workers, tmp_path: Path) -> None:
    tasks = [(number, tmp_path / "grave") for number in range(6)]
    done: list[int] = []
    assert others.map(die_once, tasks, [""] * 6, done.append) == list(range(6))
    assert sorted(done) == list(range(6))
    assert (tmp_path / "grave").exists()


def die_always(task: tuple[int, Path]) -> int:
    """Kill every worker of the second task."""
    number, graves = task
    if number == 1:
        (graves / f"{os.getpid()}").touch()
        os._exit(1)
    return number


def test_a_task_that_kills_every_worker_is_given_up_and_named(
    others: Workers, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All other tasks are done first. It is given up at the first loss, to save time.

    Should a cluster fail to restart its workers, as under load, the test ends with that error soon.
    """
    monkeypatch.setattr(workers_module, "MAX_LOSSES", 1)
    monkeypatch.setattr(workers_module, "NO_WORKER_S", 20.0)
    done: list[int] = []
    with pytest.raises(InputError) as caught:
        others.map(
            die_always, [(number, tmp_path) for number in range(4)], list("abcd"), done.append
        )
    assert caught.value.where == "b"
    assert "its worker was lost 1 times, though it ran nothing else" in caught.value.what
    assert "goes on from what is done" in caught.value.cure
    assert sorted(done) == [0, 2, 3]
    assert len(list(tmp_path.iterdir())) >= 2


@contextmanager
def scheduler_without_workers() -> Iterator[Any]:
    """Start a Dask cluster of this machine that has no worker yet."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=0, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as found:
        yield found


@contextmanager
def unattended_worker(cluster: Any) -> Iterator[None]:
    """Start a worker process that nobody restarts once it is killed."""
    command = [sys.executable, "-m", "distributed.cli.dask_worker", cluster.scheduler_address]
    options = ["--no-nanny", "--nthreads", "1", "--no-dashboard"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    worker = subprocess.Popen([*command, *options], env=environment, stderr=subprocess.DEVNULL)
    try:
        cluster.wait_for_workers(1, timeout=60)
        yield
    finally:
        worker.kill()
        worker.wait()


def test_a_cluster_whose_workers_do_not_come_back_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where the restart of a killed worker fails: the remaining tasks are named."""
    monkeypatch.setattr(workers_module, "NO_WORKER_S", 0.5)
    monkeypatch.setattr(workers_module, "WATCH_S", 0.1)
    tasks = [(number, tmp_path) for number in range(3)]
    done: list[int] = []
    with scheduler_without_workers() as found, unattended_worker(found):
        workers = Workers(cluster=found.scheduler_address)
        with pytest.raises(InputError) as caught:
            workers.map(die_always, tasks, list("abc"), done.append)
    remaining = [name for number, name in enumerate("abc") if number not in done]
    assert "b" in remaining
    assert caught.value.where == ", ".join(remaining)
    assert "none has come back within 0.5 s" in caught.value.what
    assert "the same command goes on from what is done" in caught.value.cure
    assert len(list(tmp_path.iterdir())) == 1


def test_a_cluster_whose_only_worker_is_gone_before_anybody_looks_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It dies of the only task, and the client does not see it meanwhile, as under load."""
    monkeypatch.setattr(workers_module, "NO_WORKER_S", 0.2)
    monkeypatch.setattr(workers_module, "WATCH_S", 0.1)
    monkeypatch.setattr(workers_module._WorkerWatch, "_has_worker", lambda watch: False)
    with scheduler_without_workers() as found, unattended_worker(found):
        workers = Workers(cluster=found.scheduler_address)
        with pytest.raises(InputError, match="none has come back within") as caught:
            workers.map(die_always, [(1, tmp_path)], ["b"])
    assert caught.value.where == "b"


def test_a_cluster_that_never_had_a_worker_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its workers may still be queued: here the first starts long after a lost one is given up."""
    monkeypatch.setattr(workers_module, "NO_WORKER_S", 0.1)
    monkeypatch.setattr(workers_module, "WATCH_S", 0.05)
    with scheduler_without_workers() as found:
        late = Timer(1.0, found.scale, [1])
        late.start()
        assert mapped(Workers(cluster=found.scheduler_address), 2) == [0, 1]
        late.join()


def test_whoever_stops_it_in_between_is_not_kept_waiting(workers: Workers) -> None:
    """As Ctrl-C does; and the same workers can be given other work."""

    def stop(_number: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        workers.map(squared, range(50), [""] * 50, stop)
    assert mapped(workers) == [number**2 for number in range(7)]


def test_a_cluster_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(workers_module, "CONNECT_S", 0.5)
    for address in ("tcp://127.0.0.1:9", "nowhere"):
        with pytest.raises(
            InputError, match=f"--cluster: no Dask scheduler answers at '{address}'"
        ):
            Workers(cluster=address).map(squared, [1], ["one"])


@pytest.mark.parametrize("said", [b"HTTP/1.1 400 Bad Request\r\n\r\n", b""])
def test_another_service_than_a_cluster_is_refused_in_time(
    said: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Dask would take the text for a length of exabytes, and wait for ever for one that is silent.

    As a process ends, too, nothing is waited for.
    """
    pytest.importorskip("distributed")
    monkeypatch.setattr(workers_module, "CONNECT_S", 0.5)
    num_threads = active_count()
    with socket.create_server(("127.0.0.1", 0)) as service:
        talker = Thread(target=answer_once, args=(service, said))
        talker.start()
        address = f"tcp://127.0.0.1:{service.getsockname()[1]}"
        with pytest.raises(InputError, match="--cluster: no Dask scheduler answers at"):
            Workers(cluster=address).map(squared, [1], ["one"])
        talker.join()
    assert active_count() == num_threads


def answer_once(service: socket.socket, said: bytes) -> None:
    """Say something to the first caller, and hear it until it hangs up."""
    connection, _ = service.accept()
    with connection:
        connection.sendall(said)
        with suppress(ConnectionError):
            while connection.recv(4096):
                pass
