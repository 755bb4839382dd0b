"""A wrinkle database of the built-in skirt is learned from a little motion, written to skirt.h5, read and played.

So little is learned that the wrinkles are poor; `gube demo` learns enough. It takes about half a minute.
"""

import numpy as np

import gube

SCENE = """
[[garment]]
name = "skirt"
mesh = "builtin:skirt"
attach = "top"
subdivisions = 1

[character]
file = "builtin:mannequin"

[training]
procedural_seconds = 2.0

[solver]
substep = 0.004

[wrinkles]
atoms = 6
hidden_width = 8
"""


def main() -> None:
    """Learn, read, play. Learning starts processes that import this file, so that all of it stands in a function."""
    gube.precompute(gube.parse_scene(SCENE), "skirt.h5", workers=1, report=print)

    database = gube.read_database("skirt.h5")
    character = gube.load_character("builtin:mannequin")
    walk = gube.ClipMotion(character, "walk")
    player = gube.Player(database, character)
    for frame in range(1, 121):
        player.update(walk.pose(frame / 60.0), 1.0 / 60.0)
    vertices = player.vertices + player.origin
    print(
        f"{len(database.coarse_vertices)} coarse vertices, {len(vertices)} fine ones, {player.timings['frame']:.1f} ms"
    )

    assert len(vertices) == database.fine_vertex_count > 3 * len(database.coarse_vertices), "it plays the fine mesh"
    assert np.isfinite(vertices).all() and np.allclose(np.linalg.norm(player.normals, axis=1), 1.0, atol=1e-3)
    coarse = player.simulation.vertices
    assert np.abs(vertices.mean(axis=0) - coarse.mean(axis=0)).max() < 0.05, "around the coarse garment"

    try:
        gube.Player(database, character, fabric="denim")
        raise AssertionError("a fabric that was not learned is refused")
    except gube.InputError as error:
        print(error)


if __name__ == "__main__":
    main()
