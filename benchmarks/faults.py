"""Kill commands at random moments, start many at once, and run them where something is missing.

    python benchmarks/faults.py [--kills 50] [--seed 0] [--only PART] [--folder FOLDER]

After each kill -9 of train, run, compare, convert and fetch (of an archive on disk), the results
must be complete or absent. The same command then gives the bytes of an undisturbed one, and leaves
nothing else; convert refuses to replace a file that is complete. Of two and eight at once with the
same output, at least one succeeds, with the bytes of an undisturbed one, and the others say what is
in their way. In each place where something is missing (memory, file handles, room on the disk,
leave to write, a terminal, ...), each command ends with the exit code 0, or with 2 and a message,
and earlier results stay. POSIX only; a full disk, a read-only one and a system without /tmp need
Linux's unshare, the last also a ``--folder`` that is not below /tmp.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path

import cv2
import numpy as np

from probevo_sim.point_config import PointConfig
from probevo_sim.point_world import simulate_points, write_points

PROBEVO = [sys.executable, "-m", "probevo"]
COMMANDS = {
    "train": "train DRIVE --kind knn --supervision none --iterations 20 --out OUT/m.safetensors",
    "run": "run DRIVE --out OUT",
    "compare": "compare DRIVE --noise fixed student-t --out OUT",
    "convert": "convert RUN --out OUT/odometry.bag",
    "convert-images": "convert IMAGES --out OUT/recording",
    "fetch": "fetch euroc/V1_01_easy --have ARCHIVE --accept-licence --out OUT",
}
IN_PLACES = COMMANDS | {
    "train-by-two": COMMANDS["train"] + " --jobs 2",
}
WRITERS = (2, 8)
SAME_BYTES = (
    "m.safetensors",
    "trajectory.tum",
    "trajectory.kitti.txt",
    "config.yaml",
    "table.tex",
    ".bag",
    ".png",
    "fetched.json",
    "times.txt",
    "calib.yaml",
)
"""Files without times in them."""
PLACES = {
    "no home": "env -u HOME {run}",
    "home is not there": "HOME=/nonexistent {run}",
    "temporary folder is not there": "TMPDIR=/nonexistent {run}",
    "no temporary folder": (
        "unshare -rm bash -c 'for place in /tmp /var/tmp /dev/shm; do mount -t tmpfs -o ro tmpfs"
        " $place; done; {run}'"
    ),
    "stdout closed": "{run} >&-",
    "stdout and stderr closed": "{run} >&- 2>&-",
    "stdin closed": "{run} <&-",
    "no terminal": "setsid {run} </dev/null",
    "64 file handles": "ulimit -n 64; {run}",
    "2 GB of memory": "ulimit -v 2000000; {run}",
    "one core": "taskset -c 0 {run}",
    "locale C": "LC_ALL=C PYTHONUTF8=0 PYTHONCOERCECLOCALE=0 {run}",
    "locale Latin-1": "LC_ALL=en_US.ISO-8859-1 PYTHONUTF8=0 PYTHONIOENCODING=latin-1 {run}",
    "output piped into head": "{run} | head -c 1",
    "files of 10 kB at most": "ulimit -f 10; trap '' XFSZ; {run}",
    "stdout full": "{run} >/dev/full",
    "read-only folder": (
        "unshare -rm bash -c 'mount --bind {out} {out} && mount -o remount,ro,bind {out} && {run}'"
    ),
    "disk full": (
        "cp -a {out} {out}-kept && unshare -rm bash -c 'mount -t tmpfs -o size=16m tmpfs {out} &&"
        " cp -a {out}-kept/. {out} && {{ dd if=/dev/zero of={out}/fill bs=4k; sync; }} 2>/dev/null;"
        " {run}; code=$?; rm {out}/fill; rm -r {out}-kept; cp -a {out} {out}-kept; exit $code'; "
        "code=$?; rm -r {out}; mv {out}-kept {out}; exit $code"
    ),
}


def words_of(command: str, drive: Path, out: Path) -> list[str]:
    places = {
        "DRIVE": drive,
        "RUN": drive.with_suffix(".run"),
        "IMAGES": drive.with_suffix(".images"),
        "ARCHIVE": drive.with_suffix(".zip"),
        "OUT": out,
    }
    for name, place in places.items():
        command = command.replace(name, shlex.quote(str(place)))
    return [*PROBEVO, *shlex.split(command)]


def content(folder: Path) -> dict[str, bytes]:
    """Return all files below a folder, with the folder's own name taken out."""
    own = str(folder).encode()
    return {
        path.relative_to(folder).as_posix(): path.read_bytes().replace(own, b"OUT")
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def stable(files: dict[str, bytes]) -> dict[str, bytes]:
    return {name: data for name, data in files.items() if name.endswith(SAME_BYTES)}


def kill(folder: Path, drive: Path, number: int, rng: np.random.Generator) -> list[str]:
    """Kill each command some times; return what went wrong."""
    faults = []
    for name, command in COMMANDS.items():
        # The first call may compile, which says nothing of how long the others take.
        subprocess.run(words_of(command, drive, folder / name), check=True, capture_output=True)
        whole = folder / f"{name}-whole"
        start_s = time.monotonic()
        subprocess.run(words_of(command, drive, whole), check=True, capture_output=True)
        took_s = time.monotonic() - start_s
        expected = content(whole)
        stages: dict[str, int] = {"absent": 0, "complete": 0}
        for k in range(number):
            out = folder / f"{name}-{k}"
            process = subprocess.Popen(
                words_of(command, drive, out), stdout=subprocess.PIPE, stderr=subprocess.PIPE
            )
            time.sleep(rng.uniform(0.2, 1.1) * took_s)
            process.send_signal(signal.SIGKILL)
            process.communicate()
            completed = stages["complete"]
            faults += [f"{name} {k}: {fault}" for fault in halves(name, out, expected, stages)]
            done = subprocess.run(words_of(command, drive, out), check=False, capture_output=True)
            refuses = name.startswith("convert") and stages["complete"] > completed
            if refuses and done.returncode == 2 and re.search(b"exists|not empty", done.stderr):
                pass  # a file that is complete is never replaced
            elif done.returncode != 0:
                faults.append(f"{name} {k}: does not go on: {done.stderr.decode()}")
                continue
            found = content(out)
            if stable(found) != stable(expected):
                faults.append(f"{name} {k}: other bytes after the kill")
            if found.keys() != expected.keys():
                faults.append(f"{name} {k}: left {sorted(found.keys() ^ expected.keys())}")
        print("\n".join(faults))
        print(f"{name}: {number} kills within {took_s:.1f} s: {stages}", flush=True)
    return faults


def halves(name: str, out: Path, expected: dict[str, bytes], stages: dict[str, int]) -> list[str]:
    """Return which result is neither absent nor complete."""
    found = stable(content(out)) if out.exists() else {}
    found = {key: data for key, data in found.items() if ".part/" not in key}
    found = {key: data for key, data in found.items() if ".work/" not in key}
    stages["complete" if found.keys() == stable(expected).keys() else "absent"] += 1
    faults = [f"{key} is not whole" for key, data in found.items() if data != expected.get(key)]
    # The files of a folder appear together; a comparison has a folder for each of its runs.
    folders = {Path(key).parent for key in found}
    missing = sorted(stable(expected).keys() - found.keys())
    faults += [f"{key} is missing" for key in missing if Path(key).parent in folders]
    return faults


def together(folder: Path, drive: Path) -> list[str]:
    """Start several processes with the same output at once; return what went wrong."""
    faults = []
    for name, command in COMMANDS.items():
        whole = folder / f"{name}-of-one"
        subprocess.run(words_of(command, drive, whole), check=True, capture_output=True)
        expected = content(whole)
        for number in WRITERS:
            out = folder / f"{name}-of-{number}"
            processes = [
                subprocess.Popen(
                    words_of(command, drive, out), stdout=subprocess.PIPE, stderr=subprocess.PIPE
                )
                for _ in range(number)
            ]
            ends = [
                (process.communicate()[1].decode(), process.returncode) for process in processes
            ]
            case = f"{name} by {number}"
            if all(code != 0 for _, code in ends):
                faults.append(f"{case}: none succeeds: {ends[0][0].strip()[-300:]}")
            faults += [
                f"{case}: exit code {code}: {text.strip()[-300:]}"
                for text, code in ends
                if code not in (0, 2)
                or (code == 2 and not re.search("in use by|exists|is not empty", text))
            ]
            found = content(out)
            if stable(found) != stable(expected):
                faults.append(f"{case}: other bytes")
            if found.keys() != expected.keys():
                faults.append(f"{case}: left {sorted(found.keys() ^ expected.keys())}")
            won = sum(code == 0 for _, code in ends)
            print(f"{case}: {won} wrote, {number - won} were told why not", flush=True)
    return faults


def missing(folder: Path, drive: Path) -> list[str]:
    """Run commands in places where something is missing; return what went wrong."""
    strange = folder / os.fsdecode(b"dr\xe4ive \n.npz")
    strange.write_bytes(drive.read_bytes())
    faults = []
    for name, command in IN_PLACES.items():
        whole = folder / f"{name}-elsewhere"
        subprocess.run(words_of(command, drive, whole), check=True, capture_output=True)
        expected = content(whole)
        cases = [(place, line, drive) for place, line in PLACES.items()]
        if "DRIVE" in command:
            cases.append(("name that is no UTF-8", "{run}", strange))
        ends = []
        for place, line, recording in cases:
            out = folder / f"{name}-in-places"
            if not can_be_tried(line, folder):
                ends.append(f"{place} not tried")
                continue
            words = words_of(command, recording, out)
            found, code = in_place(words, line, out, before=expected)
            if recording != drive:  # files and their names contain that of the recording
                found = [fault for fault in found if fault.startswith("exit code")]
            ends.append(f"{place} {code}")
            faults += [f"{name}, {place}: {fault}" for fault in found]
            shutil.rmtree(out)
        print(f"{name}: exit codes: {', '.join(ends)}", flush=True)
    return faults


def can_be_tried(line: str, folder: Path) -> bool:
    """Return whether this system lets us mount, and leaves the folder where it is."""
    if "unshare" not in line:
        return True
    if "/tmp" in line and Path("/tmp") in folder.resolve().parents:
        return False
    return subprocess.run(["unshare", "-rm", "true"], check=False).returncode == 0


def in_place(
    words: list[str], line: str, out: Path, *, before: dict[str, bytes]
) -> tuple[list[str], int]:
    """Run a command in a place; return what went wrong, and the exit code.

    Args:
        words: the command.
        line: the place, as a line of Bash.
        out: the output of the command. Unless it refuses to replace anything, its results of an
            earlier call are there.
        before: these results.
    """
    out.mkdir()
    is_new = "convert" in words or "fetch" in words
    if not is_new:
        for name, data in before.items():
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            (out / name).write_bytes(data)
    done = subprocess.run(
        [
            "bash",
            "-c",
            f"set -o pipefail; {line.format(run=shlex.join(words), out=shlex.quote(str(out)))}",
        ],
        check=False,
        capture_output=True,
        timeout=300,
    )
    faults = []
    text = done.stderr.decode("utf-8", "replace").strip()
    is_silent = done.returncode == 2 and not text and ">&-" not in line
    if "Traceback" in text or is_silent or done.returncode not in (0, 2, 120):
        faults.append(f"exit code {done.returncode}: {text[-600:]}")
    found = content(out)
    if done.returncode == 2:  # what train has done, from which the same command goes on
        found = {name: data for name, data in found.items() if ".work/" not in name}
    is_absent = is_new and not found
    if found.keys() != before.keys() and not is_absent:
        faults.append(f"left {sorted(found.keys() ^ before.keys())[:5]}")
    elif stable(found) != stable(before) and not is_absent:
        faults.append("other bytes than without")
    if done.returncode == 2:
        print(f"    {text[:300]!r}", flush=True)
    return faults, done.returncode


def write_images(folder: Path, rng: np.random.Generator) -> None:
    """Write a recording of images in the layout ``folder``; what they show does not matter."""
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        for number in range(40):
            image = rng.integers(0, 256, (240, 320), dtype=np.uint8)
            cv2.imwrite(str(folder / side / f"{number:06d}.png"), image)
    numbers = {"fu_px": 300.0, "fv_px": 300.0, "cu_px": 160.0, "cv_px": 120.0}
    numbers |= {"baseline_m": 0.5, "width_px": 320, "height_px": 240}
    (folder / "calib.yaml").write_text(
        "".join(f"{key}: {value}\n" for key, value in numbers.items())
    )
    (folder / "times.txt").write_text("".join(f"{0.1 * number:.1f}\n" for number in range(40)))


def main() -> int:
    """Print what was done, and what went wrong; the exit code is 1 if anything did."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=50, help="of all commands together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=("kills", "writers", "places"))
    parser.add_argument("--folder", type=Path, help="where to work; default: a temporary folder")
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    with tempfile.TemporaryDirectory(prefix="faults-", dir=given.folder) as name:
        drive = Path(name) / "drive.npz"
        config = PointConfig(radius_m=3.0, landmarks=400)
        write_points(simulate_points(config, duration_s=4.0, rng=rng), drive)
        with zipfile.ZipFile(drive.with_suffix(".zip"), "w") as packed:
            for number in range(2000):
                packed.writestr(f"mav0/cam0/data/{number}.png", rng.bytes(20_000))
        write_images(drive.with_suffix(".images"), rng)
        run = words_of(COMMANDS["run"], drive, drive.with_suffix(".run"))
        subprocess.run(run, check=True, capture_output=True)
        faults = []
        if given.only in (None, "kills"):
            faults += kill(Path(name), drive, -(-given.kills // len(COMMANDS)), rng)
        if given.only in (None, "writers"):
            faults += together(Path(name), drive)
        if given.only in (None, "places"):
            faults += missing(Path(name), drive)
    print("\n".join(faults))
    print(f"{len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
