"""Tables of numbers in text files: what may be missing in them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from probevo.errors import InputError
from probevo.sequences.text import read_fields, read_stamped_csv
from sequences.recordings import write_lines


def test_the_accelerations_of_a_sample_may_be_nan(tmp_path: Path) -> None:
    file = tmp_path / "imu.csv"
    write_lines(file, ["1,0.1,0.2,0.3,nan,nan,nan", "2,0.1,0.2,0.3,0.0,0.0,9.81"])
    stamps_ns, values = read_stamped_csv(file, 6, is_imu=True)
    assert stamps_ns.tolist() == [1, 2]
    np.testing.assert_array_equal(values[0], [0.1, 0.2, 0.3, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(values[1], [0.1, 0.2, 0.3, 0.0, 0.0, 9.81])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ("0.1,0.2,nan,nan,nan,nan", "'nan' is not finite"),
        ("0.1,0.2,0.3,0.0,nan,9.81", "some of the three accelerations are nan"),
        ("0.1,0.2,0.3,nan,nan,inf", "'inf' is not finite"),
        ("0.1,0.2,0.3,0.0,nan,nan,nan", "'nan' is not finite"),
    ],
    ids=["rate", "one acceleration", "infinite", "seven values"],
)
def test_nothing_else_may_be_nan(values: str, message: str, tmp_path: Path) -> None:
    """Seven values are a pose."""
    file = tmp_path / "samples.csv"
    write_lines(file, [f"1,{values}"])
    columns = len(values.split(","))
    with pytest.raises(InputError, match=message) as refused:
        read_stamped_csv(file, columns, is_imu=columns == 6)
    assert refused.value.where == f"{file}:1"


@pytest.mark.parametrize("line", ["1.5,0,0,0,0,0,0,1", "1.5, 0, 0, 0, 0, 0, 0, 1"])
def test_commas_instead_of_blanks_are_named_with_the_cure(line: str, tmp_path: Path) -> None:
    file = tmp_path / "truth.tum"
    write_lines(file, ["0.5 0 0 0 0 0 0 1", line])
    with pytest.raises(InputError, match="separated by commas") as refused:
        read_fields(file, 8)
    assert refused.value.where == f"{file}:2"
    assert refused.value.cure == "Replace the commas by blanks."
