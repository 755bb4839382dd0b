"""Makes the films of the gallery: python -m docs.site.gallery, which is what `make gallery` runs.

Each film is simulated here and now from built-in garments; the repository keeps only this file of them.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import gube
from runtime.draw.picture_content import Drawn, frame_camera
from runtime.draw.pictures import encode_film, render

OUT = Path(__file__).resolve().parent.parent.parent / "out" / "gallery"
SIZE = (360, 400)  # [pixel]
FILM_HZ, SECONDS = 15.0, 3.0
MAX_BYTES = 500_000  # of one film

ON_A_BODY = """
[[garment]]
name = "garment"
mesh = "{mesh}"
fabric = "{fabric}"
coarse_subdivisions = 1

[character]
file = "builtin:mannequin"
clip = "{clip}"
"""


@dataclass(frozen=True)
class Film:
    """A film and what stands under it.

    Attributes:
        title: for people.
        words: how it was made.
        frames: vertices of the garment, and of what else is drawn, at each picture [m], shapes (f, n, 3), (f, b, 3).
        faces: of both, shapes (m, 3), (k, 3).
    """

    title: str
    words: str
    frames: tuple[np.ndarray, np.ndarray]
    faces: tuple[np.ndarray, np.ndarray]


def worn(title: str, mesh: str, fabric: str, clip: str) -> Film:
    """A built-in garment on the mannequin."""
    scene = gube.parse_scene(ON_A_BODY.format(mesh=mesh, fabric=fabric, clip=clip))
    simulation, motion = gube.simulation_of(scene)
    assert motion is not None
    garment, body = [], []
    for tick in range(int(SECONDS * 60) + 1):
        if tick:
            simulation.step(motion.pose(tick / 60), 1 / 60)
        if tick % round(60 / FILM_HZ) == 0:
            garment.append(simulation.vertices)
            body.append(simulation.body.current + simulation.body.origin)
    words = f"`{mesh}` in {fabric}, subdivided once, on the clip `{clip}` of `builtin:mannequin`."
    return Film(title, words, (np.array(garment), np.array(body)), (simulation.model.mesh.faces, simulation.body.faces))


FILMS: Mapping[str, Callable[[], Film]] = {
    "skirt": lambda: worn("A wool skirt, twirling", "builtin:circle_skirt", "wool", "twirl"),
    "tshirt": lambda: worn("A jersey T-shirt, walking", "builtin:tshirt", "jersey", "walk"),
    "trousers": lambda: worn("Denim trousers, turning", "builtin:trousers", "denim", "turn"),
}
"""Names of files, and the function that makes each film."""


def draw(film: Film) -> list[np.ndarray]:
    """The pictures of a film."""
    (garment, body), (faces, body_faces) = film.frames, film.faces
    cameras = frame_camera(garment, aspect=SIZE[0] / SIZE[1], margin=1.2)
    return [
        render([Drawn.body(behind, body_faces), Drawn(cloth, faces)], camera, SIZE)
        for cloth, behind, camera in zip(garment, body, cameras, strict=True)
    ]


def main() -> int:
    """Make all films and the list of them, which the site reads.

    Returns:
        the exit status: 1 where a film is larger than a page should load.
    """
    OUT.mkdir(parents=True, exist_ok=True)
    notes, large = [], 0
    for name, make in FILMS.items():
        film = make()
        data = encode_film(draw(film), FILM_HZ)
        large += len(data) > MAX_BYTES
        (OUT / f"{name}.webp").write_bytes(data)
        notes.append({"file": f"{name}.webp", "title": film.title, "words": film.words})
        sys.stdout.write(f"{OUT / name}.webp: {len(data) / 1000:.0f} kB\n")
        sys.stdout.flush()
    (OUT / "gallery.json").write_text(json.dumps(notes, indent=2) + "\n", encoding="utf-8")
    return int(large > 0)


if __name__ == "__main__":
    sys.exit(main())
