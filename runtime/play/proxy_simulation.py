"""A garment simulated on the mesh below its coarse mesh; the coarse mesh follows it."""

from dataclasses import replace

import numpy as np

from pbd import ModelOptions, State, build_model
from pbd.attachment import Attachment
from pbd.engine import ti
from pbd.geometry import FAR, Float1, Int1, Vec3, Vec4, vec3, vec4, xyz
from pbd.taichi_internals import Launch
from runtime.play.simulation import Simulation
from wrinkles.proxy_mesh import ProxyMesh
from wrinkles.surface import csr_arrays

__all__ = ["ProxySimulation"]

YIELDING = 2.0  # a mesh of edges twice as long cannot fold as short: it gives way so many times as easily instead
STAND_OFF = 0.035  # distance from the body besides the thickness, over the mean edge: the coarse mesh dips that far [-]
THINNED = 0.6 * FAR  # spacing of the body vertices that are searched: one is nearer than FAR to any contact [m]


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
    """Position, velocity and body contact of bound vertices: weighted sums over the mesh that carries them.

    Its arrays are flat because Taichi takes no structures: a sparse matrix (start, index, value), then the state of the
    carrying mesh (own ...) and of the bound vertices.
    """
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


class ProxySimulation:
    """Steps the mesh below the coarse mesh on the same body; the state of the coarse mesh follows.

    Args:
        proxy: the mesh below, and the matrix by which it carries the coarse mesh.
        above: simulation of the coarse mesh; its body and the options of its solver are shared.
        options: options of the coarse mesh's model; the mesh below gives way to compression YIELDING times as easily.
        body_vertices: the body in its bind pose [m], shape (b, 3).
        attachment: holds the coarse mesh's held vertices to the body.

    Attributes:
        simulation: simulation of the mesh below.
    """

    def __init__(
        self,
        proxy: ProxyMesh,
        above: Simulation,
        options: ModelOptions,
        body_vertices: np.ndarray,
        attachment: Attachment,
    ) -> None:
        fabric, edge = above.model.fabric, float(proxy.mesh.edge_lengths()[1].mean())
        thicker = replace(fabric, thickness=fabric.thickness + STAND_OFF * edge)
        limits = above.model.limits.taken(proxy.nearest)
        options = replace(options, compression_compliance_scale=YIELDING * options.compression_compliance_scale)
        model = replace(build_model(proxy.mesh, thicker, proxy.held, options=options, limits=limits), smooth=True)
        own = Attachment.bind(proxy.mesh.vertices[proxy.held], body_vertices, above.body.faces)
        self.simulation = above.beside(model, own)
        self._coarser, self._above, self._attachment = proxy, above, attachment
        self._rows, self._launch = csr_arrays(proxy.matrix), Launch(_follow)
        self._surfaces = above.body.surface, above.body.thinned(body_vertices, THINNED)
        self._write(above.state.copy())  # compiled now, not in the first frame

    def take_over(self) -> None:
        """Start from the coarse mesh's state: positions and velocities are those that come nearest to it."""
        above, own = self._above.state, self.simulation.state
        inverse = self._coarser.inverse
        own.move_origin(above.origin)
        own.position[:, :3] = inverse @ above.position[:, :3]
        own.velocity[:] = inverse @ above.velocity
        own.nearest[:] = -1
        own.nearest[: len(inverse)] = above.nearest[self._coarser.nearest]
        self.simulation.body.surface = self._surfaces[1]
        # Contacts of the coarse mesh's edges and with itself end here: the mesh below has no such samples.
        above.nearest[len(above.position) :] = -1
        above.forget_self_contact()
        self.hold()
        self.lead()

    def give_back(self) -> None:
        """Let the coarse mesh be simulated again, from the state that it has now."""
        self.simulation.body.surface = self._surfaces[0]

    def hold(self) -> None:
        """Hold each dragged vertex of the coarse mesh by the vertex of this mesh that carries most of it."""
        above, own, model = self._above, self.simulation.state, self.simulation.model
        own.position[:, 3] = model.inverse_mass
        dragged = np.flatnonzero((above.state.position[:, 3] == 0.0) & (above.model.inverse_mass > 0.0))
        for vertex in dragged:
            lead = self._coarser.leading[vertex]
            own.position[lead] = *above.state.position[vertex, :3], 0.0
            own.velocity[lead] = 0.0

    def carried(self, position: np.ndarray) -> np.ndarray:
        """The coarse positions that this mesh can carry and that are nearest to given ones: [m], shape (n, 3) both."""
        return self._coarser.matrix @ (self._coarser.inverse @ position)

    def lead(self) -> None:
        """Write the coarse mesh's state as this mesh carries it."""
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
