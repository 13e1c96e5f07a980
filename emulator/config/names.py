"""What is allowed instead of a name that nobody knows, for messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

MOST_NAMES = 12
"A message lists so many names whole, of more only the similar ones."


def nearest(name: object, known: Iterable[str]) -> str:
    """What is allowed instead of an unknown name, the most similar first."""
    names = list(dict.fromkeys(known))
    if not names:
        return "none: the list is empty"
    near = difflib.get_close_matches(str(name), names, n=1)
    hint = f"{near[0]} or " if near and len(names) > 1 else ""
    if len(names) <= MOST_NAMES:
        return f"{hint}one of {', '.join(names)}"
    similar = difflib.get_close_matches(str(name), names, n=5, cutoff=0.3) or names[:5]
    return f"{', '.join(similar)} or another of the {len(names)} known names"
