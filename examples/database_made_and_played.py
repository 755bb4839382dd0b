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
    """Learn, read, play. With more workers, learning starts processes that import this file: hence the function."""
    little = gube.LearningOptions(epochs=4)
    gube.precompute(gube.parse_scene(SCENE), "skirt.h5", workers=1, options=little, report=print)

    database = gube.read_database("skirt.h5")
    character = gube.load_character("builtin:mannequin")
    walk = gube.ClipMotion(character, "walk")
    player = gube.Player(database, character)
    for frame in range(1, 121):
        player.update(walk.pose(frame / 60.0), 1.0 / 60.0)
    smooth = player.decoded(gube.LevelOfDetail(every=1, substeps=1, atoms=0, passes=0))
    wrinkles = np.linalg.norm(player.vertices - smooth, axis=1)
    print(f"{len(database.coarse_vertices)} coarse and {len(smooth)} fine vertices, {player.timings['frame']:.1f} ms")

    assert len(smooth) == database.fine_vertex_count > 3 * len(database.coarse_vertices), "the fine mesh is played"
    assert np.isfinite(player.vertices).all(), "and stays sound"
    assert np.allclose(np.linalg.norm(player.normals, axis=1), 1.0, atol=1e-3), "with unit normals"
    assert 1e-4 < wrinkles.max() < 0.1, "wrinkles of millimetres and centimetres lie on the smooth garment"
    way = player.vertices.mean(axis=0) + player.origin - database.coarse_vertices.mean(axis=0)
    assert way[2] > 0.3, "the skirt went along with the walk"


if __name__ == "__main__":
    main()
