"""What the facts of a run say of the rig."""

import pytest

from probevo.output.run_facts import delay_text


@pytest.mark.parametrize(
    ("delay_s", "text"), [(0.0049, "4.9 ms later"), (-0.002, "2.0 ms earlier")]
)
def test_the_delay_is_said_with_its_sign(delay_s: float, text: str) -> None:
    assert f"right images are exposed {text} than left ones" in delay_text(delay_s)
