"""The table of lines counts every line once, by its kind, and the page shows it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from protocols import FAMILIES, lines


@pytest.fixture(scope="module", autouse=True)
def _counted_once() -> Iterator[None]:
    """Most tests ask for the table of the same files."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("lines_of", "code_of"):
            patch.setattr(lines, name, cache(getattr(lines, name)))
        yield


def test_the_page_is_what_the_command_writes() -> None:
    page = lines.PAGE.read_text(encoding="utf-8")
    assert page == lines.written(page), "write it anew: python -m protocols.lines --page"


def test_every_module_of_a_shipped_family_has_its_kind() -> None:
    assert set(lines.KINDS) == set(FAMILIES)
    for family, kinds in lines.KINDS.items():
        said = " ".join(kinds.values()).split()
        assert sorted(said) == sorted(path.stem for path in (lines.HERE / family).glob("*.py"))
        assert set(kinds) <= set(lines.COLUMNS)


@pytest.mark.parametrize("path", [*lines.shipped(), *lines.EXAMPLES.glob("acme_[ls]*.py")], ids=lambda path: path.stem)
def test_every_line_is_counted_once(path: Path) -> None:
    files = path.glob("*.py") if path.is_dir() else [path]
    assert lines.lines_of(path).total() == sum(len(one.read_text(encoding="utf-8").splitlines()) for one in files)


def test_the_examples_are_as_short_as_new_families_are_to_be() -> None:
    for path in lines.EXAMPLES.glob("acme_[ls]*.py"):
        assert lines.lines_of(path).total() <= 250


@pytest.mark.parametrize("family", ["scip", "rplidar", "ldrobot", "ydlidar"])
def test_desk_scanners_have_at_most_500_lines_of_code_beside_their_tables(family: str) -> None:
    assert 100 < lines.code_of(lines.HERE / family) <= 500


def test_the_statements_of_a_single_module_tell_its_kinds(tmp_path: Path) -> None:
    path = tmp_path / "one.py"
    path.write_text(
        '"""Head."""\n'  # other
        "import x\n"  # other
        "\n"
        "# why\n"
        "BAUD = 9600\n"  # settings, three lines
        'PACKET = np.dtype("u1")\n'  # codec
        "def encode_scan(a):\n    return a\n"  # codec
        "class Find(FrameSplitter):\n    pass\n"  # codec
        "class One(RequestSession):\n"
        "    def _go(self):\n        return 1\n"  # commands, with the head of the class
        "    def _reply(self):\n        return 2\n"  # codec
        "    def other(self):\n        return 3\n"  # session
        '    COMMANDS = {1: Command("x", _go)}\n'  # commands
        "def build(keys: DeviceKeys):\n    return One()\n"  # settings
        "FAMILY = SimpleFamily()\n"  # other
    )
    found = lines.lines_of(path)
    assert found == {"other": 3, "settings": 5, "codec": 7, "commands": 4, "session": 2}
    assert lines.code_of(path) == 1 + 1 + 2 + 2 + 2 + 2 + 1, "import, dtype, encode_, Find, _reply, other, FAMILY"


def test_a_path_that_is_no_family_is_refused_in_a_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    (tmp_path / "no.py").write_text("def (")
    assert lines.main([str(tmp_path / "none.py")]) == 2
    assert lines.main([str(tmp_path / "no.py")]) == 2
    assert capsys.readouterr().err.count("; want the file or folder of a family\n") == 2
    assert lines.main([str(lines.EXAMPLES / "acme_spin.py")]) == 0
    assert "| acme_spin |" in capsys.readouterr().out


def test_a_page_without_a_place_for_the_table_is_refused() -> None:
    with pytest.raises(ValueError, match="no place for the table"):
        lines.written("# Families\n")
