"""The classes of input: recordings and files to mutate, and what is then done with them."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import shutil
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.random import Generator
from pydantic import BaseModel

import probevo as pv
from fuzz.mutations import (
    TOKENS,
    mutated_archive,
    mutated_arrays,
    mutated_bytes,
    mutated_text,
    mutated_value,
    one_of,
)
from probevo.cli.main import main
from probevo.errors import ProbevoError
from probevo.noise import model_file
from probevo.noise.model_io import load_model, save_model
from probevo.run_config import RunConfig, config_text, read_config
from probevo.sequences import open_sequence
from probevo.sequences.calibrations.calibration_files import read_stereo_calibration
from probevo.sequences.pose_files import read_kitti_poses, read_tum
from probevo.sequences.yaml_file import load_yaml
from probevo.storage.npz import read_npz
from sequences import recordings as tiny

Files = dict[str, bytes]
"""Content of files by their path in a folder."""
Mutate = Callable[[Files, str, Generator], Files]
"""Returns other files; called with the files, and with the name of the one to mutate."""
Use = Callable[[Path, Generator], object]
"""Uses the recording or the file; returns what may be compared, or None."""
WORD_ENDS = (".txt", ".csv", ".yaml", ".tum")


class InvalidResultError(Exception):
    """A result breaks a promise: a pose or a covariance is not finite, or an exit code is wrong."""


@dataclass(frozen=True)
class Seed:
    """Valid input to begin with."""

    files: Files
    entry: str
    """The path to open."""
    chosen: tuple[str, ...]
    """The files to mutate."""


@dataclass(frozen=True)
class Target:
    """A class of input."""

    name: str
    seeds: tuple[Seed, ...]
    mutate: Mutate
    use: Use
    is_protected: bool = False
    """Whether checksums cover the files, so that damage must not change a result in silence."""

    def attempt(self, seed: int, number: int, folder: Path) -> tuple[str, str]:
        """Make a mutant and use it: ``value``, ``refused`` with the message, or ``silent``."""
        start, files, rng = self.mutant(seed, number)
        write_files(folder, files)
        try:
            found = self.use(folder / start.entry, rng)
        except ProbevoError as error:
            return "refused", str(error)
        if self.is_protected and not _is_same(found, self.use_seed(start)):
            return "silent", "another result, though a checksum could tell"
        return "value", ""

    def mutant(self, seed: int, number: int) -> tuple[Seed, Files, Generator]:
        """Return the seed, the mutated files, and the generator after that."""
        rng = np.random.default_rng([seed, zlib.crc32(self.name.encode()), number])
        start = one_of(self.seeds, rng)
        return start, self.mutate(start.files, one_of(start.chosen, rng), rng), rng

    def use_seed(self, start: Seed) -> object:
        """Use the files as they were."""
        with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
            write_files(Path(name) / "seed", start.files)
            return self.use(Path(name) / "seed" / start.entry, np.random.default_rng(0))


def _is_same(found: object, expected: object) -> bool:
    if isinstance(found, dict) and isinstance(expected, dict):
        return found.keys() == expected.keys() and all(
            _bytes_of(found[key]) == _bytes_of(expected[key]) for key in found
        )
    return found == expected


def _bytes_of(value: object) -> object:
    return (value.dtype, value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value


def write_files(folder: Path, files: Files) -> None:
    """Make a folder hold these files and nothing else."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def read_files(folder: Path) -> Files:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


# What is mutated.


def change(edit: Callable[[bytes, Generator], bytes]) -> Mutate:
    return lambda files, name, rng: files | {name: edit(files[name], rng)}


def other_yaml(data: bytes, rng: Generator) -> bytes:
    """Change the text, or a value."""
    if rng.random() < 0.4:
        return mutated_text(data, rng)
    content = yaml.safe_load(data.decode().replace("%YAML:1.0", ""))
    return yaml.dump(mutated_value(content, rng), sort_keys=False).encode()


def other_archive(data: bytes, rng: Generator) -> bytes:
    """Change arrays, the headers of arrays, or the bytes."""
    with np.load(io.BytesIO(data)) as archive:
        arrays = dict(archive)
    kind = rng.random()
    if kind < 0.2:
        return mutated_bytes(data, rng)
    if kind < 0.5:
        return mutated_archive(arrays, rng)
    buffer = io.BytesIO()
    np.savez(buffer, **mutated_arrays(arrays, rng))  # type: ignore[arg-type]
    return buffer.getvalue()


def other_model(data: bytes, rng: Generator) -> bytes:
    """Change metadata or arrays, and give them a right checksum."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        path = Path(name) / "model.safetensors"
        path.write_bytes(data)
        content = model_file.read_model_file(path)
        kind, arrays, facts = content.kind, dict(content.arrays), dict(content.facts)
        if rng.random() < 0.6:
            facts = mutated_value(facts, rng)
        else:
            arrays = mutated_arrays(arrays, rng)
        if rng.random() < 0.05:
            kind = str(one_of((*TOKENS, "knn", "gk", "student-t"), rng))
        try:
            model_file.write_model_file(path, model_file.ModelFile(kind, arrays, facts))
        except (ValueError, TypeError, UnicodeError, RecursionError):
            return mutated_bytes(data, rng)
        return path.read_bytes()


def other_png(data: bytes, rng: Generator) -> bytes:
    """Change the chunks of a PNG file, with right checksums, or its bytes."""
    if rng.random() < 0.2:
        return mutated_bytes(data, rng)
    chunks = []
    place = 8
    while place < len(data):
        size = int.from_bytes(data[place : place + 4], "big")
        chunks.append((data[place + 4 : place + 8], data[place + 8 : place + 8 + size]))
        place += size + 12
    k = int(rng.integers(len(chunks)))
    kind, body = chunks[k]
    edit = rng.integers(5)
    if edit == 0 and len(chunks) > 1:
        del chunks[k]
    elif edit == 1:
        chunks.insert(int(rng.integers(len(chunks))), chunks[k])
    elif edit == 2:
        chunks[k] = (one_of((b"IHDR", b"IDAT", b"PLTE", b"tRNS", b"gAMA", b"xxXx"), rng), body)
    else:
        if kind == b"IDAT" and rng.random() < 0.5:
            body = zlib.compress(mutated_bytes(zlib.decompress(body), rng))
        else:
            body = mutated_bytes(body, rng)
        chunks[k] = (kind, body)
    parts = [data[:8]]
    for kind, body in chunks:
        checksum = zlib.crc32(kind + body).to_bytes(4, "big")
        parts.append(len(body).to_bytes(4, "big") + kind + body + checksum)
    return b"".join(parts)


# What is done with it.


def step_all(path: Path, rng: Generator, **options: Any) -> None:
    """Open a recording and run the odometry over it; sometimes describe it or run the command."""
    kind = rng.random()
    if kind < 0.15 and not options:
        command(["info", str(path)])
    elif kind < 0.17 and not options:
        command(["run", str(path), "--out", str(path.parent / "out-of-run")])
    sequence = open_sequence(path, **options)
    odometry = pv.StereoOdometry(sequence.camera, imu=sequence.imu)
    for frame in islice(sequence, 6):
        check(odometry.step(frame))


def check(motion: Any) -> None:
    """Check that a motion is one: a rotation, and a covariance without negative variances."""
    T, cov = motion.T_curr_prev, motion.cov
    if not (np.isfinite(T).all() and np.isfinite(cov).all()):
        raise InvalidResultError("a motion or its covariance is not finite")
    if np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() > 1e-6:
        raise InvalidResultError("the rotation of a motion is none")
    if np.linalg.eigvalsh(cov).min() < -1e-9 * max(np.abs(cov).max(), 1e-9):
        raise InvalidResultError("a covariance has a negative eigenvalue")


def command(words: list[str]) -> object:
    """Call a command; it ends with the exit code 0, or with 2 and a message.

    Returns:
        The exit code.
    """
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code: object = main(words)
        except SystemExit as stop:
            code = stop.code
    if code not in (0, 2, None):
        raise InvalidResultError(f"exit code {code}: {' '.join(words)}")
    if code == 2 and not (err.getvalue() or out.getvalue()).strip():
        raise InvalidResultError(f"exit code 2 without a message: {' '.join(words)}")
    return code


def use_images(path: Path, rng: Generator) -> object:
    step_all(path, np.random.default_rng(1))
    return {
        f"{side} {frame.index}": image
        for frame in open_sequence(path)
        for side, image in (("left", frame.left), ("right", frame.right))
    }


def use_archive(path: Path, rng: Generator) -> object:
    """Read all arrays; damaged bytes must not give other ones."""
    try:
        arrays: object = read_npz(path)
    except (OSError, ValueError, TypeError, EOFError, NotImplementedError, RuntimeError) as error:
        raise ProbevoError(str(error)) from error
    except Exception as error:
        from probevo.storage.npz import NO_NPZ

        if isinstance(error, NO_NPZ):
            raise ProbevoError(str(error)) from error
        raise
    return arrays


def use_model(path: Path, rng: Generator) -> None:
    model = load_model(path)
    for spread in (1.0, 1e6):
        noise = model.predict(rng.normal(0.0, spread, (5, len(model.columns))))
        if not np.isfinite(noise.scale).all():
            raise InvalidResultError("a predicted covariance is not finite")
    if rng.random() < 0.03:
        command(["inspect", "--model", str(path), "--out", str(path.parent / "page")])


def read_model(path: Path, rng: Generator) -> object:
    content = model_file.read_model_file(path)
    return {"kind": content.kind, "facts": content.facts, **content.arrays}


def use_config(path: Path, rng: Generator) -> None:
    config = read_config(path)
    config_text(config)
    sequence = open_sequence(path.parent / "tracks.npz")
    odometry = pv.StereoOdometry(sequence.camera, imu=sequence.imu, config=config)
    for frame in islice(sequence, 3):
        check(odometry.step(frame))


def use_calibration(path: Path, rng: Generator) -> None:
    read_stereo_calibration(path, (64, 48) if rng.random() < 0.5 else None)
    step_all(path.parent / "raw", np.random.default_rng(1), calibration=path)


def use_poses(path: Path, rng: Generator) -> None:
    read = read_tum if path.suffix == ".tum" else read_kitti_poses
    read(path)
    words = [str(path), "--gt", str(path.parent / f"truth{path.suffix}")]
    command(["eval", *(words if rng.random() < 0.5 else [words[2], "--gt", words[0]])])


def use_flags(path: Path, rng: Generator) -> None:
    words = path.read_text("utf-8", "surrogateescape").split("\x1f")
    with contextlib.chdir(path.parent):
        if command(words) == 2:
            raise ProbevoError("exit code 2")  # counted as a refusal


# Where it begins.


def texture(index: int, right: bool, rng: Generator) -> Any:
    """A wall of bricks that moves by 2 px a frame; it is 4 px farther left in the right image."""
    bricks = np.random.default_rng(5).integers(9, 256, (24, 40), dtype=np.uint8)
    wall = np.kron(bricks, np.ones((4, 4), np.uint8))
    start = 20 + (4 if right else 0) + 2 * index
    return wall[: tiny.HEIGHT_PX, start : start + tiny.WIDTH_PX].copy()


def recording_seed(
    write: Callable[[Path], Path], chosen: tuple[str, ...] = WORD_ENDS, suffix: str = ".png"
) -> Seed:
    """Write a recording whose images can be tracked; choose its files of some endings."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        root = Path(name)
        entry = write(root).relative_to(root).as_posix()
        for right in (False, True):
            folders = ("right", "image_1", "image_01/data", "cam1/data")
            if not right:
                folders = ("left", "image_0", "image_00/data", "cam0/data")
            images = [
                path
                for path in sorted(root.rglob("*.png"))
                if path.parent.as_posix().endswith(folders)
            ]
            for index, path in enumerate(images):
                pixels = texture(index, right, np.random.default_rng(0))
                path.unlink()
                tiny.write_image(path.with_suffix(suffix), pixels)
        files = read_files(root)
    return Seed(files, entry, tuple(name for name in files if name.endswith(chosen)))


def bag_seed(kind: str) -> Seed:
    """Write a bag of a folder recording."""
    from sequences.bags import write_bag

    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        folder = tiny.write_folder_sequence(Path(name) / "folder", frames=3)
        (Path(name) / "bags").mkdir()
        path = write_bag(Path(name) / "bags" / "drive", kind, open_sequence(folder))
        files = read_files(Path(name) / "bags")
        entry = path.relative_to(Path(name) / "bags").as_posix()
    return Seed(files, entry, tuple(files))


KIND_OF_ENTRY = {"drive.bag": "bag", "drive.mcap": "single mcap"}


def field_seed(kind: str) -> Seed:
    """Write a bag with the name that mutants of its messages have."""
    from fuzz.bag_fields import hostile_files

    entry, files = hostile_files(kind, tracked_messages(), None)
    return Seed(files, entry, (entry,))


@cache
def tracked_messages() -> list[Any]:
    """Return the messages of a short recording whose images can be tracked."""
    from sequences.bags import messages_of

    seed = recording_seed(lambda root: tiny.write_folder_sequence(root / "drive", frames=3))
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        write_files(Path(name), seed.files)
        return messages_of(open_sequence(Path(name) / seed.entry))


def other_bag(files: Files, name: str, rng: Generator) -> Files:
    """Write the bag anew with hostile fields; framing, lengths and checksums are right."""
    from fuzz.bag_fields import hostile_files

    del files
    return hostile_files(KIND_OF_ENTRY[name], tracked_messages(), rng)[1]


def model_seeds() -> tuple[Seed, ...]:
    """Train a small model of each kind, by given hyperparameters: their choice takes long."""
    from probevo.config.training import KernelSettings, TrainSettings
    from probevo.training.api import train_model

    kernel = KernelSettings(iterations=1, neighbors=50, prior_counts=8.0, centers=100)
    options: dict[str, dict[str, Any]] = {
        "knn": {"iterations": 2, "neighbors": 20, "exponent": 2.0},
        "gk": {"gk": kernel},
        "student-t": {},
    }
    seeds = []
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        drive = write_drive(Path(name) / "drive.npz")
        for kind, of_kind in options.items():
            path = Path(name) / f"{kind}.safetensors"
            settings = TrainSettings(kind=kind, supervision="none", **of_kind)
            train_model([drive], settings, path)
            save_model(load_model(path), path)
            seeds.append(Seed({path.name: path.read_bytes()}, path.name, (path.name,)))
    return tuple(seeds)


def write_drive(path: Path) -> Path:
    """Write a tracks file with enough landmarks to learn from."""
    from probevo_sim.point_config import PointConfig
    from probevo_sim.point_world import simulate_points, write_points

    config = PointConfig(radius_m=3.0, landmarks=400)
    write_points(simulate_points(config, duration_s=2.0, rng=np.random.default_rng(0)), path)
    return path


def calibration_seeds() -> tuple[Seed, ...]:
    """Write calibrations of several programs, each beside a raw recording."""
    from sequences.calibrations import test_calibration_files as kinds

    def kalibr(folder: Path) -> Path:
        return kinds.write_yaml(folder / "camchain.yaml", kinds.kalibr())

    def ros(folder: Path) -> Path:
        kinds.write_ros(folder)
        return folder / "left.yaml"

    def opencv(folder: Path) -> Path:
        path = folder / "stereo.yml"
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", 64)
        storage.write("image_height", 48)
        for k, intrinsics in ((1, kinds.LEFT_K), (2, kinds.RIGHT_K)):
            storage.write(f"cameraMatrix{k}", kinds.camera_matrix(intrinsics))
            storage.write(f"distCoeffs{k}", np.array([kinds.RADTAN]))
        storage.write("R", kinds.T_RIGHT_LEFT[:3, :3].copy())
        storage.write("T", kinds.T_RIGHT_LEFT[:3, 3:].copy())
        storage.release()
        return path

    def orb_slam(folder: Path) -> Path:
        kinds.test_orb_slam3(folder)
        return folder / "EuRoC.yaml"

    seeds = []
    for write in (kalibr, ros, opencv, orb_slam):
        with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
            root = Path(name)
            path = write(root)
            chosen = tuple(read_files(root))
            kinds.write_raw_pair(root / "raw")
            tiny.write_lines(root / "raw" / "times.txt", ["0.0", "0.1", "0.2"])
            seeds.append(Seed(read_files(root), path.name, chosen))
    return tuple(seeds)


def pose_seeds() -> tuple[Seed, ...]:
    """Write a path in both formats."""
    from probevo.sequences.pose_files import write_kitti_poses, write_tum

    T = tiny.poses(30)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        for stem in ("path", "truth"):
            write_tum(Path(name) / f"{stem}.tum", tiny.stamps_ns(30), T)
            write_kitti_poses(Path(name) / f"{stem}.txt", T)
        files = read_files(Path(name))
    return tuple(Seed(files, f"path{end}", (f"path{end}",)) for end in (".tum", ".txt"))


def flag_names(model: type[BaseModel], prefix: str = "--") -> list[str]:
    """Return the flags of all settings."""
    names = []
    for name, field in model.model_fields.items():
        flag = prefix + name.replace("_", "-")
        kind = field.annotation
        is_section = isinstance(kind, type) and issubclass(kind, BaseModel)
        names += flag_names(kind, f"{flag}.") if is_section else [flag]  # type: ignore[arg-type]
    return names


VALID_WORDS = (
    ("--noise", "fixed"),
    ("--max-frames", "3"),
    ("--seed", "5"),
    ("--tracking.num-features", "120"),
    ("--ransac.confidence", "0.9"),
    ("--no-self-calibration",),
)


def other_flags(files: Files, name: str, rng: Generator) -> Files:
    """Compose a command of wrong flags, values and paths; it writes below its own folder.

    One in five has nothing wrong, so that the rest is not refused for the same reason.
    """
    if rng.random() < 0.2:
        words = ["run", str(one_of(("folder", "tracks.npz"), rng)), "--out", "out"]
        for k in rng.permutation(len(VALID_WORDS))[: rng.integers(0, 4)].tolist():
            words += VALID_WORDS[k]
        return files | {name: "\x1f".join(words).encode()}
    command = one_of(("run", "train", "info", "inspect", "eval", "compare", "simulate", "x"), rng)
    if command == "train":
        from probevo.config.training import TrainSettings

        flags = flag_names(TrainSettings)
    else:
        flags = flag_names(RunConfig)
    paths = ("folder", "tracks.npz", "missing", "calib.yaml", "", ".", "a\nb", "é" * 200, "model")
    words = [command, str(one_of(paths[:2] if rng.random() < 0.7 else paths, rng))]
    for _ in range(rng.integers(1, 4)):
        flag = one_of([*flags, "--gt", "--kind", "--noise", "--frame", "--model", "--nope"], rng)
        value = one_of((*TOKENS, "5", "0.5", "3", "tracks.npz", "student-t", "gk", "fixed"), rng)
        words.append(flag)
        if rng.random() < 0.85:
            words.append(value.replace("\x00", "0"))
    out = one_of(("out", "out", "tracks.npz", "a/b", "x" * 300, "é"), rng)
    words += ["--out", f"{out}.safetensors" if command == "train" else out]
    if rng.random() < 0.1:
        words += ["--threads", one_of(("0", "-1", "x", "1"), rng)]
    return files | {name: "\x1f".join(words).encode("utf-8", "surrogateescape")}


def all_targets() -> dict[str, Target]:
    """Make all classes; trains three small models."""
    folder = recording_seed(lambda root: tiny.write_folder_sequence(root / "drive"))
    others = [recording_seed(tiny.write_kitti_odometry), recording_seed(tiny.write_kitti_raw)]
    euroc = recording_seed(tiny.write_euroc)
    tracks = recording_seed(
        lambda root: tiny.write_tracks(root, 4, **tiny.tracks_arrays(points=40)), (".npz",)
    )
    jpeg = recording_seed(
        lambda root: tiny.write_folder_sequence(root / "drive"), (".jpg",), suffix=".jpg"
    )

    def only(seed: Seed, *ends: str) -> Seed:
        return Seed(seed.files, seed.entry, tuple(n for n in seed.files if n.endswith(ends)))

    flags = folder.files | tracks.files | {"flags": b""}
    flags = {name.replace("drive/", "folder/"): data for name, data in flags.items()}
    config = {"config.yaml": config_text(RunConfig()).encode(), **tracks.files}
    models = model_seeds()
    text = change(mutated_text)
    found = [
        Target("text", (*others, only(euroc, ".csv"), only(folder, "times.txt")), text, step_all),
        Target("imu", (only(folder, "imu.csv"), only(euroc, "imu0/data.csv")), text, step_all),
        Target("yaml", (only(folder, ".yaml"), only(euroc, ".yaml")), change(other_yaml), step_all),
        Target("npz", (tracks,), change(other_archive), step_all),
        Target("npz bytes", (tracks,), change(mutated_bytes), use_archive, is_protected=True),
        Target("model", models, change(other_model), use_model),
        Target("model bytes", models, change(mutated_bytes), read_model, is_protected=True),
        Target(
            "config",
            (Seed(config, "config.yaml", ("config.yaml",)),),
            change(other_yaml),
            use_config,
        ),
        Target("png", (only(folder, ".png"),), change(other_png), step_all),
        Target(
            "png bytes",
            (only(folder, ".png"),),
            change(mutated_bytes),
            use_images,
            is_protected=True,
        ),
        Target("jpeg", (jpeg,), change(mutated_bytes), step_all),
        Target("calibration", calibration_seeds(), change(other_yaml_or_text), use_calibration),
        Target("poses", pose_seeds(), text, use_poses),
        Target("flags", (Seed(flags, "flags", ("flags",)),), other_flags, use_flags),
    ]
    if importlib.util.find_spec("rosbags") is not None:  # an extra
        bags = tuple(bag_seed(kind) for kind in ("bag", "db3"))
        mcap = tuple(bag_seed(kind) for kind in ("mcap", "single mcap"))
        found.append(Target("bag", bags, change(mutated_bytes), step_all))
        found.append(Target("mcap", mcap, change(mutated_bytes), step_all))
        fields = tuple(field_seed(kind) for kind in ("bag", "single mcap"))
        found.append(Target("bag fields", fields, other_bag, step_all))
    return {target.name: target for target in found}


def other_yaml_or_text(data: bytes, rng: Generator) -> bytes:
    """Change a value of a YAML file, or the text of one that PyYAML does not read."""
    try:
        return other_yaml(data, rng)
    except yaml.YAMLError:
        return mutated_text(data, rng)


__all__ = ["Target", "all_targets", "load_yaml"]
