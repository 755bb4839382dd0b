"""How much of a garment is modelled at present: which ticks are left out, and which mesh is stepped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from pbd import InputError
from pbd.wind import Air
from runtime.play.level_of_detail import LevelOfDetail
from runtime.play.proxy_simulation import ProxySimulation
from runtime.play.shown_surface import Surface
from runtime.play.simulation import Simulation
from runtime.play.transitions import Extrapolation, Fade, Interpolation

__all__ = ["DetailControl"]


class DetailControl:
    """Plays a garment at a level of detail, and changes that level so that nothing pops.

    Args:
        simulation: of the garment, at its start.
        surface: what is shown of it.
        between: its last two states.
        full: the most detail there is; with it the garment begins.
        rate_hz: rate of ticks [Hz].
        make_proxy: makes the simulation of the mesh below the simulated one, or None if there is no such mesh.

    Attributes:
        detail: at present.
        full: the argument.
        fade: between two details.
        idle: time since the last update [s].
        wait: ticks that are left out before the next update.
    """

    def __init__(
        self,
        simulation: Simulation,
        surface: Surface,
        between: Interpolation,
        full: LevelOfDetail,
        rate_hz: float,
        make_proxy: Callable[[], ProxySimulation | None] = lambda: None,
    ) -> None:
        self.full, self.detail = full, full
        self.fade = Fade(surface.vertices)
        self.idle, self.wait = 0.0, 0
        self._last = 0.0  # length of the last tick [s]
        self._extrapolation = Extrapolation(simulation, surface)
        self._simulation, self._between, self._rate_hz = simulation, between, rate_hz
        self._options = simulation.solver.options
        self._make_proxy = make_proxy
        self._proxy: ProxySimulation | None = None  # made when it is first asked for

    @property
    def _leader(self) -> ProxySimulation | None:
        """The mesh below where it is stepped; None where the garment's own is."""
        return self._proxy if self.detail.level else None

    @property
    def stepped(self) -> Simulation:
        """The simulation that is stepped."""
        leader = self._leader
        return self._simulation if leader is None else leader.simulation

    def elapse(self, dt: float) -> float | None:
        """Let a tick of ``dt`` [s] pass; the time of the step that is due [s], or None if this tick is left out."""
        self.fade.advance(dt)
        self._last, self.idle = dt, self.idle + dt
        if self.wait:
            self.wait -= 1
            return None
        due, self.idle, self.wait = self.idle, 0.0, self.detail.every - 1
        self._extrapolation.started = False
        return due

    def step_cloth(self, dt: float, wind: Air) -> None:
        """Advance the garment to the body's current pose."""
        simulation, stepped, leader = self._simulation, self.stepped, self._leader
        stepped.time = simulation.time
        stepped.step_cloth(dt, wind)
        simulation.time = stepped.time
        if leader is not None:
            leader.lead()

    def show(self, alpha: float, make: Callable[[float], float]) -> float:
        """Have the surface made; between two updates it is that of the last one, carried on as the garment went.

        Args:
            alpha: 0 for the end of the last tick but one, 1 for the end of the last one.
            make: makes the surface between the last two states of the garment; returns the time of relaxation [ms].

        Returns:
            time of relaxation [ms].
        """
        if self.idle == 0.0 and self.detail.every == 1:
            return make(alpha)
        relax_ms = 0.0
        if not self._extrapolation.started:
            relax_ms = make(1.0)
            self._extrapolation.start()
        self._extrapolation.show(self.idle - (1.0 - alpha) * self._last)
        return relax_ms

    def hold(self) -> None:
        """Hold what is dragged."""
        if self._leader is not None:
            self._leader.hold()

    def prepare(self, level: int) -> None:
        """Make the mesh that a level simulates.

        Raises:
            InputError: a level that this garment does not have.
        """
        if level and self._proxy is None:
            self._proxy = self._make_proxy()
            if self._proxy is None:
                raise InputError(
                    "no such mesh", key="level", received=1, expected="0: this garment's mesh is too coarse"
                )

    def turn_to(self, detail: LevelOfDetail, wait: int) -> bool:
        """Take another detail; whether it is another one, in which the surface must be made again.

        Raises:
            InputError: a level that this garment does not have.
        """
        self.wait = min(wait, detail.every - 1)
        if detail == self.detail:
            return False
        self.prepare(detail.level)
        self.fade.prepare()
        before, self.detail, self._extrapolation.started = self.detail, detail, False
        substep = self._options.substep
        if (detail.every, detail.substeps) != (self.full.every, self.full.substeps):
            substep = detail.every / (self._rate_hz * detail.substeps)
        self.stepped.solver.options = replace(self._options, substep=substep)
        if self._proxy is not None and detail.level > before.level:
            self._proxy.take_over()
            self._between.before[:, :3] = self._proxy.carried(self._between.before[:, :3])
        elif self._proxy is not None and detail.level < before.level:
            self._proxy.give_back()
        return True

    def start_again(self) -> None:
        """Go on from another state of the garment."""
        self.idle, self.wait, self._extrapolation.started = 0.0, 0, False
        self.fade.prepare()
        if self._leader is not None:
            self._leader.take_over()

    def go_on_from(self, other: DetailControl) -> None:
        """Take the detail and the ticks of other garments on the same body."""
        self.detail, self._extrapolation.started = other.detail, False
        self.idle, self.wait, self._last = other.idle, other.wait, other._last
        self.fade.prepare()
