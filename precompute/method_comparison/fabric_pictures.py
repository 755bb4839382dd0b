"""One skirt in three fabrics, side by side at the same moments of one motion, which differ by their folds alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np

from assets.fabrics import PRESETS
from assets.io.body_settings import MotionSettings
from assets.io.scene import load_scene
from pbd import Fabric, ModelOptions
from precompute.demo_run import FULL
from precompute.experiment.measures import FRAME_RATE
from precompute.learning.run_recording import Run, record_runs
from runtime.draw.picture_content import Drawn, frame_camera
from runtime.draw.pictures import render, strip
from runtime.play.simulation import body_source, poses_of
from runtime.setup.garment_setup import GarmentSetup, fine_options

__all__ = ["FABRICS", "draw_fabrics", "fabric_runs"]

# Felt of 3 mm bends as no woven cloth does: l_g is 5 cm, that of silk 1.6 cm.
FELT = Fabric(0.40, 3000.0, 3000.0, 0.2, 1200.0, 6e-4, 6e-4, friction=0.5)
FABRICS = MappingProxyType({"silk": PRESETS["silk"], "denim": PRESETS["denim"], "felt": FELT})
CLIP, SECONDS = "twirl", 2.3  # of the mannequin
MOMENTS = (0.7, 2.2)  # it stands, it turns [s]
PICTURE = (460, 420)


def fabric_runs(*, subdivisions: int = 2, seconds: float = SECONDS) -> list[Run]:
    """The fine skirt of the demo in each fabric on the same motion.

    Args:
        subdivisions: of the skirt's mesh.
        seconds: of the motion.
    """
    scene = load_scene(FULL.scene)
    garment = replace(scene.garments[0], subdivisions=subdivisions)
    stage = GarmentSetup.of(replace(scene, garments=(garment,)))
    motion = stage.motion(MotionSettings(file="builtin:mannequin", clip=CLIP))
    solver = fine_options(scene, subdivisions)
    make = partial(
        Run,
        levels=stage.levels,
        fine=True,
        body=stage.body,
        poses=poses_of(motion, 1.0 / FRAME_RATE, seconds),
        dt=1.0 / FRAME_RATE,
        options=ModelOptions(),
        solver=solver,
    )
    return [make(name=name, fabric=fabric) for name, fabric in FABRICS.items()]


def draw_fabrics(
    runs: Sequence[Run],
    cache: Path,
    *,
    moments: Sequence[float] = MOMENTS,
    workers: int = 2,
    report: Callable[[str], None] | None = None,
) -> np.ndarray:
    """Simulate the runs, where the cache does not have them yet, and draw them: uint8, shape (h, w, 3).

    Args:
        runs: a column each.
        cache: folder of simulated runs.
        moments: a row each [s].
        workers: processes at a time.
        report: called with lines of progress.
    """
    recordings = record_runs(runs, cache, workers, report=report)
    source, cut = body_source(runs[0].body), runs[0].levels.subdivision
    pattern = cut.flat_corners(runs[0].levels.pattern)
    columns = []
    for run, recording in zip(runs, recordings, strict=True):
        images = []
        for moment in moments:
            index = int(np.argmin(np.abs(recording.frames * run.dt - moment)))
            body = np.zeros((len(source.vertices), 3), np.float32)
            source.skin(run.poses[recording.frames[index]], np.zeros(3), body)
            about = np.concatenate([other.positions[index] for other in recordings])[None].astype(float)
            camera = frame_camera(about, azimuth_deg=25.0, aspect=PICTURE[0] / PICTURE[1], margin=1.15)[0]
            garment = Drawn(recording.positions[index].astype(float), cut.faces, pattern=pattern)
            images.append(render([Drawn.body(body.astype(float), source.faces), garment], camera, PICTURE))
        columns.append(images)
    return strip(columns, [run.name for run in runs], [f"{moment:g} s" for moment in moments])
