"""Installs into the environment that runs it, with uv: as pip would from the same places, in a quarter of the time.

    .venv/bin/python .ci/install.py [uv pip install's arguments]

uv does not read how pip is set up on this machine, so `pip config list` is asked and said to uv. What uv has no word
for, and a uv that is missing or fails, ends with code 3: then pip itself has to do it. Modules are compiled when they
are imported: half a minute goes into what nothing imports.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys

WORDS = {"index-url": "--default-index", "extra-index-url": "--index", "find-links": "--find-links",
         "trusted-host": "--allow-insecure-host", "constraint": "--constraint"}  # fmt: skip
"Settings of pip that uv takes as words, one for each value."
VARIABLES = {"cert": ("SSL_CERT_FILE",), "client-cert": ("SSL_CLIENT_CERT",),
             "proxy": ("HTTP_PROXY", "HTTPS_PROXY"),
             "timeout": ("UV_HTTP_TIMEOUT",), "default-timeout": ("UV_HTTP_TIMEOUT",)}  # fmt: skip
"Those that uv takes from its environment."
SAME = {"disable-pip-version-check", "cache-dir", "no-cache-dir", "progress-bar", "quiet", "verbose", "no-color",
        "no-input", "root-user-action", "retries", "compile", "no-compile", "no-warn-script-location",
        "no-python-version-warning", "use-deprecated", "require-virtualenv", "require-venv"}  # fmt: skip
"Those that choose no package."
PIP_HAS_TO = 3


def settings(listed: str) -> dict[str, str]:
    """What `pip config list` printed, by the name of the option: the environment before `install` before `global`."""
    found: dict[str, tuple[int, str]] = {}
    for line in listed.splitlines():
        name, _, value = line.partition("=")
        section, _, key = name.rpartition(".")
        order = ("global", "install", ":env:")
        if section in order and order.index(section) >= found.get(key, (0, ""))[0]:
            found[key] = (order.index(section), str(ast.literal_eval(value)))
    return {key: value for key, (_, value) in found.items()}


def said(wanted: dict[str, str]) -> tuple[list[str], dict[str, str]] | None:
    """Words and environment for uv; None: something that uv has no word for."""
    words, environment = ["--index-strategy", "unsafe-best-match"], {}  # the best of all places, as with pip
    for key, value in wanted.items():
        if key in WORDS:
            words += [word for one in value.split() for word in (WORDS[key], one)]
        elif key in VARIABLES:
            environment |= dict.fromkeys(VARIABLES[key], value)
        elif key == "no-index" and value.lower() in ("1", "true", "yes", "on"):
            words.append("--no-index")
        elif key not in SAME | {"no-index"}:
            return None
    return words, environment


def main() -> int:
    listed = subprocess.run([sys.executable, "-m", "pip", "config", "list"], capture_output=True, text=True, check=True)
    like_pip = said(settings(listed.stdout))
    uv = os.path.join(sys.prefix, "bin", "uv")
    if like_pip is None or not os.path.exists(uv):
        return PIP_HAS_TO
    words, environment = like_pip
    command = [uv, "pip", "install", "--quiet", "--no-config", "--python", sys.executable, *words, *sys.argv[1:]]
    done = subprocess.run(command, env=os.environ | environment, check=False)
    return PIP_HAS_TO if done.returncode else 0


if __name__ == "__main__":
    sys.exit(main())
