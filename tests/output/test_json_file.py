from pathlib import Path

from probevo.output.json_file import write_json


def test_json_keeps_order_and_precision(tmp_path: Path) -> None:
    write_json(tmp_path / "metrics.json", {"b": 0.1 + 0.2, "a": None})
    assert (
        tmp_path / "metrics.json"
    ).read_text() == '{\n  "b": 0.30000000000000004,\n  "a": null\n}\n'
