"""Checks of a body and a garment before anything is simulated; each that fails says what to do."""

from typing import NamedTuple

import numpy as np

MIN_HEIGHT, MAX_HEIGHT = 0.5, 3.0  # of a body [m]
MAX_OPEN_SHARE = 0.02  # of the body's edges
MIN_VERTICES, MAX_VERTICES = 50, 20_000  # of a garment
MAX_INSIDE_SHARE, MAX_DEPTH = 0.05, 0.02  # of the garment's vertices, and how deep they may lie in the body [m]
MIN_SECONDS = 2.0  # of an action: a part of it is held out


class Finding(NamedTuple):
    """One check.

    Attributes:
        passed: whether it is passed.
        text: what was found and, where it failed, what to do.
    """

    passed: bool
    text: str


def check_body(vertices: np.ndarray, faces: np.ndarray) -> list[Finding]:
    """Size and holes of a body in its rest pose.

    Args:
        vertices: [m], Z up, shape (n, 3).
        faces: triangles, shape (m, 3).
    """
    height = float(np.ptp(vertices[:, 2]))
    findings = [Finding(MIN_HEIGHT <= height <= MAX_HEIGHT, f"The body is {height:.2f} m tall")]
    if not findings[0].passed:
        wanted = f"{MIN_HEIGHT:g} to {MAX_HEIGHT:g} m"
        findings[0] = Finding(False, f"{findings[0].text}: scale it to {wanted} and apply the scale (Ctrl A)")
    share = float(np.mean(edge_counts(vertices, faces) == 1))
    text = f"{100 * share:.1f} % of the body's edges are borders of holes"
    todo = "" if share <= MAX_OPEN_SHARE else ": fill the holes (F), the cloth can slip in there"
    return [*findings, Finding(share <= MAX_OPEN_SHARE, text + todo)]


def check_garment(vertices: np.ndarray, faces: np.ndarray, scale: np.ndarray) -> list[Finding]:
    """Size and mesh of a garment.

    Args:
        vertices: [m], shape (n, 3).
        faces: triangles, shape (m, 3).
        scale: of the object, shape (3,).
    """
    counts = edge_counts(vertices, faces)
    findings = [Finding(bool(np.allclose(scale, 1.0, atol=1e-4)), "The garment's scale is applied")]
    if not findings[0].passed:
        findings[0] = Finding(False, "The garment has a scale of its own: apply it (Ctrl A, Scale)")
    several = int((counts > 2).sum())
    todo = "" if not several else ": remove inner faces, cloth is one layer"
    findings.append(Finding(not several, f"{several} edges of the garment have more than two faces{todo}"))
    open_edges = int((counts == 1).sum())
    todo = "" if open_edges else ": a garment needs openings, delete the faces that close them"
    findings.append(Finding(open_edges > 0, f"{open_edges} edges of the garment are borders{todo}"))
    count = len(vertices)
    todo = ""
    if count < MIN_VERTICES:
        todo = f": subdivide it to at least {MIN_VERTICES}"
    elif count > MAX_VERTICES:
        todo = f": decimate it to at most {MAX_VERTICES}, the folds are added later"
    return [*findings, Finding(not todo, f"The garment has {count} vertices{todo}")]


def check_fit(depths: np.ndarray) -> Finding:
    """How far a garment lies inside the body in the rest pose.

    Args:
        depths: of its vertices under the body's surface, 0 outside [m], shape (n,).
    """
    share, depth = float(np.mean(depths > 0.0)), float(depths.max(initial=0.0))
    text = f"{100 * share:.1f} % of the garment lie inside the body in its rest pose, {1e3 * depth:.0f} mm at most"
    if share <= MAX_INSIDE_SHARE and depth <= MAX_DEPTH:
        return Finding(True, text)
    return Finding(False, f"{text}: fit the garment to the rest pose, or push it out (Shrinkwrap, Outside)")


def check_motion(first: float | None, last: float | None, rate: float) -> Finding:
    """Whether the armature moves long enough.

    Args:
        first, last: frames of its action; None without one.
        rate: frames a second.
    """
    if first is None or last is None:
        return Finding(False, "The armature has no action: assign one in the Action Editor")
    seconds = (last - first) / rate
    text = f"The action takes {seconds:.1f} s"
    if seconds >= MIN_SECONDS:
        return Finding(True, text)
    return Finding(False, f"{text}: at least {MIN_SECONDS:g} s are needed to learn from")


def edge_counts(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Number of faces at each edge, shape (e,), vertices at one place counted as one."""
    _, one = np.unique(np.round(vertices, 6), axis=0, return_inverse=True)
    corners = one.reshape(-1)[faces]
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]
