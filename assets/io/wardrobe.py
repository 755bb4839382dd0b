"""Wardrobe files: one scene in many garments, bodies and fabrics."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

from assets.io.scene import Scene, scene_of, toml_file
from pbd.errors import InputError

__all__ = ["load_wardrobe"]

AXES = ("garments", "bodies", "fabrics")


def load_wardrobe(path: str | Path) -> dict[str, Scene]:
    """Read a wardrobe file: a scene file with a table ``vary``, which says in what the scenes differ.

    ``[vary.garments.NAME]`` replaces keys of the scene's garment, ``[vary.bodies.NAME]`` whole tables of the scene
    (``character``, ``training``), ``fabrics`` in ``[vary]`` are the fabrics that each garment is worn in. The scenes
    are all combinations of what is there.

    Args:
        path: the file.

    Returns:
        scenes by their names, such as ``tshirt-woman-jersey``.

    Raises:
        InputError: the file cannot be read or is not TOML; it does not vary anything, or something else; or a scene
            has values that cannot be used, with every such place of the first such scene.
    """
    path = Path(path)
    values = toml_file(path)
    vary = values.pop("vary", None)
    expected = "a table with 'garments', 'bodies' or 'fabrics'"
    if not isinstance(vary, dict) or not vary or set(vary) - set(AXES):
        received = sorted(vary) if isinstance(vary, dict) else vary
        raise InputError("nothing is varied", file=path, key="vary", received=received, expected=expected)
    axes = [_axis(path, name, vary[name]) for name in AXES if name in vary]
    scenes: dict[str, Scene] = {}
    for parts in itertools.product(*axes):
        name = "-".join(one for _, one, _ in parts)
        varied = dict(values)
        for axis, _, keys in parts:
            varied = varied | keys if axis == "bodies" else _with_garment(path, varied, keys)
        try:
            scenes[name] = scene_of(varied, path)
        except InputError as error:
            raise InputError(f"{name}: {error}") from error
    return scenes


def _axis(path: Path, axis: str, value: Any) -> list[tuple[str, str, dict[str, Any]]]:
    """What is varied, each with the axis, its name and the keys that it replaces."""
    key = f"vary.{axis}"
    if axis == "fabrics":
        if not isinstance(value, list) or not value or not all(isinstance(one, str) for one in value):
            raise InputError("no fabrics", file=path, key=key, received=value, expected="a list of names of fabrics")
        found = [(axis, one, {"fabric": one}) for one in value]
    else:
        if not isinstance(value, dict) or not value or not all(isinstance(one, dict) for one in value.values()):
            raise InputError("no tables", file=path, key=key, received=value, expected=f"tables such as [{key}.NAME]")
        found = [(axis, one, dict(keys)) for one, keys in value.items()]
    for _, name, _ in found:
        if not re.fullmatch(r"\w[\w.]*", name):
            expected = "a word of letters, digits, dots and underscores, since it becomes a part of a file's name"
            raise InputError("a name that cannot be used", file=path, key=key, received=name, expected=expected)
    if len({name for _, name, _ in found}) < len(found):
        raise InputError("a name twice", file=path, key=key, received=[name for _, name, _ in found])
    return found


def _with_garment(path: Path, values: dict[str, Any], keys: dict[str, Any]) -> dict[str, Any]:
    garments = values.get("garment", [{}])
    if not isinstance(garments, list) or len(garments) != 1:
        received = len(garments) if isinstance(garments, list) else garments
        raise InputError("garments cannot be varied", file=path, key="garment", received=received, expected="one table")
    return values | {"garment": [{**garments[0], **keys}]}
