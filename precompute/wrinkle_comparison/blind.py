"""Blind pairs: ours beside the truth without names, and how often somebody named them rightly."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from assets.text import read_text
from pbd import InputError
from pbd.storage import replacing
from precompute.learning.truth import Truth
from runtime.draw.picture_content import Drawn, frame_camera
from runtime.draw.pictures import render, save_png, strip
from runtime.draw.shown_body import shown_body
from runtime.play.simulation import body_source

__all__ = ["blind_figures", "write_blind"]

PAIRS, MOMENTS = 12, 3  # pictures, and moments of the motion in each
APART = 0.1  # from one moment of a picture to the next [s]
PICTURE = (400, 460)
KEY = Path("blind_key") / "key.json"


def write_blind(folder: Path, truth: Truth, ours: np.ndarray) -> list[Path]:
    """Draw pairs of rows A and B: one is the truth, the other ours, at random.

    Args:
        folder: pictures go to ``folder / blind``; which row is the truth's goes to ``folder / blind_key``, to be read
            afterwards.
        truth: the true run.
        ours: fine vertices of a free run of the same motion [m], shape (f, N, 3).

    Returns:
        the pictures and the key.
    """
    run, cut = truth.run, truth.levels.subdivision
    body, pattern = body_source(shown_body(run.body, truth.levels)), cut.flat_corners(truth.levels.pattern)
    step = max(1, round(APART / (run.every * run.dt)))
    last = max(len(truth.frames) - 1 - (MOMENTS - 1) * step, 0)
    rng, key, files = np.random.default_rng(), {}, []
    for name in (KEY.parent, Path("blind")):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for number, first in enumerate(np.linspace(0, last, PAIRS).round().astype(int), 1):
        is_first = bool(rng.integers(2))
        columns = []
        for index in np.minimum(first + step * np.arange(MOMENTS), len(truth.frames) - 1):
            posed = np.zeros((len(body.vertices), 3), np.float32)
            body.skin(run.poses[truth.recording.frames[index]], np.zeros(3), posed)
            aspect = PICTURE[0] / PICTURE[1]
            (camera,) = frame_camera(truth.frames[index : index + 1], azimuth_deg=30.0, aspect=aspect, margin=1.15)
            rows = [
                render(
                    [Drawn.body(posed, body.faces), Drawn(frames[index], cut.faces, pattern=pattern)], camera, PICTURE
                )
                for frames in (truth.frames, ours)
            ]
            columns.append(rows if is_first else rows[::-1])
        files.append(folder / "blind" / f"{number:02d}.png")
        save_png(files[-1], strip(columns, [""] * MOMENTS, ["A", "B"]))
        key[files[-1].name] = "A" if is_first else "B"
    files.append(folder / KEY)
    with replacing(files[-1]) as beside:
        beside.write_text(json.dumps(key, indent=1) + "\n", encoding="utf-8")
    return files


def blind_figures(folder: Path, answers: Path) -> dict[str, float]:
    """How well somebody found the truth in the pictures of :func:`write_blind`.

    Args:
        folder: of the pictures' folder and the key's.
        answers: a file with a letter, A or B, on a line for each picture: which row was said to be the truth.

    Returns:
        ``blind_right_percent``: share of the answers that are right [%]; ``blind_chance_percent``: how likely so many
        or more are right by guessing [%] (one-sided binomial test).

    Raises:
        InputError: no key, a line that is no letter of the two, or another number of lines.
    """
    from scipy.stats import binomtest

    if not (folder / KEY).exists():
        raise InputError("no blind pairs", file=folder / KEY, expected="those of gube compare --blind with the same -o")
    key = list(json.loads((folder / KEY).read_text(encoding="utf-8")).values())  # our own file
    said = read_text(answers, "a letter, A or B, on each line").split()
    if len(said) != len(key):
        raise InputError("answers missing or too many", file=answers, received=len(said), expected=f"{len(key)} lines")
    for number, letter in enumerate(said, 1):
        if letter.upper() not in ("A", "B"):
            raise InputError("no such row", file=answers, key=f"line {number}", received=letter, expected="A or B")
    right = sum(letter.upper() == true for letter, true in zip(said, key, strict=True))
    chance = binomtest(right, len(key), 0.5, "greater").pvalue
    return {"blind_right_percent": 100.0 * right / len(key), "blind_chance_percent": 100.0 * float(chance)}
