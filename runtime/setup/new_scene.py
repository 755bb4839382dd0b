"""Writes a scene file for a character and garments of one's own, with every guess as a comment in it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap

import numpy as np

from assets.fabrics import PRESETS
from assets.io.body_settings import MotionSettings
from assets.io.scene import Scene, parse_scene
from assets.io.settings import portable_path
from assets.loading import load_garment
from assets.placement import AS_STORED
from pbd import InputError
from pbd.storage import replacing
from runtime.setup.layer_order import in_order
from runtime.setup.new_body import BodyGuess, MotionGuess, guess_body, guess_motions
from runtime.setup.new_garment import GarmentGuess, guess_garment
from runtime.setup.scene_simulation import simulation_of

__all__ = ["NewScene", "write_new_scene"]

COLUMNS = 110  # of comments in the file
MAX_COARSE_OF_FINE = 1000  # coarse vertices of a fine mesh in panels
# How to mend a fault, by words of its message.
MENDS = {
    "cannot be read": "check the path",
    "not glTF": "export again as glTF 2.0 (.glb)",
    "not a binary glTF": "export again as glTF 2.0 (.glb)",
    "only an animation": "give the file of the body; this one's clips can stand under [[training.clips]] in its scene",
    "no skin": "bind the mesh to an armature (Blender: Parent, With Automatic Weights) and export with Skinning",
    "skin without weights": "give every vertex a weight (Blender: Weights, Assign Automatic From Bones)",
    "no clip that moves": "export with Animation, each action on a track of the armature",
    "not the size": "scale it in your modelling program, apply the scale and export again",
    "body that is inside out": "turn its faces (Blender: Mesh, Normals, Recalculate Outside) and export again",
    "without faces": "export the mesh, not only its points or curves; an empty file has neither",
    "not finite": "delete the vertex that is named, or undo what broke the mesh, and export again",
    "without area": "dissolve it (Blender: Mesh, Clean Up, Degenerate Dissolve)",
    "same face as": "delete one of the two (Blender: Mesh, Clean Up, Merge by Distance, then delete the inner face)",
    "an edge of": "delete the inner faces (Blender: Select, All by Trait, Non Manifold)",
    "one side only": "cut the surface along a line, so that it has an inner and an outer side",
    "a closed mesh": "take its thickness off (Blender: remove Solidify) and open it where the body goes through",
    "pieces that nothing holds": "join them to one surface (Blender: Mesh, Merge by Distance), or give stitches",
    "starts inside the body": "take the garment of this body, or move and sculpt it out of the body in its bind pose",
    "lies beside the body": "put it around the body in its bind pose, apply all transforms and export both",
}


@dataclass(frozen=True)
class NewScene:
    """A scene file that was written.

    Attributes:
        text: of the file.
        scene: the same, read back.
        body, motions, garments: the guesses in it, the innermost garment first.
    """

    text: str
    scene: Scene
    body: BodyGuess
    motions: MotionGuess
    garments: tuple[GarmentGuess, ...]


def write_new_scene(
    character: str, garments: Sequence[str], path: Path, report: Callable[[str], None] = lambda line: None
) -> NewScene:
    """Look at a character and garments, write a scene file that works, and load it once.

    Args:
        character: a character (.glb, .gltf), "builtin:mannequin", or a vertex sequence (.npz).
        garments: .obj, .glb or .gltf files, sewn garments (.npz), or built-in ones.
        path: the scene file; files that are converted are written beside it.
        report: called with lines of progress.

    Raises:
        InputError: all that is wrong with the files, each with what mends it.
        OSError: a file cannot be written.
    """
    folder = path.absolute().parent
    names = [Path(garment).stem for garment in dict.fromkeys(garments)]
    if len(set(names)) < len(names):
        expected = "files of different names, which become the garments' names"
        raise InputError("garments of the same name", key="GARMENT", received=list(garments), expected=expected)
    errors: list[InputError] = []
    body, motions, found = None, None, []
    try:
        body = guess_body(character, folder)
        motions = guess_motions(body)
    except InputError as error:
        errors.append(_with_mend(error))
    for garment in dict.fromkeys(garments):
        report(f"looking at {garment}")
        try:
            if body is None:
                _check_alone(garment)
            else:
                found.append(guess_garment(garment, body, folder))
        except InputError as error:
            errors.append(_with_mend(error))
    if body is None or motions is None or errors:
        raise InputError.join(errors)
    found.sort(key=lambda guess: guess.fit.gap_p50)
    found = [found[k] for k in in_order([(guess.garment.vertices, guess.garment.faces) for guess in found])]
    text = "\n".join(_lines(body, motions, found, folder)) + "\n"
    scene = parse_scene(text, path.absolute())
    report("loading the scene")
    simulation_of(scene)  # a scene that cannot be simulated is refused here, not later
    with replacing(path) as beside:
        beside.write_text(text, encoding="utf-8")
    return NewScene(text, scene, body, motions, tuple(found))


def _check_alone(path: str) -> None:
    """Refuse a garment that no body could wear; without a body, its unit is unknown."""
    try:
        load_garment(path)
    except InputError as error:
        if not error.problem.startswith("not in metres"):
            raise


def _with_mend(error: InputError) -> InputError:
    """The error with a line about how to mend it."""
    mend = next((mend for words, mend in MENDS.items() if words in str(error)), None)
    return error if mend is None else InputError(f"{error}\n    to mend it: {mend}")


def _lines(body: BodyGuess, motions: MotionGuess, garments: Sequence[GarmentGuess], folder: Path) -> Iterator[str]:
    yield "# Written by `gube new`. Every comment is a guess or a measure that led to one: change what is wrong."
    if len(garments) > 1:
        yield "# Garments are an outfit, in the order in which they lie over one another, the innermost first."
    for guess in garments:
        yield from ("", "[[garment]]", *_garment_lines(guess, folder))
    yield from ("", "[character]", *_body_lines(body, motions, folder))
    yield from (
        "",
        "[solver]",
        "# 24 substeps a frame. With 12 it takes less time, hangs too low and comes after the body.",
    )
    yield "substep = 0.00069445"
    yield from ("", *_training_lines(motions, folder))


def _garment_lines(guess: GarmentGuess, folder: Path) -> Iterator[str]:
    fit, garment, fabric = guess.fit, guess.garment, PRESETS[guess.fabric]
    yield f"name = {_quoted(garment.name.removesuffix('_metres'))}"
    yield f"# {_read_as(guess)}: {1e3 * fit.gap_p50:.0f} mm off the body in the median."
    yield f"mesh = {_path(guess.file, folder)}"
    if garment.pattern is not None and guess.garment.layers is None:
        yield "# Texture coordinates keep the lengths of edges: they are its flat pattern."
        yield "pattern = true"
    if guess.seams is not None:
        yield "# Stitches that are closed on this mesh. It is the fine mesh; a coarse one is made from it."
        yield f"seams = {_path(guess.seams, folder)}"
        yield f"coarse_vertices = {min(MAX_COARSE_OF_FINE, len(garment.vertices) // 8)}"
    weights = f"Kind by its shape: {guess.kind}. Its {guess.area:.2f} m2 would weigh {_weights(guess.area)}."
    yield from wrap(weights, COLUMNS, initial_indent="# ", subsequent_indent="#   ")
    yield f"fabric = {_quoted(guess.fabric)}  # {fabric.areal_density:g} kg/m2"
    yield f"# {_held_by(guess)}"
    yield f"attach = {_quoted(guess.attach)}"
    if guess.coarse_subdivisions:
        yield f"# {len(garment.vertices)} vertices, {1e3 * guess.edge:.0f} mm apart: subdivided before it is simulated."
        yield f"coarse_subdivisions = {guess.coarse_subdivisions}"
    yield "# `subdivisions` for the fine mesh follow from the fabric; `gube simulate SCENE --explain` names them."
    for note in guess.notes:
        yield from wrap(f"Note: {note}", COLUMNS, initial_indent="# ", subsequent_indent="#   ")
    if any("`ease`" in note for note in guess.notes):
        yield "# ease = [0.1, 0.03]"


def _read_as(guess: GarmentGuess) -> str:
    if isinstance(guess.file, str):
        return "Built in"
    turned = "its faces pointed at the body and were turned" if guess.turned else ""
    if guess.placement == AS_STORED:
        return "Read as metres, Y up" + ("; " + turned if turned else "")
    written = f"The file given is in {guess.placement} by the body's size, and was written once more"
    return written + ("; " + turned if turned else "")


def _weights(area: float) -> str:
    presets = sorted(PRESETS.items(), key=lambda one: one[1].areal_density)
    return ", ".join(f"{1e3 * area * fabric.areal_density:.0f} g in {name}" for name, fabric in presets)


def _held_by(guess: GarmentGuess) -> str:
    if guess.attach == "bands":
        return "The body carries the rims of its taut bands, such as a waistband; its shoulders hold it by themselves."
    if guess.attach == "top":
        return "It hangs below the shoulders: the body carries its highest opening, the waistband."
    return 'The shoulders hold it; nothing is attached. "top" would tie the neckline to the body.'


def _body_lines(body: BodyGuess, motions: MotionGuess, folder: Path) -> Iterator[str]:
    height = float(np.ptp(body.vertices[:, 1]))
    stored = body.placement == AS_STORED
    read = "read as metres, Y up" if stored else f"the file given is in {body.placement}, and was written once more"
    yield f"# {height:.2f} m tall: {read}."
    shown = motions.held_out
    if shown.clip is None:
        yield f"sequence = {_path(body.file, folder)}"
        return
    yield f"file = {_path(body.file, folder)}"
    yield "# The clip that `gube simulate` plays: the one that is held out below."
    yield f"clip = {_quoted(shown.clip)}"


def _training_lines(motions: MotionGuess, folder: Path) -> Iterator[str]:
    if motions.procedural_seconds:
        yield "[training]"
        yield "# The joints' names are a figure's, so that motion can be made for it: walks, turns, squats, lunges."
        yield f"procedural_seconds = {motions.procedural_seconds:g}"
        yield ""
    if motions.left_out:
        yield "# Clips that are left out:"
        yield from (f"#   {_quoted(name)}: {why}" for name, why in motions.left_out)
        yield ""
    for motion in motions.clips:
        yield from ("[[training.clips]]", *_motion_lines(motion, folder), "")
    yield "# Nothing is learned from this: the figures of `gube info` are measured on it."
    yield from ("[[training.held_out]]", *_motion_lines(motions.held_out, folder))


def _motion_lines(motion: MotionSettings, folder: Path) -> Iterator[str]:
    yield f"file = {_path(motion.file, folder)}"
    if motion.clip is not None:
        yield f"clip = {_quoted(motion.clip)}"
    if motion.start:
        yield f"start = {motion.start:g}"
    if motion.end is not None:
        yield f"end = {motion.end:g}"
    if motion.speed != 1.0:
        yield f"speed = {motion.speed:g}"


def _path(file: Path | str, folder: Path) -> str:
    """A file as the scene names it, so that both can be moved together: see :func:`portable_path`."""
    return _quoted(portable_path(file, folder) if isinstance(file, Path) else file)


def _quoted(text: str) -> str:
    """A text as a TOML string on one line."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
