"""The one error that bad input raises, anywhere in the project."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

__all__ = ["InputError"]


class InputError(ValueError):
    """Input that cannot be used. Names the file, the key, the value received and what is expected.

    Args:
        problem: the fault, in one sentence without a full stop.
        file: path of the file that holds the value, if any.
        key: key, element or argument inside it, if any.
        received: the value received; printed with ``repr``.
        expected: input that is accepted, in words.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: Any = None,
        key: str | None = None,
        received: Any = None,
        expected: str | None = None,
    ) -> None:
        self.problem, self.file, self.key = problem, file, key
        self.received, self.expected = received, expected
        place = ": ".join(str(part) for part in (file, key) if part is not None)
        detail = []
        if received is not None:
            detail.append(f"received {received!r}")
        if expected is not None:
            detail.append(f"expected {expected}")
        text = f"{place}: {problem}" if place else problem
        super().__init__(f"{text} ({', '.join(detail)})" if detail else text)

    def in_file(self, file: Any) -> InputError:
        """The same error about a file that the code which found it did not know."""
        return InputError(self.problem, file=file, key=self.key, received=self.received, expected=self.expected)

    @classmethod
    def join(cls, errors: Sequence[InputError]) -> InputError:
        """One error that reports several at once, a line each."""
        if len(errors) == 1:
            return errors[0]
        return cls(f"{len(errors)} problems:\n" + "\n".join(f"  {error}" for error in errors))
