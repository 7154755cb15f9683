"""YAML as YAML 1.2 means it, with lines, and without surprises."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contact_app.errors import ConfigurationError
from contact_app.machine.time_limit import time_limit
from contact_app.scene.yaml_reader import LARGEST_FILE, MOST_VALUES, key_text, parse, read, scalar


def refusal(function: Callable[..., Any], *arguments: Any) -> str:
    """Message of the refusal, or what a message begins with where there is none."""
    try:
        function(*arguments)
    except ConfigurationError as error:
        return str(error)
    return f"{arguments[-1]}: accepted"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3),
        ("2E5", 2e5),
        ("1.0e-3", 1e-3),
        (".5", 0.5),
        ("5.", 5.0),
        ("+1.5", 1.5),
        ("-7", -7),
        ("007", 7),
        ("0x1F", 31),
        ("0o17", 15),
        ("1_000", "1_000"),
        ("12:30:45", "12:30:45"),
        ("2020-01-01", "2020-01-01"),
        ("true", True),
        ("FALSE", False),
        ("yes", "yes"),
        ("on", "on"),
        ("~", None),
        ("null", None),
        ("", None),
        (".inf", math.inf),
        ("-.INF", -math.inf),
        ("1e999", math.inf),
        ("'1e3'", "1e3"),
    ],
)
def test_plain_values(text: str, value: object) -> None:
    found = parse(f"key: {text}\n", "t")[0]["key"]
    assert found == value
    assert type(found) is type(value)


def test_nan() -> None:
    assert math.isnan(scalar(".nan", "t"))


def test_lines_of_keys_and_items() -> None:
    lines = parse("a: 1\nb:\n  - c: 2\n  -\n    d: {e: 3,\n        f: 4}\n", "t")[1]
    assert lines[("a",)] == 1
    assert lines[("b", 0, "c")] == 3
    assert lines[("b", 1, "d", "e")] == 5
    assert lines[("b", 1, "d", "f")] == 6


def test_key_text() -> None:
    assert key_text(("bodies", 0, "material", "young")) == "bodies[0].material.young"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "is empty"),
        ("# nothing\n", "is empty"),
        ("a: 1\nb: 2\na: 3\n", "t:3: a is given twice, first in line 1"),
        ("a: {b: 1, b: 2}", "a.b is given twice"),
        ("a:\n\t- b\n", "t:2: .*spaces, not tabs"),
        ("a: [1, 2\n", "not YAML"),
        ("a: 'b\n", "not YAML"),
        ("a: b: c\n", "t:1: .*not YAML"),
        ("a: 1\n---\nb: 2\n", "t:2: .*second document"),
        ("a: &x 1\nb: *x\n", "t:1: anchors and aliases"),
        ("a: 1\nb: *x\n", "t:2: anchors and aliases"),
        ("a: !!python/object/apply:os.system [ls]\n", "tag .* is not allowed"),
        ("a: !!int abc\n", "tag .* is not allowed"),
        ("a: !!binary aGk=\n", "tag .* is not allowed"),
        ("? [a, b]\n: 3\n", "a key must be a plain word"),
        ("a: " + "9" * 5000, "a whole number of 5000 digits"),
        ("%YAML 9.9\n---\na: 1\n", "not YAML"),
        ("a: b\0c\n", "not YAML"),
        ("[" * 5000, "nested deeper"),
        ("{a: " * 3000 + "1" + "}" * 3000, "nested deeper"),
        ("a: [" + "1," * (2 * MOST_VALUES) + "1]", "values are not allowed"),
    ],
    ids=lambda text: text[:20],
)
def test_refused_at_once_with_the_line(text: str, expected: str) -> None:
    with time_limit(30.0), pytest.raises(ConfigurationError, match=expected):
        parse(text, "t")


def test_a_billion_laughs_are_not_expanded() -> None:
    lines = ["a0: &a0 [ha]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 12)]
    with pytest.raises(ConfigurationError, match="anchors and aliases"):
        parse("\n".join(lines), "t")


def test_files_that_are_none(tmp_path: Path) -> None:
    cases = {
        tmp_path / "none.yaml": "there is no such file",
        tmp_path: "is not a file",
        Path("/dev/zero"): "is not a file",
        tmp_path / "garbage": "not text in UTF-8",
        tmp_path / "large": "bytes",
        tmp_path / "x" / "y": "there is no such file",
        tmp_path / "garbage" / "y": "cannot be read",
        Path("/tmp/" + "a" * 300): "cannot be read",
        Path("/tmp/a\0b"): "is no valid file name",
    }
    (tmp_path / "garbage").write_bytes(bytes(range(256)))
    (tmp_path / "large").write_bytes(b"#" * (LARGEST_FILE + 1))
    for path, expected in cases.items():
        with pytest.raises(ConfigurationError, match=expected):
            read(path)


def test_byte_order_mark_and_carriage_returns(tmp_path: Path) -> None:
    path = tmp_path / "windows.yaml"
    path.write_bytes(b"\xef\xbb\xbfa: 1\r\nb: 2\r\n")
    assert read(path)[0] == {"a": 1, "b": 2}


@settings(max_examples=300, deadline=None)
@given(
    st.one_of(
        st.text(max_size=200),
        st.lists(
            st.sampled_from([*"ab:-[]{}\n \t#&*!|>'\"%@`,?~019.e", "- ", ": ", "---\n"]),
            max_size=60,
        ).map("".join),
    )
)
def test_any_text_is_read_or_refused(text: str) -> None:
    assert refusal(parse, text, "t").startswith("t:")


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_bytes(data)
    assert refusal(read, path).startswith(f"{path}:")
