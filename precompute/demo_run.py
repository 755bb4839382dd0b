"""`gube demo`: the whole road on the built-in scene, from nothing to a page with pictures.

The short demo learns from nothing in about six minutes of two cores. The full one learns from more motion with a
wider network and compares with more plain cloths; it takes a quarter of an hour.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

import assets
from assets.character import Character
from assets.io.scene import Scene, load_scene
from assets.io.sequence import Sequence as VertexSequence
from pbd.storage import replacing
from precompute.demo_page import duration, newcomer_sections
from precompute.learning.evaluation import Evaluation
from precompute.learning.options import LearningOptions
from precompute.learning.pipeline import STAGES as LEARNING_STAGES
from precompute.learning.pipeline import default_cache, precompute, scene_run
from precompute.learning.run_recording import Recording, Run, record_runs
from precompute.learning.stages import StageClock
from precompute.learning.truth import Truth, settled, truth_runs
from precompute.reporting.html_page import write_page
from precompute.workers import Workers
from runtime.draw.picture_content import Drawn, frame_camera
from runtime.draw.pictures import encode_film, render, save_png, strip
from runtime.draw.shown_body import shown_body
from runtime.export.animation_files import bake_glb
from runtime.export.free_run import posed_bodies
from runtime.export.glb import BYTES_A_VERTEX
from runtime.output.verdict import verdict
from runtime.setup.garment_setup import GarmentSetup
from wrinkles.metrics import normal_error_deg

__all__ = [
    "FULL",
    "SHORT",
    "STAGES",
    "WORDS",
    "Demo",
    "DemoResult",
    "draw_film",
    "draw_moments",
    "introduction",
    "run_demo",
]

DATA = Path(assets.__file__).parent / "data"
WORDS = {
    "held-out motion": "simulating the walk that nothing is learned from, coarse and fine",
    "simulating": "simulating the motion that is learned from",
    "fitting patches": "finding the shapes that folds are made of",
    "fitting": "learning which folds belong to which coarse skirt",
    "means of vertices": "learning what all folds have in common",
    "unfamiliarity": "learning where not to trust what was learned",
    "evaluating": "playing the walk and judging it",
    "comparing": "comparing with plain cloth",
    "drawing": "drawing, baking the animation and writing the page",
}
STAGES = ("held-out motion", *LEARNING_STAGES, "comparing", "drawing")
PICTURE = (560, 640)
AZIMUTH = 8.0  # of the camera, seen from where the walk goes [deg]
FILM, FILM_EVERY = (300, 340), 3  # size of a picture of the film, and recorded frames from one to the next
GLB_BYTES = 14e6  # that the garment of the animation may take; frames are left out evenly until it does


@dataclass(frozen=True)
class Demo:
    """One way to run the demo.

    Attributes:
        scene: file of the scene.
        options: how much is done to learn.
        seconds: about how long each of STAGES takes on two idle cores [s].
        moments: that the picture shows.
        brief: compare with few plain cloths.
    """

    scene: Path
    options: LearningOptions
    seconds: tuple[float, ...]
    moments: int
    brief: bool


SHORT = Demo(
    DATA / "demo.toml",
    LearningOptions(
        training_frames=400,
        epochs=8,
        most_epochs=8,
        mean_frames=60,
        score_frames=120,
        piece_s=0.25,
        free_runs=2,
    ),
    seconds=(68.0, 93.0, 4.0, 13.0, 3.0, 12.0, 33.0, 69.0, 36.0),
    moments=2,
    brief=True,
)
FULL = Demo(
    DATA / "demo_full.toml",
    LearningOptions(),
    seconds=(60.0, 80.0, 20.0, 120.0, 20.0, 30.0, 60.0, 180.0, 45.0),
    moments=4,
    brief=False,
)


@dataclass(frozen=True)
class DemoResult:
    """What a demo made.

    Attributes:
        figures: by name.
        words: what was made, how good it is and what it costs, in sentences.
        page, picture, first_picture, film, animation, database: files.
    """

    figures: dict[str, float]
    words: tuple[str, ...]
    page: Path
    picture: Path
    first_picture: Path
    film: Path
    animation: Path
    database: Path


class _Clock(StageClock):
    """Says which stage of how many begins, in words, and about how long the rest takes.

    Args:
        seconds: that each of STAGES is expected to take [s].
        workers: of all stages.
        say: called with lines that stay on the screen.
        report: called with lines of progress.
    """

    def __init__(
        self,
        seconds: Sequence[float],
        workers: Workers,
        say: Callable[[str], None],
        report: Callable[[str], None] | None,
    ) -> None:
        super().__init__(STAGES, workers, report)
        self._seconds, self._say, self._began = seconds, say, time.monotonic()

    def begin(self, name: str) -> None:
        """Say it, and how much time is left at the pace of this machine."""
        number = STAGES.index(name)
        before, after = sum(self._seconds[:number]), sum(self._seconds[number:])
        pace = (time.monotonic() - self._began) / before if number else 1.0
        self._say(f"stage {number + 1} of {len(STAGES)}: {WORDS[name]} (about {duration(pace * after)} left)")


def introduction(demo: Demo, output: Path) -> str:
    """What the demo will do, how long that takes and where it goes."""
    scene = load_scene(demo.scene)
    garment, minutes = scene.garments[0].name, sum(demo.seconds) / 60.0
    return "\n".join(
        [
            f"A fine simulation of a {garment} is learned from, so that a coarse one can be played with the fine one's",
            "folds. Then it is played on a walk that nothing was learned from, and judged beside the truth.",
            f"This takes about {minutes:.0f} minutes on two idle cores. Everything goes to {output}:",
            "first.png (coarse and truth, within a minute or two), demo.png, demo.webp (the same moving), skirt.glb,",
            "skirt.h5 and index.html.",
        ]
    )


def run_demo(
    output: Path,
    demo: Demo = SHORT,
    *,
    workers: int = 2,
    say: Callable[[str], None] | None = None,
    report: Callable[[str], None] | None = None,
) -> DemoResult:
    """Learn a small database, play held-out motion and write the animation, the pictures and the page.

    Args:
        output: folder for everything; simulated runs are kept in it and found again.
        demo: the short one or the full one.
        workers: processes that simulate.
        say: called with lines that stay on the screen: the stages as they begin, and that the first picture is there.
        report: called with lines of progress.
    """
    from precompute.wrinkle_comparison.compare_database import compare, write_choice
    from precompute.wrinkle_comparison.comparison_page import comparison_sections

    say = say or (lambda line: None)
    scene, database_path, began = load_scene(demo.scene), output / "skirt.h5", time.monotonic()
    first_picture, picture_file, film = output / "first.png", output / "demo.png", output / "demo.webp"
    animation = output / "skirt.glb"
    pool = Workers(workers)
    clock = _Clock(demo.seconds, pool, say, report)
    with pool:
        with clock.stage("held-out motion"):
            save_png(first_picture, _first_picture(scene, default_cache(database_path), demo, clock, pool))
            say(f"the first picture is there: {first_picture} (coarse | truth)")
        learned = precompute(scene, database_path, workers=pool, options=demo.options, clock=clock)
    truth, evaluation = learned.truth, learned.evaluation
    assert truth is not None and evaluation is not None
    # Workers that end leave the kernels that they compiled on the disk, where new ones find them.
    with pool:
        with clock.stage("comparing"):
            comparison = compare(learned.database, [truth], brief=demo.brief, workers=pool, report=clock)
            database = write_choice(database_path, learned.database, comparison)
        with clock.stage("drawing"):
            body = shown_body(truth.run.body, truth.levels)
            picture = draw_moments(truth, evaluation, demo.moments, body.faces)
            save_png(picture_file, picture)
            with replacing(film) as beside:
                beside.write_bytes(draw_film(truth, evaluation, body.faces, pool))
            _bake(animation, truth, evaluation, body, learned.database.fine_texture)
    sections = newcomer_sections(learned, database, film, picture, time.monotonic() - began)
    write_page(output / "index.html", "A skirt with learned folds", [*sections, *comparison_sections(comparison)])
    return DemoResult(
        evaluation.figures,
        verdict(database),
        output / "index.html",
        picture_file,
        first_picture,
        film,
        animation,
        database_path,
    )


def _first_picture(
    scene: Scene, cache: Path, demo: Demo, report: Callable[[str], None], workers: Workers
) -> np.ndarray:
    """Simulate the held-out motion, coarse and fine, and draw both before anything is learned."""
    stage = GarmentSetup.of(scene)
    run = scene_run(stage, scene, stage.motion(scene.training.held_out[0]))
    coarse = replace(run, name=f"{run.name} (coarse)", fine=False, solver=scene.solver.options(), bend_factor=None)
    # The fine runs that it is judged by are wanted later: they keep the other core busy.
    truth, *others = truth_runs(run, demo.options)
    found = record_runs([truth, coarse, *others[:1]], cache, workers, report=report)
    fine, rough = settled(found[0], run), settled(found[1], run)
    levels = run.levels
    columns = {"coarse": (rough.positions, levels.coarse.faces), "truth": (fine.positions, levels.subdivision.faces)}
    return _draw(columns, run, fine, demo.moments, run.body.faces)


def draw_moments(truth: Truth, evaluation: Evaluation, moments: int, body_faces: np.ndarray) -> np.ndarray:
    """Coarse, truth and ours at several moments of a free run, and ours given the truth's coarse state.

    Args:
        truth: of the motion.
        evaluation: of the database on it.
        moments: number of rows.
        body_faces: of the body that are drawn, int, shape (k, 3).

    Returns:
        uint8, shape (h, w, 3).
    """
    coarse, fine = truth.levels.coarse.faces, truth.levels.subdivision.faces
    columns = {
        "coarse": (evaluation.free.coarse, coarse),
        "truth": (truth.frames, fine),
        "ours": (evaluation.free.frames, fine),
        "ours on the truth's own coarse skirt": (evaluation.decoded, fine),
    }
    return _draw(columns, truth.run, truth.recording, moments, body_faces)


def _draw(
    columns: dict[str, tuple[np.ndarray, np.ndarray]],
    run: Run,
    recording: Recording,
    moments: int,
    body_faces: np.ndarray,
) -> np.ndarray:
    """Meshes by their names, each with its vertices [m], shape (f, n, 3), and faces, at some moments.

    Of each part of the fine run it is the moment at which its folds turn its smooth surface most.
    """
    smooth = run.levels.subdivision.upsample(recording.coarse)
    parts = np.array_split(normal_error_deg(recording.positions, smooth, run.levels.fine.faces), moments)
    firsts = np.cumsum([0, *(len(part) for part in parts)])
    picked = np.array([first + part.argmax() for first, part in zip(firsts, parts, strict=False)])
    pictures = _pictures(columns, run, recording, picked, body_faces, PICTURE)
    return strip(pictures, list(columns), [f"{recording.frames[index] * run.dt:.1f} s" for index in picked])


def draw_film(truth: Truth, evaluation: Evaluation, body_faces: np.ndarray, workers: Workers) -> bytes:
    """Coarse, truth and ours side by side, the free run from its start to its end: the bytes of a WebP file.

    Args:
        truth, evaluation, body_faces: as for :func:`draw_moments`.
        workers: that draw.
    """
    coarse, fine, run = truth.levels.coarse.faces, truth.levels.subdivision.faces, truth.run
    columns = {
        "coarse": (evaluation.free.coarse, coarse),
        "truth": (truth.frames, fine),
        "ours": (evaluation.free.frames, fine),
    }
    picked = np.arange(0, len(truth.frames), FILM_EVERY)
    jobs = [
        partial(_pictures, {name: one}, run, truth.recording, picked, body_faces, FILM) for name, one in columns.items()
    ]
    pictures = [column for (column,) in workers.run(jobs)]
    shown = [strip([[one] for one in moment], list(columns), [""]) for moment in zip(*pictures, strict=True)]
    return encode_film(shown, 1.0 / (run.dt * run.every * FILM_EVERY))


def _pictures(
    columns: dict[str, tuple[np.ndarray, np.ndarray]],
    run: Run,
    recording: Recording,
    picked: np.ndarray,
    body_faces: np.ndarray,
    size: tuple[int, int],
) -> list[list[np.ndarray]]:
    """Each mesh at the picked recorded frames."""
    bodies = posed_bodies(run.body, run.poses[recording.frames[picked]])
    shown = recording.positions[picked].astype(float)
    cameras = frame_camera(shown, azimuth_deg=AZIMUTH, aspect=size[0] / size[1], margin=1.12)
    levels = run.levels
    patterns = {len(levels.coarse.faces): levels.pattern}
    patterns[len(levels.subdivision.faces)] = levels.subdivision.flat_corners(levels.pattern)
    return [
        [
            render(
                [Drawn.body(body, body_faces), Drawn(vertices[index], faces, pattern=patterns[len(faces)])],
                camera,
                size,
            )
            for index, body, camera in zip(picked, bodies, cameras, strict=True)
        ]
        for vertices, faces in columns.values()
    ]


def _bake(
    path: Path, truth: Truth, evaluation: Evaluation, body: Character | VertexSequence, texture: np.ndarray | None
) -> None:
    """Write the animation of the free run on a body, of as many frames a second as stay below GLB_BYTES."""
    run, frames = truth.run, evaluation.free.frames
    every = max(1, int(np.ceil(BYTES_A_VERTEX * frames.shape[0] * frames.shape[1] / GLB_BYTES)))
    poses = run.poses[truth.recording.frames[::every]]
    rate = 1.0 / (run.dt * run.every * every)
    faces = truth.levels.subdivision.faces
    bake_glb(path, faces, frames[::every], rate, body=body, poses=poses, texture=texture)
