"""MuJoCo's flex, dressed: the body is a second flex, whose vertices are placed in every step.

It takes no pattern: the rest shape is that of the dressing.
"""

# pyright: reportMissingImports=false
from __future__ import annotations

from collections.abc import Callable

import numpy as np

from precompute.rivals.dressing import Dressing

__all__ = ["start_mujoco"]

HELD = 10.0  # mass of a held vertex [kg]


def start_mujoco(
    dressing: Dressing, *, substeps: int, iterations: int, stretch: float = 1.0, damping: float = 1e-4
) -> tuple[Callable[[int], None], Callable[[], np.ndarray]]:
    """A garment in MuJoCo.

    Args:
        dressing: the garment and its body.
        substeps: of a frame.
        iterations: of the solver in a substep, at most.
        stretch: stiffness over that of the fabric; that of bending follows from it and the thickness.
        damping: of the cloth [s].

    Returns:
        what plays a frame of a number, and what gives the vertices [m], shape (n, 3).
    """
    import mujoco

    fabric, start = dressing.fabric, dressing.start
    modulus = stretch * float(np.sqrt(fabric["stretch_warp"] * fabric["stretch_weft"]))
    # The plate E h^3 / (12 (1 - nu^2)) bends like the fabric when it has this thickness.
    bend = float(np.sqrt(fabric["bend_warp"] * fabric["bend_weft"]))
    thick = float(np.sqrt(12.0 * (1.0 - fabric["poisson"] ** 2) * bend / modulus))
    numbers = lambda values: " ".join(f"{value:.7g}" for value in np.ravel(values))  # noqa: E731
    slides = "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    bodies = [f'<body name="b{i}" mocap="true" pos="{numbers(x)}"/>' for i, x in enumerate(dressing.body[0])]
    # Flex knows no vertex that is placed by hand: those that are held weigh so much that the cloth does not move them.
    weights = dressing.mass.copy()
    weights[dressing.held] = HELD
    bodies += [
        f'<body name="c{i}" gravcomp="{float(mass == HELD)}" pos="{numbers(x)}">'
        f'<inertial pos="0 0 0" mass="{mass:.7g}" diaginertia="1e-9 1e-9 1e-9"/>{slides}</body>'
        for i, (x, mass) in enumerate(zip(dressing.rest, weights, strict=True))
    ]
    stiff = f'solref="{2.0 * dressing.dt / substeps:.7g} 1"'  # as stiff as its solver takes
    joined = [
        f'<connect body1="c{v}" body2="c{a if weight < 0.5 else b}" anchor="0 0 0" {stiff}/>'
        for (v, a, b), weight in zip(dressing.stitches, dressing.stitch_weights, strict=True)
    ]
    flex = lambda name, prefix, count, faces, inside: (  # noqa: E731
        f'<flex name="{name}" dim="2" radius="{0.25 * fabric["thickness"]:.7g}" element="{numbers(faces)}" '
        f'body="{" ".join(f"{prefix}{i}" for i in range(count))}">{inside}</flex>'
    )
    contact = lambda own: (  # noqa: E731
        f'<contact selfcollide="{own}" friction="{fabric["friction"]} 0.005 0.0001" {stiff} '
        f'margin="{0.5 * fabric["thickness"]:.7g}"/>'
    )
    cloth = contact("auto" if dressing.self_collision else "none")
    cloth += f'<elasticity young="{modulus / thick:.7g}" poisson="{fabric["poisson"]}" thickness="{thick:.7g}" '
    cloth += f'elastic2d="both" damping="{damping}"/>'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{dressing.dt / substeps:.9f}" gravity="0 -9.81 0" solver="CG" tolerance="1e-4" '
        f'iterations="{iterations}" integrator="discrete"/><size memory="4G"/><worldbody>{"".join(bodies)}</worldbody>'
        f"<deformable>{flex('body', 'b', len(dressing.body[0]), dressing.body_faces, contact('none'))}"
        f"{flex('cloth', 'c', len(start), dressing.faces, cloth)}</deformable>"
        f"<equality>{''.join(joined)}</equality></mujoco>"
    )
    data = mujoco.MjData(model)
    data.qpos[:] = (start - dressing.rest).ravel()  # three slides a vertex
    mujoco.mj_forward(model, data)
    first, held = len(dressing.body[0]), dressing.held
    position, velocity = data.qpos.reshape(-1, 3), data.qvel.reshape(-1, 3)

    def step(frame: int) -> None:
        body, targets = dressing.body[frame - 1 : frame + 1], dressing.targets[frame - 1 : frame + 1]
        speed = (targets[1] - targets[0]) / dressing.dt
        for number in range(1, substeps + 1):
            part = number / substeps
            data.mocap_pos[:] = body[0] + part * (body[1] - body[0])
            # At the end of the step they are where they should be.
            position[held] = targets[0] + part * (targets[1] - targets[0]) - dressing.rest[held]
            position[held] -= speed * dressing.dt / substeps
            velocity[held] = speed
            mujoco.mj_step(model, data)

    return step, lambda: data.flexvert_xpos.reshape(-1, 3)[first:].copy()
