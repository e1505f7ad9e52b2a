"""Results as JSON files, with numbers at full precision."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from probevo.storage.files import write_atomically


def write_json(path: Path, values: Mapping[str, object]) -> None:
    """Write a JSON file such as ``metrics.json``.

    Keys stay in the given order, numbers have full precision, and None becomes null.
    """
    write_atomically(path, json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + "\n")
