"""Words of an order, `NAME=VALUE`, as a user types them on the command line or on the live page.

Belongs here: words to tables. Not: what a daemon makes of them (orders).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click

from emulator.config.budgets import TooMuch, loads_json


def parameters_of(texts: Sequence[str]) -> dict[str, Any]:
    """`fog.visibility_m=50` and the like as tables; the daemon judges names and values."""
    params: dict[str, Any] = {}
    for text in texts:
        name, separator, value = text.partition("=")
        parts = name.split(".")
        if not separator or not all(parts):
            raise click.BadParameter(f"{text!r}; want NAME=VALUE", param_hint="NAME=VALUE")
        here = params
        for part in parts[:-1]:
            here = here.setdefault(part, {})
            if not isinstance(here, dict):
                raise click.BadParameter(f"{text!r} is below a key that already has a value", param_hint="NAME=VALUE")
        if parts[-1] in here:
            raise click.BadParameter(f"{text!r}; {name} was already given", param_hint="NAME=VALUE")
        try:
            here[parts[-1]] = loads_json(value)
        except TooMuch as error:
            raise click.BadParameter(f"{name}: {error}", param_hint="NAME=VALUE") from None
        except ValueError:
            here[parts[-1]] = value
    return params
