"""Text to plain data: YAML 1.2's own examples, lines of values, and everything that is not plain data refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator.config import yaml_lines
from emulator.config.yaml_lines import Source, dotted, parse
from emulator.errors import ScenarioError
from tests.draws import cases

HERE = Path("file.yaml")


def read(text: str) -> Source:
    return parse(text, HERE, ScenarioError)


def refused(text: str) -> str:
    with pytest.raises(ScenarioError) as caught:
        read(text)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("12", 12), ("-12", -12), ("+12", 12), ("0o14", 12), ("0xC", 12), ("0b1", "0b1"), ("012", 12),
        ("1.5", 1.5), ("1e3", 1000.0), ("12e03", 12000.0), ("-2E+05", -200000.0), (".5", 0.5), ("1.", 1.0),
        ("true", True), ("False", False), ("TRUE", True), ("yes", "yes"), ("on", "on"), ("No", "No"),
        ("null", None), ("~", None), ("", None), ("'12'", "12"), ('"true"', "true"), ("1_000", "1_000"),
        ("12:30:45", "12:30:45"), ("2001-12-14", "2001-12-14"), ("0.", 0.0), ("1e", "1e"), ("- 1", [1]),
        ("a: {b: [1, {c: ~}]}", {"a": {"b": [1, {"c": None}]}}), ("905: 1", {"905": 1}), ("on: 1", {"on": 1}),
        ("a: |\n  x\n  y\n", {"a": "x\ny\n"}), ("&x a: *x", {"a": "a"}),
        ("a: &x [1, 2]\nb: *x", {"a": [1, 2], "b": [1, 2]}),
        ("<<: {a: 1}\nb: 2", {"<<": {"a": 1}, "b": 2}),
        ("%YAML 1.2\n---\na: 1\n...\n", {"a": 1}),
    ],
)  # fmt: skip
def test_scalars_mean_what_the_core_schema_of_yaml_1_2_says(text: str, value: object) -> None:
    found = read(text)
    assert found.data == value
    assert type(found.data) is type(value)
    assert not found.faults


def test_every_value_knows_its_line() -> None:
    source = read("a: 1\nb:\n  c: [1,\n    {d: 2}]\n  e: x\nf: &k {g: 1}\nh: *k\n")
    lines = {dotted(loc): line for loc, (_, line) in source.places.items()}
    assert lines == {
        "file": 1, "a": 1, "b": 2, "b.c": 3, "b.c[0]": 3, "b.c[1]": 4, "b.c[1].d": 4, "b.e": 5, "f": 6, "f.g": 6,
        "h": 7, "h.g": 6,
    }  # fmt: skip
    assert source.place(("b", "c", 1, "zzz", 4)) == "file.yaml:4"


def test_items_of_lists_are_named_by_their_id_where_it_is_one() -> None:
    data = read("s: [{id: front, x: 1}, {x: 2}, {id: two}, {id: two}]").data
    assert dotted(("s", 0, "x"), data) == "s.front.x"
    assert dotted(("s", 1, "x"), data) == "s[1].x"
    assert dotted(("s", 3), data) == "s[3]"
    assert dotted(("s", 9, "x"), data) == "s[9].x"


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("a: [1, 2\nb: 3", "file.yaml:2: not YAML: "),
        ("a: 1\n b: 2", "file.yaml:2: not YAML: "),
        ("a: b: c", "file.yaml:1: not YAML: "),
        ("a: *x", "file.yaml:1: alias *x without its anchor; want an anchor before it"),
        ("a: &x [1, *x]", "file.yaml:1: alias *x inside its own anchor; want data without a cycle"),
        ("a: 1\n---\nb: 2", "file.yaml:2: a second document; want one document per file"),
        ("a: \x00", "file.yaml:1: not YAML: "),
        ("a: \t- b", "file.yaml:1: not YAML: "),
        ("[" * 40, "file.yaml:1: nested more than 32 deep; want a flatter file"),
        ("\n".join("  " * k + "a:" for k in range(60)), "file.yaml:33: nested more than 32 deep"),
    ],
)
def test_what_cannot_be_read_is_told_with_its_line(text: str, reported: str) -> None:
    assert refused(text).startswith(reported)


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("a: 1\nb: 2\na: 3", "file.yaml:3: a: given twice, first in line 1; want each key only once"),
        ("x: {1: a, '1': b}", "file.yaml:1: x.1: given twice, first in line 1; want each key only once"),
        ("a: !!python/object:os.system x", "file.yaml:1: a: tag tag:yaml.org,2002:python/object:os.system; want"),
        ("a: !mine {b: 1}", "file.yaml:1: a: tag !mine; want plain data"),
        ("a: !!str 3", "file.yaml:1: a: tag tag:yaml.org,2002:str; want plain data"),
        ("a: !!binary aGk=", "file.yaml:1: a: tag tag:yaml.org,2002:binary; want plain data"),
        ("s: !!set {a, b}", "file.yaml:1: s: tag tag:yaml.org,2002:set; want plain data"),
        ("? [1, 2]\n: 3", "file.yaml:1: file: a key on line 1 that is a list or table; want text as a key"),
        ("a: " + "1" * 50, "file.yaml:1: a: a number of 50 digits; want at most 40"),
    ],
)
def test_what_is_not_plain_data_is_told_and_the_rest_is_read(text: str, reported: str) -> None:
    source = read(text)
    assert len(source.faults) == 1
    assert source.faults[0].startswith(reported)


def test_aliases_that_multiply_are_stopped() -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    assert "more than 400000 values; want a smaller file" in refused("\n".join(lines))


def test_aliases_that_nest_are_stopped() -> None:
    lines = ["a0: &a0 {x: 1}"] + [f"a{k}: &a{k} {{x: *a{k - 1}}}" for k in range(1, 80)]
    assert "nested more than 64 deep" in refused("\n".join(lines))


def test_files_that_cannot_be_read_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def reported(path: Path) -> str:
        with pytest.raises(ScenarioError) as caught:
            yaml_lines.read(path, ScenarioError)
        return str(caught.value).replace(str(tmp_path), "")

    (tmp_path / "latin.yaml").write_bytes(b"a: 1\nb: \xe4\n")
    (tmp_path / "big.yaml").write_text("a: 1\n")
    assert reported(tmp_path / "none.yaml") == "/none.yaml:1: no such file; want a YAML file"
    assert reported(tmp_path) == ":1: no such file; want a YAML file"
    assert reported(tmp_path / "latin.yaml") == "/latin.yaml:2: byte 0xe4 is not UTF-8; want UTF-8"
    monkeypatch.setattr(yaml_lines, "MAX_BYTES", 3)
    assert reported(tmp_path / "big.yaml") == "/big.yaml:1: 5 bytes; want at most 3"


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    (tmp_path / "bom.yaml").write_bytes(b"\xef\xbb\xbfa: 1\n")
    assert yaml_lines.read(tmp_path / "bom.yaml", ScenarioError).data == {"a": 1}


def test_a_text_that_was_read_before_is_not_parsed_again_and_its_data_are_new(monkeypatch: pytest.MonkeyPatch) -> None:
    text = "a: &x {b: [1, 2], b: 3}\nc: *x\nonly: here"
    first = read(text)
    monkeypatch.setattr(yaml_lines, "_Tree", None)
    first.data["a"]["b"].append(9)
    again = parse(text, Path("other.yaml"), ScenarioError)
    assert again.data == {"a": {"b": [1, 2]}, "c": {"b": [1, 2]}, "only": "here"}
    assert again.faults == ("other.yaml:1: a.b: given twice, first in line 1; want each key only once",
                            "other.yaml:1: c.b: given twice, first in line 1; want each key only once")  # fmt: skip
    assert again.spot(("only",)) == (Path("other.yaml"), 3)


def test_a_text_that_was_refused_before_is_refused_with_the_name_of_its_own_file() -> None:
    for name in ("one.yaml", "other.yaml"):
        with pytest.raises(ScenarioError, match=rf"^{name}:2: a second document; want one document per file"):
            parse("a: 1\n--- b", Path(name), ScenarioError)


@given(st.text(alphabet=st.sampled_from("ab:-{}[],&*!#'\"\n \t|>%@?~<0.1"), max_size=60))
@settings(max_examples=cases(300), deadline=None)
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        reported = read(text).faults
    except ScenarioError as error:
        reported = (str(error),)
    assert all(fault.startswith("file.yaml:") for fault in reported)


plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**6), 10**6) | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(alphabet=st.characters(min_codepoint=32, max_codepoint=0x2FF, exclude_characters="\x7f\x85\xa0"),
              max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("abcxyz", min_size=1), inner, max_size=3),
    max_leaves=12,
)  # fmt: skip


@given(plain)
@settings(max_examples=cases(100), deadline=None)
def test_json_is_yaml(value: object) -> None:
    import json

    assert read(json.dumps(value)).data == value
