"""Cloth, fabrics, colliders and time: the solvers and everything they stand on."""

from pbd.contact.colliders import Body, Capsule, Colliders, DistanceField, Plane, Sphere
from pbd.engine import ensure_initialized
from pbd.errors import InputError
from pbd.fabric import Fabric
from pbd.limits import Limits
from pbd.mesh import ClothMesh
from pbd.model import Model, ModelOptions, build_model
from pbd.state import State
from pbd.xpbd.solver import Solver, SolverOptions

__all__ = [
    "Body",
    "Capsule",
    "ClothMesh",
    "Colliders",
    "DistanceField",
    "Fabric",
    "InputError",
    "Limits",
    "Model",
    "ModelOptions",
    "Plane",
    "Sphere",
    "Solver",
    "SolverOptions",
    "State",
    "build_model",
    "ensure_initialized",
]
