"""Libraries that come with extras: what is said where one is missing, and that learning and playing need none."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from assets.extras import EXTRAS, missing_library, require_extra
from assets.patterns.load import load_pattern
from pbd import InputError
from runtime.cli import command
from runtime.cli.commands import info
from tests.data import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.mark.parametrize(
    ("words", "module", "extra"),
    [
        (["view", "skirt.h5"], "viser", "view"),
        (["bake", "skirt.h5", "-o", "skirt.usdc"], "pxr", "usd"),
        (["measure", "body.usda"], "pxr", "usd"),
        (["sew", "skirt.svg", "-b", "builtin:mannequin", "-o", "skirt.npz"], "svgpathtools", "sew"),
        (["sew", "skirt.svg", "-b", "builtin:mannequin", "-o", "a.npz", "--picture", "a.png"], "matplotlib", "report"),
        (["play", "skirt.h5"], "pyvista", "report"),
    ],
)
def test_a_command_says_what_installs_what_is_missing(
    words: list[str],
    module: str,
    extra: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("body.usda", "skirt.svg"):
        Path(name).write_text("")
    before = sorted(tmp_path.iterdir())
    monkeypatch.setitem(sys.modules, module, None)
    assert command.main(words) == 2
    said = capsys.readouterr().err
    assert f"{module} is not installed" in said and f"pip install 'gube[{extra}]'" in said
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(("name", "module"), [("a.svg", "svgpathtools"), ("a.dxf", "ezdxf")])
def test_a_pattern_names_the_file_that_needs_it(
    name: str, module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / name).write_text("")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"{name}: {module} is not installed .*gube\[sew\]"):
        load_pattern(tmp_path / name)


def test_an_import_that_fails_late_is_said_as_well(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run_without(module: str) -> None:
        def run(options: object) -> None:
            raise ModuleNotFoundError(f"No module named {module!r}", name=module)

        monkeypatch.setattr(info, "run", run)

    run_without("matplotlib.figure")
    assert command.main(["info", "skirt.h5"]) == 2
    assert "gube info: matplotlib is not installed (expected `pip install 'gube[report]'`)" in capsys.readouterr().err
    run_without("scipy")  # of no extra: a broken installation
    with pytest.raises(ModuleNotFoundError):
        command.main(["info", "skirt.h5"])


def test_the_extras_are_those_of_the_package() -> None:
    owners = {
        extra: {canonicalize_name(owner) for module in modules for owner in packages_distributions()[module]}
        for extra, modules in EXTRAS.items()
    }
    extras = PROJECT["optional-dependencies"]
    assert owners == {name: {canonicalize_name(Requirement(text).name) for text in extras[name]} for name in EXTRAS}
    assert missing_library("numpy") is None
    for extra in EXTRAS:
        require_extra(extra)


def test_learning_and_playing_need_no_extra() -> None:
    blocked = [module for modules in EXTRAS.values() for module in modules]
    script = (
        "import sys\n"
        f"for name in {blocked!r}: sys.modules[name] = None\n"
        "import gube, precompute.learning.pipeline, precompute.planning.planning, runtime.export.free_run\n"
        "for name in gube.__all__: getattr(gube, name)\n"
    )
    result = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
