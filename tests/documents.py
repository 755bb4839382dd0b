"""Reads the documents: their prose, their code, and the commands in it."""

from __future__ import annotations

from collections.abc import Iterator

__all__ = ["commands", "prose_and_code"]


def prose_and_code(text: str) -> tuple[str, list[tuple[str, str]]]:
    """A page without its code blocks, and the blocks with their language."""
    blocks, prose, lines = [], [], text.split("\n")
    while lines:
        line = lines.pop(0)
        if line.startswith("```"):
            end = next((place for place, other in enumerate(lines) if other.startswith("```")), len(lines))
            blocks.append((line.strip("`"), "\n".join(lines[:end])))
            lines = lines[end + 1 :]
        elif line.startswith("    ") and not line.lstrip().startswith(("-", "|", "*")):
            block = [line[4:]]
            while lines and (lines[0].startswith("    ") or not lines[0].strip()):
                block.append(lines.pop(0)[4:])
            blocks.append(("", "\n".join(block).strip("\n")))
        else:
            prose.append(line)
    return "\n".join(prose), blocks


def commands(code: str) -> Iterator[str]:
    """Lines of a block that run `gube`, joined where they go on in the next line."""
    for line in code.replace("\\\n", " ").split("\n"):
        words = line.partition("  #")[0].strip()
        if words.startswith("gube ") and "COMMAND" not in words:
            yield words
