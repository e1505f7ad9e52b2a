"""Render sheets of every preset and every effect of the simulated scenes.

They are docs/images/presets.jpg and docs/images/effects.jpg:

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
"""Time at which the effects are shown: in a bend, with the sun from behind."""
SHADOWS_LATER_FRAMES = 6
"""Frames after that at which the shadows are shown."""


def scene(preset: PresetName, seed: int = SEED, **effects: float) -> SceneRecording:
    """Open a drive through a preset with these effects."""
    return open_scene(SceneConfig(preset=preset, seed=seed, effects=Effects(**effects)))


def labelled(image: Image, text: str) -> Image:
    """Return a copy of an image with a label in its upper left corner."""
    image = image.copy()
    cv2.rectangle(image, (0, 0), (8 + 9 * len(text), 19), 20, cv2.FILLED)
    cv2.putText(
        image,
        text,
        org=(5, 14),
        fontFace=cv2.FONT_HERSHEY_SIMPLEX,
        fontScale=0.5,
        color=240,
        thickness=1,
        lineType=cv2.LINE_AA,
    )
    return image


def write_sheet(path: Path, tiles: list[Image], columns: int) -> None:
    """Write images as one, row by row."""
    rows = [np.hstack(tiles[k : k + columns]) for k in range(0, len(tiles), columns)]
    cv2.imwrite(str(path), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, 82])
    print(path)


def write_presets(path: Path) -> None:
    """Write three frames of each preset."""
    tiles = []
    for preset in get_args(PresetName):
        recording = scene(preset)
        for share in (0.05, 0.35, 0.65):
            left, _ = recording.images(int(share * len(recording)))
            tiles.append(labelled(left, preset))
    write_sheet(path, tiles, columns=3)


def mismatch(recording: SceneRecording, index: int) -> Image:
    """Return five times the difference of the images, warped by the true disparity."""
    left, right = recording.images(index)
    disparity_px = recording.pixel_truth(index).disparity_px.astype(np.float32)
    v, u = np.mgrid[: left.shape[0], : left.shape[1]].astype(np.float32)
    warped = cv2.remap(right, u - disparity_px, v, cv2.INTER_CUBIC).astype(float)
    return np.clip(np.abs(warped - left) * 5.0, 0, 255).astype(np.uint8)


def write_effects(path: Path) -> None:
    """Write a frame and its successor without effects, and with each effect at full strength."""
    clean = scene(PRESET)
    index = int(AT_S * clean.config.rig.rate_hz)
    tiles = [
        labelled(clean.images(index)[0], "clean"),
        labelled(clean.images(index + 1)[0], "clean, next frame"),
    ]
    for name in Effects.model_fields:
        recording = scene(PRESET, **{name: 1.0})
        if name == "rectification":
            # Too small an effect to be seen but in the difference of the two images.
            for label, shown in (("clean", clean), (name, recording)):
                difference = mismatch(shown, index)
                tiles.append(labelled(difference, f"{label}: left against right, x 5"))
            continue
        first = index + SHADOWS_LATER_FRAMES if name == "shadows" else index
        tiles.append(labelled(recording.images(first)[0], name))
        tiles.append(labelled(recording.images(first + 1)[0], f"{name}, next frame"))
    write_sheet(path, tiles, columns=2)


def main() -> None:
    """Write both sheets."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    write_presets(folder / "presets.jpg")
    write_effects(folder / "effects.jpg")


if __name__ == "__main__":
    main()
