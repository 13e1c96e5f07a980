"""Whether compiled loops are used, and what happens where they cannot be."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from emulator.casting import embree
from emulator.casting.raycast import Caster
from emulator.casting.structures import Content
from emulator.compiled import switch
from emulator.world import triangles
from tests.casting.test_raycast import WALL, fan, scene_of

pytest.importorskip("numba")


@pytest.fixture(autouse=True)
def _looked_again() -> Iterator[None]:
    switch._loops.cache_clear()
    yield
    switch._loops.cache_clear()  # what a test pretended is not found by the next one


def reported(**environment: str) -> str:
    """Whether a process of its own uses them."""
    code = "from emulator.compiled.switch import kernels; print(kernels() is not None)"
    env = {**os.environ, **environment}
    return subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True).stdout


def test_the_environment_leaves_them_out() -> None:
    assert reported(LIDAREMU_COMPILED="0") == "False\n"
    assert reported(LIDAREMU_COMPILED="1") == "True\n"


def test_without_numba_arrays_do_it(monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "numba" else real(name))
    with switch.switched(True):
        assert switch.kernels() is None
        assert "lidaremu[fast]" in switch.why()[1]
        assert met() == 721


def test_without_the_library_of_embree_its_own_rays_are_cast(monkeypatch: pytest.MonkeyPatch) -> None:
    with switch.switched(True):
        loops = switch.kernels()
        assert loops is not None
        monkeypatch.setattr(loops, "library", lambda: None)
        shape = triangles.box(1.0, 1.0, 1.0)
        made = embree.structure(Content(shape.vertices.astype(np.float32), shape.faces.astype(np.int32)))
        assert not embree.in_packets([made])
        assert met() == 721


def test_a_numba_that_does_not_go_with_this_numpy_is_told_and_arrays_do_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = "Numba needs NumPy 2.4 or less. Got NumPy 9.9."

    def refuse(name: str) -> object:
        raise ImportError(wrong)

    monkeypatch.setattr(importlib, "import_module", refuse)
    with switch.switched(True):
        assert met() == 721
        assert switch.why() == (False, wrong)
    assert capsys.readouterr().err == f"lidaremu: loops are not compiled: {wrong}\n"


def test_a_folder_that_may_not_be_written_to_costs_the_compiled_code_its_place() -> None:
    """Each process compiles then; one function stands for all."""
    code = (
        "from numba.core import caching\n"
        "caching.CacheImpl._locator_classes = []\n"
        "from emulator.compiled import arithmetic, jit\n"
        "print(jit.compiled(jit.INT)(lambda k: k + 1)(2))\n"
    )
    env = {**os.environ, "LIDAREMU_COMPILED": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=False)
    assert done.stdout == "3\n", done.stderr


def test_a_change_of_one_file_has_all_of_them_compiled_anew(tmp_path: Path) -> None:
    """A function that calls one of another file has the old one in it."""
    from emulator.compiled.jit import forget_older

    kept = tmp_path / "__pycache__"
    kept.mkdir()
    for name, seconds in (("one.py", 100), ("other.py", 300), ("__pycache__/a.nbi", 200), ("__pycache__/b.nbi", 300)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (seconds, seconds))
    forget_older(tmp_path)
    assert [path.name for path in kept.iterdir()] == ["b.nbi"]
    forget_older(tmp_path / "nowhere")


def test_the_compiler_is_told_of_once_when_it_runs_and_never_when_loops_come_from_the_disk() -> None:
    """On a busy machine the import alone takes as long as a compiler."""
    code = (
        "import sys\n"
        "from emulator.compiled import jit\n"
        "tell = lambda text: print(text, end='')\n"
        "with jit.reported_once(tell, 'loaded '):\n"
        "    from emulator.compiled import arithmetic, clusters\n"
        "with jit.reported_once(tell, 'compiled '):\n"
        "    jit.compiled(jit.INT)(eval('lambda k: k + 1'))\n"
        "    jit.compiled(jit.FLOAT)(eval('lambda k: k + 2'))\n"
    )
    with switch.switched(True):
        assert switch.kernels() is not None  # built by now
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "compiled ", done.stderr


def test_what_loops_alone_call_is_refused_to_python_compiled_or_not() -> None:
    """No way in from Python is compiled for it: numba would jump to address 0."""
    from emulator.compiled import jit

    inner = jit.compiled()(eval("lambda k: k + 1"))
    with pytest.raises(TypeError, match="compiled loops alone call"):
        inner(2)
    assert jit.compiled(jit.INT)(eval("lambda k: inner(k)", {"inner": inner}))(2) == 3
    with pytest.raises(TypeError, match="compiled loops alone call"):
        inner(2)
    assert inner.py_func(2) == 3


def test_doctor_is_told_why() -> None:
    with switch.switched(True):
        assert switch.why()[0]
        assert "packets of" in switch.why()[1]
    with switch.switched(False):
        assert switch.why() == (False, "LIDAREMU_COMPILED=0 switches them off")


def test_what_was_built_with_them_serves_without() -> None:
    with switch.switched(True):
        caster = Caster(scene_of((triangles.plane(60.0, 60.0), WALL)))
    with switch.switched(False):
        hits = caster.first_hits(np.zeros(3), fan(721, 20.0), 0.0)
    assert np.isfinite(hits.range_m).all()


def met() -> int:
    """Rays that meet a wall before them."""
    caster = Caster(scene_of((triangles.plane(60.0, 60.0), WALL)))
    return int(np.count_nonzero(np.isfinite(caster.first_hits(np.zeros(3), fan(721, 20.0), 0.0).range_m)))
