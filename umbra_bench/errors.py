"""Errors that end a command with one clear line and exit code 2."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class UmbraBenchError(Exception):
    """Something that the user can mend: bad input, a missing file, an engine that cannot do it."""


class ScenarioError(UmbraBenchError):
    """A scenario file that is wrong: the message names file, key, value and what is allowed."""


class UnsupportedScenario(UmbraBenchError):
    """A method that cannot run a scenario, with the reason; a study records it as a skip."""


class EngineFailed(UmbraBenchError):
    """An engine in another process that died, was silent or answered nonsense: a result, too."""


MOST_WORDS = 40
"""Of how many known words a message tells at most."""

LONGEST_WORD = 100
"""Longer words are nobody's slip of the pen, and comparing them takes the square of their length."""


def hint(word: object, known: Iterable[str], label: str = "allowed") -> str:
    """Return the end of a message: the known word nearest to `word`, if any, and all of them."""
    words = [text for text in known if len(text) <= LONGEST_WORD]
    close = difflib.get_close_matches(str(word)[:LONGEST_WORD], words, n=1, cutoff=0.6)
    suggestion = f"; did you mean {close[0]!r}? {label.capitalize()}" if close else f"; {label}"
    more = f" and {len(words) - MOST_WORDS} more" if len(words) > MOST_WORDS else ""
    return f"{suggestion}: {', '.join(words[:MOST_WORDS])}{more}"


def one_line(text: str, length: int = 1000) -> str:
    """Return `text` as one printable line of at most `length` characters, whatever was in it."""
    text = " ".join(text[: 4 * length].split())
    text = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text[:length])
    return text if len(text) < length else text[: length - 3] + "..."


def short(value: object, length: int = 60) -> str:
    """Return `value` as one printable line of at most `length` characters."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # a number of thousands of digits, a table a mile deep
        return f"<a {type(value).__name__} too large to print>"
    return text if len(text) <= length else text[: length - 3] + "..."
