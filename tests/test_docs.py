"""The documents: links and anchors lead somewhere, code in them is right, and pages made from the code are whole."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import pytest
from markdown.extensions.toc import slugify

import gube
from docs.site.build import NAV, front_page
from docs.site.fabric_presets import BEGIN, END, PAGE, numbers_table
from docs.site.pages import GENERATED, TABLES, attribute_texts, options_page, scene_keys
from runtime.cli.command import COMMANDS, parser
from tests.data import ROOT
from tests.documents import commands, prose_and_code
from tests.sentences import paragraphs_of_code, paragraphs_of_page, unclear

FILES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
PAGES = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in FILES}
MADE = {*GENERATED, "index.md"}  # pages that only the site has


def anchors(text: str) -> set[str]:
    """Names of the headings of a page, as the site's builder makes them."""
    prose, _ = prose_and_code(text)
    titles = re.findall(r"^#+ +(.*?) *$", prose, re.MULTILINE)
    return {slugify(re.sub(r"[`*]", "", title), "-") for title in titles}


def broken(path: Path, text: str) -> list[str]:
    """Links of a page to nowhere."""
    prose, _ = prose_and_code(text)
    found = []
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`]*`", "", prose)):
        if re.match(r"[a-z]+:", target):
            continue
        place, _, anchor = target.partition("#")
        file = path.parent / place if place else path
        if not file.exists() and Path(place).name not in MADE:
            found.append(target)
        elif anchor and file.suffix == ".md" and file.exists() and file.name not in GENERATED:
            if anchor not in anchors(file.read_text(encoding="utf-8")):
                found.append(target)
    return found


def refused(line: str) -> bool:
    """Whether the parser refuses a line that runs `gube`."""
    words = shlex.split(line, comments=True)[1:]
    try:
        parser(words).parse_args(words)
    except SystemExit as error:
        return error.code != 0
    return False


def test_links_and_anchors_lead_somewhere() -> None:
    assert [f"{name}: {link}" for name, text in PAGES.items() for link in broken(ROOT / name, text)] == []


def test_a_broken_link_is_found(tmp_path: Path) -> None:
    (tmp_path / "other.md").write_text("# One title\n", encoding="utf-8")
    text = "[a](other.md) [b](other.md#one-title) [c](missing.md) [d](other.md#none) [e](#top) `[f](x)`\n# Top\n"
    (tmp_path / "page.md").write_text(text, encoding="utf-8")
    assert broken(tmp_path / "page.md", text) == ["missing.md", "other.md#none"]


def not_public(name: str, code: str) -> Iterator[str]:
    """What a block of Python in a page takes beside numpy and the public names."""
    for node in ast.walk(ast.parse(code, name)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name not in ("gube", "numpy"))
        if isinstance(node, ast.ImportFrom) and node.module != "gube":
            yield node.module or "."
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "gube" and node.attr not in gube.__all__:
            yield f"gube.{node.attr}"


def test_python_code_compiles_and_imports_public_names_alone() -> None:
    blocks = [(name, *block) for name, text in PAGES.items() for block in prose_and_code(text)[1]]
    codes = [(name, code) for name, language, code in blocks if language == "python" or code.startswith("import gube")]
    assert [f"{name}: {one}" for name, code in codes for one in not_public(name, code)] == []


def test_commands_in_code_blocks_are_those_of_the_parser() -> None:
    codes = [(name, code) for name, text in PAGES.items() for _, code in prose_and_code(text)[1]]
    assert [f"{name}: {line}" for name, code in codes for line in commands(code) if refused(line)] == []


def test_a_wrong_command_is_found(capsys: pytest.CaptureFixture[str]) -> None:
    code = "gube play a.h5 --truth  # judged\ngube play a.h5 \\\n    --nonsense\nmake test\ngube dance\n"
    assert [refused(line) for line in commands(code)] == [False, True, True]
    assert "--nonsense" in capsys.readouterr().err


def test_commands_in_the_text_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = {"lint", *re.findall(r"^([a-z-]+)(?=:)", makefile, re.MULTILINE)}
    known = {*(f"gube {name.split()[0]}" for name in COMMANDS), *(f"make {name}" for name in targets)}
    missing = []
    for name, text in PAGES.items():
        prose, blocks = prose_and_code(text)
        programs = "make" if "lab-notes/" in name else "gube|make"  # notes speak of commands as they were
        named = re.findall(rf"`((?:{programs}) [a-z][a-z-]*)", prose)
        named += [line for _, code in blocks for line in re.findall(r"^make [a-z-]+", code, re.MULTILINE)]
        missing += [f"{name}: {one}" for one in named if one not in known]
    assert missing == []


def test_each_command_has_a_section() -> None:
    sections = set(re.findall(r"^## (gube .+)$", PAGES["docs/commands.md"], re.MULTILINE))
    assert {f"gube {name.split()[0]}" for name in COMMANDS} - sections == set()


@pytest.mark.parametrize("heading", TABLES)
def test_each_key_of_a_scene_is_explained_where_it_is_declared_and_in_the_guide(heading: str) -> None:
    kind = TABLES[heading]
    guide, texts = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8"), attribute_texts(kind)
    row = re.compile(r"^\| `([^`]*)` \|.*\| (.*) \|$", re.MULTILINE)
    section = scene_keys().partition(f"## {heading}\n")[2].partition("\n## ")[0]
    assert {key for key, _ in row.findall(section)} == {one.metadata.get("key") or one.name for one in fields(kind)}
    for one in fields(kind):
        assert re.search(rf"`(\[\[)?(\w+\.)?{one.metadata.get('key') or one.name}\b", guide), one.name
    if texts:
        own = {one.name for one in fields(kind)}
        assert own & set(texts) and set(texts) <= own


def test_each_command_and_option_is_on_the_page_of_options() -> None:
    page = options_page()
    assert re.findall(r"^## gube (.*)$", page, re.MULTILINE) == list(COMMANDS)
    assert page.count("`--json FILE`") == len(COMMANDS)


def test_the_front_page_leads_to_pages_of_the_site() -> None:
    text = front_page("[a](docs/a.md#b) [c](examples) ![d](docs/d.png) [e](https://f)")
    assert text == "[a](a.md#b) [c](python.md#examples) ![d](d.png) [e](https://f)"


def test_sentences_are_understood_at_the_first_reading() -> None:
    """Of documents, docstrings and comments; tests/sentences.py lists the patterns."""
    folders = ("pbd", "assets", "wrinkles", "runtime", "precompute", "gube", "docs", "examples")
    codes = [ROOT / "setup.py", *(path for folder in folders for path in sorted((ROOT / folder).rglob("*.py")))]
    found = [
        f"{name} {one}" for name, text in PAGES.items() for part in paragraphs_of_page(text) for one in unclear(part)
    ]
    for path in codes:
        for part in paragraphs_of_code(path.read_text(encoding="utf-8")):
            found += [f"{path.relative_to(ROOT)} {one}" for one in unclear(part)]
    assert found == []


def test_unclear_sentences_are_found() -> None:
    page = (
        "What is not whole is tried\nagain.\n- Its speed hangs on it.\n| a number that is none |\n\n    what is it is\n"
    )
    assert [len(unclear(part)) for part in paragraphs_of_page(page)] == [1, 1, 1]
    code = '"""Told.\n\nArgs:\n    told: called.\n"""\nA = 1  # b, c and so on\n# what the\n'
    code += "# first finds is no less\nB = 'whatever'"
    assert [len(unclear(part)) for part in paragraphs_of_code(code)] == [1, 0, 0, 3, 0]
    clear = (
        "What is it that is needed? It says what was learned. What the file is and how it is read. It keeps what it"
        " has, and a wheel needs none. What to do. What each one bends by for a bend."
    )
    assert unclear(clear) == []


def glossary_words() -> set[str]:
    """Words that the glossary explains, one or several to an entry."""
    entries = re.findall(r"\*\*([^*]+)\*\*", PAGES["docs/glossary.md"])
    return {re.sub(r"^pairs ", "", word.strip()) for entry in entries for word in entry.split(",")}


def unexplained(text: str) -> list[str]:
    """Words of the glossary in a text, also in the plural; symbols of one letter are capitals."""
    patterns = {word: rf"\b{re.escape(word)}s?\b" for word in glossary_words()}
    flags = {word: 0 if len(word) == 1 else re.IGNORECASE for word in patterns}
    return sorted(word for word, pattern in patterns.items() if re.search(pattern, text, flags[word]))


def test_words_of_the_glossary_are_found() -> None:
    assert {"coarse", "truth", "layer", "hysteresis", "2HB", "C"} <= glossary_words()
    assert unexplained("Coarse cloth, two sub-\nsteps, Frames, refine, A. cutting") == ["A", "coarse", "frame"]


def test_the_first_lines_of_a_reader_need_no_glossary() -> None:
    """README up to its first picture and the text that stands for it; the answer on top of the table of choices."""
    front, picture, rest = PAGES["README.md"].partition("![")
    assert front.startswith("# gube\n") and front.count(".") >= 2
    assert unexplained(front + picture + rest.partition("]")[0]) == []
    answer = PAGES["docs/when-to-use.md"].partition("\n## Words of the table")[0]
    assert re.findall(r"^(\d)\.", answer, re.MULTILINE) == ["1", "2", "3", "4", "5"]
    before, _, after = answer.partition("**Plain cloth** (the simulated mesh is drawn")
    assert unexplained(before) == [] and unexplained(after) == ["plain cloth"]


def rows(page: str) -> Iterator[list[str]]:
    """Rows of the tables of a page, without heads."""
    for line in re.findall(r"^\| (.*) \|$", page, re.MULTILINE):
        yield line.split(" | ")


def test_the_table_of_choices_has_figures_of_the_notes_and_commands_that_print_them() -> None:
    notes = " ".join(text for name, text in PAGES.items() if "lab-notes/" in name)
    numbers = set(re.findall(r"\d[\d.,]*\d|\d", notes))
    for condition, _, measured, printed in list(rows(PAGES["docs/when-to-use.md"]))[1:]:
        found = re.findall(r"\d[\d.,]*\d|\d", measured)
        assert found and set(found) <= numbers, condition
        lines = re.findall(r"`(gube [^`]*)`", printed)
        assert lines and not any(refused(line) for line in lines), condition


def test_the_navigation_names_pages_that_there_are() -> None:
    pages = [page for _, some in NAV for page in some]
    assert [page for page in pages if page not in MADE and not (ROOT / "docs" / page).is_file()] == []
    assert len(set(pages)) == len(pages)


def test_the_page_of_fabrics_has_the_numbers_of_the_code() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert text.partition(BEGIN)[2].partition(END)[0].strip().endswith(numbers_table())
