"""Views: the functions of the kernels take these instead of long lists of arrays.

A view is a plain Python object that exists only while a kernel is compiled. The kernel makes it from its own arguments
and hands it on as a ``ti.template()``: it costs nothing when the kernel runs. An array that a kernel does not use may
be left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from pbd.engine import ti
from pbd.geometry import vec3
from pbd.taichi_internals import in_kernel, local, subscript

__all__ = [
    "ClothArrays",
    "ConstraintArrays",
    "ContactWork",
    "FrameSteps",
    "MultigridArrays",
    "ObstacleArrays",
    "PairArrays",
    "ParameterVector",
    "StepParameters",
    "StepView",
]


@in_kernel
@dataclass(eq=False)
class ClothArrays:
    """The vertices of a garment and the forces on them.

    A vertex stands at ``position`` (on a grid) plus a small ``position_delta``, which takes the corrections. Its
    velocity is ``velocity + velocity_delta``.

    Attributes:
        position: [m], and the inverse mass [1/kg], vec4.
        velocity: at the start of the frame [m/s], vec3.
        position_delta: [m], vec4.
        velocity_delta: change of the velocity in the frame so far [m/s], vec4. In a substep the predicted
            position_delta / h is taken off it, so that the vertex started it at -h (velocity + velocity_delta).
        normals: unit vertex normals, and the acceleration by pressure along them [m/s2], vec4.
        air: velocity of the air [m/s], and its drag over the mass [1/m], vec4.
        pressure: [Pa]; no number where there is none anywhere.
        held: vertices that follow targets, and ``target_start``, ``target_end``: where these are at the start and end
            of the frame [m], vec3.
    """

    position: Any = None
    velocity: Any = None
    position_delta: Any = None
    velocity_delta: Any = None
    normals: Any = None
    air: Any = None
    pressure: Any = None
    held: Any = None
    target_start: Any = None
    target_end: Any = None
    _data_oriented = True


@in_kernel
@dataclass(eq=False)
class ConstraintArrays:
    """The constraints of a garment, see :class:`pbd.Model`.

    Attributes:
        triangles, triangle_blocks, block_colors, triangle_data: of the model.
        hinges, hinge_colors, hinge_data, stitches, tethers, tether_lengths: of the model.
        rubs: whether the shear of the triangles has internal friction, known while the kernel is compiled. Their data
            then have two more rows: the shear at which it slips, see :func:`pbd.xpbd.constraints.rubbing_shear`, and
            the one at which it is without force, which is written.
        stitch_data: of each stitch the place w on its edge, and how far it is still open at the start and at the end of
            the frame [m], vec4.
        limits: position of the target at the frame's start and the vertex, motion of the target over the frame, normal
            there, law of :func:`pbd.xpbd.constraints.limit_correction`; vec4, shape (l, 4).
        bending_factor: see :func:`pbd.xpbd.stiff_bending.bending_factor`; no row where hinges are solved one by one.
        stiff: whether the kernel solves any bending by such a factor, known while it is compiled.
        strain_limits, limit_work: see :func:`pbd.contact.strain_limits.limit_rows`.
    """

    triangles: Any = None
    triangle_blocks: Any = None
    block_colors: Any = None
    triangle_data: Any = None
    hinges: Any = None
    hinge_colors: Any = None
    hinge_data: Any = None
    stitches: Any = None
    stitch_data: Any = None
    tethers: Any = None
    tether_lengths: Any = None
    limits: Any = None
    strain_limits: Any = None
    limit_work: Any = None
    bending_factor: Any = None
    rubs: bool = False
    stiff: bool = False
    _data_oriented = True


@in_kernel
@dataclass(eq=False)
class ObstacleArrays:
    """Planes, spheres and capsules (:meth:`pbd.Colliders.rows`), and distance fields (:meth:`pbd.Colliders.fields`)."""

    primitives: Any = None
    fields: Any = None
    field_values: Any = None
    _data_oriented = True


@in_kernel
@dataclass(eq=False)
class ContactWork:
    """Where a garment is tested for contact with a body, and where it touches it.

    Attributes:
        samples: two vertices, between which a sample lies; the same vertex twice for a vertex.
        sample_colors: offsets of the samples that share no vertex.
        nearest: body vertex near each sample, -1 for none.
        contact_faces, contact_weights: the face that each sample touched last, see :class:`pbd.State`.
        contact_points: of each sample the point that it touches at the frame's start, the motion of that point over
            the frame, the normal there; vec4, shape (s, 3).
        active_samples: samples that have a body vertex near them, sorted by colour; half the array further on
            those of them that are near the body until all are tested again.
        active_counts: of each colour, how many there are of both kinds.
        contact_distance: of each vertex at the end of the frame [m]; written only.
        max_approach: how far cloth and body can come nearer to one another in the frame [m], one number.
    """

    samples: Any = None
    sample_colors: Any = None
    nearest: Any = None
    contact_faces: Any = None
    contact_weights: Any = None
    contact_points: Any = None
    active_samples: Any = None
    active_counts: Any = None
    contact_distance: Any = None
    max_approach: Any = None
    _data_oriented = True


@in_kernel
@dataclass(eq=False)
class MultigridArrays:
    """Coarser levels of a garment, see :class:`pbd.xpbd.multigrid.Multigrid`, and their values in a substep.

    Attributes:
        used: whether the kernel has coarser levels at all, known while it is compiled.
        parent, mass_share, level_starts, children: of that class.
        springs, spring_colors, color_starts, spring_data, spring_shares: of that class.
        displacement: of the centres of the patches over the substep [m], and inverse masses [1/kg], vec4. Corrections
            go here: small numbers keep their digits.
        patch_centers: at the start of the substep [m], vec4. Before that it is workspace of the bending of stiff cloth.
        predicted_displacement: the displacement before any correction [m], vec4.
        coarse_strain: strain that the springs of the coarser levels bear (uu, vv, 2 uv) [-], vec4.
        spring_workspace: of each spring its direction, distance and length [m], compliance, inverse mass of both ends,
            multiplier and the least that this may be; shape (9, m + BLOCK).
    """

    used: bool = True
    parent: Any = None
    mass_share: Any = None
    displacement: Any = None
    patch_centers: Any = None
    predicted_displacement: Any = None
    coarse_strain: Any = None
    level_starts: Any = None
    children: Any = None
    springs: Any = None
    spring_colors: Any = None
    color_starts: Any = None
    spring_data: Any = None
    spring_shares: Any = None
    spring_workspace: Any = None
    _data_oriented = True


@in_kernel
@dataclass(eq=False)
class PairArrays:
    """Pairs of features of the cloth that may touch one another, see :class:`pbd.contact.self_collision.SelfCollision`.

    Attributes:
        used: whether the kernel has pairs at all, known while it is compiled.
        pairs, pair_data, ready_pairs: its ``pairs``, ``data`` and ``ready``.
    """

    used: bool = True
    pairs: Any = None
    pair_data: Any = None
    ready_pairs: Any = None
    _data_oriented = True


class FrameSteps(NamedTuple):
    """The substeps of a frame, in the order in which kernels take them as an int32 array.

    Attributes:
        begin, end: the first substep, and the one after the last.
        count: how many substeps the frame has.
        refresh: substeps between two tests of all contact samples.
        levels: coarser levels that are solved.
        sweeps: passes over each of them.
    """

    begin: int
    end: int
    count: int
    refresh: int
    levels: int
    sweeps: int


class StepParameters(NamedTuple):
    """Numbers of a step, in the order in which kernels take them as one vector.

    Attributes:
        h: substep [s].
        gravity_x, gravity_y, gravity_z: [m/s2].
        compression_compliance_scale: see :class:`pbd.ModelOptions` [-].
        thickness: of the fabric [m].
        friction: Coulomb coefficient [-].
        cushion: pressure of the law by which the thickness gives way, over the areal density [m/s2].
        smooth_surface: above 0 where middles of edges are tested for contact on the smooth surface over them [-].
    """

    h: float
    gravity_x: float
    gravity_y: float
    gravity_z: float
    compression_compliance_scale: float
    thickness: float
    friction: float
    cushion: float
    smooth_surface: float


ParameterVector = ti.types.vector(len(StepParameters._fields), ti.f32)


@in_kernel
class StepView:
    """Steps and parameters in a kernel, by their names: those of :class:`FrameSteps` and :class:`StepParameters`.

    Args:
        steps: int32 array.
        parameters: vector.

    Attributes:
        inverse_h, inverse_h2: 1/h [1/s] and its square.
        share: of a substep in the frame [-].
        gravity: [m/s2], vec3.
    """

    _data_oriented = True

    def __init__(self, steps: Any, parameters: Any) -> None:
        self.begin, self.end, self.count, self.refresh, self.levels, self.sweeps = _members(steps, FrameSteps._fields)
        (
            self.h, gravity_x, gravity_y, gravity_z, self.compression_compliance_scale, self.thickness, self.friction,
            self.cushion, self.smooth_surface,
        ) = _members(parameters, StepParameters._fields)  # fmt: skip
        self.gravity = local(vec3(gravity_x, gravity_y, gravity_z))
        self.inverse_h = local(1.0 / self.h)
        self.inverse_h2 = local(self.inverse_h * self.inverse_h)
        self.share = local(1.0 / self.count)


@in_kernel
def _members(array: Any, names: Sequence[str]) -> list[Any]:
    return [local(subscript(array, k)) for k in range(len(names))]
