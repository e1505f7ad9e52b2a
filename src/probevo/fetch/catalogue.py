"""The public recordings that ``probevo fetch`` knows: where they are, their licence and checksums.

Only TUM publishes checksums, as files beside the archives. For all others the table says so, and a
checksum is computed only to be reported.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from difflib import get_close_matches

from probevo.errors import InputError

KITTI = "https://s3.eu-central-1.amazonaws.com/avg-kitti"
EUROC = "http://robotics.ethz.ch/~asl-datasets/ijrr_euroc_mav_dataset"
EUROC_ARCHIVE = "https://www.research-collection.ethz.ch/bitstreams"
TUM_VI = (
    "https://cdn3.vision.in.tum.de/tumvi/exported/euroc/512_16",
    "https://vision.in.tum.de/tumvi/exported/euroc/512_16",
)
TARTAN_AIR = (
    "https://airlab-share.andrew.cmu.edu:8081/tartanair",
    "https://tartanair.blob.core.windows.net/tartanair-release1",
)
EUROC_SEQUENCES = {
    "MH_01_easy": "machine_hall",
    "MH_02_easy": "machine_hall",
    "MH_03_medium": "machine_hall",
    "MH_04_difficult": "machine_hall",
    "MH_05_difficult": "machine_hall",
    "V1_01_easy": "vicon_room1",
    "V1_02_medium": "vicon_room1",
    "V1_03_difficult": "vicon_room1",
    "V2_01_easy": "vicon_room2",
    "V2_02_medium": "vicon_room2",
    "V2_03_difficult": "vicon_room2",
}
TUM_VI_PLACES = {"room": 6, "corridor": 5, "magistrale": 6, "outdoors": 8, "slides": 3}
"""Number of sequences of each place."""
TARTAN_AIR_PLACES = (
    "abandonedfactory",
    "abandonedfactory_night",
    "amusement",
    "carwelding",
    "endofworld",
    "gascola",
    "hospital",
    "japanesealley",
    "neighborhood",
    "ocean",
    "office",
    "office2",
    "oldtown",
)
KITTI_DRIVE = re.compile(r"(20\d\d_\d\d_\d\d)_drive_(\d{4})")


@dataclass(frozen=True)
class RemoteFile:
    """An archive that is downloaded."""

    name: str
    """Name of the file on disk."""
    urls: tuple[str, ...]
    """URLs of the file; the first that answers is taken."""
    md5_suffix: str = ""
    """Suffix of the URL at which the host publishes the MD5 sum; empty if it does not."""
    sha256: str = ""
    """Published SHA-256, in hexadecimal digits; empty if none is published."""

    @property
    def has_checksum(self) -> bool:
        """Whether a published checksum will tell if the file is the right one."""
        return bool(self.md5_suffix or self.sha256)


@dataclass(frozen=True)
class Dataset:
    """Recordings that are fetched together."""

    name: str
    files: tuple[RemoteFile, ...]
    licence: str
    page: str
    """URL at which the authors describe the data set and its terms."""
    size: str
    """Size of all archives, if it is known; else empty."""
    recordings: str
    """Glob pattern of the recordings in the unpacked folder; . is that folder itself."""


@dataclass(frozen=True)
class Family:
    """Data sets of one source: how their names look, and what is common to all."""

    names: str
    """Pattern of the names, for people."""
    examples: tuple[str, ...]
    """All names, or one where a pattern says enough."""
    licence: str
    checksums: str
    size: str


KITTI_LICENCE = "CC BY-NC-SA 3.0: not for commercial use"
EUROC_LICENCE = "© ASL, ETH Zurich; the page has the terms, and asks to cite the paper"
TUM_VI_LICENCE = "CC BY 4.0"
TARTAN_AIR_LICENCE = "CC BY 4.0"
TUM_VI_NAMES = tuple(
    f"tum-vi/{place}{number}"
    for place, count in TUM_VI_PLACES.items()
    for number in range(1, count + 1)
)
TARTAN_AIR_NAMES = tuple(
    f"tartanair/{place}/{level}" for place in TARTAN_AIR_PLACES for level in ("Easy", "Hard")
)
FAMILIES = (
    Family(
        names="kitti-odometry",
        examples=("kitti-odometry",),
        licence=KITTI_LICENCE,
        checksums="none published",
        size="22 GB, all sequences in one archive",
    ),
    Family(
        names="kitti-raw/DATE_drive_NUMBER",
        examples=("kitti-raw/2011_09_26_drive_0005",),
        licence=KITTI_LICENCE,
        checksums="none published",
        size="as its host says",
    ),
    Family(
        names="euroc/SEQUENCE",
        examples=tuple(f"euroc/{name}" for name in [*EUROC_SEQUENCES, "machine_hall"]),
        licence=EUROC_LICENCE,
        checksums="none published",
        size="as its host says; machine_hall, which is all five of it, 12.7 GB",
    ),
    Family(
        names="tum-vi/SEQUENCE",
        examples=TUM_VI_NAMES,
        licence=TUM_VI_LICENCE,
        checksums="MD5, beside each archive",
        size="as its host says; room1 has 1.7 GB",
    ),
    Family(
        names="tartanair/PLACE/Easy, tartanair/PLACE/Hard",
        examples=TARTAN_AIR_NAMES,
        licence=TARTAN_AIR_LICENCE,
        checksums="none published",
        size="as its host says",
    ),
)


def find_dataset(name: str) -> Dataset:
    """Return the data set of a name, such as ``euroc/MH_01_easy``.

    Raises:
        InputError: there is no such data set; a similar name is suggested.
    """
    source, _, part = name.strip("/").partition("/")
    dataset = None
    if source == "kitti-odometry" and not part:
        dataset = _kitti_odometry()
    elif source == "kitti-raw" and (match := KITTI_DRIVE.fullmatch(part.removesuffix("_sync"))):
        dataset = _kitti_raw(date=match[1], drive=match[0])
    elif source == "euroc" and (part in EUROC_SEQUENCES or part == "machine_hall"):
        dataset = _euroc(part)
    elif f"{source}/{part}" in TUM_VI_NAMES:
        dataset = _tum_vi(part)
    elif f"{source}/{part}" in TARTAN_AIR_NAMES:
        dataset = _tartan_air(part)
    if dataset is not None:
        return dataset
    known = [example for family in FAMILIES for example in family.examples]
    similar = get_close_matches(name, known, n=3, cutoff=0.5)
    cure = f"Did you mean {', or '.join(similar)}?" if similar else ""
    if not cure:
        cure = f"Names are {'; '.join(family.names for family in FAMILIES)}."
    raise InputError(name, "no such data set is known.", cure)


def _kitti_odometry() -> Dataset:
    files = ("data_odometry_gray.zip", "data_odometry_calib.zip", "data_odometry_poses.zip")
    return Dataset(
        name="kitti-odometry",
        files=tuple(RemoteFile(file, (f"{KITTI}/{file}",)) for file in files),
        licence=KITTI_LICENCE,
        page="https://www.cvlibs.net/datasets/kitti/eval_odometry.php",
        size="22 GB",
        recordings="dataset/sequences/*",
    )


def _kitti_raw(date: str, drive: str) -> Dataset:
    return Dataset(
        name=f"kitti-raw/{drive}",
        files=(
            RemoteFile(f"{drive}_sync.zip", (f"{KITTI}/raw_data/{drive}/{drive}_sync.zip",)),
            RemoteFile(f"{date}_calib.zip", (f"{KITTI}/raw_data/{date}_calib.zip",)),
        ),
        licence=KITTI_LICENCE,
        page="https://www.cvlibs.net/datasets/kitti/raw_data.php",
        size="",
        recordings="*/*_sync",
    )


def _euroc(part: str) -> Dataset:
    page = "https://projects.asl.ethz.ch/datasets/doku.php?id=kmavvisualinertialdatasets"
    if part == "machine_hall":
        url = f"{EUROC_ARCHIVE}/7b2419c1-62b5-4714-b7f8-485e5fe3e5fe/download"
        file = RemoteFile("machine_hall.zip", (url,))
        size = "12.7 GB"
        recordings = "machine_hall/*/*"
    else:
        url = f"{EUROC}/{EUROC_SEQUENCES[part]}/{part}/{part}.zip"
        file = RemoteFile(f"{part}.zip", (url,))
        size = ""
        recordings = "."
    return Dataset(
        name=f"euroc/{part}",
        files=(file,),
        licence=EUROC_LICENCE,
        page=page,
        size=size,
        recordings=recordings,
    )


def _tum_vi(part: str) -> Dataset:
    name = f"dataset-{part}_512_16.tar"
    return Dataset(
        name=f"tum-vi/{part}",
        files=(RemoteFile(name, tuple(f"{host}/{name}" for host in TUM_VI), md5_suffix=".md5"),),
        licence=TUM_VI_LICENCE,
        page="https://cvg.cit.tum.de/data/datasets/visual-inertial-dataset",
        size="1.7 GB" if part == "room1" else "",
        recordings="dataset-*",
    )


def _tartan_air(part: str) -> Dataset:
    files = []
    for side in ("left", "right"):
        urls = tuple(f"{host}/{part}/image_{side}.zip" for host in TARTAN_AIR)
        files.append(RemoteFile(f"image_{side}.zip", urls))
    return Dataset(
        name=f"tartanair/{part}",
        files=tuple(files),
        licence=TARTAN_AIR_LICENCE,
        page="https://theairlab.org/tartanair-dataset/",
        size="",
        recordings="**/P[0-9][0-9][0-9]",
    )
