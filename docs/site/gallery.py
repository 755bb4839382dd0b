"""Makes the films of the gallery: python -m docs.site.gallery, which is what `make gallery` runs.

Each film is simulated here and now from built-in garments; the repository keeps only this file of them, and the film of
the demo, which is shown beside them.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import ceil, cos, pi, sin
from pathlib import Path

import numpy as np

import gube
from precompute.workers import run_jobs
from runtime.draw.picture_content import Drawn, frame_camera
from runtime.draw.pictures import encode_film, render, strip
from runtime.viewer.opened_view import BUILTIN_DATABASE

ROOT = Path(__file__).resolve().parent.parent.parent
OUT = ROOT / "out" / "gallery"
DEMO = ROOT / "docs" / "demo.webp"
SIZE, NARROW = (360, 400), (280, 340)  # of a picture, and of one of several side by side [pixel]
FILM_HZ, SECONDS, TICK = 15.0, 10.0, 1.0 / 60.0
REPEATED = ("turn", "twirl")  # clips
MAX_BYTES = 25_000_000  # of all films

GARMENT = """
[[garment]]
name = "{name}"
mesh = "builtin:{mesh}"
fabric = "{fabric}"
coarse_subdivisions = {cuts}
"""
BODY = """
[character]
file = "builtin:mannequin"
"""

Played = gube.Simulation | gube.Player


@dataclass(frozen=True)
class Column:
    """What one picture of a film shows.

    Attributes:
        frames: vertices of the garments, and of what they lie on, at each picture [m], shapes (f, n, 3), (f, b, 3).
        faces: of both, shapes (m, 3), (k, 3).
        layer: number of the garment of each vertex, int, shape (n,); None for one garment.
    """

    frames: tuple[np.ndarray, np.ndarray]
    faces: tuple[np.ndarray, np.ndarray]
    layer: np.ndarray | None = None


@dataclass(frozen=True)
class Film:
    """A film and what stands under it.

    Attributes:
        title: for people.
        words: how it was made.
        columns: by their titles; one without a title stands alone.
    """

    title: str
    words: str
    columns: Mapping[str, Column]


def clip(name: str) -> gube.ClipMotion:
    """A clip of the mannequin that is as long as a film: repeated, or slowed down where it cannot be."""
    character = gube.load_character("builtin:mannequin")
    if name in REPEATED:
        return gube.ClipMotion(character, name, loop=True)
    once = gube.ClipMotion(character, name)
    return gube.ClipMotion(character, name, speed=(once.duration - once.blend) / (SECONDS - once.blend))


def world(played: Played) -> np.ndarray:
    """Vertices that are drawn [m], shape (n, 3)."""
    return played.vertices + played.origin if isinstance(played, gube.Player) else played.vertices.copy()


def filmed(played: Played, live_input: Callable[[float], gube.LiveInput]) -> Column:
    """Play garments on the mannequin and keep what the film shows."""
    loop = gube.GameLoop(played, live_input, FILM_HZ, TICK, ceil(1.0 / (FILM_HZ * TICK)) + 1)
    simulation = played.simulation if isinstance(played, gube.Player) else played
    body, garments, bodies = simulation.body, [], []
    for _ in range(round(SECONDS * FILM_HZ)):
        garments.append(world(played))
        bodies.append(body.current + body.origin)
        loop.advance(1.0 / FILM_HZ)
    frames = np.array(garments), np.array(bodies)
    if isinstance(played, gube.Player):
        return Column(frames, (played.levels.subdivision.faces, body.faces))
    return Column(frames, (simulation.model.mesh.faces, body.faces), simulation.model.layer)


def simulated(*garments: tuple[str, str], cuts: int = 1) -> gube.Simulation:
    """Built-in garments of a fabric on the mannequin, in the order in which they are worn.

    Args:
        garments: mesh and fabric of each.
        cuts: times that each face is cut in four.
    """
    text = "".join(GARMENT.format(name=mesh, mesh=mesh, fabric=fabric, cuts=cuts) for mesh, fabric in garments)
    return gube.simulation_of(gube.parse_scene(text + BODY))[0]


def worn(title: str, name: str, *garments: tuple[str, str], cuts: int = 1) -> Film:
    """Built-in garments on a clip."""
    motion = clip(name)
    column = filmed(simulated(*garments, cuts=cuts), lambda t: gube.LiveInput(motion.pose(t)))
    what = ", ".join(f"`builtin:{mesh}` in {fabric}" for mesh, fabric in garments)
    return Film(title, f"{what}, on the clip `{name}` of `builtin:mannequin`.", {"": column})


def in_fabrics() -> Film:
    """One skirt in three fabrics."""
    motion, fabrics = clip("twirl"), ("silk", "denim", "jersey")
    columns = {
        fabric: filmed(simulated(("circle_skirt", fabric)), lambda t: gube.LiveInput(motion.pose(t)))
        for fabric in fabrics
    }
    return Film("One skirt in three fabrics", "`builtin:circle_skirt` on the clip `twirl`.", columns)


def pulled() -> Film:
    """A hem that is led around."""
    skirt, motion = simulated(("circle_skirt", "wool")), clip("sway")
    lowest = np.flatnonzero(skirt.vertices[:, 1] < skirt.vertices[:, 1].min() + 0.03)
    hem = int(lowest[skirt.vertices[lowest, 2].argmax()])  # in front, where neither legs nor hands are in the way
    start = skirt.vertices[hem].copy()

    def live_input(t: float) -> gube.LiveInput:
        turn = 2.0 * pi * t / 3.0
        way = 0.2 * np.array([sin(turn), 0.7 * (1.0 - cos(turn)), 1.0 - cos(turn)])
        return gube.LiveInput(motion.pose(t), drag=(hem, start + way) if t < 6.0 else None)

    words = "A vertex of the hem is led around twice and let go after six seconds (`gube.LiveInput`)."
    return Film("A skirt that is pulled at its hem", words, {"": filmed(skirt, live_input)})


def in_wind() -> Film:
    """Gusts from the side."""
    skirt, motion = simulated(("circle_skirt", "silk")), clip("sway")
    gust = lambda t: (4.0 * max(0.0, sin(2.0 * pi * t / 4.0)), 0.0, 0.0)  # noqa: E731
    column = filmed(skirt, lambda t: gube.LiveInput(motion.pose(t), gust(t)))
    return Film("Gusts of wind", "Wind from the side, up to 4 m/s, rises and falls every four seconds.", {"": column})


def levels() -> Film:
    """The database of the package, with more and less of it played."""
    character, motion = gube.load_character("builtin:mannequin"), clip("walk")
    columns = {}
    for title in ("with wrinkles", "without", "far away"):
        player = gube.Player(gube.read_database(BUILTIN_DATABASE), character)
        full = player.full
        if title == "without":
            player.change(gube.LevelOfDetail(full.every, full.substeps, 0, 0))
        elif title == "far away":
            player.change(gube.LevelOfDetail(1, 6, 0, 0, 1))
        columns[title] = filmed(player, lambda t: gube.LiveInput(motion.pose(t)))
    words = "The skirt that comes with the package: with all that was learned, without, and on a third of the points."
    return Film("Levels of detail", words, columns)


FILMS: Mapping[str, Callable[[], Film]] = {
    "skirt": lambda: worn("A wool skirt, twirling", "twirl", ("circle_skirt", "wool")),
    "tshirt": lambda: worn("A jersey T-shirt, walking", "walk", ("tshirt", "jersey")),
    "trousers": lambda: worn("Denim trousers, turning", "turn", ("trousers", "denim")),
    "shirt": lambda: worn("A cotton shirt, twirling", "twirl", ("shirt", "cotton")),
    "outfit": lambda: worn(
        "A jumper over a T-shirt and trousers", "walk", ("trousers", "cotton"), ("tshirt", "jersey"),
        ("shirt", "cotton"), cuts=0,
    ),
    "fabrics": in_fabrics,
    "hem": pulled,
    "wind": in_wind,
    "levels": levels,
}  # fmt: skip
"""Names of files, and the function that makes each film."""


def draw(film: Film) -> list[np.ndarray]:
    """The pictures of a film."""
    size = NARROW if len(film.columns) > 1 else SIZE
    everything = np.concatenate([column.frames[0] for column in film.columns.values()], axis=1)
    cameras = frame_camera(everything, aspect=size[0] / size[1], margin=1.2)  # one size in all columns
    rows = []
    for column in film.columns.values():
        (garments, bodies), (faces, body_faces) = column.frames, column.faces
        rows.append(
            [
                render([Drawn.body(body, body_faces), *Drawn.garments(one, faces, None, column.layer)], camera, size)
                for one, body, camera in zip(garments, bodies, cameras, strict=True)
            ]
        )
    if len(rows) == 1:
        return rows[0]
    return [strip([[one] for one in pictures], list(film.columns), [""]) for pictures in zip(*rows, strict=True)]


def made(name: str) -> tuple[str, str, bytes]:
    """Title, words and file of a film."""
    film = FILMS[name]()
    return film.title, film.words, encode_film(draw(film), FILM_HZ)


def main() -> int:
    """Make all films and the list of them, which the site reads.

    Returns:
        the exit status: 1 where all together are larger than a page should load.
    """
    OUT.mkdir(parents=True, exist_ok=True)
    shutil.copy(DEMO, OUT)
    words = "`gube demo` draws this: a skirt of few vertices, the exact simulation, and the player's result."
    notes, total = [{"file": DEMO.name, "title": "Coarse, truth and ours", "words": words}], DEMO.stat().st_size
    films = run_jobs([partial(made, name) for name in FILMS], os.cpu_count() or 1)
    for name, (title, words, data) in zip(FILMS, films, strict=True):
        total += len(data)
        (OUT / f"{name}.webp").write_bytes(data)
        notes.append({"file": f"{name}.webp", "title": title, "words": words})
        sys.stdout.write(f"{OUT / name}.webp: {len(data) / 1000:.0f} kB\n")
    (OUT / "gallery.json").write_text(json.dumps(notes, indent=2) + "\n", encoding="utf-8")
    return int(total > MAX_BYTES)


if __name__ == "__main__":
    sys.exit(main())
