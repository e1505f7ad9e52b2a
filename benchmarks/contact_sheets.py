"""Pictures of every preset and every effect of the simulated scenes: docs/images/presets.jpg and
effects.jpg.

python benchmarks/contact_sheets.py [folder]
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import get_args

import cv2
import numpy as np

from probevo.arrays import Image
from probevo_sim.scene.config import Effects, PresetName, SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images"
PRESET = "city"
SEED = 1
AT_S = 3.4
"""Of the effects: a moment in a bend, with the sun from behind."""


def scene(preset: PresetName, seed: int = SEED, **effects: float) -> SceneRecording:
    return open_scene(SceneConfig(preset=preset, seed=seed, effects=Effects(**effects)))


def labelled(image: Image, text: str) -> Image:
    image = image.copy()
    cv2.rectangle(image, (0, 0), (8 + 9 * len(text), 19), 20, cv2.FILLED)
    cv2.putText(image, text, (5, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 240, 1, cv2.LINE_AA)
    return image


def sheet(path: Path, tiles: list[Image], columns: int) -> None:
    rows = [np.hstack(tiles[k : k + columns]) for k in range(0, len(tiles), columns)]
    cv2.imwrite(str(path), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, 82])
    print(path)


def presets(path: Path) -> None:
    tiles = []
    for preset in get_args(PresetName):
        recording = scene(preset)
        for share in (0.05, 0.35, 0.65):
            tiles.append(labelled(recording.images(int(share * len(recording)))[0], preset))
    sheet(path, tiles, columns=3)


def mismatch(recording: SceneRecording, index: int) -> Image:
    """What is left of the right image when the left one, moved by the true disparity, is taken off;
    five times."""
    left, right = recording.images(index)
    disparity = recording.pixel_truth(index).disparity_px.astype(np.float32)
    v, u = np.mgrid[: left.shape[0], : left.shape[1]].astype(np.float32)
    seen = cv2.remap(right, u - disparity, v, cv2.INTER_CUBIC).astype(float)
    return np.clip(np.abs(seen - left) * 5.0, 0, 255).astype(np.uint8)


def effects(path: Path) -> None:
    clean = scene(PRESET)
    index = int(AT_S * clean.config.rig.rate_hz)
    tiles = [
        labelled(clean.images(index)[0], "clean"),
        labelled(clean.images(index + 1)[0], "clean, next frame"),
    ]
    for name in Effects.model_fields:
        recording = scene(PRESET, **{name: 1.0})
        if name == "rectification":
            tiles.append(labelled(mismatch(clean, index), "clean: left against right, x 5"))
            tiles.append(
                labelled(mismatch(recording, index), "rectification: left against right, x 5")
            )
            continue
        later = index + 6 if name == "shadows" else index
        tiles.append(labelled(recording.images(later)[0], name))
        tiles.append(labelled(recording.images(later + 1)[0], f"{name}, next frame"))
    sheet(path, tiles, columns=2)


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    presets(folder / "presets.jpg")
    effects(folder / "effects.jpg")


if __name__ == "__main__":
    main()
