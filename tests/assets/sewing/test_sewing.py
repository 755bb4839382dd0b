from __future__ import annotations

import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from assets.anthropometry import measure
from assets.garment import boundary_loops, highest_loop
from assets.loading import load_garment, load_standing_body
from assets.patterns.drafts import DRAFTS, draft
from assets.patterns.load import load_pattern
from assets.patterns.panel_mesh import cut
from assets.sewing.arrangement import CLEARANCE, arranged
from assets.sewing.body import StandingBody
from assets.sewing.pieces import pieces_of
from assets.sewing.sewing import SewingError, arranged_pieces, sew
from assets.sewing.sewn_file import read_sewn, write_sewn
from assets.sewing.sewn_garment import SewnGarment, drape_figures, faults_of, faulty_panels
from pbd.contact.colliders import Body
from pbd.distance import BodyDistance
from tests.assets.sewing.tubes import egg, tube_pattern
from tests.data import data_path
from tests.refusals import refuses
from tests.wrinkles.meshes import icosphere


@pytest.fixture(scope="module")
def tube() -> SewnGarment:
    return sew(tube_pattern(), egg(), "cotton", edge_length=0.02)


def test_a_tube_is_sewn_and_hangs_where_it_fits(tube: SewnGarment) -> None:
    garment, figures = tube.garment, tube.figures
    assert faults_of(figures) == []
    assert len(boundary_loops(garment.faces)) == 2
    assert garment.pattern is not None and garment.layers is not None
    sides = garment.pattern[:, 1:] - garment.pattern[:, :1]
    assert np.isclose(0.5 * np.linalg.det(sides).sum(), 0.6 * 0.1)  # the flat metric is that of the pattern
    assert figures["tension_p99"] < 0.05
    # The egg is as wide as the tube 0.27 m below or 0.03 m below the origin: the tube is caught at the upper place.
    lowest = garment.vertices[:, 1].min()
    assert -0.1 < lowest < 0.02
    away = BodyDistance(egg().faces).signed_distance(garment.vertices, egg().vertices)
    assert away.min() > 0.0


def test_seams_and_bands_are_thicker(tube: SewnGarment) -> None:
    garment = tube.garment
    assert garment.layers is not None and garment.pattern is not None
    middle = garment.pattern.mean(axis=1)  # (warp, weft): along the height, and from the middle to the seams
    plain = (middle[:, 0] < 0.06) & (np.abs(middle[:, 1]) < 0.12)
    np.testing.assert_allclose(garment.layers[plain], 1.0)
    assert garment.layers[(middle[:, 0] > 0.085) & (np.abs(middle[:, 1]) < 0.12)].min() > 1.5
    assert garment.layers[(middle[:, 0] < 0.06) & (np.abs(middle[:, 1]) > 0.142)].min() > 1.3


def test_a_body_that_is_thin_while_the_seams_close_has_its_own_shape_afterwards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    placed: list[np.ndarray] = []
    place, advance = Body.place, Body.advance
    monkeypatch.setattr("assets.sewing.sewing.CLOSINGS", ((1.0, 12),))
    monkeypatch.setattr(Body, "place", lambda self, vertices: (placed.append(vertices), place(self, vertices))[1])
    monkeypatch.setattr(Body, "advance", lambda self, vertices: (placed.append(vertices), advance(self, vertices))[1])
    sewn = sew(tube_pattern(), egg(), "cotton", edge_length=0.025)
    widths = [np.ptp(vertices[:, 0]) for vertices in placed]
    assert widths[0] < 0.97 * widths[-1] and widths[-1] == pytest.approx(np.ptp(egg().vertices[:, 0]))
    away = BodyDistance(egg().faces).signed_distance(sewn.garment.vertices, egg().vertices)
    assert away.min() > 0.0


def test_a_tube_that_is_too_small_says_so() -> None:
    pole = replace(egg(), vertices=egg().vertices * [1.0, 6.0, 1.0])  # from which it cannot slide
    with pytest.raises(SewingError, match="(stays open|too small).*may mend it"):
        sew(tube_pattern(girth=0.4), pole, "cotton", edge_length=0.025)


@pytest.mark.proof
def test_a_band_holds_where_it_is_tight_however_finely_it_is_cut() -> None:
    """A heavy skirt on the waist of an hourglass."""
    vertices, faces = icosphere(4)
    vertices = vertices * [0.11, 0.6, 0.11]
    vertices[:, [0, 2]] *= 1.0 - 0.3 * np.exp(-((vertices[:, 1:2] / 0.12) ** 2))
    body = StandingBody("hourglass", vertices + [0.0, 0.4, 0.0], faces)
    skirt, rims = tube_pattern(girth=0.49, height=0.4, layers=3.0, flare=0.6), []
    for edge in (0.025, 0.012):
        garment = sew(skirt, body, "denim", edge_length=edge).garment
        rims.append(garment.vertices[highest_loop(garment.vertices, garment.faces), 1].mean())
    assert rims == pytest.approx([0.4, 0.4], abs=0.003) and abs(rims[1] - rims[0]) < 0.001


def test_faults_name_what_is_wrong(tube: SewnGarment) -> None:
    vertices = tube.garment.vertices.copy()
    vertices[:10] = vertices[:10].mean(axis=0) * [0.0, 1.0, 0.0]
    vertices[:10] += 1e-3 * np.arange(10)[:, None]
    broken = replace(tube.garment, vertices=vertices)
    faults = faults_of({"seam_gap_mm": 3.0, "slid_cm": 80.0} | drape_figures(broken, egg()))
    assert "a seam stays open by 3.0 mm" in faults
    assert "it slid down by 80 cm: nothing holds it" in faults
    assert any("inside the body" in fault for fault in faults)


def test_a_fault_is_at_its_panel(tube: SewnGarment) -> None:
    assert faulty_panels(tube, egg()) == []
    garment, number = tube.garment, len(tube.panel_names) - 1
    of_panel = np.bincount(garment.faces.ravel(), weights=np.repeat(tube.panel_of_face == number, 3))
    inner = np.flatnonzero(of_panel == np.bincount(garment.faces.ravel()))[0]
    vertices = garment.vertices.copy()
    vertices[inner] += 0.1 * vertices[inner] * [1.0, 0.0, 1.0] / np.linalg.norm(vertices[inner, [0, 2]])
    stretched = replace(tube, garment=replace(garment, vertices=vertices))
    assert faulty_panels(stretched, egg()) == [tube.panel_names[number]]


def test_pieces_without_a_place_lie_beside_what_they_are_sewn_to() -> None:
    pieces, start = arranged_pieces(tube_pattern(placed=False), egg(), 0.02)
    ends = start[pieces.stitches]
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).max() < 0.35
    assert BodyDistance(egg().faces).signed_distance(start, egg().vertices).min() >= CLEARANCE


def test_pieces_that_nothing_places_are_refused() -> None:
    pieces = pieces_of(cut(tube_pattern(), 0.02))
    refuses("front, back: pieces without a place", arranged, pieces, [None, None], egg())


def test_a_piece_in_the_body_is_moved_out() -> None:
    pattern = tube_pattern()
    front = pattern.panels[0]
    assert front.placement is not None
    deep = replace(front, placement=replace(front.placement, translation=np.array([0.0, 0.0, 0.02])))
    _, start = arranged_pieces(replace(pattern, panels=(deep, pattern.panels[1])), egg(), 0.02)
    assert BodyDistance(egg().faces).signed_distance(start, egg().vertices).min() >= CLEARANCE


def test_a_file_holds_the_whole_garment(tube: SewnGarment, tmp_path: Path) -> None:
    path = tmp_path / "tube.npz"
    write_sewn(path, tube)
    found = read_sewn(path)
    assert (found.panel_names, found.fabric) == (("front", "back"), "cotton")
    for name in ("vertices", "faces", "pattern", "layers", "max_stretch"):
        np.testing.assert_array_equal(getattr(found.garment, name), getattr(tube.garment, name))
    np.testing.assert_array_equal(found.seams, tube.seams)
    np.testing.assert_array_equal(load_garment(path).vertices, tube.garment.vertices)


def test_files_of_the_version_before_are_read_without_bands(tube: SewnGarment, tmp_path: Path) -> None:
    path = tmp_path / "tube.npz"
    write_sewn(path, tube)
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive if name != "max_stretch"} | {"format": np.array(1)}
    np.savez(path, **arrays)  # type: ignore[arg-type]
    found = load_garment(path)
    assert found.max_stretch is None
    np.testing.assert_array_equal(found.layers, tube.garment.layers)


def _with(**changes: np.ndarray) -> Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]:
    return lambda arrays: arrays | changes


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda arrays: {key: value for key, value in arrays.items() if key != "layers"}, "layers: a missing key"),
        (_with(format=np.array(99)), "another version.*99"),
        (_with(layers=np.zeros(3)), "layers: a bad array"),
        (lambda arrays: {k: v for k, v in arrays.items() if k != "max_stretch"}, "max_stretch: a missing key"),
        (lambda arrays: arrays | {"max_stretch": 0.9 * arrays["max_stretch"] / 1.5}, "max_stretch.*at least 1"),
        (_with(vertices=np.full((4, 3), np.nan)), "vertices"),
        (lambda arrays: arrays | {"faces": arrays["faces"] + 10_000}, "faces: a number out of range"),
        (lambda arrays: arrays | {"pattern": arrays["pattern"][:, ::-1]}, "pattern, face 0.*counter-clockwise"),
        (_with(fabric=np.array({"a": 1}, dtype=object)), "damaged|no arrays"),
    ],
)
def test_bad_files_are_refused(
    tube: SewnGarment, tmp_path: Path, change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]], message: str
) -> None:
    path = tmp_path / "tube.npz"
    write_sewn(path, tube)
    with np.load(path) as archive:
        arrays = change(dict(archive))
    np.savez(path, **arrays)  # type: ignore[arg-type]
    refuses(message, read_sewn, path)


def test_an_array_whose_header_ends_in_a_bracket_is_refused(tube: SewnGarment, tmp_path: Path) -> None:
    """numpy takes such a header apart with Python's tokenizer, whose error is of no usual kind."""
    path, header = tmp_path / "tube.npz", b"{'descr': '<f8', 'fortran_order': False, 'shape': (3,\n"
    write_sewn(path, tube)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["faces.npy"] = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    refuses("damaged", read_sewn, path)


def test_a_body_must_be_closed(tmp_path: Path) -> None:
    path = tmp_path / "sheet.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    refuses("not closed", load_standing_body, path)
    refuses("unknown kind of body", load_standing_body, tmp_path / "body.stl")


@pytest.mark.parametrize("edge", [0.0, 0.001, 0.2, float("nan")])
def test_edges_that_no_garment_has_are_refused(edge: float) -> None:
    refuses(r"edge: .*0\.002 to 0\.05", sew, tube_pattern(), egg(), "cotton", edge_length=edge)


@pytest.mark.proof
@pytest.mark.parametrize("name", ["shirt_mean", "dress_pencil"])
def test_patterns_of_garmentcode_come_out_whole(name: str) -> None:
    pattern = load_pattern(data_path(f"patterns/{name}_specification.json"))
    sew(pattern, load_standing_body(data_path("patterns/mean_all.obj")), "cotton", edge_length=0.01)


@pytest.mark.proof
@pytest.mark.parametrize("name", DRAFTS)
@pytest.mark.parametrize("body", ["builtin:mannequin", "characters/mh_female_bandai_NC.glb"])
def test_drafts_come_out_whole(name: str, body: str) -> None:
    figure = load_standing_body(body if body.startswith("builtin") else data_path(body))
    sew(draft(name, measure(figure)), figure, "cotton", edge_length=0.01)
