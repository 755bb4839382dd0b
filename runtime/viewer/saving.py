"""What a viewer saves: a picture, a clip, and the scene file that gives the view again.

Files go to one folder under names that the viewer chooses; a browser names neither.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from assets.character import Character
from assets.io.scene import CameraSettings, Scene, WindSettings, scene_text
from assets.io.sequence import Sequence
from assets.io.view_settings import ViewSettings
from pbd.storage import replacing
from pbd.wind import Wind
from runtime.draw.pictures import save_png
from runtime.draw.studio import BACKGROUND
from runtime.export.animation_baking import clip_begin
from runtime.export.animation_files import bake_glb
from runtime.viewer.garments import ViewedGarment
from runtime.viewer.playback import Playback

__all__ = ["bake_clip", "clip_frames", "free_file", "write_picture", "write_view"]

CLIP_HZ = 30.0  # about how many frames a second a clip has [Hz]


def free_file(folder: Path, stem: str, ending: str) -> Path:
    """The first of ``stem_1``, ``stem_2``, ... that does not exist in a folder."""
    number = 1
    while (path := folder / f"{stem}_{number}{ending}").exists():
        number += 1
    return path


def write_picture(folder: Path, picture: np.ndarray) -> Path:
    """Write what a browser has drawn.

    Args:
        folder: where.
        picture: red, green, blue and opacity, uint8, shape (h, w, 4).
    """
    below, above = (np.array(color) * 255.0 for color in BACKGROUND)
    shade = np.linspace(0.0, 1.0, len(picture))[:, None, None]
    opacity = picture[..., 3:] / 255.0
    flat = picture[..., :3] * opacity + (above + shade * (below - above)) * (1.0 - opacity)
    path = free_file(folder, "picture", ".png")
    save_png(path, np.round(flat).astype(np.uint8))
    return path


def clip_frames(garment: ViewedGarment, playback: Playback) -> tuple[np.ndarray, np.ndarray | None, float]:
    """Every kept moment of a playback, about :data:`CLIP_HZ` of them a second; it shows the present one again after it.

    Moments before the motion's own first frame are left out, unless no others were played.

    Returns:
        vertices of the main mesh in the world [m], float32, shape (f, n, 3); poses of the body, shape (f, ...), None
        without one; their rate [Hz].
    """
    present = playback.tick_count
    here = playback.player.keep()
    begin = 0.0 if garment.motion is None else clip_begin(garment.motion)
    kept = playback.kept_ticks
    ticks = [tick for tick in kept if tick * playback.tick >= begin - 1e-6] or kept
    ticks = ticks[:: max(1, round(1.0 / (playback.tick * playback.stride * CLIP_HZ)))]
    frames = []
    for tick in ticks:
        playback.go_to(tick)
        frames.append((garment.vertices(garment.main, tick) + garment.player.origin).astype(np.float32))
    motion = garment.motion
    poses = None if motion is None else np.array([motion.pose(tick * playback.tick) for tick in ticks])
    playback.show(here, present)
    every = ticks[1] - ticks[0] if len(ticks) > 1 else playback.stride
    return np.array(frames), poses, 1.0 / (every * playback.tick)


def bake_clip(
    folder: Path,
    faces: np.ndarray,
    frames: np.ndarray,
    poses: np.ndarray | None,
    rate_hz: float,
    body: Character | Sequence | None,
    garments: Mapping[str, np.ndarray] | None,
    texture: np.ndarray | None,
) -> Path:
    """Write frames as an animation; arguments as for :func:`runtime.export.animation_files.bake_glb`."""
    path = free_file(folder, "clip", ".glb")
    worn_by = {"body": None if poses is None else body, "poses": poses}
    bake_glb(path, faces, frames, rate_hz, **worn_by, garments=garments, texture=texture)
    return path


def write_view(folder: Path, scene: Scene, wind: Wind, camera: CameraSettings, view: ViewSettings) -> Path:
    """Write the scene file of a view.

    Args:
        folder: where.
        scene: that is viewed.
        wind: that blows now.
        camera: the browser's, in the world.
        view: what is shown, and how.
    """
    air = WindSettings(velocity=wind.velocity, turbulence=wind.turbulence, length=wind.length)
    path = free_file(folder, "view", ".toml")
    with replacing(path) as beside:
        beside.write_text(scene_text(replace(scene, wind=air, camera=camera, view=view)), encoding="utf-8")
    return path
