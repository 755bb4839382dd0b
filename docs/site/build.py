"""Builds the site of the documents: python -m docs.site.build, which is what `make docs` runs.

Pages that people write are taken from ``docs`` and README. Pages about things that the code declares are made from it:
scene keys, options of commands, public names, the database file. Tables of figures are made from the files that
commands wrote. Everything lies in ``out/site``; nothing is loaded from the network, neither here nor by the pages.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys

import yaml

from docs.site.pages import FILMS, GENERATED, ROOT

OUT = ROOT / "out" / "site"
PAGES, HTML = OUT / "pages", OUT / "html"

NAV: list[tuple[str, list[str]]] = [
    ("Start", ["index.md", "when-to-use.md", "gallery.md", "glossary.md"]),
    (
        "Guides",
        ["viewer.md", "artists-guide.md", "interchange.md", "engine-guide.md", "patterns.md", "contributing.md"],
    ),
    ("How it works", ["how-it-works.md", "solver.md"]),
    (
        "Reference",
        [
            "scenes.md",
            "fabrics.md",
            "cluster.md",
            "scene-keys.md",
            "commands.md",
            "options.md",
            "api.md",
            "python.md",
            "database-file.md",
            "recording-file.md",
        ],
    ),
    ("Evidence", ["validation.md", "other-engines.md"]),
    ("Lab notes", ["lab-notes.md"]),
]
"""Sections and their pages; pages that are in none of them come to the end of the section that `_section` says."""

# What README links to in the repository, and the page of the site that shows it.
ELSEWHERE = {"examples": "python.md#examples", "wrinkles/schema.py": "database-file.md"}
FOREIGN = re.compile(r'<(?:script|link|img|iframe|source)\b[^>]*\b(?:src|href)="?(?:https?:)?//', re.IGNORECASE)


def main() -> int:
    """Gather the pages, build the site and check that it loads nothing from elsewhere.

    Returns:
        the exit status: 0, or 1 for warnings of the builder or a page that loads something from elsewhere.
    """
    gather()
    settings = OUT / "mkdocs.yml"
    nav = [{section: pages} for section, pages in navigation().items()]
    inherited = {
        "INHERIT": str(ROOT / "docs" / "mkdocs.yml"),
        "docs_dir": str(PAGES),
        "site_dir": str(HTML),
        "nav": nav,
    }
    settings.write_text(yaml.safe_dump(inherited, sort_keys=False, allow_unicode=True), encoding="utf-8")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-f", str(settings)]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}  # about a successor of the theme
    if subprocess.run(command, cwd=ROOT, env=quiet).returncode:
        return 1
    foreign = [path for path in sorted(HTML.rglob("*.html")) if FOREIGN.search(path.read_text(encoding="utf-8"))]
    for path in foreign:
        sys.stderr.write(f"{path.relative_to(HTML)} loads something from elsewhere\n")
    sys.stdout.write(f"{HTML / 'index.html'}; to search it, serve it: python -m http.server -b 127.0.0.1 -d {HTML}\n")
    return 1 if foreign else 0


def gather() -> None:
    """Put all pages and pictures into ``out/site/pages``."""
    shutil.rmtree(OUT, ignore_errors=True)
    shutil.copytree(ROOT / "docs", PAGES, ignore=shutil.ignore_patterns("site", "scenes", "*.yml", "__pycache__"))
    (PAGES / "index.md").write_text(front_page((ROOT / "README.md").read_text(encoding="utf-8")), encoding="utf-8")
    if FILMS.is_file():
        shutil.copytree(FILMS.parent, PAGES / "gallery")
    shutil.copy(ROOT / "docs" / "site" / "site.css", PAGES)
    for name, make in GENERATED.items():
        (PAGES / name).write_text(make(), encoding="utf-8")


def front_page(readme: str) -> str:
    """README as a page of the site: its links lead to pages instead of files of the repository."""

    def led(match: re.Match[str]) -> str:
        return f"]({ELSEWHERE.get(match[1], match[1].removeprefix('docs/'))}"

    return re.sub(r"\]\(([^)#:]+)(?=[)#])", led, readme)


def navigation() -> dict[str, list[str]]:
    """Pages by section, those that NAV does not name at the end of the reference or of the lab notes."""
    sections = {title: list(pages) for title, pages in NAV}
    named = {page for pages in sections.values() for page in pages}
    for path in sorted(PAGES.rglob("*.md")):
        page = path.relative_to(PAGES).as_posix()
        if page not in named:
            sections["Lab notes" if page.startswith("lab-notes/") else "Reference"].append(page)
    return sections


if __name__ == "__main__":
    sys.exit(main())
