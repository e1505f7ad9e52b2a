"""Transfer of one file over HTTP: resumed where it stopped, checked, and complete or absent.

What has arrived lies beside the file as ``NAME.part`` (``NAME.part1`` of a second host), and
``NAME.part.json`` says from where. The file gets its own name when it is complete. Then its
checksum is compared, if one is published, and a file with a wrong one is removed.
"""

from __future__ import annotations

import hashlib
import http.client
import json
import os
import re
import shutil
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from probevo import __version__
from probevo.errors import InputError
from probevo.fetch.catalogue import RemoteFile
from probevo.storage.files import write_atomically

TIMEOUT_S = 30.0
CHUNK = 1 << 20
ATTEMPTS = 5
"""Failures in a row of a URL, without a byte arriving, after which the next one is tried."""
BUSY = (http.client.REQUEST_TIMEOUT, http.client.TOO_MANY_REQUESTS)
"""Answers after which a host may be asked again, besides those of a server that has failed."""
LONGEST_CHECKSUM = 4096
"""Bytes of a file that holds a checksum."""
NO_NETWORK = (OSError, http.client.HTTPException)
"""Exceptions of urllib where a host, a connection or an answer fails; URLError is an OSError."""
Progress = Callable[[int, int], None]
"""A function of the bytes that are there and of their total number; 0 if that is unknown."""


@dataclass(frozen=True)
class Fetched:
    """A file that is complete."""

    path: Path
    url: str
    size: int
    sha256: str
    is_verified: bool
    """Whether a published checksum says that it is the right one; False if none is published."""


class _ChecksumError(Exception):
    """A complete file is not the published one."""


def download(
    file: RemoteFile,
    folder: Path,
    on_progress: Progress = lambda done, total: None,
    wait_s: float = 1.0,
) -> Fetched:
    """Download a file into a folder, unless it is there already; go on where it stopped.

    A broken connection is resumed by an HTTP range, where the host can, and if the file there is
    still the same. A host that fails, or whose file has a wrong checksum, gives way to the next.

    Args:
        file: what to fetch.
        folder: folder for the file.
        on_progress: called as it arrives.
        wait_s: time before the second attempt; it doubles with each.

    Raises:
        InputError: no host could give it; the message says why, of each. What has arrived stays.
    """
    path = folder / file.name
    # What has arrived of each host, since their files may differ
    partials = [path.with_name(f"{file.name}.part{k or ''}") for k in range(len(file.urls))]
    failures = []
    for url, partial in zip(file.urls, partials, strict=True):
        try:
            if not path.exists():
                _transfer(url, partial, on_progress, wait_s=wait_s)
                partial.replace(path)
                for other in partials:
                    _discard(other)
            return _verified(file, path, url)
        except _ChecksumError as error:
            path.unlink()
            failures.append(f"{url}: {error}")
        except urllib.error.HTTPError as error:
            failures.append(f"{url}: HTTP status {error.code}")
        except NO_NETWORK as error:
            failures.append(f"{url}: {_cause(error)}")
    cure = "Try again later: what has arrived is kept. Or download it yourself, and give --have."
    raise InputError(file.name, f"could not be fetched: {'; '.join(failures)}.", cure)


def checked_copy(file: RemoteFile, path: Path) -> Fetched:
    """Return a file that is already on disk, if its checksum is right.

    Where the host publishes the checksum, it is asked for it; without a network, it stays
    unverified.

    Raises:
        InputError: it is not the published file.
    """
    for url in file.urls:
        try:
            return _verified(file, path, url)
        except _ChecksumError as error:
            cure = "Remove it, and let probevo fetch it."
            raise InputError(path, f"is not the published file: {error}.", cure) from error
        except NO_NETWORK:
            continue
    digest = _digest(path, "sha256")
    return Fetched(path, "", path.stat().st_size, sha256=digest, is_verified=False)


def _transfer(url: str, partial: Path, on_progress: Progress, *, wait_s: float) -> None:
    """Complete the partial file, in as many attempts as bring something new."""
    failures = 0
    while True:
        size_before = partial.stat().st_size if partial.exists() else 0
        try:
            _receive(url, partial, on_progress)
            break
        except urllib.error.HTTPError as error:
            if error.code == http.client.REQUESTED_RANGE_NOT_SATISFIABLE:
                if _is_complete(error, size_before):
                    break
                _discard(partial)
            elif error.code not in BUSY and error.code < http.client.INTERNAL_SERVER_ERROR:
                raise
            failures += 1
            last: Exception = error
        except NO_NETWORK as error:
            now = partial.stat().st_size if partial.exists() else 0
            failures = 1 if now > size_before else failures + 1
            last = error
        if failures >= ATTEMPTS:
            raise last
        time.sleep(wait_s * 2.0 ** (failures - 1))


def _receive(url: str, partial: Path, on_progress: Progress) -> None:
    """Append to the partial file what is missing of it.

    Raises:
        OSError: the connection breaks, or has given less than was said.
    """
    start, validator = _state(partial, url)
    headers = {"User-Agent": f"probevo/{__version__}", "Accept-Encoding": "identity"}
    if start:
        headers |= {"Range": f"bytes={start}-", "If-Range": validator}
    request = urllib.request.Request(url, headers=headers)
    with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
        if start and not _continues(answer, start):
            start = 0  # the whole file: no ranges here, or it has changed
        length = answer.headers.get("Content-Length")
        total = start + int(length) if length and length.isdigit() else 0
        _check_space(partial, total - start)
        validator = answer.headers.get("ETag") or answer.headers.get("Last-Modified") or ""
        if validator.startswith("W/"):
            validator = ""
        if start == 0:
            _discard(partial)
        write_atomically(_note(partial), json.dumps({"url": url, "validator": validator}))
        done = start
        with partial.open("ab") as out:
            while chunk := answer.read(CHUNK):
                out.write(chunk)
                done += len(chunk)
                on_progress(done, total)
            out.flush()
            os.fsync(out.fileno())
    if total and done < total:
        raise ConnectionError(f"the connection broke after {done:,} of {total:,} bytes")


def _state(partial: Path, url: str) -> tuple[int, str]:
    """Return how many bytes are there of the file at this URL, and what tells that it is the same;
    0 where nothing could tell that."""
    try:
        note = json.loads(_note(partial).read_text("utf-8"))
        validator = note["validator"]
        if note["url"] != url or not isinstance(validator, str) or not validator:
            return 0, ""
        return partial.stat().st_size, validator
    except (OSError, ValueError, KeyError, TypeError):
        return 0, ""


def _continues(answer: Any, start: int) -> bool:
    """Return whether an answer holds the bytes from ``start`` on."""
    if answer.status != http.client.PARTIAL_CONTENT:
        return False
    span = re.fullmatch(r"bytes (\d+)-\d+/(?:\d+|\*)", answer.headers.get("Content-Range", ""))
    return span is not None and int(span[1]) == start


def _is_complete(refusal: urllib.error.HTTPError, size: int) -> bool:
    """Return whether a host refuses to go on since the file has no more bytes than these.

    It compares ``If-Range`` first, so that the file is still the same.
    """
    span = re.fullmatch(r"bytes \*/(\d+)", refusal.headers.get("Content-Range", ""))
    return span is not None and int(span[1]) == size > 0


def _check_space(partial: Path, needed: int) -> None:
    free = shutil.disk_usage(partial.parent).free
    if needed > free:
        what = f"{needed / 1e9:.1f} GB are still to come, and {free / 1e9:.1f} GB are free."
        raise InputError(partial.parent, what, "Choose another folder with --out.")


def _discard(partial: Path) -> None:
    partial.unlink(missing_ok=True)
    _note(partial).unlink(missing_ok=True)


def _note(partial: Path) -> Path:
    return partial.with_name(f"{partial.name}.json")


def _verified(file: RemoteFile, path: Path, url: str) -> Fetched:
    """Compare a complete file with its published checksum, if there is one.

    Raises:
        _ChecksumError: it differs.
        OSError: the checksum could not be fetched.
    """
    digest = _digest(path, "sha256")
    if file.sha256 and digest != file.sha256.lower():
        raise _ChecksumError(f"its SHA-256 is {digest}, and should be {file.sha256}")
    if file.md5_suffix:
        published = _published_md5(url + file.md5_suffix)
        digest_md5 = _digest(path, "md5")
        if digest_md5 != published:
            raise _ChecksumError(f"its MD5 is {digest_md5}, and should be {published}")
    size = path.stat().st_size
    return Fetched(path, url, size, sha256=digest, is_verified=file.has_checksum)


def _published_md5(url: str) -> str:
    """Read an MD5 sum that lies beside its file, as md5sum writes it.

    Raises:
        OSError: it could not be fetched, or is no MD5 sum.
    """
    request = urllib.request.Request(url, headers={"User-Agent": f"probevo/{__version__}"})
    with urllib.request.urlopen(request, timeout=TIMEOUT_S) as answer:
        text = answer.read(LONGEST_CHECKSUM).decode("ascii", "replace")
    match = re.search(r"\b[0-9a-fA-F]{32}\b", text)
    if match is None:
        raise ConnectionError(f"{url} holds no MD5 sum")
    return match[0].lower()


def _digest(path: Path, algorithm: str) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, algorithm).hexdigest()


def _cause(error: Exception) -> str:
    """Return in words why a connection failed."""
    reason = getattr(error, "reason", None)
    text = str(reason or error)
    with suppress(AttributeError):
        text = reason.strerror or text  # type: ignore[union-attr]
    return text or type(error).__name__
