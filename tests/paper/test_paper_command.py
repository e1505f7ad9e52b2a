"""``probevo paper``: what it writes and says, and how it refuses mistakes."""

from pathlib import Path

import pytest

from probevo.cli.main import main
from probevo_paper.figure_5_page import TABLE_HEAD


def test_blur_writes_a_page_and_its_observations(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a" / "b"
    assert main(["paper", "blur", "--out", str(out), "--instants", "20", "--seed", "5"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {path.name for path in out.iterdir()} == {"blur.html", "blur.csv"}
    assert lines[0].split() == " ".join(TABLE_HEAD).split()
    assert [line.split()[0] for line in lines[2:10]] == ["reprojection,"] * 4 + ["tracking,"] * 4
    assert lines[-1] == str(out / "blur.html")
    assert "of 20 each" in lines[-2]
    assert len((out / "blur.csv").read_text().splitlines()) == 1 + 20 * 32


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        (["--instants", "5"], "--instants is 5; it should be"),
        (["--seed", "-1"], "--seed is -1; it should be"),
    ],
)
def test_mistakes_exit_with_2_and_name_the_flag(
    words: list[str], fragment: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["paper", "blur", "--out", str(tmp_path / "out"), *words]) == 2
    assert fragment in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_file_in_the_way_is_left_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine")
    assert main(["paper", "blur", "--out", str(tmp_path / "file")]) == 2
    assert f"--out: {tmp_path / 'file'} is a file." in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        ([], "table-i"),
        (["table-x"], "blur"),
        (["blur"], "--out"),
        (["None"], "blur"),
        (["table-i", "--out", "x"], "--kitti"),
        (["table-1.2"], "--out"),
        (["table-1.3"], "--out"),
        (["sun"], "--out"),
    ],
)
def test_words_that_cannot_be_read_exit_with_2(
    words: list[str], fragment: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["paper", *words])
    assert caught.value.code == 2
    assert fragment in capsys.readouterr().err
