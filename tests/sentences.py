"""Sentences of documents, docstrings and comments, and patterns of those that are not understood at once."""

from __future__ import annotations

import re
from collections.abc import Iterator

from tests.documents import prose_and_code

__all__ = ["UNCLEAR", "paragraphs_of_code", "paragraphs_of_page", "unclear"]

# A clause "what VERB ... VERB", whose second verb is that of the sentence: "what is read stays". The words between
# begin no clause of their own, and no word before the second verb makes a noun or an infinitive of it.
_PLAIN_WORD = (
    r"(?!(?:that|which|who|whose|where|how|while|when|if|because|as|than|and|or|until|to|what|besides)\b)[^\s,;.:?|]+ "
)
_INNER_VERB = (
    r"(?:is|are|was|were|has|have|had|does|do|did|must|may|can|cannot|will|shall|would|goes|go|comes?|came|stays?|"
    r"lies|lie|stands?|hangs?|gives?|gets?|takes?|counts?|moves?|needs?|finds?|found|bends?|tells?|makes?|shows?|"
    r"follows?|becomes?|remains?|keeps?|holds?|says?|said|adds?|ends?|begins?|starts?|bears?|asks?|reads?|costs?|acts?|"
    r"leaves?|sees?|knows?|wants?)"
)
_MAIN_VERB = (
    r"(?<!\ba )(?<!\ban )(?<!\bthe )(?<!\bnot )(?:is|are|was|were|has|have|had|does|did|must|may|can|cannot|will|would|"
    r"goes|comes|came|stays?|lies|stands|hangs|gives|gets|takes|counts|moves?|needs?|finds|bends?|makes|shows|follows|"
    r"becomes|remains|keeps|holds|adds|ends|begins|starts|tells|costs|acts)"
)
UNCLEAR = {
    '"what ..." as the subject; name the thing': re.compile(
        rf"\bwhat (?:{_PLAIN_WORD})*?{_INNER_VERB} (?:{_PLAIN_WORD})*?{_MAIN_VERB}\b(?![^.;:|]*\?)", re.IGNORECASE
    ),
    '"hang on"; depend on, hang from, be a child of': re.compile(r"\b(?:hangs?|hanging|hung) on\b", re.IGNORECASE),
    '"told"; distinguished, reported, named': re.compile(r"\btold\b(?!:)", re.IGNORECASE),
    '"whatever"; for any, independent of': re.compile(r"\bwhatever\b", re.IGNORECASE),
    '"and so on"; say where it ends': re.compile(r"\band so on\b", re.IGNORECASE),
    '"that is none"; say what it is not': re.compile(r"\bthat (?:is|are|has|have) none\b"),
    '"no less", "go any way"; say it without a negative': re.compile(
        r"\bno less\b|\bgo(?:es)? any way\b", re.IGNORECASE
    ),
}
"""Each kind with its cure."""


def unclear(paragraph: str) -> list[str]:
    """Kinds of sentences in a paragraph that are not understood at the first reading, each with the words."""
    text = " ".join(paragraph.split())
    return [f"{found[0]!r}: {kind}" for kind, pattern in UNCLEAR.items() for found in pattern.finditer(text)]


def paragraphs_of_page(page: str) -> Iterator[str]:
    """Paragraphs, rows of tables, and items of lists of a page without its code blocks."""
    yield from re.split(r"\n(?=\n|\s*- |\||#|\d+\. )", prose_and_code(page)[0])


def paragraphs_of_code(source: str) -> Iterator[str]:
    """Paragraphs of docstrings, also of those below a constant, and comments; one of several lines is one paragraph."""
    for text in re.findall(r'"""(.*?)"""', source, re.DOTALL):
        yield from re.split(r"\n\s*\n|\n(?=\s*[\w, `]+: )", text)
    block: list[str] = []
    for line in source.split("\n"):
        code, mark, text = line.rpartition("# ")
        alone = mark != "" and not code.strip()
        if block and not alone:
            yield " ".join(block)
            block = []
        if alone or (mark and code.endswith("  ")):
            block.append(text)
    yield " ".join(block)
