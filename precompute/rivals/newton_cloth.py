"""Newton (XPBD, VBD, Style3D) on the processor, dressed.

The body is a mesh shape whose points, velocities and search tree are brought up to date with every search for contact:
left alone, it stays where it was at the start.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from precompute.rivals.dressing import Dressing

__all__ = ["start_newton"]

GRAVITY = 9.81
REACH = 0.03  # how deep in the body a vertex is still pushed out [m]; less loses the cloth in a fast stride
STITCH = 1e4  # stiffness of a stitch [N/m]
# Bending energy of a lattice of equilateral triangles: half of B times this times the angle squared, for an edge.
EQUILATERAL = 2.0 * np.sqrt(3.0)


def start_newton(
    dressing: Dressing,
    solver: str,
    *,
    substeps: int,
    iterations: int,
    stretch: float = 1.0,
    bend: float = 1.0,
    contact: float = 1e3,
    searches: int = 1,
    linear_iterations: int = 10,
) -> tuple[Callable[[int], None], Callable[[], np.ndarray]]:
    """A garment in one of Newton's solvers.

    Args:
        dressing: the garment and its body.
        solver: "xpbd", "vbd" or "style3d".
        substeps: of a frame.
        iterations: of a substep.
        stretch, bend: stiffness over that of the fabric.
        contact: stiffness of contact [N/m].
        searches: of contact with the body in a frame, each with the body where it is then.
        linear_iterations: of Style3D's linear solver.

    Returns:
        what plays a frame of a number, and what gives the vertices [m], shape (n, 3).
    """
    import newton
    import warp

    warp.config.quiet = True
    warp.set_device("cpu")
    model, source = _model(dressing, solver, stretch, bend, contact)
    stepper = _stepper(model, solver, dressing, iterations, linear_iterations)
    pipeline = newton.CollisionPipeline(model, soft_contact_margin=REACH)
    contacts, control = pipeline.contacts(), model.control()
    states = [model.state(), model.state()]
    shape = source.mesh
    points, velocities = shape.points.numpy(), shape.velocities.numpy()
    # Particles outside this box are not asked; it is computed once, where the body stands at first.
    lower, upper = model.shape_collision_aabb_lower.numpy(), model.shape_collision_aabb_upper.numpy()

    def step(frame: int) -> None:
        before, after = dressing.body[frame - 1], dressing.body[frame]
        velocities[:] = (after - before) / dressing.dt
        held = dressing.targets[frame - 1 : frame + 1]
        for number in range(1, substeps + 1):
            part = number / substeps
            for state in states:
                state.particle_q.numpy()[dressing.held] = held[0] + part * (held[1] - held[0])
            states[0].clear_forces()
            if (number - 1) % (-(-substeps // searches)) == 0:
                points[:] = before + min(1.0, (number - 1) / substeps + 1.0 / searches) * (after - before)
                lower[0], upper[0] = points.min(axis=0), points.max(axis=0)
                shape.refit()
                pipeline.collide(states[0], contacts)
            stepper.step(states[0], states[1], control, contacts, dressing.dt / substeps)
            states.reverse()

    return step, lambda: states[0].particle_q.numpy().astype(float)


def _model(dressing: Dressing, solver: str, stretch: float, bend: float, contact: float) -> tuple[Any, Any]:
    """The garment and its body, and the mesh of the body, which moves."""
    import newton

    fabric = dressing.fabric
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=(0.0, -GRAVITY, 0.0))
    _add_garment(builder, dressing, solver, stretch, bend)
    source = newton.Mesh(dressing.body[0], dressing.body_faces.ravel(), compute_inertia=False)
    material = newton.ModelBuilder.ShapeConfig(mu=fabric["friction"], ke=contact, kd=0.0)
    builder.add_shape_mesh(body=-1, mesh=source, cfg=material)
    if solver == "vbd":
        builder.color()
    model = builder.finalize(device="cpu")
    mass = dressing.mass.astype(np.float32).copy()
    mass[dressing.held] = 0.0
    model.particle_mass.numpy()[:] = mass
    model.particle_inv_mass.numpy()[:] = np.divide(1.0, mass, where=mass > 0.0, out=np.zeros_like(mass))
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = contact, 0.0, fabric["friction"]
    if model.spring_count:
        lengths = model.spring_rest_length.numpy()
        lengths[len(lengths) - len(dressing.stitches) :] = 0.0
        if solver == "xpbd":
            lengths[: len(dressing.lengths)] = dressing.lengths
    model.edge_rest_angle.numpy()[:] = 0.0  # cloth is cut flat
    if solver != "style3d":  # which has panels
        model.tri_poses.numpy()[:] = np.linalg.inv(dressing.flat)
        model.tri_areas.numpy()[:] = 0.5 * np.abs(np.linalg.det(dressing.flat))
    return model, source


def _add_garment(builder: Any, dressing: Dressing, solver: str, stretch: float, bend: float) -> None:
    import warp
    from newton.solvers import SolverStyle3D, style3d

    fabric, faces = dressing.fabric, dressing.faces
    warp_ke, weft_ke, shear_ke = (stretch * fabric[name] for name in ("stretch_warp", "stretch_weft", "shear"))
    bend_warp, bend_weft = bend * fabric["bend_warp"], bend * fabric["bend_weft"]
    mean_bend = float(np.sqrt(bend_warp * bend_weft))
    common = {
        "pos": warp.vec3(0.0), "rot": warp.quat_identity(), "vel": warp.vec3(0.0), "scale": 1.0,
        "vertices": [warp.vec3(*x) for x in dressing.start.tolist()], "indices": faces.ravel().tolist(),
        "density": fabric["areal_density"], "particle_radius": fabric["thickness"],
    }  # fmt: skip
    if solver == "style3d":
        SolverStyle3D.register_custom_attributes(builder)
        # Columns of `flat` are the sides of a face: a panel of its own for each.
        panel = np.zeros((len(faces), 3, 2))
        panel[:, 1:] = np.swapaxes(dressing.flat, 1, 2)
        style3d.add_cloth_mesh(
            builder, panel_verts=panel.reshape(-1, 2).tolist(), panel_indices=list(range(3 * len(faces))),
            tri_aniso_ke=warp.vec3(warp_ke, weft_ke, shear_ke),
            edge_aniso_ke=warp.vec3(bend_warp, bend_weft, mean_bend), **common,
        )  # fmt: skip
    else:
        # Young's modulus and Poisson's ratio in plane stress, as Lame's numbers of an isotropic sheet.
        modulus, poisson = float(np.sqrt(warp_ke * weft_ke)), fabric["poisson"]
        # VBD multiplies by the length of the edge. XPBD's gradient of an angle is the edge times the height of a face
        # too large, and so is its force.
        scale = 1.0 / (dressing.edge if solver == "vbd" else 0.5 * np.sqrt(3.0) * dressing.edge**2)
        builder.add_cloth_mesh(
            tri_ke=modulus / (2.0 * (1.0 + poisson)), tri_ka=modulus * poisson / (1.0 - poisson**2), tri_kd=0.0,
            edge_ke=EQUILATERAL * mean_bend * scale, edge_kd=0.0, **common,
        )  # fmt: skip
    if solver == "xpbd":
        for i, j in dressing.edges.tolist():
            builder.add_spring(i, j, 0.75 * float(np.sqrt(warp_ke * weft_ke)), 0.0, 0.0)
    for (v, a, b), weight in zip(dressing.stitches.tolist(), dressing.stitch_weights, strict=True):
        builder.add_spring(v, a if weight < 0.5 else b, STITCH, 0.0, 0.0)


def _stepper(model: Any, solver: str, dressing: Dressing, iterations: int, linear_iterations: int) -> Any:
    from newton.solvers import SolverStyle3D, SolverVBD, SolverXPBD

    if solver == "xpbd":
        return SolverXPBD(model, iterations=iterations, soft_body_relaxation=0.9)
    if solver == "vbd":
        thickness = dressing.fabric["thickness"]
        return SolverVBD(
            model, iterations=iterations, particle_enable_self_contact=dressing.self_collision,
            particle_self_contact_radius=thickness, particle_self_contact_margin=2.0 * thickness,
        )  # fmt: skip
    # Its contact with the body and with itself are one: neither can be had without the other.
    config = SolverStyle3D.Config(iterations=iterations, linear_iterations=linear_iterations)
    return SolverStyle3D(model, config=config)
