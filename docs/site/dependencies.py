"""What the project depends on: every locked package with its licence and what it is for.

``make licences`` prints the list and writes it as a software bill of materials (CycloneDX 1.6, ECMA-424), which every
wheel carries in its folder ``sboms`` (PEP 770). It is no command of ``gube``: who installs the wheel has the file.
"""

from __future__ import annotations

import base64
import json
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageMetadata, distribution
from pathlib import Path
from typing import Any

from packaging.licenses import InvalidLicenseExpression, canonicalize_license_expression
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from assets.extras import EXTRAS
from gube import __version__

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["BILL", "Locked", "bill_of_materials", "direct_reasons", "licence_of", "locked"]

ROOT = Path(__file__).resolve().parent.parent.parent
BILL = ROOT / "dependencies.cdx.json"
# Licence and requirements of what is installed on macOS alone, from the METADATA of the wheels.
ELSEWHERE = {"pyobjc-core": ("MIT", []), "pyobjc-framework-cocoa": ("MIT", ["pyobjc-core"])}
LONGEST = 40  # characters of a licence's name; a longer one is its text


@dataclass(frozen=True)
class Locked:
    """One locked package.

    Attributes:
        name: as its registry has it.
        version: the locked one.
        licence: SPDX expression where its authors give one, else the name that they use; empty if unknown.
        reason: why the project needs it, from ``pyproject.toml``; empty for what only others need.
        needed_by: names of the packages that ask for it, "gube" among them for what an installed wheel needs.
        at_run_time: whether an installed wheel needs or holds it; else only development does.
        kind: "pypi" or "npm".
        digest: SHA-512 of what is downloaded, hexadecimal; empty where the lock has a hash for each platform.
    """

    name: str
    version: str
    licence: str
    reason: str
    needed_by: tuple[str, ...]
    at_run_time: bool
    kind: str = "pypi"
    digest: str = ""

    @property
    def reference(self) -> str:
        """Its package URL."""
        return f"pkg:{self.kind}/{self.name.replace('@', '%40')}@{self.version}"


def licence_of(about: PackageMetadata) -> str:
    """Licence in a package's metadata: the expression, else a short name, else the classifiers; empty without any."""
    classifiers = [text for text in about.get_all("Classifier") or [] if text.startswith("License ::")]
    (expression, *_), (short, *_) = (about.get_all(key) or [""] for key in ("License-Expression", "License"))
    short = short if len(short) <= LONGEST and short != "UNKNOWN" else ""
    return expression or short or " AND ".join(text.rpartition(" :: ")[2] for text in classifiers)


def direct_reasons(project: str) -> dict[str, str]:
    """Why the project needs its direct dependencies: their comment in ``pyproject.toml``, else that of their group."""
    reasons, group = {}, ""
    for line in project.partition("[project.scripts]")[0].splitlines():
        code, _, comment = line.partition(" # ")
        if line.startswith("# "):
            group = line.removeprefix("# ")
        elif not line.strip():
            group = ""
        elif re.match(r" |[\w-]+ = \[", line):
            names = re.findall(r'"([A-Za-z][\w.-]*)(?:\[\w+\])?[<>=]', code)
            reasons |= {canonicalize_name(name): comment or group for name in names}
    return reasons


def locked() -> list[Locked]:
    """All packages of ``requirements.lock`` and ``package-lock.json``.

    Raises:
        PackageNotFoundError: a package for this machine that is not installed.
    """
    text = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    versions = re.findall(r"^([a-z0-9-]+)==([^\s;]+)", text, re.MULTILINE)  # some have two, for old and new Pythons
    names = ["gube", *dict(versions)]
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    reasons, extras = direct_reasons(project), set(re.findall(r'"[\w-]+\[(\w+)\]>=', project))
    asked = {name: {one for one in _requirements(name, extras) if one in names} for name in names}
    at_run_time = _reached("gube", asked)
    return [
        Locked(
            name,
            version,
            ELSEWHERE[name][0] if name in ELSEWHERE else licence_of(distribution(name).metadata),
            reasons.get(name, ""),
            tuple(sorted(other for other in names if name in asked[other])),
            name in at_run_time,
        )
        for name, version in versions
    ] + list(_from_npm())


def _from_npm() -> Iterator[Locked]:
    packages = json.loads((ROOT / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    own = {"esbuild": "bundles three.js", "three": "draws exported pages; the wheel holds it"}
    for path, entry in sorted(packages.items()):
        name = path.removeprefix("node_modules/")
        parents = [
            other.removeprefix("node_modules/")
            for other, held in packages.items()
            if other and name in {**held.get("dependencies", {}), **held.get("optionalDependencies", {})}
        ]
        if name == "three":
            parents.append("gube")
        if name:
            digest = base64.b64decode(entry["integrity"].removeprefix("sha512-")).hex()
            licence, version = entry.get("license", ""), entry["version"]
            yield Locked(name, version, licence, own.get(name, ""), tuple(parents), name == "three", "npm", digest)


def _requirements(name: str, extras: set[str]) -> Iterator[str]:
    """Names of what a package needs, on any system; of its extras, only those that the project asks for."""
    if name == "gube":  # as it will be installed, with all that its commands may need
        project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        optional = project["optional-dependencies"]
        texts = [*project["dependencies"], *(text for extra in EXTRAS for text in optional[extra])]
    else:
        texts = ELSEWHERE[name][1] if name in ELSEWHERE else distribution(name).requires or []
    for text in texts:
        wish = Requirement(text)
        extra = re.search(r'extra == "([^"]*)"', str(wish.marker))
        if extra is None or extra[1] in extras:
            yield canonicalize_name(wish.name)


def _reached(start: str, asked: dict[str, set[str]]) -> set[str]:
    found, left = set(), [start]
    while left:
        new = asked[left.pop()] - found
        found |= new
        left += new
    return found


def bill_of_materials(packages: list[Locked]) -> dict[str, Any]:
    """The list as CycloneDX: the same packages give the same file, so that it has no date and no serial number."""
    own = f"pkg:pypi/gube@{__version__}"
    named = [("gube", own), *((package.name, package.reference) for package in packages)]
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "library", "bom-ref": own, "name": "gube", "version": __version__, "purl": own,
                "licenses": [{"license": {"id": "MIT"}}],
            }
        },
        "components": [_component(package) for package in packages],
        "dependencies": [
            {"ref": reference, "dependsOn": sorted(one.reference for one in packages if name in one.needed_by)}
            for name, reference in named
        ],
    }  # fmt: skip


def _component(package: Locked) -> dict[str, Any]:
    try:
        licence: dict[str, Any] = {"expression": str(canonicalize_license_expression(package.licence))}
    except InvalidLicenseExpression:
        licence = {"license": {"name": package.licence}}
    return {
        "type": "library",
        "bom-ref": package.reference,
        "name": package.name,
        "version": package.version,
        "purl": package.reference,
        "scope": "required" if package.at_run_time else "excluded",
        "licenses": [licence],
        **({"hashes": [{"alg": "SHA-512", "content": package.digest}]} if package.digest else {}),
    }


def main() -> None:
    """Print the list, and write the bill of materials."""
    packages = locked()
    for package in packages:
        use = package.reason or "for " + ", ".join(package.needed_by)
        where = "installed" if package.at_run_time else "development"
        sys.stdout.write(f"{package.name:30} {package.version:12} {where:12} {package.licence:32} {use}\n")
    BILL.write_text(json.dumps(bill_of_materials(packages), indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
