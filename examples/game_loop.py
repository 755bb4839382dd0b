"""A garment in a game loop: fixed ticks at any frame rate, live input, wind and a pull at the hem.

The loop plays a gube.Simulation here; a gube.Player of a wrinkle database is played by the same lines. It takes some
seconds, one of them by the clock.
"""

import gube

SCENE = """
[[garment]]
name = "skirt"
mesh = "builtin:skirt"
attach = "top"

[character]
file = "builtin:mannequin"
"""
TWIRL = gube.ClipMotion(gube.load_character("builtin:mannequin"), "twirl")


def loop_at(rate_hz: float) -> tuple[gube.GameLoop, gube.Simulation]:
    """The skirt in a loop that draws so many frames a second."""
    skirt, _ = gube.simulation_of(gube.parse_scene(SCENE))
    hem = int(skirt.vertices[:, 1].argmin())
    pulled = skirt.vertices[hem] + [0.2, 0.1, 0.0]

    def live_input(t: float) -> gube.LiveInput:
        """A gust of wind in the first half second, then a pull at the hem for a tenth of a second."""
        wind = (3.0, 0.0, 0.0) if t < 0.5 else (0.0, 0.0, 0.0)
        return gube.LiveInput(TWIRL.pose(t), wind, drag=(hem, pulled) if 0.5 < t < 0.6 else None)

    return gube.GameLoop(skirt, live_input, rate_hz), skirt


# An engine with a frame loop of its own says how much time has passed. The frame rate changes nothing in the garment.
states = []
for elapsed, count in ((1.0 / 30.0, 30), (1.0 / 144.0, 144)):
    loop, skirt = loop_at(1.0 / elapsed)
    for _ in range(count):
        loop.advance(elapsed)
        vertices = skirt.vertices  # what the engine draws
    assert loop.tick_count == 60 and loop.dropped_time == 0.0, "a second has 60 ticks at any frame rate"
    states.append(skirt.state.hash())
assert states[0] == states[1], "30 and 144 frames a second move the garment alike, to the bit"

# A loop of its own, by the clock: sleeps between frames and counts the deadlines that it missed.
loop, skirt = loop_at(60.0)
figures = loop.run(1.0, show=lambda: skirt.vertices)
print(f"{figures['frame_ms_p50']:.1f} ms a frame, {figures['missed_deadlines']:.0f} deadlines missed")
assert figures["frame_count"] + figures["missed_deadlines"] >= 60.0, "each period has its frame, or a missed deadline"
assert loop.tick_count <= 60 and figures["dropped_time_s"] >= 0.0, "the garment never runs ahead of the clock"
