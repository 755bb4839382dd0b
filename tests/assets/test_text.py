"""Every reader of text takes a byte order mark, and names other encodings, separators and decimal commas."""

from __future__ import annotations

import ast
import base64
import codecs
import json
import pickle
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from ezdxf.document import Drawing
from ezdxf.enums import InsertUnits

from assets.fabrics import load_fabric
from assets.io.bvh import read_bvh
from assets.io.gltf import read_document
from assets.io.obj import read_obj
from assets.io.retarget import load_joint_table
from assets.io.scene import load_scene, parse_scene
from assets.io.sequence import load_sequence
from assets.loading import load_character, load_garment
from assets.painted_limits import load_limits
from assets.patterns.load import load_pattern
from assets.seams import load_seams
from assets.text import read_text, read_words
from pbd.errors import InputError
from precompute.fabric_lab.fabric_fit import read_curves
from precompute.fuzzing.readers import BVH, READERS, SCENE, SEAMS, SVG
from precompute.wrinkle_comparison.blind import KEY, blind_figures
from runtime.detail.cost_table import read_cost_table, write_cost_table
from tests.assets.files import bar_glb
from tests.data import ROOT
from tests.refusals import refuses
from tests.runtime.cost_tables import made_front

OBJ = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0.1 0.1 0\nf 1 2 3\nf 2 4 3\n"
FABRIC = json.dumps({"density": 0.2, "stretching": [[100.0, 10.0, 90.0, 20.0]] * 6, "bending": [[1e-5] * 5] * 3})
EDGES = [{"endpoints": [k, (k + 1) % 4]} for k in range(4)]
PANEL = {"vertices": [[0, 0], [40, 0], [40, 50], [0, 50]], "edges": EDGES, "rotation": [0, 0, 0]}
GARMENTCODE = json.dumps(
    {
        "pattern": {
            "panels": {name: PANEL | {"translation": [0, 100, z]} for name, z in (("front", 20), ("back", -20))},
            "stitches": [[{"panel": "front", "edge": 1}, {"panel": "back", "edge": 1}]],
        },
        "properties": {"units_in_meter": 100, "curvature_coords": "relative"},
    }
)
USDA = """#usda 1.0
(
    metersPerUnit = 1
    timeCodesPerSecond = 30
    upAxis = "Y"
)
def Mesh "cloth"
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points.timeSamples = {
        0: [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
        1: [(0, 0, 1), (1, 0, 1), (0, 1, 1)],
    }
}
"""
LIMITS = "vertex,maximum_distance,backstop,stiffness\n0,0.05,0.01,100\n3,0.1,,\n"
STITCHES = "v,a,b,w\n0,5,6,0.25\n4,9,8,0.5\n"
JOINTS = "part,joint,bvh\nleft hand,hand_l,LeftHand\nleft foot,,LeftFoot\n"
CURVES = "instrument,direction,deformation,load\ntension,warp,0.01,20\nbending,warp,100,0.001\n"


def dxf(path: Path) -> str:
    """A drawing of two panels, in the folder of ``path``."""
    drawing = Drawing.new("R2010")
    drawing.units = InsertUnits.Centimeters
    for number, name in enumerate(("front", "back")):
        corners = [(50.0 * number + x, y) for x, y in ((0, 0), (40, 0), (40, 60), (0, 60))]
        drawing.modelspace().add_lwpolyline(corners, close=True, dxfattribs={"layer": name})
    drawing.saveas(path)
    return path.read_text(encoding="utf-8")


def gltf(path: Path) -> str:
    """A character as JSON, with its buffer inside."""
    glb = bar_glb()
    glb.bytes()
    uri = "data:application/octet-stream;base64," + base64.b64encode(glb.data).decode("ascii")
    glb.json["buffers"][0]["uri"] = uri
    return json.dumps(glb.json)


def cost_table(path: Path) -> str:
    write_cost_table(path, made_front(3))
    return path.read_text(encoding="utf-8")


def drawn(path: Path, seams: str = SEAMS) -> Any:
    path.with_suffix(".seams.toml").write_text(seams, encoding="utf-8")
    return load_pattern(path)


def sides(path: Path) -> Any:
    """The pattern of a drawing beside, whose file of seams is read."""
    (path.parent / "panel.svg").write_text(SVG, encoding="utf-8")
    return load_pattern(path.parent / "panel.svg")


def answered(path: Path) -> Any:
    """Figures of answers to two blind pairs."""
    (path.parent / KEY).parent.mkdir(exist_ok=True)
    (path.parent / KEY).write_text('{"1": "A", "2": "B"}', encoding="utf-8")
    return blind_figures(path.parent, path)


CASES: dict[str, tuple[str | Callable[[Path], str], Callable[[Path], Any]]] = {
    "sheet.obj": (OBJ, read_obj),
    "garment.obj": (OBJ, load_garment),
    "motion.bvh": (BVH, read_bvh),
    "scene.toml": (SCENE.format(mesh="builtin:skirt").replace('limits = "limits.csv"\n', ""), load_scene),
    "panel.seams.toml": (SEAMS, sides),
    "limits.csv": (LIMITS, lambda path: load_limits(path, 20)),
    "stitches.csv": (STITCHES, lambda path: load_seams(path, 20)),
    "joints.csv": (JOINTS, load_joint_table),
    "curves.csv": (CURVES, read_curves),
    "fabric.json": (FABRIC, load_fabric),
    "pattern.json": (GARMENTCODE, load_pattern),
    "cost_table.json": (cost_table, read_cost_table),
    "panel.svg": (SVG, drawn),
    "panel.dxf": (dxf, drawn),
    "body.gltf": (gltf, lambda path: (read_document(path).json, load_character(path).vertices)),
    "cloth.usda": (USDA, load_sequence),
    "answers.txt": ("A\nB\n", answered),
}
KEEP_OWN_NAMES = {".obj", ".bvh", ".dxf", ".usda"}  # take bytes of Latin-1 where they are no name that is used
TABLES = ("limits.csv", "stitches.csv", "joints.csv", "curves.csv")


def case(name: str, folder: Path) -> tuple[Path, bytes, Callable[[Path], Any]]:
    text, read = CASES[name]
    path = folder / name
    return path, (text if isinstance(text, str) else text(path)).encode("utf-8"), read


@pytest.fixture(autouse=True)
def no_other_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """USD files are not read in another process first, which takes a second and finds nothing in these."""
    monkeypatch.setattr("assets.io.usd.require_sound", lambda path: None)


def test_every_reader_of_text_is_tried() -> None:
    suffixes = {Path(name).suffix for name in CASES}
    binary = {".glb", ".h5", ".npz", ".pc2", ".mdd", ".usdc", ".rec"}
    assert set(READERS) - binary <= suffixes


@pytest.mark.parametrize("name", CASES)
def test_a_byte_order_mark_changes_nothing(tmp_path: Path, name: str) -> None:
    path, data, read = case(name, tmp_path)
    path.write_bytes(data)
    without = pickle.dumps(read(path))
    path.write_bytes(codecs.BOM_UTF8 + data.replace(b"\r\n", b"\n").replace(b"\n", b"\r\n"))
    assert pickle.dumps(read(path)) == without


def test_a_mark_in_the_middle_takes_no_vertex_away(tmp_path: Path) -> None:
    """Two files that were put together."""
    path = tmp_path / "two.obj"
    path.write_bytes(2 * (codecs.BOM_UTF8 + OBJ.encode()))
    assert len(read_obj(path).vertices) == 8


def test_a_scene_in_a_string_may_begin_with_the_mark() -> None:
    text = CASES["scene.toml"][0]
    assert isinstance(text, str) and parse_scene("\ufeff" + text) == parse_scene(text)


@pytest.mark.parametrize(
    ("name", "encoding"),
    [
        *((name, "utf-16") for name in CASES),
        ("sheet.obj", "utf-16-be"),
        ("sheet.obj", "utf-32"),
        ("panel.svg", "utf-32"),
    ],
)
def test_other_encodings_are_named(tmp_path: Path, name: str, encoding: str) -> None:
    path, data, read = case(name, tmp_path)
    path.write_bytes(codecs.BOM_UTF16_BE * (encoding == "utf-16-be") + data.decode("utf-8").encode(encoding))
    if path.suffix == ".svg" and encoding != "utf-32":  # XML may be in UTF-16
        assert len(read(path).panels) == 2
        return
    assert "UTF-8" in refuses(re.escape(name) + ".*" + encoding[:6].upper(), read, path)


@pytest.mark.parametrize("name", [name for name in CASES if Path(name).suffix not in {".svg", ".dxf", ".usda"}])
def test_utf_16_without_a_mark_is_named(tmp_path: Path, name: str) -> None:
    path, data, read = case(name, tmp_path)
    for encoding in ("utf-16-le", "utf-16-be"):
        path.write_bytes(data.decode("utf-8").encode(encoding))
        refuses(re.escape(name) + ".*UTF-16", read, path)


@pytest.mark.parametrize("name", [name for name in CASES if Path(name).suffix not in KEEP_OWN_NAMES])
def test_text_in_latin_1_is_named_with_its_line(tmp_path: Path, name: str) -> None:
    path, data, read = case(name, tmp_path)
    path.write_bytes(data.rstrip(b"\n") + "\n# Größe\n".encode("latin-1"))
    line = data.rstrip(b"\n").count(b"\n") + 2
    with pytest.raises(InputError, match=rf"{re.escape(name)}: line {line}: .*Latin-1.*# Größe.*UTF-8"):
        read(path)


def test_comments_and_names_in_latin_1_do_not_keep_a_mesh_or_a_motion_from_being_read(tmp_path: Path) -> None:
    path, data, read = case("sheet.obj", tmp_path)
    for mark in (b"", codecs.BOM_UTF8):
        path.write_bytes(mark + data + "# Größe\ng Straße\n".encode("latin-1"))
        assert len(read(path).vertices) == 4
    path, data, read = case("motion.bvh", tmp_path)
    path.write_bytes(data.replace(b"spine", "Rücken".encode("latin-1")))
    assert read(path).joint_names == ("hips", "Rücken")


def test_a_panel_of_a_drawing_with_a_name_in_latin_1_is_refused(tmp_path: Path) -> None:
    path, data, read = case("panel.dxf", tmp_path)
    path.write_bytes(data.replace(b"front", "Rücken".encode("latin-1")))
    refuses("Latin-1.*Rücken.*UTF-8", read, path)


@pytest.mark.parametrize(("separator", "word"), [(";", "semicolons"), ("\t", "tabs"), ("|", "bars")])
@pytest.mark.parametrize("name", TABLES)
def test_other_separators_are_named(tmp_path: Path, name: str, separator: str, word: str) -> None:
    path, data, read = case(name, tmp_path)
    path.write_bytes(data.replace(b",", separator.encode()))
    refuses(f"{name}: line 1: columns between {word} .*expected commas", read, path)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ('1,"0,25"', r"line 3, column length: a decimal comma \(received '0,25', expected a decimal point\)"),
        ('1," -,5e3 "', "line 3, column length: a decimal comma"),
        ("1,0,25", r"line 3: too many columns \(received '1,0,25', expected vertex,length, and a decimal point"),
    ],
)
def test_decimal_commas_are_named(tmp_path: Path, row: str, message: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"vertex,length\n\n{row}\n", encoding="utf-8")
    refuses(message, read_words, path, ("vertex", "length"))


def test_words_are_read_as_they_stand(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text('vertex, length \n1, 0.5\n ,\n\n2\n"a,b",\n', encoding="utf-8")
    assert read_words(path, ("vertex", "length")) == [(2, ["1", " 0.5"]), (5, ["2"]), (6, ["a,b", ""])]


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    refuses(r"a\.txt: cannot be read: no such file.*expected a list", read_text, tmp_path / "a.txt", "a list")


OF_THEIR_OWN = {  # read what this program or the system wrote
    "precompute/benchmarks/frame_turns.py", "precompute/fuzzing/fuzzing.py",
    "precompute/scratch.py", "precompute/wrinkle_comparison/blind.py", "runtime/output/report.py",
}  # fmt: skip


def reads_text(source: str) -> list[str]:
    """Calls of a module that read text past :mod:`assets.text`."""
    found = []
    for node in ast.walk(ast.parse(source)) if re.search(r"open\(|read_text|csv\.|json\.load\(", source) else ():
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        mode = [a.value for a in [*node.args, *(k.value for k in node.keywords)] if isinstance(a, ast.Constant)]
        reading = name.rpartition(".")[2] == "open" and not {"rb", "wb", "ab", "w"} & set(mode)
        if name.endswith(".read_text") or name in ("csv.reader", "csv.DictReader", "json.load") or reading:
            found.append(name)
    return found


def test_no_module_reads_text_past_the_shared_reader() -> None:
    modules = [
        path
        for floor in ("pbd", "assets", "wrinkles", "runtime", "precompute")
        for path in (ROOT / floor).rglob("*.py")
    ]
    found = {path.relative_to(ROOT).as_posix() for path in modules if reads_text(path.read_text(encoding="utf-8"))}
    assert found - OF_THEIR_OWN == {"assets/text.py"}


def test_reading_past_it_is_found() -> None:
    source = (
        "path.read_text()\nopen(path, encoding='utf-8')\npath.open()\ncsv.reader(file)\nopen(path, 'wb')\nread_text(a)"
    )
    assert reads_text(source) == ["path.read_text", "open", "path.open", "csv.reader"]
