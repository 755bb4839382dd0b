"""Errors of runs of a compared scene and the floor between two right answers: distances, or statistics of folds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pbd import ClothMesh
from precompute.experiment.error_classes import START, ErrorClass, Recorded, classify, deviations
from precompute.experiment.measures import FRAME_RATE
from precompute.method_comparison.compare_scenes import CompareScene
from precompute.method_comparison.scene_runs import MethodSetting, SceneRun
from wrinkles.mesh_measures import PIXELS_PER_METRE, bending_energy, fold_count, jitter_px
from wrinkles.spectrum import BandedEnergy

__all__ = ["Judge", "Judgement", "reference_settings", "screen_mm"]

LEAST_BAND = 0.01  # of the reference's bending energy: a ratio to less says little
# Growth of energy below this is none [-]: a symplectic step's velocity is half a substep ahead of its position, which
# alone makes g h / v, 2 % at four substeps.
ENERGY_NOISE = 0.02


@dataclass(frozen=True)
class Judgement:
    """Error, figures and class of a run.

    Attributes:
        error: distance to the reference, p95 [px], or of statistics [octaves]; infinite where the run ended early.
        figures: by name; see :func:`~precompute.experiment.error_classes.deviations` and
            :meth:`Judge.statistics`.
        worst: class of the worst figure.
        because: the figure that makes it so.
    """

    error: float
    figures: dict[str, float]
    worst: ErrorClass
    because: str


@dataclass
class Judge:
    """Judges the runs of a scene.

    Args:
        scene: whose runs they are.
        references: of a scene with a unique answer two refinements, the finer one last; of a chaotic one several
            perturbed ones, and last one that is refined.
    """

    scene: CompareScene
    references: Sequence[SceneRun]
    floor: float = field(init=False)
    refined: float = field(init=False)

    def __post_init__(self) -> None:
        sheet = self.scene.compared()
        rest = np.insert(sheet.flat, 2, 0.0, axis=1)
        self._mesh = ClothMesh.from_pattern(rest, sheet.faces, sheet.flat[sheet.faces])
        self._bands = BandedEnergy(self._mesh)
        self._border = _border(len(sheet.xs), len(sheet.ys))
        *proxy, finest = self.references
        if self.scene.unique:
            self.reference, self._wanted = finest, {}
            self.floor = self.refined = max(self.judge(run).error for run in proxy)
        else:
            self.reference = proxy[0]
            found = [self.statistics(run) for run in proxy]
            self._wanted = _mean(found)
            others = [_mean([s for s in found if s is not one]) for one in found]
            self.floor = max(_octaves(one, other) for one, other in zip(found, others, strict=True))
            self.refined = _octaves(self.statistics(finest), self._wanted)

    @property
    def unit(self) -> str:
        return "px" if self.scene.unique else "octaves"

    def judge(self, run: SceneRun) -> Judgement:
        """Error, figures and class of a run."""
        if run.problem:
            return Judgement(np.inf, {"not_finite": 1.0}, ErrorClass.CATASTROPHIC, run.problem)
        edges, lengths = self._mesh.edge_lengths()
        thickness, speed = self.scene.fabric.thickness, self._rail_speed()
        chaotic = not self.scene.unique
        figures = deviations(
            self._recorded(run), self._recorded(self.reference), edges, lengths, thickness, speed, chaotic=chaotic
        )
        if chaotic:
            # A spline through few vertices is longer than the cloth: each on its own mesh.
            figures["edge_strain_p95"] = abs(float(run.strain[0] - self.reference.strain[0]))
            figures["edge_strain_beyond"] = float(run.strain[1] - self.reference.strain[1])
            figures["edge_strain_max"] = max(0.0, figures["edge_strain_beyond"])
        if not self.scene.driven:
            figures |= self._energy_figures(run)
        classes = classify(figures)
        because = max(classes, key=lambda name: (classes[name], figures[name]))
        extra = {"strain_p95": float(run.strain[0]), "strain_max": float(run.strain[1])}
        if chaotic:
            found = self.statistics(run)
            error = _octaves(found, self._wanted)
            extra |= {"jitter_all_px": jitter_px(self._later(run)), **found}
        else:
            error = figures["position_px"]
            extra["position_rms_mm"] = float(1e3 * _rms(self._later(run) - self._later(self.reference)))
        return Judgement(error, figures | extra, classes[because], because)

    def statistics(self, run: SceneRun) -> dict[str, float]:
        """Bending energy in all and by wavelength per unit of stiffness [-], and folds along the border, as means."""
        x = self._later(run)
        energy = self._bands.energy(x).mean(axis=0)
        found = {f"energy {name}": float(value) for name, value in zip(self._bands.names, energy, strict=True)}
        found["bending_energy"] = float(bending_energy(x, self._mesh).mean())
        found["fold_count"] = float(fold_count(x[::3, self._border]).mean())
        return found

    def _later(self, run: SceneRun) -> np.ndarray:
        return run.position[min(round(START * FRAME_RATE), len(run.position) - 1) :].astype(float)

    def _rail_speed(self) -> float:
        times = np.arange(self.scene.frame_count + 1) / FRAME_RATE
        places = np.array([self.scene.rail(t) for t in times])
        return float(np.linalg.norm(np.diff(places, axis=0), axis=1).max(initial=0.0) * FRAME_RATE)

    def _recorded(self, run: SceneRun) -> Recorded:
        depth = run.depth if self.scene.colliders() else None
        return Recorded(run.position, run.velocity, 1.0 / FRAME_RATE, None, depth)

    def _energy_figures(self, run: SceneRun) -> dict[str, float]:
        """Growth and error of the energy over the greatest kinetic energy of the reference."""
        (total, _), (wanted, kinetic) = run.energy, self.reference.energy
        scale = max(float(kinetic.max()), 1e-12)
        growth = float((total - total[0]).max() / scale)
        later = slice(min(round(START * FRAME_RATE), len(total) - 1), None)
        error = float(np.abs(total - wanted - (total[0] - wanted[0]))[later].max() / scale)
        return {"energy_growth": growth if growth > ENERGY_NOISE else 0.0, "energy_error": error}


def _rms(difference: np.ndarray) -> float:
    return float(np.sqrt((difference**2).sum(axis=2).mean()))


def _mean(statistics: Sequence[dict[str, float]]) -> dict[str, float]:
    return {name: float(np.mean([one[name] for one in statistics])) for name in statistics[0]}


def _octaves(found: dict[str, float], wanted: dict[str, float]) -> float:
    """Root mean square of the statistics' ratios to those wanted, each in octaves: 1 is a factor of two.

    Bands with under a hundredth of the energy are left out; one fold is added to both counts.
    """
    bands = [name for name in wanted if name.startswith("energy ")]
    least = LEAST_BAND * sum(wanted[name] for name in bands)
    ratios = [found[name] / wanted[name] for name in (*bands, "bending_energy") if wanted[name] > least]
    ratios.append((found["fold_count"] + 1.0) / (wanted["fold_count"] + 1.0))
    return float(np.sqrt(np.mean(np.log2(np.maximum(ratios, 1e-6)) ** 2)))


def _border(rows: int, columns: int) -> np.ndarray:
    """Vertices around a lattice, in order."""
    index = np.arange(rows * columns).reshape(rows, columns)
    return np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])


def screen_mm(pixels: float) -> float:
    """Length on the cloth of so many pixels [mm]."""
    return 1e3 * pixels / PIXELS_PER_METRE


def reference_settings(scene: CompareScene) -> list[MethodSetting]:
    """The references of a scene, as :class:`Judge` takes them."""
    if scene.unique:
        fine, finer = scene.samples, round(1.5 * scene.samples)
        return [MethodSetting("fem-stvk+isometric/verlet", fine), MethodSetting("fem-stvk+isometric/verlet", finer)]
    fine = scene.samples
    perturbed = [MethodSetting("default", fine, 32, seed=seed) for seed in (1, 2, 3)]
    return [*perturbed, MethodSetting("default", round(1.5 * fine), 48, seed=1)]
