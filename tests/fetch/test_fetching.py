"""A data set is fetched whole or not at all, once, and by one process at a time."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import pytest

from fetch.conftest import Hosts
from probevo.errors import InputError
from probevo.fetch.catalogue import FAMILIES, Dataset, RemoteFile, find_dataset
from probevo.fetch.fetching import ARCHIVES, RECORD, fetch
from probevo.storage.lock import locked


def zipped(name: str, data: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as packed:
        packed.writestr(name, data)
    return buffer.getvalue()


def dataset_at(url: str) -> Dataset:
    return Dataset(
        name="some/thing",
        files=tuple(RemoteFile(name, (f"{url}/{name}",)) for name in ("a.zip", "b.zip")),
        licence="a licence",
        page="a page",
        size="",
        recordings="rec*",
    )


FILES = {"/a.zip": zipped("rec1/a", b"a"), "/b.zip": zipped("rec2/b", b"b")}


def test_all_archives_become_one_folder_once(hosts: Hosts, tmp_path: Path) -> None:
    host = hosts(dict(FILES))
    result = fetch(dataset_at(host.url), tmp_path)
    assert result.folder == tmp_path / "some" / "thing"
    assert [path.name for path in result.recordings] == ["rec1", "rec2"]
    record = json.loads((result.folder / RECORD).read_text())
    assert [file["matches_a_published_checksum"] for file in record["files"]] == [False, False]
    assert record["licence"] == "a licence"
    assert not (tmp_path / ARCHIVES).exists()
    again = fetch(dataset_at(host.url), tmp_path)
    assert again.files == ()
    assert again.recordings == result.recordings
    assert len(host.asked) == 2


def test_where_nothing_arrives_nothing_is_left(hosts: Hosts, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="404"):
        fetch(dataset_at(hosts({}).url), tmp_path, wait_s=0.0)
    assert list(tmp_path.iterdir()) == []


def test_what_has_arrived_is_kept_until_the_rest_comes(hosts: Hosts, tmp_path: Path) -> None:
    host = hosts({"/a.zip": FILES["/a.zip"]})
    with pytest.raises(InputError, match="404"):
        fetch(dataset_at(host.url), tmp_path, wait_s=0.0)
    assert not (tmp_path / "some").exists()
    host.files = dict(FILES)
    assert len(fetch(dataset_at(host.url), tmp_path).recordings) == 2
    assert [path for path, _ in host.asked].count("/a.zip") == 1


def test_archives_of_the_user_are_taken_and_stay(hosts: Hosts, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "a.zip").write_bytes(FILES["/a.zip"])
    host = hosts(dict(FILES))
    result = fetch(dataset_at(host.url), tmp_path / "out", mine)
    assert len(result.recordings) == 2
    assert [path for path, _ in host.asked] == ["/b.zip"]
    assert (mine / "a.zip").exists()
    with pytest.raises(InputError, match="no archive"):
        fetch(dataset_at(host.url), tmp_path / "other", tmp_path / "out")


def test_a_damaged_archive_leaves_no_folder(hosts: Hosts, tmp_path: Path) -> None:
    host = hosts(FILES | {"/b.zip": b"<html>"})
    with pytest.raises(InputError, match="damaged"):
        fetch(dataset_at(host.url), tmp_path)
    assert not (tmp_path / "some" / "thing").exists()


def test_a_folder_of_others_is_left_alone(hosts: Hosts, tmp_path: Path) -> None:
    (tmp_path / "some" / "thing").mkdir(parents=True)
    with pytest.raises(InputError, match="not written by probevo"):
        fetch(dataset_at(hosts(dict(FILES)).url), tmp_path)


def test_two_do_not_fetch_into_one_place(hosts: Hosts, tmp_path: Path) -> None:
    host = hosts(dict(FILES))
    with locked(tmp_path / ARCHIVES), pytest.raises(InputError, match="in use by"):
        fetch(dataset_at(host.url), tmp_path)


@pytest.mark.parametrize("name", [name for family in FAMILIES for name in family.examples])
def test_each_listed_name_is_a_data_set(name: str) -> None:
    dataset = find_dataset(name)
    assert dataset.name == name
    assert dataset.licence
    assert dataset.files
    for file in dataset.files:
        assert all(url.startswith(("https://", "http://robotics.ethz.ch/")) for url in file.urls)
        assert file.has_checksum == name.startswith("tum-vi/")


@pytest.mark.parametrize(
    ("name", "suggested"), [("euroc/MH_01", "euroc/MH_01_easy"), ("tum-vi/rom1", "tum-vi/room1")]
)
def test_a_name_that_is_wrong_gets_a_suggestion(name: str, suggested: str) -> None:
    with pytest.raises(InputError, match=suggested):
        find_dataset(name)


@pytest.mark.parametrize("name", ["", "kitti", "kitti-raw/2011_09_26", "../x", "euroc/../../x"])
def test_any_other_name_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="no such data set"):
        find_dataset(name)
