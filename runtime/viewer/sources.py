"""What a viewer is opened on, a wrinkle database or a scene: its motions, fabrics and garments to choose from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from assets.character import Character
from assets.io.scene import Scene
from assets.io.sequence import Sequence
from assets.motion import Motion
from pbd.wind import Wind
from runtime.draw.shown_body import shown_body
from runtime.output.verdict import verdict
from runtime.play.plain_cloth import plain_choice
from runtime.play.plain_surface import SmoothGarment
from runtime.play.player import Player, player_of
from runtime.setup.garment_mesh import texture_of
from runtime.setup.garment_setup import scene_of
from runtime.setup.playback_inputs import PlaybackInputs
from runtime.setup.scene_body import body_of
from runtime.setup.scene_simulation import simulation_of
from runtime.viewer.garments import ShownTruth, ViewedGarment
from wrinkles.database import WrinkleDatabase
from wrinkles.worn_garments import garment_names

__all__ = ["DatabaseSource", "SceneSource", "Source"]


@dataclass(frozen=True)
class DatabaseSource:
    """A wrinkle database that is viewed.

    Attributes:
        path: of its file.
        database: the database.
        inputs: its body, motions, wind and colliders.
        truths: recorded fine simulations by the name of the motion.
    """

    path: Path
    database: WrinkleDatabase
    inputs: PlaybackInputs
    truths: Mapping[str, ShownTruth]

    @property
    def title(self) -> str:
        """The garment and the file."""
        return f"{self.database.garment_name} ({self.path.name})"

    @property
    def motions(self) -> tuple[Motion, ...]:
        """Motions that can be played."""
        return self.inputs.motions

    @property
    def fabrics(self) -> tuple[str, ...]:
        """Fabrics that the wrinkles were learned in, the garment's own first."""
        return self.database.fabric_names

    @property
    def garments(self) -> tuple[str, ...]:
        """Garments that can be taken off, from the innermost outwards; none where there is but one."""
        return () if self.database.layers is None else garment_names(self.database)

    @property
    def frame_rate(self) -> float:
        """Rate of ticks [Hz]."""
        return self.database.frame_rate

    @property
    def wind(self) -> Wind:
        """Wind of the scene."""
        return self.inputs.wind

    @property
    def scene(self) -> Scene:
        """The scene that is stored in the database."""
        return scene_of(self.database)

    @property
    def body(self) -> Character | Sequence:
        """What wears the garment."""
        return self.inputs.body

    @property
    def prefers_plain_cloth(self) -> bool:
        """Whether plain cloth costs less and is as good, as a comparison found."""
        return plain_choice(self.database) is not None

    @property
    def notice(self) -> str:
        """What this is, how good it is, what it costs, and so what is played by itself."""
        more = ("'play the wrinkles' plays the learned folds.",) if self.prefers_plain_cloth else ()
        return " ".join((*verdict(self.database), *more))

    @property
    def wrinkles_notice(self) -> str:
        """The same where the wrinkles are asked for."""
        if not self.prefers_plain_cloth:
            return self.notice
        return " ".join((*verdict(self.database), "Here the learned folds are played."))

    @property
    def wearable(self) -> bool:
        """Whether stiffness and weight can be changed: those of several garments at once cannot."""
        return self.database.layers is None

    def garment(self, motion: Motion | None, fabric: str, wrinkles: bool) -> ViewedGarment:
        """The garment at the start of a motion.

        Args:
            motion: one of :attr:`motions`.
            fabric: one of :attr:`fabrics`.
            wrinkles: play the wrinkles even where plain cloth is the better choice.
        """
        assert motion is not None
        database = self.database if fabric == self.database.fabric_name else self.database.in_fabric(fabric)
        inputs = self.inputs
        player = player_of(database, inputs.body, motion.pose(0.0), primitives=inputs.primitives, wrinkles=wrinkles)
        truth = self.truths.get(motion.name) if fabric == self.database.fabric_name else None
        body = shown_body(inputs.body, player.levels)
        return ViewedGarment(player, motion, body, database.fine_texture, truth)

    def wearing(self, garment: ViewedGarment, names: tuple[str, ...]) -> ViewedGarment:
        """The same player and motion with some garments of the outfit, from its present moment on.

        Args:
            garment: made by :meth:`garment`.
            names: of :attr:`garments`.

        Raises:
            InputError: no garment, or one that the outfit does not have.
        """
        player, motion = garment.player, garment.motion
        assert motion is not None
        player.wear(names)
        truth = self.truths.get(motion.name) if player.worn == self.garments else None
        body = shown_body(self.inputs.body, player.levels)
        return ViewedGarment(player, motion, body, player.database.fine_texture, truth)


@dataclass(frozen=True)
class SceneSource:
    """A scene whose garments are simulated without wrinkles.

    Attributes:
        path: of its file.
        scene: the scene.
    """

    path: Path
    scene: Scene

    @property
    def notice(self) -> str:
        """What is played."""
        return "The garments of a scene, simulated without wrinkles. A database of `gube precompute` has wrinkles."

    @property
    def wrinkles_notice(self) -> str:
        """The same: there are no wrinkles to choose."""
        return self.notice

    @property
    def title(self) -> str:
        """The garments and the file."""
        return f"{', '.join(garment.name for garment in self.scene.garments)} ({self.path.name})"

    @property
    def motions(self) -> tuple[Motion, ...]:
        """Motions to choose from: none, for a scene names its own."""
        return ()

    @property
    def garments(self) -> tuple[str, ...]:
        """Garments that can be taken off: none."""
        return ()

    @property
    def fabrics(self) -> tuple[str, ...]:
        """Fabrics to choose from: none, for each garment has its own."""
        return ()

    @property
    def frame_rate(self) -> float:
        """Rate of ticks [Hz]."""
        return self.scene.solver.frame_rate

    @property
    def wind(self) -> Wind:
        """Wind of the scene."""
        return self.scene.wind.air()

    @property
    def body(self) -> Character | Sequence | None:
        """What wears the garments; None without a body."""
        return None if self.scene.character is None else body_of(self.scene)

    @property
    def prefers_plain_cloth(self) -> bool:
        """There are no wrinkles to choose."""
        return False

    @property
    def wearable(self) -> bool:
        """Whether stiffness and weight can be changed: those of several garments at once cannot."""
        return len(self.scene.garments) == 1

    def garment(self, motion: Motion | None, fabric: str, wrinkles: bool) -> ViewedGarment:
        """The garments at the start of the motion; a scene has no other fabric and no wrinkles."""
        body = self.body  # as it is before its file changes
        simulation, motion = simulation_of(self.scene)
        pose = None if motion is None else motion.pose(0.0)
        player = Player.of_scene(simulation, pose, self.frame_rate)
        surface = player.surface
        assert isinstance(surface, SmoothGarment)
        return ViewedGarment(player, motion, body, surface.subdivision.flat_corners(texture_of(self.scene)))


Source = DatabaseSource | SceneSource
