"""The preload shim under a C program that does what the drivers do, on our pseudo-terminal."""

from __future__ import annotations

import os
import select
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from emulator.errors import EmulatorError
from emulator.transports import shim
from emulator.transports.pseudo_terminal import PseudoTerminal
from emulator.transports.schemes import open_link
from emulator.transports.shim import build_shim, cache_folder, find_compiler, shim_environment
from emulator.transports.tty_modes import read_lines

HERE = Path(__file__).parent
COMPILER = find_compiler(os.environ)

needs_compiler = pytest.mark.skipif(COMPILER is None, reason="no C compiler here (looked for cc, gcc, clang)")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, str]]:
    """The driver's program, and an environment with the shim, built in a cache of its own."""
    folder = tmp_path_factory.mktemp("shim")
    program = folder / "custom_speed"
    source = HERE / "data" / "custom_speed.c"
    flags = ["-O2", "-D_FORTIFY_SOURCE=2", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([str(COMPILER), *flags, "-o", program, source, "-lpthread"], check=True, timeout=60)
    environment = shim_environment({**os.environ, "XDG_CACHE_HOME": str(folder / "cache")})
    return program, environment


class Driver:
    """The driver's program on a link of ours."""

    def __init__(self, program: Path, environment: dict[str, str], folder: Path) -> None:
        link = open_link(f"pty:{folder / 'front'}")
        assert isinstance(link, PseudoTerminal)
        self.link = link
        self.link.set_speed(9600)
        self.process = subprocess.Popen(
            [str(program), str(folder / "front")],
            env=environment,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )

    def do(self, command: str) -> str:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        return self.process.stdout.readline().strip()

    def speed(self) -> int:
        return self.link.host_modes().sends_baud

    def close(self) -> str:
        _, errors = self.process.communicate(timeout=10)
        self.link.close()
        return errors


@pytest.fixture
def driver(built: tuple[Path, dict[str, str]], tmp_path: Path) -> Iterator[Driver]:
    driver = Driver(*built, tmp_path)
    yield driver
    driver.close()


@needs_compiler
@pytest.mark.parametrize("way", ["sicktoolbox 500000", "player 500000", "computed 500000", "ioctl 500000"])
def test_every_known_way_to_500000_gets_there_and_back(driver: Driver, way: str) -> None:
    assert driver.do("sicktoolbox 9600") == "ok"
    assert driver.speed() == 9600
    assert driver.do(way) == "ok"
    assert driver.speed() == 500_000
    assert driver.do("sicktoolbox 38400") == "ok"
    assert driver.speed() == 38_400
    assert driver.do(way) == "ok"
    assert driver.speed() == 500_000
    assert driver.do("sicktoolbox 9600") == "ok"
    assert driver.speed() == 9600


@needs_compiler
def test_a_telegram_passes_at_500000_and_the_strict_rule_stays_on(driver: Driver) -> None:
    driver.link.set_speed(500_000)
    driver.do("sicktoolbox 38400")
    driver.do("telegram")
    (garbage,) = driver.link.receive(0)
    assert set(garbage.data) == {0}  # to a receiver 13 times as fast every low bit is a break
    driver.do("sicktoolbox 500000")
    driver.do("telegram")
    assert driver.link.receive(0)[0].data == bytes.fromhex("02000100311512")  # status request, sicktoolbox's bytes


@needs_compiler
def test_what_the_driver_reads_back_is_what_it_set(driver: Driver) -> None:
    driver.do("sicktoolbox 500000")
    assert driver.do("read back") == "speed B38400 flags 0x30 divisor 48 base 24000000 ok"
    driver.do("sicktoolbox 38400")
    assert driver.do("read back") == "speed B38400 flags 0 divisor 0 base 24000000 ok"


@needs_compiler
def test_a_cleared_flag_turns_the_speed_back_by_itself(driver: Driver) -> None:
    driver.do("sicktoolbox 500000")
    assert driver.do("clear") == "ok"
    assert driver.speed() == 38_400


@needs_compiler
def test_other_speeds_pass_untouched_while_the_flag_is_set(driver: Driver) -> None:
    driver.do("sicktoolbox 500000")
    assert driver.do("ioctl 9600") == "ok"
    assert driver.speed() == 9600
    assert driver.do("native 500000") == "ok"
    assert driver.speed() == 500_000


@needs_compiler
def test_the_other_special_speeds_of_setserial_work_too(driver: Driver) -> None:
    assert driver.do("vhi") == "ok"
    assert driver.speed() == 115_200


@needs_compiler
@pytest.mark.parametrize("speed", [500_000, 38_400, 123_457])
def test_a_speed_set_without_asking_for_the_settings_first_is_that_speed(driver: Driver, speed: int) -> None:
    assert driver.do(f"blind {speed}") == "ok"
    assert driver.speed() == speed


@needs_compiler
def test_38400_as_a_number_is_special_too_while_the_flag_is_set(driver: Driver) -> None:
    driver.do("sicktoolbox 500000")
    assert driver.do("blind 38400") == "ok"
    assert driver.speed() == 500_000


@needs_compiler
def test_modem_lines_are_up_and_the_driver_s_to_change(driver: Driver) -> None:
    assert driver.do("get lines") == "DTR RTS device ok"
    assert driver.do("lines down dtr") == "ok"
    assert driver.do("get lines") == "RTS device ok"
    assert driver.do("lines set dtr") == "ok"
    assert driver.do("get lines") == "DTR device ok"
    assert driver.do("lines up rts") == "ok"
    assert driver.do("get lines") == "DTR RTS device ok"
    assert driver.do("count") == "ok"


def lines_reported(driver: Driver) -> list[tuple[bool, bool] | None]:
    return [received.lines for received in driver.link.receive(0)]


@needs_compiler
def test_the_device_is_told_of_dtr_and_rts(driver: Driver) -> None:
    assert lines_reported(driver) == []
    driver.do("lines down dtr")
    assert select.select(driver.link.filenos(), [], [], 5)[0]  # it is woken, though no byte has come
    assert lines_reported(driver) == [(False, True)]
    assert lines_reported(driver) == []
    driver.do("sicktoolbox 9600")  # tcgetattr, tcsetattr
    driver.do("blind 38400")  # settings made from nothing
    assert lines_reported(driver) == []
    driver.do("lines up dtr")
    driver.do("lines down rts")
    assert lines_reported(driver) == [(True, False)]
    driver.do("blind 9600")  # the device's own speed
    driver.do("telegram")
    driver.do("lines up rts")
    assert [(one.lines, len(one.data)) for one in driver.link.receive(0)] == [((True, True), 0), (None, 7)]
    driver.process.communicate(timeout=10)
    assert lines_reported(driver) == [(False, False)]
    assert read_lines(driver.link._master) is None


@needs_compiler
def test_without_the_shim_modem_lines_fail_as_on_any_pseudo_terminal(
    built: tuple[Path, dict[str, str]], tmp_path: Path
) -> None:
    driver = Driver(built[0], dict(os.environ), tmp_path)
    assert driver.do("get lines") == "failed Inappropriate ioctl for device"
    driver.close()


@needs_compiler
def test_threads_do_not_trip_over_each_other(driver: Driver) -> None:
    assert driver.do("threads") == "ok"
    assert driver.speed() == 500_000


@needs_compiler
def test_what_is_no_pseudo_terminal_is_left_to_the_kernel(driver: Driver) -> None:
    assert driver.do("plain file") == "ok"


@needs_compiler
def test_it_says_loudly_that_it_is_there(built: tuple[Path, dict[str, str]], tmp_path: Path) -> None:
    errors = Driver(*built, tmp_path).close()
    assert errors.startswith("lidaremu shim: ACTIVE in process ")
    assert "custom_speed" in errors
    assert errors.count("\n") == 1


@needs_compiler
def test_of_a_script_the_first_program_says_it_and_others_when_they_need_it(
    built: tuple[Path, dict[str, str]], tmp_path: Path
) -> None:
    """`roslaunch` starts a dozen programs before the driver, a shell script one for each of its lines."""
    link = open_link(f"pty:{tmp_path / 'front'}")
    script = (
        f"ls / >/dev/null; cat /dev/null; echo 'sicktoolbox 500000' | {built[0]} {tmp_path / 'front'}; ls / >/dev/null"
    )
    done = subprocess.run(
        ["/bin/sh", "-c", script], env=built[1], capture_output=True, text=True, timeout=30, check=True
    )
    link.close()
    assert done.stdout.strip() == "ok"
    first, driver = done.stderr.splitlines()
    assert "ACTIVE in process " in first
    assert "(sh): " in first
    assert "(custom_speed): " in driver
    assert shim.SAID not in shim_environment({**os.environ, shim.SAID: "1"})


@needs_compiler
def test_a_port_that_has_the_number_of_standard_error_gets_none_of_it(
    built: tuple[Path, dict[str, str]], tmp_path: Path
) -> None:
    link = open_link(f"pty:{tmp_path / 'front'}")
    script = f"echo 'sicktoolbox 500000' | {built[0]} {tmp_path / 'front'} 2>&-"
    subprocess.run(["/bin/sh", "-c", script], env=built[1], capture_output=True, timeout=30, check=True)
    assert b"".join(one.data for one in link.receive(0)) == b""
    link.close()


@needs_compiler
def test_without_the_shim_the_same_driver_fails(built: tuple[Path, dict[str, str]], tmp_path: Path) -> None:
    driver = Driver(built[0], dict(os.environ), tmp_path)
    assert driver.do("sicktoolbox 500000") == "failed Inappropriate ioctl for device"
    assert driver.do("native 500000") == "ok"
    assert driver.speed() == 500_000
    assert driver.close() == ""


@needs_compiler
def test_it_is_built_once_and_stands_before_what_is_preloaded_already(tmp_path: Path) -> None:
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "LD_PRELOAD": "/lib/other.so"}
    library = build_shim(environment)
    first = library.stat().st_mtime_ns
    assert build_shim(environment).stat().st_mtime_ns == first
    assert shim_environment(environment)["LD_PRELOAD"] == f"{library}:/lib/other.so"
    assert os.listdir(tmp_path / "lidaremu") == [library.name]


@needs_compiler
def test_the_source_compiles_without_a_warning(tmp_path: Path) -> None:
    command = [str(COMPILER), *shim.FLAGS, "-Werror", "-Wshadow", "-Wconversion", "-D_FORTIFY_SOURCE=3"]
    done = subprocess.run(
        [*command, "-o", tmp_path / "s.so", *shim.SOURCES], capture_output=True, text=True, check=False
    )
    assert done.stderr == ""


def test_without_a_compiler_it_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(EmulatorError, match=r"none found \(looked for cc, gcc, clang\): install gcc or set CC"):
        build_shim({"PATH": str(tmp_path)})
    with pytest.raises(EmulatorError, match="looked for no-such-compiler"):
        build_shim({"PATH": os.environ["PATH"], "CC": "no-such-compiler"})


def test_a_compiler_that_fails_is_quoted(tmp_path: Path) -> None:
    compiler = tmp_path / "cc"
    compiler.write_text("#!/bin/sh\necho 'no headers here' >&2\nexit 1\n")
    compiler.chmod(0o755)
    environment = {"PATH": f"{tmp_path}:{os.environ['PATH']}", "XDG_CACHE_HOME": str(tmp_path / "cache")}
    with pytest.raises(EmulatorError, match=r"does not compile with .*: no headers here"):
        build_shim(environment)
    assert os.listdir(tmp_path / "cache" / "lidaremu") == []


@pytest.mark.skipif(shutil.which("cc") is None, reason="no cc on this machine")
def test_a_cache_that_cannot_be_preloaded_from_or_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(EmulatorError, match="no path with spaces or colons"):
        build_shim({"PATH": os.environ["PATH"], "XDG_CACHE_HOME": str(tmp_path / "with space")})
    (tmp_path / "file").write_text("")
    with pytest.raises(EmulatorError, match=r"cannot be made: .*set XDG_CACHE_HOME"):
        build_shim({"PATH": os.environ["PATH"], "XDG_CACHE_HOME": str(tmp_path / "file")})


def test_the_cache_is_the_user_s_own() -> None:
    assert cache_folder({}) == Path.home() / ".cache" / "lidaremu"
    assert cache_folder({"XDG_CACHE_HOME": "relative"}) == Path.home() / ".cache" / "lidaremu"
    assert cache_folder({"XDG_CACHE_HOME": "/var/cache/me"}) == Path("/var/cache/me/lidaremu")
