"""What the wheel holds, and that it works without the checkout."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.data import ROOT

PACKAGES = ("gube", "pbd", "assets", "wrinkles", "precompute", "runtime")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built from a source distribution, so that nothing stale in the checkout can get into it."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    (path,) = folder.glob("*.whl")
    return path


def test_it_holds_the_six_packages_whole_and_nothing_else(wheel: Path) -> None:
    shipped = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    in_checkout = {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert shipped == in_checkout


def test_it_carries_the_licence_the_command_and_the_list_of_dependencies(wheel: Path) -> None:
    archive = zipfile.ZipFile(wheel)
    about = [name for name in archive.namelist() if ".dist-info/" in name]
    texts = {name.partition(".dist-info/")[2]: archive.read(name).decode() for name in about}
    assert texts["licenses/LICENSE"].startswith("MIT License")
    assert "gube = runtime.cli.command:main" in texts["entry_points.txt"]
    assert texts["sboms/dependencies.cdx.json"] == (ROOT / "dependencies.cdx.json").read_text(encoding="utf-8")


def test_command_and_public_names_come_from_the_wheel_alone(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path)
    script = (
        "import sys; sys.path.insert(0, '.'); import gube; from runtime.cli import command\n"
        "for name in gube.__all__: getattr(gube, name)\n"
        "try: command.main(['--help'])\n"
        "finally: print(command.__file__, gube.__file__, gube.load_garment('builtin:skirt').source)"
    )
    command = [sys.executable, "-I", "-c", script]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert "usage: gube" in result.stdout
    *paths, source = result.stdout.splitlines()[-1].split()
    assert all(Path(path).is_relative_to(tmp_path) for path in paths) and source == "builtin:skirt"
