"""The note that loops are compiled: when it holds and when not."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from emulator.compiled import build
from emulator.process.private_folder import private_folder
from emulator.transports.shim import cache_folder


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with one compiled function, and a cache of our own for the note."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "kept"
    folder.mkdir()
    (folder / "one.nbi").touch()
    return folder


def test_without_a_note_loops_are_not_built(kept: Path) -> None:
    assert not build.built()
    build.note_built({str(kept)})
    assert build.built()


def test_the_folder_of_the_note_is_one_in_which_the_preload_library_may_lie(kept: Path) -> None:
    before = os.umask(0o022)
    try:
        build.note_built({str(kept)})
    finally:
        os.umask(before)
    assert build.note_path().parent == cache_folder(os.environ)
    assert private_folder(cache_folder(os.environ), "") == build.note_path().parent


def test_a_compiled_file_that_has_gone_takes_the_note_with_it(kept: Path) -> None:
    build.note_built({str(kept)})
    (kept / "one.nbi").unlink()
    assert not build.built()


def test_where_nothing_was_kept_nothing_is_built(kept: Path) -> None:
    build.note_built(set())
    assert not build.built()


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"files": 3}', '{"files": [3]}', "\udcff"])
def test_a_note_of_anything_else_is_none(kept: Path, text: str) -> None:
    build.note_path().parent.mkdir(parents=True)
    build.note_path().write_bytes(text.encode(errors="surrogateescape"))
    assert not build.built()


def test_another_processor_or_another_version_of_a_loop_has_a_note_of_its_own(
    kept: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    build.note_built({str(kept)})
    with monkeypatch.context() as other:
        other.setattr(build, "_processor", lambda: "another one")
        assert not build.built()
    with monkeypatch.context() as other:
        (kept.parent / "loops.py").touch()
        other.setattr(build, "__file__", str(kept.parent / "build.py"))
        assert not build.built()
    assert build.built()


def test_a_place_that_may_not_be_written_to_has_no_note(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (kept.parent / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(kept.parent / "file"))
    build.note_built({str(kept)})
    assert not build.built()


def test_asking_does_not_import_numba() -> None:
    code = "import sys; from emulator.compiled import build; build.wanted(); print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "False\n", done.stderr
