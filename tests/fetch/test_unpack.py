"""Archives are unpacked whole or not at all, and never outside of their folder."""

from __future__ import annotations

import io
import tarfile
import zipfile
from pathlib import Path

import pytest

from probevo.errors import InputError
from probevo.fetch.unpack import unpack_all


def zipped(path: Path, files: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w") as packed:
        for name, data in files.items():
            packed.writestr(name, data)
    return path


def tarred(path: Path, members: list[tarfile.TarInfo], data: bytes = b"x") -> Path:
    with tarfile.open(path, "w") as packed:
        for info in members:
            info.size = len(data) if info.isreg() else 0
            packed.addfile(info, io.BytesIO(data) if info.isreg() else None)
    return path


def test_zip_and_tar_and_zips_inside(tmp_path: Path) -> None:
    inner = zipped(tmp_path / "inner.zip", {"mav0/a.txt": b"a"})
    outer = zipped(
        tmp_path / "outer.zip", {"hall/one/one.zip": inner.read_bytes(), "hall/b.txt": b"b"}
    )
    other = tarred(tmp_path / "other.tar", [tarfile.TarInfo("c.txt")], b"c")
    seen: list[tuple[int, int]] = []

    def on_progress(done: int, total: int) -> None:
        seen.append((done, total))

    unpack_all([outer, other], tmp_path / "out", {"note.json": "{}"}, on_progress)
    found = {
        path.relative_to(tmp_path / "out").as_posix(): path.read_bytes()
        for path in (tmp_path / "out").rglob("*")
        if path.is_file()
    }
    assert found == {
        "hall/one/mav0/a.txt": b"a",
        "hall/b.txt": b"b",
        "c.txt": b"c",
        "note.json": b"{}",
    }
    total = sum(path.stat().st_size for path in (outer, other)) + len(inner.read_bytes())
    assert seen[-1][1] == total
    assert [done for done, _ in seen] == sorted({done for done, _ in seen})
    assert all(0 < done <= total for done, _ in seen)
    assert len(seen) == 4


@pytest.mark.parametrize("name", ["../evil", "/evil", "a/../../evil", "C:/evil", "..\\evil"])
@pytest.mark.parametrize("kind", ["zip", "tar"])
def test_nothing_is_written_outside(name: str, kind: str, tmp_path: Path) -> None:
    place = tmp_path / "deep" / "down"
    place.mkdir(parents=True)
    if kind == "zip":
        archive = zipped(place / "a.zip", {"good": b"", name: b"evil"})
    else:
        archive = tarred(place / "a.tar", [tarfile.TarInfo("good"), tarfile.TarInfo(name)])
    with pytest.raises(InputError, match="outside of its folder"):
        unpack_all([archive], place / "out", {})
    assert sorted(path.name for path in tmp_path.rglob("*")) == sorted(
        ["deep", "down", archive.name]
    )


def test_links_and_devices_are_left_out(tmp_path: Path) -> None:
    link = tarfile.TarInfo("link")
    link.type = tarfile.SYMTYPE
    link.linkname = "/etc"
    device = tarfile.TarInfo("device")
    device.type = tarfile.CHRTYPE
    archive = tarred(tmp_path / "a.tar", [link, device, tarfile.TarInfo("file")])
    unpack_all([archive], tmp_path / "out", {})
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["file"]


@pytest.mark.parametrize("kind", ["zip", "tar", "text"])
def test_a_damaged_archive_leaves_nothing(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{kind}"
    if kind == "zip":
        zipped(path, {"big": bytes(range(256)) * 400})
        data = bytearray(path.read_bytes())
        data[2000] ^= 1  # found by its checksum
        path.write_bytes(data)
    elif kind == "tar":
        tarred(path, [tarfile.TarInfo("big")], bytes(100_000))
        path.write_bytes(path.read_bytes()[:50_000])
    else:
        path.write_text("<html>Please log in.</html>")
    with pytest.raises(InputError, match="damaged"):
        unpack_all([path], tmp_path / "out", {})
    assert [found.name for found in tmp_path.iterdir()] == [path.name]


def test_an_encrypted_archive_is_refused(tmp_path: Path) -> None:
    archive = zipped(tmp_path / "secret.zip", {"a.txt": b"a"})
    content = bytearray(archive.read_bytes())
    # Bit 0 of the flags, in the header of the file and in that of the directory
    for signature, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.index(signature) + flags] |= 1
    archive.write_bytes(content)
    with pytest.raises(InputError, match=r"secret\.zip"):
        unpack_all([archive], tmp_path / "out", {})
    assert not (tmp_path / "out").exists()
