"""`gube demo`: the whole road on the built-in scene, from nothing to a page with pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

import assets
from assets.io.scene import load_scene
from precompute.learning.evaluation import Evaluation, Truth, body_source
from precompute.learning.pipeline import precompute
from runtime.bake import bake_glb
from runtime.pictures import BODY_COLOR, Camera, Drawn, frame_camera, render, save_png, strip

__all__ = ["draw_moments", "run_demo"]

SCENE = Path(assets.__file__).parent / "data" / "demo.toml"
PICTURE = (560, 640)
MOMENTS = 4


def draw_moments(truth: Truth, evaluation: Evaluation, moments: int = MOMENTS) -> np.ndarray:
    """Coarse, truth and ours side by side at several moments of a free run: uint8, shape (h, w, 3)."""
    source = body_source(truth.run.body)
    picked = np.linspace(0, len(truth.recording.frames) - 1, moments + 2).astype(int)[1:-1]
    levels = truth.levels
    bodies = []
    for index in picked:
        posed = np.zeros((len(source.vertices), 3), np.float32)
        source.skin(truth.run.poses[truth.recording.frames[index]], np.zeros(3), posed)
        bodies.append(posed)
    cameras = frame_camera(
        truth.frames[picked].astype(float), azimuth_deg=30.0, aspect=PICTURE[0] / PICTURE[1], margin=1.15
    )
    kinds = (
        (evaluation.free.coarse, levels.coarse.faces),
        (truth.frames, levels.fine.faces),
        (evaluation.free.frames, levels.fine.faces),
    )
    columns = [
        [
            _picture(frames[index], faces, body, source.faces, camera)
            for index, body, camera in zip(picked, bodies, cameras, strict=True)
        ]
        for frames, faces in kinds
    ]
    seconds = [f"{truth.recording.frames[i] * truth.run.dt:.1f} s" for i in picked]
    return strip(columns, ["coarse", "truth", "ours"], seconds)


def _picture(
    vertices: np.ndarray, faces: np.ndarray, body: np.ndarray, body_faces: np.ndarray, camera: Camera
) -> np.ndarray:
    return render([Drawn(body, body_faces, BODY_COLOR), Drawn(vertices, faces)], camera, PICTURE)


def run_demo(output: Path, report: Callable[[str], None] | None = None) -> dict[str, float]:
    """Learn a small database, play held-out motion and write the animation, the picture and the page.

    Args:
        output: folder for everything; simulated runs are kept in it and found again.
        report: told lines of progress.

    Returns:
        the figures.
    """
    from precompute.wrinkle_comparison.compare import compare
    from precompute.wrinkle_comparison.comparison_page import write_comparison

    tell = report or (lambda line: None)
    result = precompute(load_scene(SCENE), output / "skirt.h5", report=report)
    truth, evaluation = result.truth, result.evaluation
    assert truth is not None and evaluation is not None
    tell("drawing")
    picture = draw_moments(truth, evaluation)
    save_png(output / "demo.png", picture)
    tell("baking the animation")
    frames = truth.recording.frames
    rate = 1.0 / (truth.run.dt * truth.run.every)
    poses = truth.run.poses[frames]
    bake_glb(
        output / "skirt.glb", truth.levels.fine.faces, evaluation.free.frames, rate, body=truth.run.body, poses=poses
    )
    tell("comparing")
    comparison = compare(result.database, truth, report=report)
    write_comparison(output / "index.html", comparison, picture=picture)
    return evaluation.figures
