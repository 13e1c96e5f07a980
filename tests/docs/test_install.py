"""How the test command says to uv what pip is told on this machine."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture
def install() -> ModuleType:
    spec = importlib.util.spec_from_file_location("install", Path(__file__).resolve().parents[2] / ".ci/install.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


LISTED = """\
:env:.default-timeout='180'
:env:.find-links='/opt/wheels'
global.cert='/etc/ssl/all.crt'
global.extra-index-url='file:///a/simple file:///b/simple'
global.find-links='/other'
install.find-links='/never'
freeze.timeout='1'
"""


def test_the_environment_comes_before_the_command_and_that_before_the_rest(install: ModuleType) -> None:
    found = install.settings(LISTED)
    assert found["find-links"] == "/opt/wheels"
    assert install.settings(LISTED.replace(":env:.find-links", ":env:.retries"))["find-links"] == "/never"
    assert "timeout" not in found


def test_every_place_is_said_and_the_best_of_all_is_taken(install: ModuleType) -> None:
    words, environment = install.said(install.settings(LISTED))
    assert words[:2] == ["--index-strategy", "unsafe-best-match"]
    pairs = set(zip(words[::2], words[1::2], strict=True))
    assert {("--index", "file:///a/simple"), ("--index", "file:///b/simple"), ("--find-links", "/opt/wheels")} < pairs
    assert environment == {"SSL_CERT_FILE": "/etc/ssl/all.crt", "UV_HTTP_TIMEOUT": "180"}


@pytest.mark.parametrize(("said", "word"), [("true", True), ("1", True), ("false", False), ("0", False)])
def test_without_an_index_where_pip_has_none(install: ModuleType, said: str, word: bool) -> None:
    words, _ = install.said({"no-index": said})
    assert ("--no-index" in words) is word


def test_what_uv_has_no_word_for_is_left_to_pip(
    install: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert install.said({"prefer-binary": "1"}) is None
    assert install.said({"no-binary": ":all:"}) is None
    monkeypatch.setattr(install, "settings", lambda listed: {"no-binary": ":all:"})
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    assert install.main() == install.PIP_HAS_TO


@pytest.mark.parametrize(("code", "told"), [(0, 0), (2, 3)])
def test_a_uv_that_is_missing_or_fails_leaves_it_to_pip(
    install: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, code: int, told: int
) -> None:
    monkeypatch.setattr(install, "settings", lambda listed: {"index-url": "file:///c"})
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["install.py", "--no-deps", "x==1"])
    assert install.main() == install.PIP_HAS_TO
    uv = tmp_path / "bin/uv"
    uv.parent.mkdir()
    uv.write_text(f'#!/bin/sh\necho "$@" >"{tmp_path}/said"\nexit {code}\n', encoding="utf-8")
    uv.chmod(0o755)
    assert install.main() == told
    said = (tmp_path / "said").read_text(encoding="utf-8").split()
    assert said[:2] == ["pip", "install"]
    assert said[-2:] == ["--no-deps", "x==1"]
    assert "--default-index file:///c" in " ".join(said)
