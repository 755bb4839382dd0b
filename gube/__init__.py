"""Real-time clothing with the folds of an offline simulation: the one name to import.

Every public name is imported from its folder when it is first used, so that ``import gube`` costs next to nothing and a
game that plays a database never loads what only learning needs. ``docs/api.md`` lists the names.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

# Each public name, with the module and the attribute that it stands for. The block below repeats them for type
# checkers; a test holds the two equal.
SOURCES = {
    "Body": "pbd.contact.colliders:Body",
    "Capsule": "pbd.contact.colliders:Capsule",
    "Character": "assets.character:Character",
    "ClipMotion": "assets.motion:ClipMotion",
    "ClothMesh": "pbd.mesh:ClothMesh",
    "Colliders": "pbd.contact.colliders:Colliders",
    "LevelOfDetail": "runtime.play.level_of_detail:LevelOfDetail",
    "DistanceField": "pbd.contact.distance_field:DistanceField",
    "FABRICS": "assets.fabrics:PRESETS",
    "Fabric": "pbd.fabric:Fabric",
    "GameLoop": "runtime.play.game_loop:GameLoop",
    "GarmentGroup": "runtime.detail.garment_group:GarmentGroup",
    "InputError": "pbd.errors:InputError",
    "LearningOptions": "precompute.learning.options:LearningOptions",
    "LiveInput": "runtime.play.game_loop:LiveInput",
    "Model": "pbd.model:Model",
    "ModelOptions": "pbd.model:ModelOptions",
    "Plane": "pbd.contact.colliders:Plane",
    "Planner": "runtime.detail.planner:Planner",
    "Player": "runtime.play.player:Player",
    "SOLVERS": "pbd.models.registry:SOLVERS",
    "ViewSize": "runtime.detail.planner:ViewSize",
    "Simulation": "runtime.play.simulation:Simulation",
    "Solver": "pbd.xpbd.solver:Solver",
    "SolverOptions": "pbd.xpbd.solver:SolverOptions",
    "Sphere": "pbd.contact.colliders:Sphere",
    "State": "pbd.state:State",
    "StepError": "pbd.models.newton:StepError",
    "Wind": "pbd.wind:Wind",
    "WrinkleDatabase": "wrinkles.database:WrinkleDatabase",
    "bake_glb": "runtime.export.animation_files:bake_glb",
    "build_model": "pbd.model:build_model",
    "ensure_initialized": "pbd.engine:ensure_initialized",
    "load_character": "assets.loading:load_character",
    "load_fabric": "assets.fabrics:load_fabric",
    "load_garment": "assets.loading:load_garment",
    "load_scene": "assets.io.scene:load_scene",
    "make_solver": "pbd.models.registry:make_solver",
    "parse_scene": "assets.io.scene:parse_scene",
    "player_of": "runtime.play.player:player_of",
    "precompute": "precompute.learning.pipeline:precompute",
    "read_cost_table": "runtime.detail.cost_table:read_cost_table",
    "read_database": "wrinkles.database_file:read_database",
    "simulation_of": "runtime.setup.scene_simulation:simulation_of",
}

if TYPE_CHECKING:
    from assets.character import Character as Character
    from assets.fabrics import PRESETS as FABRICS
    from assets.fabrics import load_fabric as load_fabric
    from assets.io.scene import load_scene as load_scene
    from assets.io.scene import parse_scene as parse_scene
    from assets.loading import load_character as load_character
    from assets.loading import load_garment as load_garment
    from assets.motion import ClipMotion as ClipMotion
    from pbd.contact.colliders import Body as Body
    from pbd.contact.colliders import Capsule as Capsule
    from pbd.contact.colliders import Colliders as Colliders
    from pbd.contact.colliders import Plane as Plane
    from pbd.contact.colliders import Sphere as Sphere
    from pbd.contact.distance_field import DistanceField as DistanceField
    from pbd.engine import ensure_initialized as ensure_initialized
    from pbd.errors import InputError as InputError
    from pbd.fabric import Fabric as Fabric
    from pbd.mesh import ClothMesh as ClothMesh
    from pbd.model import Model as Model
    from pbd.model import ModelOptions as ModelOptions
    from pbd.model import build_model as build_model
    from pbd.models.newton import StepError as StepError
    from pbd.models.registry import SOLVERS as SOLVERS
    from pbd.models.registry import make_solver as make_solver
    from pbd.state import State as State
    from pbd.wind import Wind as Wind
    from pbd.xpbd.solver import Solver as Solver
    from pbd.xpbd.solver import SolverOptions as SolverOptions
    from precompute.learning.options import LearningOptions as LearningOptions
    from precompute.learning.pipeline import precompute as precompute
    from runtime.detail.cost_table import read_cost_table as read_cost_table
    from runtime.detail.garment_group import GarmentGroup as GarmentGroup
    from runtime.detail.planner import Planner as Planner
    from runtime.detail.planner import ViewSize as ViewSize
    from runtime.export.animation_files import bake_glb as bake_glb
    from runtime.play.game_loop import GameLoop as GameLoop
    from runtime.play.game_loop import LiveInput as LiveInput
    from runtime.play.level_of_detail import LevelOfDetail as LevelOfDetail
    from runtime.play.player import Player as Player
    from runtime.play.player import player_of as player_of
    from runtime.play.simulation import Simulation as Simulation
    from runtime.setup.scene_simulation import simulation_of as simulation_of
    from wrinkles.database import WrinkleDatabase as WrinkleDatabase
    from wrinkles.database_file import read_database as read_database

    __version__: str

else:  # with a function of this name in sight, a type checker would take any name for a public one

    def __getattr__(name: str) -> Any:
        """Import a public name when it is first used (PEP 562)."""
        if name == "__version__":
            from importlib.metadata import PackageNotFoundError, version

            try:
                value: Any = version("gube")
            except PackageNotFoundError:  # run from a source tree
                value = "0"
        elif name in SOURCES:
            from importlib import import_module

            module, _, attribute = SOURCES[name].partition(":")
            value = getattr(import_module(module), attribute)
        else:
            raise AttributeError(_unknown(name), name=name)
        globals()[name] = value
        return value


__all__ = sorted([*SOURCES, "__version__"])  # pyright: ignore[reportUnsupportedDunderAll]


def __dir__() -> list[str]:
    return __all__


def _unknown(name: str) -> str:
    """Message of the error for a name that is not public, with those that look like it."""
    from difflib import get_close_matches

    lowered = {public.lower(): public for public in SOURCES}
    close = [lowered[match] for match in get_close_matches(name.lower(), lowered, cutoff=0.7)]
    hint = f"did you mean {' or '.join(close)}?" if close else "dir(gube) lists the public names"
    return f"module 'gube' has no attribute '{name}': {hint}"
