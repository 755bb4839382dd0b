"""What a solver has to know of all vertices of a state at once."""

from pbd.engine import ti
from pbd.geometry import Float1, Vec3, Vec4, vec3, xyz

__all__ = ["SUMMARY", "summarize"]

SUMMARY = 7  # numbers


@ti.kernel
def summarize(position: Vec4, velocity: Vec3, out: Float1):
    """Mean position [m] and mean velocity [m/s]; 0 if all numbers are finite, else none."""
    ti.loop_config(serialize=True)
    for _ in range(1):
        centre, drift, zero = vec3(0.0), vec3(0.0), 0.0
        for i in range(position.shape[0]):
            x, v = position[i], velocity[i]
            centre += xyz(x)
            drift += v
            zero += 0.0 * x[0] + 0.0 * x[1] + 0.0 * x[2] + 0.0 * x[3] + (0.0 * v[0] + 0.0 * v[1] + 0.0 * v[2])
        for a in ti.static(range(3)):
            out[a] = centre[a] / position.shape[0]
            out[3 + a] = drift[a] / position.shape[0]
        out[6] = zero
