"""Wardrobe files: all combinations of garments, bodies and fabrics, and clear errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from assets.fabrics import PRESETS
from assets.io.wardrobe import load_wardrobe
from tests.refusals import refuses

WARDROBE = """
[[garment]]
name = "skirt"
mesh = "builtin:skirt"
attach = "top"

[character]
file = "builtin:mannequin"
clip = "walk"

[vary]
fabrics = ["wool", "silk"]

[vary.garments.short]
subdivisions = 1

[vary.garments.free]
attach = "none"

[vary.bodies.walking]

[vary.bodies.turning]
character = { file = "builtin:mannequin", clip = "turn" }
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "wardrobe.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_all_combinations_and_what_they_replace(tmp_path: Path) -> None:
    scenes = load_wardrobe(written(tmp_path, WARDROBE))
    assert list(scenes) == [
        f"{garment}-{body}-{fabric}"
        for garment in ("short", "free")
        for body in ("walking", "turning")
        for fabric in ("wool", "silk")
    ]
    one, other = scenes["short-turning-silk"], scenes["free-walking-wool"]
    assert one.character is not None and other.character is not None
    assert (one.garments[0].subdivisions, one.garments[0].attach) == (1, "top") and other.garments[0].attach == "none"
    assert one.garments[0].fabric == PRESETS["silk"] and other.garments[0].fabric == PRESETS["wool"]
    assert (one.character.clip, other.character.clip) == ("turn", "walk")


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("[vary", "[varied", "nothing is varied"),
        ("fabrics", "colours", "colours"),
        ('["wool", "silk"]', '"wool"', "a list of names"),
        ('["wool", "silk"]', '["wool", "wool"]', "a name twice"),
        ('["wool", "silk"]', '["wool", "../silk"]', "a word of letters"),
        ("subdivisions = 1", 'subdivisions = "many"', "short-walking-wool"),
        ("subdivisions = 1", "sub = 1", "sub"),
        (
            "[character]",
            '[[garment]]\nname = "more"\nmesh = "builtin:skirt"\n\n[character]',
            "garments cannot be varied",
        ),
        ("[[garment]]", "[[garment]", "not TOML"),
    ],
)
def test_what_cannot_be_used_is_named(old: str, new: str, problem: str, tmp_path: Path) -> None:
    text = refuses("", load_wardrobe, written(tmp_path, WARDROBE.replace(old, new)))
    assert problem in text and "wardrobe.toml" in text


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    refuses(r"none\.toml", load_wardrobe, tmp_path / "none.toml")
