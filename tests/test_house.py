"""The house stands: imports run one way and in no circles, and playing loads nothing that only learning needs."""

import ast
import re
import sys
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

import pytest

from tests.data import ROOT
from tests.docstrings import untrue_sections
from tests.imports import circles, imports, modules_imported
from tests.processes import python

FLOORS = ("pbd", "assets", "wrinkles", "runtime", "precompute", "gube")  # ground floor first, the roof last
PLAYING = FLOORS[:4]
NOT_FOR_PLAYING = ("sklearn", "matplotlib", "pyvista", "dask")
TABLE_OF_COMMANDS = Path("runtime/cli/command.py")  # alone names modules above its own floor
TABLES = (TABLE_OF_COMMANDS, Path("gube/__init__.py"))  # alone import modules by name
EXTENSION = ROOT / "runtime" / "blender"  # runs inside Blender, and so has rules of its own
FOR_BLENDER = sorted(EXTENSION.glob("*.py"))
MODULES = [
    path for floor in FLOORS for path in sorted((ROOT / floor).rglob("*.py")) if not path.is_relative_to(EXTENSION)
]
SOURCES = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in MODULES}


def names_of_modules(tree: ast.AST) -> Iterator[str]:
    """Texts that are the dotted name of a module of the house, from which an import could be made."""
    pattern = re.compile(rf"({'|'.join(FLOORS)})(\.\w+)+(:\w+)?")
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and pattern.fullmatch(node.value):
            yield node.value


def forbidden(relative: Path, source: str) -> list[str]:
    """What a module imports against the rules of the house, by a statement or by the text of a name."""
    floor = FLOORS.index(relative.parts[0])
    tree, found = ast.parse(source), []
    for name, inside_function in imports(tree):
        if name in FLOORS[floor + 1 :] or name in (".", "..", "tests"):
            found.append(f"imports {name}")
        if relative.parts[0] in PLAYING and name in NOT_FOR_PLAYING and not inside_function:
            found.append(f"imports {name} outside a function")
    if relative != TABLE_OF_COMMANDS:
        above = FLOORS[floor + 1 :]
        found += [f"names {name}" for name in names_of_modules(tree) if name.partition(".")[0] in above]
    if relative not in TABLES:
        calls = [node for node in ast.walk(tree) if isinstance(node, (ast.Name, ast.Attribute))]
        names = [node.id if isinstance(node, ast.Name) else node.attr for node in calls]
        found += [f"calls {name}" for name in names if name in ("import_module", "__import__")]
    return found


def test_imports_run_one_way() -> None:
    assert [f"{name} {one}" for name, source in SOURCES.items() for one in forbidden(Path(name), source)] == []


@pytest.mark.parametrize(
    ("module", "source", "problem"),
    [
        ("pbd/a.py", "import assets", "imports assets"),
        ("pbd/a.py", "def f():\n    from wrinkles.b import c", "imports wrinkles"),
        ("assets/a.py", "try:\n    import runtime.play.player\nexcept ImportError: pass", "imports runtime"),
        ("runtime/a.py", "def f():\n    import precompute.b", "imports precompute"),
        ("runtime/cli/command.py", "from precompute import b", "imports precompute"),
        ("runtime/cli/command.py", "def f():\n    from precompute import b", "imports precompute"),
        ("runtime/cli/commands/a.py", "B = 'precompute.commands.b'", "names precompute.commands.b"),
        ("runtime/cli/commands/a.py", "B = {'c': 'precompute.b:run'}", "names precompute.b:run"),
        ("pbd/a.py", "import importlib\nimportlib.import_module(f'{f}.b')", "calls import_module"),
        ("assets/a.py", "__import__(name)", "calls __import__"),
        ("wrinkles/a.py", "from sklearn.linear_model import Ridge", "imports sklearn outside a function"),
        ("assets/a.py", "from . import b", "imports ."),
        ("precompute/a.py", "import tests.data", "imports tests"),
        ("precompute/a.py", "from gube import Player", "imports gube"),
        ("runtime/cli/command.py", "def demo():\n    import gube", "imports gube"),
    ],
)
def test_a_breach_is_found(module: str, source: str, problem: str) -> None:
    assert forbidden(Path(module), source) == [problem]


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("runtime/cli/command.py", "TABLE = {'demo': 'precompute.commands.demo'}\nimport_module(TABLE[name])"),
        ("runtime/a.py", '"""What precompute.learning.pipeline makes."""\nB = "wrinkles.database"'),
        ("wrinkles/a.py", "def fit():\n    import sklearn"),
        ("precompute/a.py", "import pbd, assets, wrinkles, runtime, sklearn"),
        ("gube/a.py", "import pbd, assets, wrinkles, runtime, precompute"),
        ("gube/__init__.py", "SOURCES = {'Solver': 'pbd.xpbd.solver:Solver'}\nimport_module(SOURCES[name])"),
    ],
)
def test_what_is_allowed_passes(module: str, source: str) -> None:
    assert forbidden(Path(module), source) == []


# Sub-packages, ground first: a module belongs to the longest name that it starts with and imports only what stands
# in its own sub-package or before it. The module that a floor is imported by as a whole (pbd) is its door and free.
STAIRS = (
    "pbd",
    "pbd.contact",
    "pbd.xpbd",
    "pbd.models",
    "assets",
    "assets.io",
    "assets.patterns",
    "assets.patterns.drafts",
    "assets.sewing",
    "assets.procedural",
    "assets.loading",
    "wrinkles",
    "runtime",
    "runtime.output",  # words, tables and files of figures
    "runtime.play",
    "runtime.setup",
    "runtime.detail",
    "runtime.draw",
    "runtime.export",
    "runtime.viewer",
    "runtime.cli",
    "runtime.cli.commands",
    "precompute",  # processes and computers that work together
    "precompute.reporting",
    "precompute.experiment",
    "precompute.rivals",
    "precompute.learning",
    "precompute.wardrobe_learning",
    "precompute.wrinkle_comparison",
    "precompute.demo_page",
    "precompute.demo_run",
    "precompute.planning",
    "precompute.method_comparison",
    "precompute.benchmarks",
    "precompute.failures",
    "precompute.stability",
    "precompute.validation",
    "precompute.fabric_lab",
    "precompute.fuzzing",
    "precompute.commands",
    "gube",
)


def house(sources: Mapping[str, str]) -> dict[str, set[str]]:
    """What each module imports of the modules of the house, by dotted names; ``sources`` by their files."""
    names = {file.removesuffix(".py").removesuffix("/__init__").replace("/", "."): file for file in sources}
    return {name: modules_imported(ast.parse(sources[file]), names) - {name} for name, file in names.items()}


def step_of(module: str) -> str:
    return max((one for one in STAIRS if f"{module}.".startswith(f"{one}.")), key=len)


def arrows_up(graph: Mapping[str, Collection[str]]) -> list[str]:
    """Imports of a sub-package that stands after the importing one on the same floor."""
    return sorted(
        f"{module} -> {other}"
        for module, others in graph.items()
        for other in others
        if module not in FLOORS and module.partition(".")[0] == other.partition(".")[0]
        if STAIRS.index(step_of(other)) > STAIRS.index(step_of(module))
    )


@pytest.fixture(scope="module")
def graph() -> dict[str, set[str]]:
    return house(SOURCES)


def test_files_import_one_another_in_no_circles(graph: dict[str, set[str]]) -> None:
    assert circles(graph) == []


def test_imports_of_sub_packages_run_one_way(graph: dict[str, set[str]]) -> None:
    assert arrows_up(graph) == []


def test_each_sub_package_has_its_step(graph: dict[str, set[str]]) -> None:
    folders = {path.parent.relative_to(ROOT).as_posix().replace("/", ".") for path in MODULES}
    assert folders <= set(STAIRS) <= {*graph, *folders}


def test_circles_and_arrows_up_are_found() -> None:
    graph = house(
        {
            "pbd/__init__.py": "from pbd.xpbd.a import A",
            "pbd/b.py": "import pbd.c",
            "pbd/c.py": "def f():\n    from pbd import d",
            "pbd/d.py": "if TYPE_CHECKING:\n    from pbd.b import B",
            "pbd/contact/e.py": "from pbd.xpbd.a import A\nfrom pbd.b import B\nimport assets.f",
            "pbd/xpbd/a.py": "import pbd.contact.e",
            "assets/f.py": "B = 'pbd.b'",
        }
    )
    assert circles(graph) == [("pbd.b", "pbd.c", "pbd.d"), ("pbd.contact.e", "pbd.xpbd.a")]
    assert arrows_up(graph) == ["pbd.contact.e -> pbd.xpbd.a"]


def not_in_blender(source: str) -> list[str]:
    """Imports of an extension that Blender does not bring; "." is the extension itself."""
    known = {*sys.stdlib_module_names, "bpy", "numpy", "."}
    return [name for name, _ in imports(ast.parse(source)) if name.partition(".")[0] not in known and name != "."]


def test_the_extension_imports_what_blender_has() -> None:
    sources = {path.name: path.read_text(encoding="utf-8") for path in FOR_BLENDER}
    assert [f"{name} imports {one}" for name, text in sources.items() for one in not_in_blender(text)] == []
    assert [f"{name} {one}" for name, text in sources.items() for one in long_functions(text)] == []


def test_imports_that_blender_lacks_are_found() -> None:
    assert not_in_blender("import bpy, json\nfrom . import files\nimport scipy\nfrom assets import motion") == [
        "scipy",
        "assets",
    ]


def test_no_test_module_is_imported() -> None:
    """What several need is in a module of its own; also scripts for other processes take it from there."""
    files = sorted((ROOT / "tests").rglob("*.py"))
    pattern = re.compile(r"(from|import) tests\.[\w.]*test_")
    assert [path.name for path in files if pattern.search(path.read_text(encoding="utf-8"))] == []


def test_playing_loads_nothing_that_only_learning_needs(graph: dict[str, set[str]]) -> None:
    """Also through third parties, which the imports' text does not show."""
    names = [name for name in graph if name.partition(".")[0] in PLAYING]
    script = (
        "import importlib, sys\n"
        f"for name in {names!r}:\n"
        "    importlib.import_module(name)\n"
        f"    loaded = [top for top in {(*NOT_FOR_PLAYING, 'precompute')!r} if top in sys.modules]\n"
        "    if loaded: sys.exit(f'{name} loads {loaded}')\n"
    )
    python(script)


def test_docstrings_explain_what_there_is() -> None:
    found = {name: list(untrue_sections(ast.parse(source))) for name, source in SOURCES.items()}
    assert [f"{name} {one}" for name, some in found.items() for one in some] == []


def test_untrue_docstrings_are_found() -> None:
    code = """
def f(self, a, b, *c, d=0):
    '''Of ``d``.

    Args:
        a, e: of both, where
            g: is none.
        c: more.
    '''
class A:
    '''Data.

    Args:
        g: given.
        k: not given.
    Attributes:
        g, i, p, q: of it.
        n: of nothing.
    '''
    g: int
    h: float = 0
    i, j = 1, 2
    k: int = field(init=False)
    m: ClassVar[int] = 3
    def p(self): self.q = 1
class B:
    '''No data.

    Args:
        g: taken.
    Attributes:
        r: kept.
    '''
    h: int
    def __init__(self, g, s): self.r = g
"""
    assert list(untrue_sections(ast.parse(code))) == [
        *("f: e is not there", "f: b is not explained"),
        *("A: k is not there", "A: h is not explained"),
        *("A: n is not there", "A: h is not explained", "A: k is not explained"),
        "B: s is not explained",
    ]


MAX_LINES, MAX_ARGUMENTS = 60, 12
MOST_LONG, MOST_WIDE = 10, 4  # functions over these; those with more arguments are kernels


def long_functions(source: str) -> list[str]:
    """Functions and methods over 60 lines or 12 arguments; one inside another counts as a part of it."""
    return [name for name, lines, arguments in functions(source) if lines > MAX_LINES or arguments > MAX_ARGUMENTS]


def functions(source: str) -> Iterator[tuple[str, int, int]]:
    """Names of functions and methods, with the numbers of their lines and arguments."""
    left = list(ast.parse(source).body)
    while left:
        node = left.pop()
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            arguments = len([*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs])
            yield node.name, (node.end_lineno or 0) - node.lineno + 1, arguments
        elif isinstance(node, ast.ClassDef):
            left += node.body


def test_no_module_is_over_450_lines() -> None:
    assert [name for name, source in SOURCES.items() if source.count("\n") > 450] == []


def public_classes(source: str) -> list[str]:
    return [n.name for n in ast.parse(source).body if isinstance(n, ast.ClassDef) and not n.name.startswith("_")]


def test_no_public_class_has_the_name_of_another() -> None:
    count = Counter(name for source in SOURCES.values() for name in public_classes(source))
    assert [name for name, times in count.items() if times > 1] == []
    assert public_classes("class A: pass\nclass _B: pass\ndef f():\n    class C: pass") == ["A"]


SAY_NOTHING = {"told", "said", "mine", "given", "gathers", "unfamiliarity", "sights", "fronts"}


def names_that_say_nothing(source: str) -> set[str]:
    """Names of variables, arguments, attributes, functions and classes that do not say what they hold."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        for field in ("id", "arg", "attr", "name"):
            name = getattr(node, field, None)
            if isinstance(name, str) and name.lstrip("_") in SAY_NOTHING:
                found.add(name)
    return found


def test_names_say_what_they_hold() -> None:
    floors = tuple(f"{floor}/" for floor in PLAYING)
    found = {name: names_that_say_nothing(source) for name, source in SOURCES.items() if name.startswith(floors)}
    assert {name: some for name, some in found.items() if some} == {}
    code = "def given(mine): _said = a.told; b(unfamiliarity=1, stage=worn)\nclass _Sights: fronts: int\n'gathers'"
    assert names_that_say_nothing(code) == {"given", "mine", "_said", "told", "unfamiliarity", "fronts"}


def with_many_defaults(source: str) -> list[str]:
    """Public functions that two or more arguments can be left out of by their places."""
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    return [one.name for one in functions if not one.name.startswith("_") and len(one.args.defaults) > 1]


def test_second_defaults_are_given_by_name() -> None:
    """A step of a simulation is called each frame, and so is short."""
    found = [f"{name} {one}" for name, source in SOURCES.items() for one in with_many_defaults(source) if one != "step"]
    assert found == []
    assert with_many_defaults("def f(a=1, b=2): pass\ndef g(a=1, *, b=2): pass") == ["f"]


def test_long_functions_are_exceptions() -> None:
    found = [(f"{name} {one}", *counts) for name, source in SOURCES.items() for one, *counts in functions(source)]
    long = [name for name, lines, _ in found if lines > MAX_LINES]
    wide = [name for name, _, arguments in found if arguments > MAX_ARGUMENTS]
    assert len(long) <= MOST_LONG and len(wide) <= MOST_WIDE, (long, wide)


def test_long_functions_are_found() -> None:
    short = "def f():\n" + 59 * "    x = 0\n"
    assert long_functions(short) == []
    assert long_functions(short + "    x = 0\n") == ["f"]
    assert long_functions("class A:\n    def f(" + ", ".join(f"a{k}" for k in range(13)) + "): ...") == ["f"]
