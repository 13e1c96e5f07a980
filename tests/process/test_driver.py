"""A driver that is ended takes what it has started with it."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from emulator.errors import EmulatorError
from emulator.process.driver import end_driver, family_of, start_driver

NESTED = "import subprocess, sys; subprocess.run(['sh', '-c', sys.argv[1]])"
ENDLESS = "echo up; read nothing; sleep 1000"


def nested(shell: str) -> subprocess.Popen[bytes]:
    """A Python that runs a shell that waits on its standard input, both up."""
    driver = subprocess.Popen(
        [sys.executable, "-c", NESTED, shell], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=dict(os.environ)
    )
    assert driver.stdout is not None
    assert driver.stdout.readline() == b"up\n"
    return driver


@pytest.mark.parametrize("shell", [ENDLESS, 'trap "" TERM; ' + ENDLESS])
def test_children_of_a_driver_end_with_it_willing_or_not(shell: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("emulator.process.driver.TIME_LIMIT_S", 0.2)
    driver = nested(shell)
    family = list(family_of(driver.pid))
    assert len(family) >= 2
    assert end_driver(driver) == 0
    assert driver.stdout is not None
    assert driver.stdout.read() == b""  # nobody holds its other end any more
    for pipe in (driver.stdin, driver.stdout):
        if pipe is not None:
            pipe.close()
    assert list(family_of(driver.pid)) == []


def test_a_driver_that_has_ended_gives_its_code_and_one_that_is_not_there_is_told() -> None:
    driver = start_driver(["sh", "-c", "exit 3"], dict(os.environ), False)
    driver.wait()
    assert end_driver(driver) == 3
    with pytest.raises(EmulatorError, match=r"cannot start \./nowhere: No such file"):
        start_driver(["./nowhere"], dict(os.environ), False)
