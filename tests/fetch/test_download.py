"""Downloads are resumed, checked, and complete or absent, whatever the host does."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from fetch.conftest import Hosts
from probevo.errors import InputError
from probevo.fetch.catalogue import RemoteFile
from probevo.fetch.download import CHUNK, checked_copy, download

DATA = np.random.default_rng(0).bytes(3 * CHUNK + 12345)
MD5 = hashlib.md5(DATA).hexdigest().encode()
NOWHERE = "http://127.0.0.1:9/data.zip"
"""Nobody listens there."""


def remote(*urls: str, md5: bool = False) -> RemoteFile:
    return RemoteFile("data.zip", urls, md5_suffix=".md5" if md5 else "")


def test_what_arrives_is_what_was_sent(hosts: Hosts, tmp_path: Path) -> None:
    host = hosts({"/data.zip": DATA})
    seen: list[tuple[int, int]] = []
    done = download(
        remote(f"{host.url}/data.zip"), tmp_path, lambda have, total: seen.append((have, total))
    )
    assert done.path.read_bytes() == DATA
    assert done.sha256 == hashlib.sha256(DATA).hexdigest()
    assert not done.is_verified
    assert seen[-1] == (len(DATA), len(DATA))
    assert [path.name for path in tmp_path.iterdir()] == ["data.zip"]


def test_a_broken_connection_is_resumed_where_it_broke(hosts: Hosts, tmp_path: Path) -> None:
    host = hosts({"/data.zip": DATA})
    host.breaks_after = [CHUNK, CHUNK + 7]
    done = download(remote(f"{host.url}/data.zip"), tmp_path, wait_s=0.0)
    assert done.path.read_bytes() == DATA
    spans = [span for _, span in host.asked]
    assert spans == ["", f"bytes={CHUNK}-", f"bytes={2 * CHUNK + 7}-"]


def test_an_interrupted_download_goes_on_in_the_next_call(hosts: Hosts, tmp_path: Path) -> None:
    host = hosts({"/data.zip": DATA})

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        download(remote(f"{host.url}/data.zip"), tmp_path, stop)
    assert not (tmp_path / "data.zip").exists()
    assert download(remote(f"{host.url}/data.zip"), tmp_path).path.read_bytes() == DATA
    assert [span for _, span in host.asked] == ["", f"bytes={CHUNK}-"]


def test_after_a_kill_the_download_goes_on(hosts: Hosts, tmp_path: Path) -> None:
    """kill -9 in the middle: nothing with the file's name is there, and what came is kept."""
    host = hosts({"/data.zip": DATA})
    host.pause_s = 0.05
    script = (
        "import sys; from pathlib import Path; from probevo.fetch.catalogue import RemoteFile;"
        " from probevo.fetch.download import download;"
        " download(RemoteFile('data.zip', (sys.argv[1],)), Path(sys.argv[2]))"
    )
    url = f"{host.url}/data.zip"
    process = subprocess.Popen([sys.executable, "-c", script, url, str(tmp_path)])
    part = tmp_path / "data.zip.part"
    until_s = time.monotonic() + 30.0
    while (not part.exists() or part.stat().st_size < CHUNK) and time.monotonic() < until_s:
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert not (tmp_path / "data.zip").exists()
    kept = part.stat().st_size
    assert kept >= CHUNK
    host.pause_s = 0.0
    assert download(remote(url), tmp_path).path.read_bytes() == DATA
    assert host.asked[-1][1] == f"bytes={kept}-"
    assert [path.name for path in tmp_path.iterdir()] == ["data.zip"]


def test_a_host_without_ranges_sends_all_of_it_again(hosts: Hosts, tmp_path: Path) -> None:
    host = hosts({"/data.zip": DATA})
    host.has_ranges = False
    host.breaks_after = [CHUNK]
    done = download(remote(f"{host.url}/data.zip"), tmp_path, wait_s=0.0)
    assert done.path.read_bytes() == DATA
    assert len(host.asked) == 2


def test_a_file_that_has_changed_meanwhile_is_not_mixed(hosts: Hosts, tmp_path: Path) -> None:
    host = hosts({"/data.zip": DATA})
    url = f"{host.url}/data.zip"

    def change(done: int, total: int) -> None:
        host.files["/data.zip"] = DATA[::-1]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        download(remote(url), tmp_path, change)
    assert download(remote(url), tmp_path).path.read_bytes() == DATA[::-1]


def test_a_part_that_is_longer_than_the_file_begins_anew(hosts: Hosts, tmp_path: Path) -> None:
    host = hosts({"/data.zip": DATA})
    url = f"{host.url}/data.zip"
    host.breaks_after = [CHUNK]

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        download(remote(url), tmp_path, stop)
    with (tmp_path / "data.zip.part").open("ab") as part:
        part.write(DATA)
    assert download(remote(url), tmp_path, wait_s=0.0).path.read_bytes() == DATA


def test_a_part_that_is_complete_is_not_fetched_again(hosts: Hosts, tmp_path: Path) -> None:
    """It was stopped after the last byte, before the file got its name."""
    host = hosts({"/data.zip": DATA})
    url = f"{host.url}/data.zip"

    def stop(done: int, total: int) -> None:
        if done == total:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        download(remote(url), tmp_path, stop)
    seen: list[int] = []
    done = download(remote(url), tmp_path, lambda have, total: seen.append(have), wait_s=0.0)
    assert done.path.read_bytes() == DATA
    assert not seen
    assert [span for _, span in host.asked] == ["", f"bytes={len(DATA)}-"]
    assert [path.name for path in tmp_path.iterdir()] == ["data.zip"]


@pytest.mark.parametrize("code", [408, 429, 500, 503])
def test_a_busy_host_is_asked_again(code: int, hosts: Hosts, tmp_path: Path) -> None:
    host = hosts({"/data.zip": DATA})
    host.fails_with = [code, code]
    done = download(remote(f"{host.url}/data.zip"), tmp_path, wait_s=0.0)
    assert done.path.read_bytes() == DATA
    assert len(host.asked) == 3


@pytest.mark.parametrize("first", ["down", "missing", "wrong"])
def test_the_next_host_takes_over(first: str, hosts: Hosts, tmp_path: Path) -> None:
    """Where one is down, has no such file, or has one of another checksum."""
    good = hosts({"/data.zip": DATA, "/data.zip.md5": MD5 + b"  data.zip\n"})
    bad = hosts({})
    if first == "wrong":
        bad.files = {"/data.zip": DATA[1:], "/data.zip.md5": MD5}
    url = NOWHERE if first == "down" else f"{bad.url}/data.zip"
    file = remote(url, f"{good.url}/data.zip", md5=True)
    done = download(file, tmp_path, wait_s=0.0)
    assert done.path.read_bytes() == DATA
    assert done.url.startswith(good.url)
    assert done.is_verified


def test_what_has_arrived_of_a_host_stays_while_another_one_is_asked(
    hosts: Hosts, tmp_path: Path
) -> None:
    first = hosts({"/data.zip": DATA})
    first.breaks_after = [CHUNK, 0, 0, 0, 0, 0, 0]
    second = hosts({"/data.zip": DATA})

    def stop(done: int, total: int) -> None:
        if second.asked:
            raise KeyboardInterrupt

    file = remote(f"{first.url}/data.zip", f"{second.url}/data.zip")
    with pytest.raises(KeyboardInterrupt):
        download(file, tmp_path, stop, wait_s=0.0)
    first.breaks_after = []
    assert download(file, tmp_path, wait_s=0.0).path.read_bytes() == DATA
    assert first.asked[-1][1] == f"bytes={CHUNK}-"
    assert [path.name for path in tmp_path.iterdir()] == ["data.zip"]


def test_a_wrong_checksum_leaves_nothing(hosts: Hosts, tmp_path: Path) -> None:
    host = hosts({"/data.zip": DATA, "/data.zip.md5": b"0" * 32})
    with pytest.raises(InputError, match="MD5") as caught:
        download(remote(f"{host.url}/data.zip", md5=True), tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert caught.value.where == "data.zip"


def test_each_host_and_its_fault_is_named(hosts: Hosts, tmp_path: Path) -> None:
    host = hosts({})
    with pytest.raises(InputError, match="refused") as caught:
        download(remote(NOWHERE, f"{host.url}/data.zip"), tmp_path, wait_s=0.0)
    assert "HTTP status 404" in caught.value.what
    assert NOWHERE in caught.value.what


def test_a_full_disk_is_seen_before_it_is_full(
    hosts: Hosts, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    host = hosts({"/data.zip": DATA})
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    with pytest.raises(InputError, match="free"):
        download(remote(f"{host.url}/data.zip"), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_the_user_is_compared_where_that_is_possible(
    hosts: Hosts, tmp_path: Path
) -> None:
    host = hosts({"/data.zip.md5": MD5})
    file = remote(f"{host.url}/data.zip", md5=True)
    (tmp_path / "mine.zip").write_bytes(DATA)
    assert checked_copy(file, tmp_path / "mine.zip").is_verified
    assert not checked_copy(remote(NOWHERE, md5=True), tmp_path / "mine.zip").is_verified
    (tmp_path / "mine.zip").write_bytes(DATA[1:])
    with pytest.raises(InputError, match="not the published file"):
        checked_copy(file, tmp_path / "mine.zip")
    assert (tmp_path / "mine.zip").exists()
