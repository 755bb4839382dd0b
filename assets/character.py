"""A skinned character: one welded mesh, a tree of joints, weights and clips.

Matrices act on column vectors. A *pose* is an array of skinning matrices ``[rotation | translation]``, shape
(joints, 3, 4): the joint's transform in the world times its inverse bind matrix. The bind pose is therefore the
identity, and a vertex moves to the sum over its influences of ``weight * (matrix @ (x, y, z, 1))``, linear-blend
skinning.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from assets.texture import checked
from assets.transform import local_matrices
from pbd.arrays import floats, integers, numbers
from pbd.errors import InputError

__all__ = [
    "CHARACTER_SUFFIXES",
    "SEQUENCE_SUFFIXES",
    "USD_SUFFIXES",
    "Animation",
    "Character",
    "Clip",
    "with_clips",
]

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
CHARACTER_SUFFIXES = (".glb", ".gltf", *USD_SUFFIXES)
SEQUENCE_SUFFIXES = (".npz", ".mdd", ".pc2", *USD_SUFFIXES)  # of bodies that are given as vertex positions over time

Floats = NDArray[np.float64]

# A bind pose that moves a vertex by more than this [m] is a mistake in the data, not rounding: files store float32.
_BIND_TOLERANCE = 1e-3
_WEIGHT_TOLERANCE = 1e-3  # by which the weights of a vertex may fail to sum to 1 [-]


@dataclass(frozen=True, eq=False)
class Clip:
    """Local transforms of every joint, sampled at a uniform rate.

    Attributes:
        name: name of the clip inside its character.
        rate: samples per second [Hz].
        translation: offset from the parent [m], shape (frames, joints, 3), float64.
        rotation: unit quaternions x, y, z, w [-], shape (frames, joints, 4), float64.
        scale: scale along the joint's axes [-], shape (frames, joints, 3), float64.
    """

    name: str
    rate: float
    translation: Floats
    rotation: Floats
    scale: Floats

    def __post_init__(self) -> None:
        for key in ("translation", "rotation", "scale"):
            array = numbers(getattr(self, key), f"clip {self.name}, {key}", ("frames", "joints", "width"))
            object.__setattr__(self, key, array)
        frames, joints = self.translation.shape[:2]
        for key, width in (("translation", 3), ("rotation", 4), ("scale", 3)):
            array = getattr(self, key)
            if frames < 1 or array.shape != (frames, joints, width):
                raise InputError(
                    "bad shape",
                    key=f"clip {self.name}, {key}",
                    received=array.shape,
                    expected=f"(frames, joints, {width}), the same for all three arrays",
                )
            if not np.isfinite(array).all():
                frame = int(np.argwhere(~np.isfinite(array))[0, 0])
                key, received = f"clip {self.name}, {key}, frame {frame}", float(array[~np.isfinite(array)][0])
                raise InputError("values that are not finite", key=key, received=received, expected="finite numbers")
        if not self.rate > 0:
            raise InputError("bad rate", key=f"clip {self.name}", received=self.rate, expected="more than 0 Hz")
        lengths = np.linalg.norm(self.rotation, axis=2)
        if np.abs(lengths - 1.0).max() > 1e-4:
            frame, joint = np.unravel_index(int(np.abs(lengths - 1.0).argmax()), lengths.shape)
            raise InputError(
                "a rotation that is not a unit quaternion",
                key=f"clip {self.name}, frame {frame}, joint {joint}",
                received=self.rotation[frame, joint].tolist(),
            )

    @property
    def frame_count(self) -> int:
        """Number of samples [-]."""
        return len(self.translation)

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return (self.frame_count - 1) / self.rate


@dataclass(frozen=True, eq=False)
class Character:
    """A skinned mesh with the clips that move it; the bind pose is the mesh as stored.

    Attributes:
        name: name for messages.
        vertices: bind pose in the world [m], shape (vertices, 3), float64, one vertex per position.
        faces: counter-clockwise from outside, shape (faces, 3), int32.
        joint_names: one name per joint.
        joint_parents: index of the parent, -1 at a root, parents first, shape (joints,), int32.
        joint_indices: joints that move a vertex, shape (vertices, 4), int32.
        joint_weights: their weights [-], rows sum to 1, shape (vertices, 4), float32.
        rest_local: bind pose as local translation [m] (joints, 3), rotation x, y, z, w (joints, 4), scale (joints, 3).
        inverse_bind: world of the bind pose to joint, shape (joints, 4, 4).
        root_transform: constant transform above the root joints, shape (4, 4).
        clips: clips by name.
        texture: texture coordinates of each face corner, v upwards, shape (faces, 3, 2), float64, NaN at faces without;
            None without any.
    """

    name: str
    vertices: Floats
    faces: NDArray[np.int32]
    joint_names: tuple[str, ...]
    joint_parents: NDArray[np.int32]
    joint_indices: NDArray[np.int32]
    joint_weights: NDArray[np.float32]
    rest_local: tuple[Floats, Floats, Floats]
    inverse_bind: Floats
    root_transform: Floats
    clips: dict[str, Clip] = field(default_factory=dict)
    texture: Floats | None = None

    def __post_init__(self) -> None:
        _keep_arrays(self)
        _check_shapes(self)
        _check_weights(self)
        for clip in self.clips.values():
            if clip.translation.shape[1] != self.joint_count:
                raise InputError(
                    "a clip for another skeleton",
                    key=f"character {self.name}, clip {clip.name}",
                    received=f"{clip.translation.shape[1]} joints",
                    expected=f"{self.joint_count} joints",
                )
        # How far the bind pose can move any point of the mesh.
        difference = np.abs(self.pose_from_local(*self.rest_local) - self.bind_pose())
        error = (difference[:, :, :3] @ np.abs(self.vertices).max(axis=0) + difference[:, :, 3]).max(axis=1)
        if error.max() > _BIND_TOLERANCE:
            joint = int(error.argmax())
            raise InputError(
                "the bind pose and the inverse bind matrix disagree",
                key=f"character {self.name}, joint {self.joint_names[joint]}",
                received=f"{error[joint]:.3g} m",
                expected=f"less than {_BIND_TOLERANCE} m",
            )

    @property
    def joint_count(self) -> int:
        """Number of joints [-]."""
        return len(self.joint_names)

    @cached_property
    def _levels(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Joints of each depth below the roots and their parents, so that a level is one batched product."""
        depth = np.zeros(self.joint_count, dtype=np.intp)
        for joint, parent in enumerate(self.joint_parents):
            depth[joint] = depth[parent] + 1 if parent >= 0 else 0
        levels = [np.flatnonzero(depth == level) for level in range(1, int(depth.max()) + 1)]
        return [(joints, self.joint_parents[joints].astype(np.intp)) for joints in levels]

    def joint_transforms(self, translation: Floats, rotation: Floats, scale: Floats) -> Floats:
        """Transforms of the joints in the world, shape (joints, 4, 4), from local ones.

        Args:
            translation: offset from the parent [m], shape (joints, 3).
            rotation: unit quaternions x, y, z, w, shape (joints, 4).
            scale: scale along the joint's axes [-], shape (joints, 3).

        Raises:
            InputError: arrays of another shape, or values that are not finite.
        """
        count = self.joint_count
        translation = floats(translation, "translation", (count, 3), unit=" [m]")
        rotation, scale = floats(rotation, "rotation", (count, 4)), floats(scale, "scale", (count, 3))
        world = local_matrices(translation, rotation, scale)
        roots = self.joint_parents < 0
        world[roots] = self.root_transform @ world[roots]
        for joints, parents in self._levels:
            world[joints] = world[parents] @ world[joints]
        return world

    def pose_from_local(self, translation: Floats, rotation: Floats, scale: Floats) -> Floats:
        """Skinning matrices [-, m], shape (joints, 3, 4), from local transforms (see :meth:`joint_transforms`)."""
        return self.joint_transforms(translation, rotation, scale)[:, :3] @ self.inverse_bind

    def bind_pose(self) -> Floats:
        """The pose that leaves the mesh as stored: identities, shape (joints, 3, 4)."""
        return np.tile(np.eye(3, 4), (self.joint_count, 1, 1))

    def clip(self, name: str) -> Clip:
        """The clip of that name.

        Raises:
            InputError: there is none; the message lists those that exist.
        """
        if name not in self.clips:
            known = "one of " + ", ".join(sorted(self.clips)) if self.clips else "none: it has no clips"
            raise InputError("no such clip", key=f"character {self.name}", received=name, expected=known)
        return self.clips[name]


@dataclass(frozen=True, eq=False)
class Animation:
    """A skeleton with clips and without a mesh.

    Attributes:
        file: the file that it comes from.
        joint_names: one name per joint, not always different.
        joint_parents: index of the parent, -1 at a root, parents first, shape (joints,), int32.
        root_transform: constant transform above the root joints, to metres, Y up, shape (4, 4).
        clips: clips of these joints, by name.
    """

    file: Path
    joint_names: tuple[str, ...]
    joint_parents: NDArray[np.int32]
    root_transform: Floats
    clips: dict[str, Clip]


def with_clips(character: Character, other: Character) -> Character:
    """The character with the clips of another file of the same mesh and skeleton added.

    Raises:
        InputError: other joints, another tree, another bind pose, another vertex count, or a clip name that both have.
    """
    key = f"character {other.name}"
    if other.joint_names != character.joint_names:
        unknown = sorted(set(other.joint_names) ^ set(character.joint_names)) or ["the order"]
        problem = f"clips of another skeleton than {character.name}: joints differ in {', '.join(unknown[:5])}"
        raise InputError(problem, key=key)
    if not np.array_equal(other.joint_parents, character.joint_parents):
        joint = int(np.flatnonzero(other.joint_parents != character.joint_parents)[0])
        problem = f"clips of another skeleton than {character.name}"
        raise InputError(problem, key=f"{key}, parent of {other.joint_names[joint]}")
    if len(other.vertices) != len(character.vertices):
        raise InputError(
            f"clips of another mesh than {character.name}",
            key=f"{key}, vertices",
            received=len(other.vertices),
            expected=str(len(character.vertices)),
        )
    here, there = character.joint_transforms(*character.rest_local), other.joint_transforms(*other.rest_local)
    gap = np.abs(here - there).max(axis=(1, 2))
    if gap.max() > _BIND_TOLERANCE:
        joint = other.joint_names[int(gap.argmax())]
        raise InputError(f"clips of another bind pose than {character.name}", key=f"{key}, joint {joint}")
    twice = sorted(set(character.clips) & set(other.clips))
    if twice:
        raise InputError("clips of the same name in both files", key=key, received=twice[0])
    return replace(character, clips={**character.clips, **other.clips})


def _keep_arrays(character: Character) -> None:
    """Make arrays of what is none yet, and refuse what does not hold numbers."""
    about = f"character {character.name}, "
    for name, axes in (
        ("vertices", 2), ("faces", 2), ("joint_parents", 1), ("joint_indices", 2), ("joint_weights", 2),
        ("inverse_bind", 3), ("root_transform", 2),
    ):  # fmt: skip
        array = numbers(getattr(character, name), about + name, tuple("klm"[:axes]))
        if name in ("faces", "joint_parents", "joint_indices") and array.dtype.kind == "f":
            least = -1 if name == "joint_parents" else 0
            array = least + integers(array - least, about + name, array.shape)
        object.__setattr__(character, name, array)
    rest, names = character.rest_local, ("translation", "rotation", "scale")
    if not isinstance(rest, (tuple, list)) or len(rest) != len(names):
        raise InputError("bad shape", key=f"{about}rest_local", received=type(rest).__name__, expected=", ".join(names))
    rest = tuple(numbers(x, f"{about}rest_local {name}", ("k", "l")) for name, x in zip(names, rest, strict=True))
    object.__setattr__(character, "rest_local", rest)


def _check_shapes(character: Character) -> None:
    vertices, joints = len(character.vertices), len(character.joint_names)
    expected = {
        "vertices": (character.vertices, (vertices, 3)),
        "faces": (character.faces, (len(character.faces), 3)),
        "joint_parents": (character.joint_parents, (joints,)),
        "joint_indices": (character.joint_indices, (vertices, 4)),
        "joint_weights": (character.joint_weights, (vertices, 4)),
        "rest_local translation": (character.rest_local[0], (joints, 3)),
        "rest_local rotation": (character.rest_local[1], (joints, 4)),
        "rest_local scale": (character.rest_local[2], (joints, 3)),
        "inverse_bind": (character.inverse_bind, (joints, 4, 4)),
        "root_transform": (character.root_transform, (4, 4)),
    }
    for key, (array, shape) in expected.items():
        key = f"character {character.name}, {key}"
        if array.shape != shape or 0 in shape:
            raise InputError("bad shape", key=key, received=array.shape, expected=str(shape))
        if not np.isfinite(array).all():
            row = int(np.argwhere(~np.isfinite(array))[0, 0])
            received = float(array[~np.isfinite(array)][0])
            key = f"{key}, row {row}"
            raise InputError("values that are not finite", key=key, received=received, expected="finite numbers")
    if character.texture is not None:
        texture = checked(character.texture, len(character.faces), f"character {character.name}, texture")
        object.__setattr__(character, "texture", texture)
    linear = character.root_transform[:3, :3]
    square = linear @ linear.T
    if np.abs(square - np.eye(3) * square.trace() / 3.0).max() > 1e-4 * square.trace():
        raise InputError("a root transform that shears or scales unevenly", key=f"character {character.name}")
    bad = np.flatnonzero(((character.faces < 0) | (character.faces >= vertices)).any(axis=1))
    if bad.size:
        raise InputError(
            "a face with a vertex that does not exist",
            key=f"character {character.name}, face {bad[0]}",
            received=character.faces[bad[0]].tolist(),
            expected=f"0 to {vertices - 1}",
        )
    parents = character.joint_parents
    bad = np.flatnonzero((parents < -1) | (parents >= np.arange(joints)))
    if bad.size:
        raise InputError(
            "joints out of order",
            key=f"character {character.name}, joint {character.joint_names[bad[0]]}",
            received=int(parents[bad[0]]),
            expected="a parent that stands before it, or -1",
        )


def _check_weights(character: Character) -> None:
    indices, weights = character.joint_indices, character.joint_weights
    bad = np.flatnonzero(((indices < 0) | (indices >= character.joint_count)).any(axis=1))
    if bad.size:
        raise InputError(
            "a joint that does not exist",
            key=f"character {character.name}, vertex {bad[0]}",
            received=indices[bad[0]].tolist(),
            expected=f"0 to {character.joint_count - 1}",
        )
    bad = np.flatnonzero((weights < 0).any(axis=1) | (np.abs(weights.sum(axis=1) - 1.0) > _WEIGHT_TOLERANCE))
    if bad.size:
        raise InputError(
            "skin weights that do not sum to one",
            key=f"character {character.name}, vertex {bad[0]}",
            received=weights[bad[0]].tolist(),
        )
