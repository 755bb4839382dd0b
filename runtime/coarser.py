"""A garment simulated on the mesh below its coarse one, which follows."""

from dataclasses import replace

import numpy as np

from pbd import ModelOptions, State, build_model
from pbd.attachment import Attachment
from pbd.engine import ti
from pbd.geometry import FAR, Float1, Int1, Vec3, Vec4, vec3, vec4, xyz
from pbd.taichi_internals import Launch
from runtime.simulation import Simulation
from wrinkles.coarser import Coarser
from wrinkles.surface import csr_arrays

__all__ = ["CoarserSimulation"]

STAND_OFF = 0.035  # of a mean edge, kept from the body besides the thickness: what hangs on the mesh dips below it
THINNED = 0.6 * FAR  # what touches the body is nearer than FAR to a vertex of it that is left for the search [m]


@ti.kernel
def _follow(
    start: Int1,
    index: Int1,
    value: Float1,
    leading: Int1,
    own_position: Vec4,
    own_velocity: Vec3,
    own_contact: Float1,
    own_nearest: Int1,
    position: Vec4,
    velocity: Vec3,
    contact: Float1,
    nearest: Int1,
):
    """Bound vertices where their mesh carries them, and what they are near to."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        for i in range(position.shape[0]):
            x, v, away = vec3(0.0), vec3(0.0), 0.0
            for q in range(start[i], start[i + 1]):
                k = index[q]
                x += value[q] * xyz(own_position[k])
                v += value[q] * own_velocity[k]
                away += value[q] * own_contact[k]
            position[i] = vec4(x, position[i][3])
            velocity[i] = v
            contact[i] = away
            nearest[i] = own_nearest[leading[i]]


class CoarserSimulation:
    """Steps the mesh below the coarse one, on the body of a simulation of the coarse one, whose state follows.

    Args:
        coarser: the mesh and what hangs on it.
        above: the coarse garment's simulation; it keeps its options and lends its body.
        options: how the coarse garment's model is made from its mesh; the coarser one's is made alike.
        body_vertices: of the body's bind pose [m], shape (b, 3).
        attachment: of the coarse mesh's held vertices.

    Attributes:
        simulation: of the mesh below.
    """

    def __init__(
        self,
        coarser: Coarser,
        above: Simulation,
        options: ModelOptions,
        body_vertices: np.ndarray,
        attachment: Attachment,
    ) -> None:
        fabric, edge = above.model.fabric, float(coarser.mesh.edge_lengths()[1].mean())
        thicker = replace(fabric, thickness=fabric.thickness + STAND_OFF * edge)
        limits = above.model.limits.taken(coarser.nearest)
        model = replace(build_model(coarser.mesh, thicker, coarser.held, options, limits=limits), smooth=True)
        own = Attachment.bind(coarser.mesh.vertices[coarser.held], body_vertices, above.body.faces)
        self.simulation = above.beside(model, own)
        self._coarser, self._above, self._attachment = coarser, above, attachment
        self._rows, self._launch = csr_arrays(coarser.matrix), Launch(_follow)
        self._surfaces = above.body.surface, above.body.thinned(body_vertices, THINNED)
        self._write(above.state.copy())  # compiled now, not in the first frame

    def take_over(self) -> None:
        """Go on from where the coarse garment is, as near as the mesh comes to it, and as fast; momentum stays."""
        above, own = self._above.state, self.simulation.state
        inverse = self._coarser.inverse
        own.move_origin(above.origin)
        own.position[:, :3] = inverse @ above.position[:, :3]
        own.velocity[:] = inverse @ above.velocity
        own.nearest[:] = -1
        own.nearest[: len(inverse)] = above.nearest[self._coarser.nearest]
        self.simulation.body.surface = self._surfaces[1]
        # Memory of the coarse garment's contacts ends here: what its edges and folds touched is not carried along.
        above.nearest[len(above.position) :] = -1
        above.pairs, above.pair_sides = above.pairs[:0], above.pair_sides[:0]
        self.hold()
        self.lead()

    def give_back(self) -> None:
        """Leave the coarse garment, which is where this one is, to itself."""
        self.simulation.body.surface = self._surfaces[0]

    def hold(self) -> None:
        """Hold what of the coarse garment is dragged, by the vertex that it leans on most."""
        above, own, model = self._above, self.simulation.state, self.simulation.model
        own.position[:, 3] = model.inverse_mass
        dragged = np.flatnonzero((above.state.position[:, 3] == 0.0) & (above.model.inverse_mass > 0.0))
        for vertex in dragged:
            lead = self._coarser.leading[vertex]
            own.position[lead] = *above.state.position[vertex, :3], 0.0
            own.velocity[lead] = 0.0

    def carried(self, position: np.ndarray) -> np.ndarray:
        """Coarse positions that this mesh comes nearest to others with: [m], shape (n, 3) both."""
        return self._coarser.matrix @ (self._coarser.inverse @ position)

    def lead(self) -> None:
        """Bring the coarse garment's state to where this one is."""
        above, held = self._above.state, self._above.model.held
        above.move_origin(self.simulation.state.origin)
        self._write(above)
        if len(held):
            above.position[held, :3] = self._attachment.targets(self._above.body.current)

    def _write(self, above: State) -> None:
        own = self.simulation.state
        self._launch(
            *self._rows, self._coarser.leading, own.position, own.velocity, own.contact, own.nearest,
            above.position, above.velocity, above.contact, above.nearest,
        )  # fmt: skip
