"""Hosts that are closed after each test."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from fetch.hosts import Host

Hosts = Callable[[dict[str, bytes]], Host]


@pytest.fixture
def hosts() -> Iterator[Hosts]:
    """A function that makes a host of files."""
    made: list[Host] = []

    def make(files: dict[str, bytes]) -> Host:
        made.append(Host(files))
        return made[-1]

    yield make
    for host in made:
        host.close()
