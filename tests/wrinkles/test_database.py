from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import numpy as np
import pytest

from assets.fabrics import PRESETS
from pbd import Fabric, InputError
from tests.refusals import refuses
from tests.wrinkles.databases import small_database
from tests.wrinkles.meshes import flat_sheet
from wrinkles import database, database_file
from wrinkles.binding import Binding
from wrinkles.coarsening import FLAT_STEP, PLACE_STEP
from wrinkles.database import WrinkleDatabase, body_hash, code_version
from wrinkles.database_file import as_stored, database_figures, read_database, write_database
from wrinkles.levels import Layers
from wrinkles.schema import ENTRIES, SCHEMA_VERSION, VERSION_BEFORE
from wrinkles.surface import SewnRest, Subdivision

QUANTISED = {"atoms.shapes", "novelty.weights_1"} | {
    f"mapping.{name}" for name in ("weights_1", "weights_2", "weights_3", "place", "place_weights")
}
DERIVED = {"format", "schema_version", "units", "topology_hash", "content_hash"}


OTHERS = {
    "denim": Fabric(areal_density=0.4, bend_warp=6e-5),
    "шёлк": Fabric(areal_density=0.06, friction=0.1 + 1e-9),
}
GATHERS = small_database().rest_shape


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "curtain.h5"
    write_database(path, small_database())
    return path


def small_binding(fine: int = 40) -> Binding:
    """Vertices all over the subdivided sheet of the small database, in two triangles and with one stitch."""
    rng = np.random.default_rng(3)
    place = np.round(rng.uniform(-0.2, 0.6, (fine, 2)) / PLACE_STEP) * PLACE_STEP
    place = np.concatenate([1.0 - place.sum(axis=1, keepdims=True), place], axis=1)
    flat = np.round(rng.uniform(-2.0, 2.0, (fine, 2)) / FLAT_STEP) * FLAT_STEP
    face = rng.integers(0, 72 * 16, fine).astype(np.int32)
    panels = np.array([[0, 1, 2], [3, 4, fine - 1]], np.int32)
    return Binding(face, place, panels, flat, np.array([[0, 3, 4]], np.int32), np.array([1.0 / 3.0]))


def small_sewn() -> SewnRest:
    """How the sheet rests as a sewn garment with a band."""
    vertices, faces = flat_sheet(7, 0.6)
    return SewnRest(vertices[faces][:, :, [2, 0]], np.full(72, 1.5), np.where(np.arange(72) < 9, 1.01, 1.5))


# Texture coordinates of the sheet; the last face has none.
TEXTURE = np.arange(72 * 6, dtype=np.float32).reshape(72, 3, 2) / 7.0
TEXTURE[-1] = np.nan


def leaves(value: Any, name: str = "") -> dict[str, Any]:
    """Every value inside nested dataclasses by its dotted path, arrays with their type and all their bits."""
    if is_dataclass(value):
        parts = [leaves(getattr(value, f.name), f"{name}.{f.name}".lstrip(".")) for f in fields(value)]
        return {key: leaf for part in parts for key, leaf in part.items()}
    if isinstance(value, np.ndarray):
        return {name: (value.dtype.str, value.shape, value.tobytes())}
    return {name: (type(value), value)}


def arrays_of(value: Any) -> list[np.ndarray]:
    """Every array inside nested dataclasses."""
    if is_dataclass(value):
        return [array for f in fields(value) for array in arrays_of(getattr(value, f.name))]
    return [value] if isinstance(value, np.ndarray) else []


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"held": np.zeros(0, np.int32), "quality": {}, "held_out": (), "trained_on": (), "scene": ""},
        {"binding": small_binding()},
        {"sewn": small_sewn()},
        {"other_fabrics": OTHERS, "pressure": 12.5},
        {"texture": TEXTURE},
        {"seed": 2**40, "scene": "x" * 200_000, "garment_name": " 裙子\n"},
    ],
)
def test_what_is_written_is_read_bit_by_bit(tmp_path: Path, changes: dict[str, Any]) -> None:
    database = small_database(**changes)
    write_database(tmp_path / "a.h5", database)
    read = read_database(tmp_path / "a.h5")
    assert leaves(read) == leaves(as_stored(database)) == leaves(as_stored(read))
    exact, stored = leaves(database), leaves(read)
    assert {name for name in exact if exact[name] != stored[name]} == QUANTISED


def test_numbers_in_steps_are_right_to_half_a_step(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    database = small_database()
    shapes = (database.atoms.shapes * 10.0 ** rng.uniform(-20.0, 5.0, (5, 1))).astype(np.float32)
    shapes[3] = 0.0
    write_database(tmp_path / "a.h5", replace(database, atoms=replace(database.atoms, shapes=shapes)))
    read = read_database(tmp_path / "a.h5")
    peaks = np.abs(shapes).max(axis=1, keepdims=True)
    assert (np.abs(read.atoms.shapes - shapes) <= 0.501 / 127.0 * peaks).all()  # each atom by its own size
    assert len(np.unique(read.mapping.weights_1[:, 2])) > 60
    weights = database.mapping.weights_1
    assert (np.abs(read.mapping.weights_1 - weights) <= 0.501 / 127.0 * np.abs(weights).max(axis=0)).all()


def test_a_garment_is_put_in_any_fabric_that_it_was_learned_in(tmp_path: Path) -> None:
    write_database(tmp_path / "a.h5", small_database(other_fabrics=OTHERS))
    database = read_database(tmp_path / "a.h5")
    assert database.fabric_names == ("muslin", "denim", "шёлк")
    own = database.in_fabric("muslin")
    assert leaves(own) == leaves(replace(database, other_fabrics={}))
    for name, fabric in OTHERS.items():
        worn = database.in_fabric(name)
        assert (worn.fabric_names, worn.fabric) == ((name,), fabric)
        assert worn.mapping is database.mapping  # the coarse state shows the fabric
        assert leaves(worn.in_fabric(name)) == leaves(worn)
    refuses("fabric: a fabric that was not learned.*'wool'.*one of muslin, denim, шёлк", database.in_fabric, "wool")


def test_the_same_database_gives_the_same_file(tmp_path: Path, path: Path) -> None:
    write_database(tmp_path / "again.h5", read_database(path))
    assert (tmp_path / "again.h5").read_bytes() == path.read_bytes()


def test_large_arrays_are_stored_compressed_and_every_value_has_its_unit(tmp_path: Path) -> None:
    write_database(tmp_path / "a.h5", small_database(atoms=40))
    with h5py.File(tmp_path / "a.h5") as file:
        shapes = file["atoms/shapes"]
        assert (shapes.compression, shapes.shuffle, shapes.dtype) == ("gzip", True, np.int8)
        assert file["atoms/shapes_scale"].attrs["unit"] == b"m"
        assert shapes.chunks is not None
        assert file["fabric/areal_density"].attrs["unit"] == b"kg/m2"
        assert file.attrs["units"] == b"SI: m, kg, s"


def test_every_field_has_its_entry() -> None:
    """A field that is added without its line in the table would be lost on the way."""
    names = [entry.name for entry in ENTRIES]
    assert len(set(names)) == len(names)
    scales = {f"{name}_scale" for name in QUANTISED}
    stored = {name.replace("/", ".") for name in names} - DERIVED - scales - {"quality.names", "quality.values"}
    others = {"other_fabrics.name"} | {f"other_fabrics.fabric.{field.name}" for field in fields(Fabric)}
    whole = small_database(binding=small_binding(), sewn=small_sewn(), texture=TEXTURE)
    layers = {f"layers.fabrics.{field.name}" for field in fields(Fabric)}
    layers |= {f"layers.{name}" for name in ("names", "layer", "fastened")}
    assert stored == set(leaves(whole)) - {"quality", "other_fabrics", "layers"} | others | layers


def test_the_garments_of_an_outfit_are_stored(tmp_path: Path) -> None:
    layer = (np.arange(49) >= 20).astype(np.int32)
    worn = Layers(("shirt", "jacket"), (PRESETS["denim"],), layer, np.array([21, 30], np.int32))
    write_database(tmp_path / "a.h5", small_database(layers=worn))
    found = read_database(tmp_path / "a.h5").layers
    assert found is not None and (found.names, found.fabrics) == (worn.names, worn.fabrics)
    np.testing.assert_array_equal(found.layer, layer)
    np.testing.assert_array_equal(found.fastened, worn.fastened)
    figures = {f"figure_{k}": 1.0 for k in range(5)}  # more than there are vertices that are fastened
    write_database(tmp_path / "c.h5", small_database(layers=worn, quality=figures))
    for wrong, problem in (
        (replace(worn, layer=layer[:-1]), "garments that do not fit"),
        (replace(worn, names=("shirt",)), "garment"),
        (replace(worn, layer=layer + 1), "a garment that does not exist"),
        (replace(worn, fastened=np.array([49], np.int32)), "a vertex that does not exist"),
        (replace(worn, fastened=np.array([30, 21], np.int32)), "not in ascending order"),
    ):
        refuses(problem, write_database, tmp_path / "b.h5", small_database(layers=wrong))


def test_texture_coordinates_are_cut_with_the_faces_and_must_be_theirs(tmp_path: Path) -> None:
    database = small_database(texture=TEXTURE)
    fine = database.fine_texture
    assert fine is not None and fine.shape == (16 * 72, 3, 2)
    np.testing.assert_allclose(fine[:16].mean(axis=(0, 1)), TEXTURE[0].mean(axis=0), rtol=1e-6)
    assert np.isnan(fine[-16:]).all() and np.isfinite(fine[:-16]).all()
    assert small_database().fine_texture is None
    delivered = small_database(binding=small_binding())
    assert delivered.binding is not None and delivered.fine_texture is delivered.binding.sewn.flat
    bad = TEXTURE.copy()
    bad[3, 1, 0] = np.inf
    for wrong, problem in ((TEXTURE[1:], "texture: another number of faces"), (bad, r"texture\[3, 1, 0\]: not finite")):
        refuses(problem, write_database, tmp_path / "b.h5", small_database(texture=wrong))


def test_files_of_the_version_before_are_read(path: Path) -> None:
    before = leaves(read_database(path))
    with h5py.File(path, "r+") as file:
        del file["texture"]
        del file["machine"]
        file.attrs["schema_version"] = np.int64(VERSION_BEFORE)
    refuses("content_hash", read_database, path)
    with h5py.File(path, "r+") as file:
        arrays = {
            e.name: np.asarray(file.attrs[e.name] if e.in_header else file[e.name][()])
            for e in ENTRIES
            if e.name not in ("texture", "machine")
        }
        digest = hashlib.sha256()
        for name, array in arrays.items():
            if name != "content_hash":
                digest.update(f"{name} {array.dtype} {array.shape} ".encode() + array.tobytes())
        file.attrs["content_hash"] = np.bytes_(digest.hexdigest())
    assert leaves(read_database(path)) == before | {"machine": (str, "an unknown processor")}
    assert database_figures(path)["database_mb"] > 0.0
    with h5py.File(path, "r+") as file:
        file.create_dataset("texture", data=np.zeros((0, 3, 2), np.float32))
    refuses("texture: unknown key", read_database, path)


def test_figures_that_are_not_finite_are_not_stored(tmp_path: Path) -> None:
    quality = {"rmse_mm": 3.0, "normal_skill": float("nan"), "rmse_skill": float("-inf")}
    write_database(tmp_path / "a.h5", small_database(quality=quality))
    assert read_database(tmp_path / "a.h5").quality == {"rmse_mm": 3.0}


def put(name: str, value: Any) -> Callable[[h5py.File], None]:
    """Replace a data set, its unit kept, or a header value."""

    def change(file: h5py.File) -> None:
        if name in file.attrs:
            file.attrs[name] = value
        else:
            unit = file[name].attrs["unit"]
            del file[name]
            file.create_dataset(name, data=value).attrs["unit"] = unit

    return change


def edit(name: str, place: Any, value: Any) -> Callable[[h5py.File], None]:
    return lambda file: file[name].__setitem__(place, value)


def delete(name: str) -> Callable[[h5py.File], None]:
    return lambda file: file.attrs.__delitem__(name) if name in file.attrs else file.__delitem__(name)


def link(name: str) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        del file[name]
        file[name] = h5py.ExternalLink("/etc/passwd", "/")

    return change


SEWN = ("pattern", "layers", "max_stretch")


def sewn(**values: float) -> Callable[[h5py.File], None]:
    """A sewn garment, with one value for all of some array."""

    def change(file: h5py.File) -> None:
        rest = small_sewn()
        for name in SEWN:
            array = getattr(rest, name)
            put(f"sewn/{name}", np.full(array.shape, values[name]) if name in values else array)(file)

    return change


REFUSED: dict[str, tuple[Callable[[h5py.File], Any], str, str]] = {
    "another format": (put("format", np.bytes_("notes")), "format: not a wrinkle database", "received 'notes'"),
    "no format": (delete("format"), "format: not a wrinkle database", "'gube wrinkle database'"),
    "newer": (put("schema_version", np.int64(SCHEMA_VERSION + 1)), "newer version", f"expected {SCHEMA_VERSION}"),
    "older": (put("schema_version", np.int64(1)), "no longer read", f"received 1, expected {SCHEMA_VERSION}"),
    "version in words": (put("schema_version", np.bytes_("one")), "no longer read", "received 'one'"),
    "missing array": (delete("mapping/bias_3"), "mapping/bias_3", "missing"),
    "missing group": (delete("fabric"), "fabric/shear", f"{len(fields(Fabric))} problems"),
    "missing header": (delete("seed"), "seed", "missing"),
    "unknown array": (lambda f: f.create_dataset("atoms/extra", data=1.0), "atoms/extra", "unknown key"),
    "unknown group": (lambda f: f.create_group("later"), "later", "unknown key"),
    "unknown header": (lambda f: f.attrs.__setitem__("author", 1), "author", "unknown key"),
    "linked elsewhere": (link("scene"), "scene", "missing"),
    "array for a group": (lambda f: (f.__delitem__("rest_shape"), f.create_dataset("rest_shape", data=1.0)),
                          "rest_shape/stretch", "missing"),
    "single for double": (lambda f: put("coarse_vertices", f["coarse_vertices"][()].astype(np.float32))(f),
                          "coarse_vertices: wrong type", "received 'float32', expected float64"),
    "number for text": (put("scene", 1.0), "scene: wrong type", "expected text"),
    "text of any length": (put("garment_name", "curtain"), "garment_name: wrong type", "received 'object'"),
    "header of another type": (put("seed", 3.0), "seed: wrong type", "received 'float64', expected int64"),
    "scalar for array": (put("warp", 1.0), "warp: wrong shape", "received (), expected (3)"),
    "nothing": (put("cutoff", h5py.Empty("f8")), "cutoff: wrong shape", "expected ()"),
    "two columns": (put("coarse_faces", np.zeros((72, 2), np.int32)), "coarse_faces: wrong shape", "received (72, 2)"),
    "no vertices": (put("coarse_vertices", np.zeros((0, 3))), "coarse_vertices: wrong shape", "received (0, 3)"),
    "too many vertices": (put("coarse_vertices", np.zeros((50, 3))), "mapping/place: wrong shape",
                          "received (49, 5), expected (n, d) with n = 50"),
    "too few atoms": (put("mapping/bias_3", np.zeros((2, 4), np.float32)), "mapping/bias_3: wrong shape",
                      "received (2, 4), expected (r, K) with r = 2, K = 5"),
    "other layer": (put("mapping/weights_2", np.zeros((2, 8, 9), np.int8)), "mapping/weights_3", "h2 = 9"),
    "other features": (put("mapping/center", np.zeros(9, np.float32)), "mapping/center: wrong shape", "received (9,)"),
    "figure without value": (put("quality/values", np.ones(2)), "quality/values", "with q = 3"),
    "no such region": (edit("mapping/region", 7, 2), "mapping/region: a region that does not exist", "received 2"),
    "not a number": (edit("mapping/center", 3, np.nan), "mapping/center[3]: not finite", "nan"),
    "infinite": (edit("coarse_vertices", (0, 1), np.inf), "coarse_vertices[0, 1]: not finite", "received inf"),
    "single for steps": (put("mapping/weights_2", np.zeros((8, 6), np.float32)), "mapping/weights_2: wrong type",
                         "received 'float32', expected int8"),
    "other vertices": (put("atoms/vertex_mean", np.zeros((7, 3), np.float32)),
                       "atoms/vertex_mean: another number of fine vertices", "received 7, expected 625"),
    "other grid": (
        lambda f: [put("atoms/mean", np.zeros(75, np.float32))(f), put("atoms/shapes", np.zeros((5, 75), np.int8))(f)],
        "atoms/mean: another grid than that of these subdivisions",
        "received 75, expected 363",
    ),
    "too few scales": (put("atoms/shapes_scale", np.ones(4, np.float32)), "atoms/shapes_scale: wrong shape", "K = 5"),
    "no scale": (edit("mapping/weights_3_scale", (1, 2), 0.0), "mapping/weights_3_scale: out of range", "above 0"),
    "NaN alone": (edit("cutoff", (), np.nan), "cutoff: not finite", "expected finite numbers"),
    "frame rate": (edit("frame_rate", (), 0.0), "frame_rate: out of range", "received 0.0, expected above 0"),
    "subdivisions": (edit("subdivisions", (), 9), "subdivisions: out of range", "received 9, expected 1 to 4"),
    "sewn, too few faces": (
        lambda f: [put(f"sewn/{name}", np.ones((4, 3, 2) if name == "pattern" else 4))(f) for name in SEWN],
        "sewn/pattern: another number of faces",
        "received 4, expected 0 or 72",
    ),
    "sewn, one without layers": (put("sewn/pattern", np.ones((72, 3, 2))), "sewn/layers: wrong shape", "w = 72"),
    "sewn, no area": (sewn(pattern=0.0), "sewn/pattern[0]: a face without area", "counter-clockwise"),
    "sewn, no layer": (sewn(layers=0.0), "sewn/layers: out of range", "above 0"),
    "sewn, shorter than at rest": (sewn(max_stretch=0.9), "sewn/max_stretch: out of range", "at least 1"),
    "warp": (edit("warp", slice(None), 0.0), "warp: no direction", "not zero"),
    "no such vertex": (edit("coarse_faces", (0, 0), 49), "coarse_faces: a vertex", "received 49, expected 0 to 48"),
    "negative vertex": (edit("held", 0, -1), "held: a vertex", "received -1, expected 0 to 48"),
    "limits of no vertex": (edit("limits/vertices", 1, 49), "limits/vertices: a vertex", "received 49"),
    "limits out of order": (edit("limits/vertices", 1, 2), "limits/vertices: not in ascending order",
                            "each vertex once"),
    "limit below zero": (edit("limits/backstop", 1, -0.1), "limits/backstop: out of range", "at least 0"),
    "held twice": (edit("held", 1, 0), "held: not in ascending order", "expected each vertex once"),
    "bad fabric": (edit("fabric/areal_density", (), -1.0), "content_hash", "damaged or changed by hand"),
    "turned face": (edit("coarse_faces", 0, (1, 0, 7)), "topology_hash: does not belong", "received '"),
    "other topology": (put("topology_hash", np.bytes_("f" * 64)), "topology_hash: does not belong", "'ffff"),
    "other units": (put("units", np.bytes_("inches")), "units: other units", "received 'inches'"),
    "other unit": (lambda f: f["cutoff"].attrs.__setitem__("unit", np.bytes_("mm")), "cutoff: wrong unit",
                   "received 'mm', expected 'm'"),
    "one bit": (edit("atoms/mean", 0, 0.125), "content_hash: damaged or changed by hand", "received '"),
    "prettier figure": (edit("quality/values", 0, 1.0), "content_hash: damaged or changed by hand", "expected "),
    "other bytes": (put("garment_name", np.bytes_(b"\xff\xfe")), "garment_name: not UTF-8", "expected text"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_understood_is_refused(path: Path, case: str) -> None:
    change, place, detail = REFUSED[case]
    with h5py.File(path, "r+") as file:
        change(file)
    text = refuses("", read_database, path)
    assert str(path) in text
    assert place in text
    assert detail in text


def test_values_that_a_fabric_refuses_name_the_file(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A writer with a bug could hash them correctly."""
    monkeypatch.setattr(database_file, "check_values", lambda arrays, path: None)
    with h5py.File(path, "r+") as file:
        file["fabric/areal_density"][()] = -1.0
    with pytest.raises(InputError, match="areal_density.*received -1.0") as caught:
        read_database(path)
    assert caught.value.file == path


def test_files_that_are_no_database_are_refused(tmp_path: Path) -> None:
    (tmp_path / "text.h5").write_text("coarse_vertices: many")
    (tmp_path / "empty.h5").touch()
    (tmp_path / "folder.h5").mkdir()
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["x"] = 1.0
    for name in ("text", "empty", "folder", "other", "absent"):
        with pytest.raises(InputError, match=rf"{name}\.h5: ") as caught:
            read_database(tmp_path / f"{name}.h5")
        assert caught.value.expected is not None


def test_a_truncated_file_is_refused(path: Path) -> None:
    whole = path.read_bytes()
    for size in np.linspace(0, len(whole) - 1, 40).astype(int):
        path.write_bytes(whole[:size])
        refuses("truncated", read_database, path)


def test_a_flipped_bit_is_refused_or_does_not_matter(path: Path) -> None:
    whole, truth = path.read_bytes(), leaves(read_database(path))
    rng = np.random.default_rng(0)
    refused = 0
    for place, bit in zip(rng.integers(len(whole), size=80), rng.integers(8, size=80), strict=True):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << bit
        path.write_bytes(bytes(damaged))
        try:
            assert leaves(read_database(path)) == truth
        except InputError:
            refused += 1
    assert refused > 20


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"bend_factor": float("nan")}, "bend_factor: not finite"),
        (
            {"rest_shape": replace(GATHERS, stretch=np.ones((72, 3), "f4"))},
            r"rest_shape/stretch\[0\]: a face without area",
        ),
        ({"rest_shape": replace(GATHERS, bends=GATHERS.bends[1:])}, "rest_shape/bends: another number of hinges"),
        ({"mapping": replace(small_database().mapping, weights_2=np.full((2, 8, 6), np.inf))}, "weights_2: not finite"),
        ({"held": np.array([3, 1], np.int32)}, "held: not in ascending order"),
        ({"held": np.array([0.5, 1.0])}, "held: wrong type"),
        ({"coarse_vertices": np.zeros((50, 3))}, "mapping/place: wrong shape"),
        ({"warp": (0.0, 1.0)}, "warp: wrong shape"),
        ({"other_fabrics": {"muslin": OTHERS["denim"]}}, "other_fabrics/name: the same name twice"),
        ({"subdivisions": 0}, "subdivisions: out of range"),
    ],
)
def test_what_could_not_be_read_is_not_written(path: Path, changes: dict[str, Any], place: str) -> None:
    before = path.read_bytes()
    refuses(place, write_database, path, small_database(**changes))
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("after", [0, 1, 20, 40])
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(
    path: Path, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    before, count, create = path.read_bytes(), 0, h5py.File.create_dataset

    def fail_later(self: h5py.File, *args: Any, **options: Any) -> Any:
        nonlocal count
        count += 1
        if count > after:
            raise OSError("No space left on device")
        return create(self, *args, **options)

    monkeypatch.setattr(h5py.File, "create_dataset", fail_later)
    for target in (path, path.with_name("new.h5")):
        count = 0
        with pytest.raises(OSError, match="No space left"):
            write_database(target, small_database(seed=99))
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("subdivisions", [1, 2, 3])
def test_fine_vertices_are_counted_without_refining(subdivisions: int) -> None:
    database = small_database(subdivisions=subdivisions)
    refined = Subdivision.of(database.coarse_faces, len(database.coarse_vertices), subdivisions)
    assert database.fine_vertex_count == refined.fine_count


def test_the_figures_are_those_of_the_file(path: Path) -> None:
    figures = database_figures(path)
    size = path.stat().st_size
    assert list(figures) == ["database_mb", "mesh_mb", "bytes_per_fine_vertex", "compression_ratio", "load_s"]
    assert figures["database_mb"] == size / 1e6
    assert 49 * 3 < 1e6 * figures["mesh_mb"] < size / 4
    assert figures["bytes_per_fine_vertex"] == pytest.approx((size - 1e6 * figures["mesh_mb"]) / 625)  # 25 by 25
    numbers = [np.size(value) for value in arrays_of(small_database())]
    assert figures["compression_ratio"] * size == pytest.approx(4 * sum(numbers), rel=0.1)  # words are few
    assert figures["load_s"] > 0.0


def character(**changes: Any) -> Any:
    """What a body's hash reads of a character."""
    rng = np.random.default_rng(2)
    parts = {
        "name": "someone",
        "vertices": rng.normal(size=(30, 3)),
        "faces": rng.integers(30, size=(40, 3)).astype(np.int32),
        "joint_names": ("hips", "knee"),
        "joint_indices": rng.integers(2, size=(30, 4)).astype(np.int32),
        "joint_weights": rng.dirichlet(np.ones(4), 30).astype(np.float32),
    }
    return SimpleNamespace(**(parts | changes))


def test_another_body_is_refused_and_rounding_makes_no_other() -> None:
    mine = character()
    database = replace(small_database(), body_hash=body_hash(mine), body_vertex_count=30)
    database.require_body(mine)
    database.require_body(character(name="the same", vertices=mine.vertices * (1 + 1e-15)))
    moved, heavier = mine.vertices.copy(), mine.joint_weights.copy()
    moved[7, 1] += 1e-3
    heavier[7] = heavier[7, ::-1]
    others: list[dict[str, Any]] = [
        {"vertices": moved},
        {"faces": mine.faces[::-1]},
        {"joint_names": ("hips", "elbow")},
        {"joint_indices": 1 - mine.joint_indices},
        {"joint_weights": heavier},
    ]
    for change in others:
        refuses("someone: a database of another character", database.require_body, character(**change))


def test_positions_of_a_file_do_not_lie_between_two_steps_of_the_hash() -> None:
    """Decimal and binary fractions, a rounding error up or down."""
    grids = np.concatenate([np.arange(30000) / 10.0**5, np.arange(30000) / 2.0**17]).reshape(-1, 3)
    one = character(vertices=grids)
    for error in (-1e-14, 1e-14):
        assert body_hash(character(vertices=grids + error)) == body_hash(one)


def test_a_sequence_is_known_by_its_first_frame() -> None:
    frames = np.random.default_rng(1).normal(size=(4, 12, 3)).astype(np.float32)
    faces = np.arange(12, dtype=np.int32).reshape(-1, 3)
    sequence = SimpleNamespace(name="run", vertices=frames, faces=faces, dt=0.1)
    posed = SimpleNamespace(vertices=frames[0].astype(np.float64), faces=faces)
    assert body_hash(sequence) == body_hash(posed)
    other = SimpleNamespace(name="run", vertices=frames[1:], faces=faces, dt=0.1)
    database = replace(small_database(), body_hash=body_hash(sequence))
    refuses("received '12 vertices", database.require_body, other)


def test_the_code_version_follows_the_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in ("pbd", "wrinkles"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.py").write_text("x = 1\n")
    monkeypatch.setattr(database.pbd, "__path__", [str(tmp_path / "pbd")])
    monkeypatch.setattr(database, "__file__", str(tmp_path / "wrinkles" / "database.py"))
    versions = []
    for text in ("x = 1\n", "x = 2\n", "x = 1\n"):
        (tmp_path / "pbd" / "a.py").write_text(text)
        versions.append(code_version.__wrapped__())
    assert versions[0] == versions[2] != versions[1]
    assert "+" in versions[0]


def test_a_database_does_not_change() -> None:
    with pytest.raises(AttributeError):
        small_database().seed = 4  # type: ignore[misc]
    assert isinstance(small_database(), WrinkleDatabase)
