"""Reader of YAML 1.2 with the line of every key.

PyYAML reads YAML 1.1, where `on` is a boolean and `1e-3` a string. Here only `true` and `false`
are booleans, and `1e-3`, `2E5`, `.5` and `1.0e-3` are numbers. Anchors, aliases and tags are
refused: scenes do not need them, and a few lines of aliases can expand to gigabytes. Size, depth
and number of values are limited, so that no file takes long to read.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from contact_app.errors import ConfigurationError

LARGEST_FILE = 500_000
MOST_VALUES = 20_000
DEEPEST = 30
LONGEST_NUMBER = 30

Key = tuple[str | int, ...]


class _Refused(Exception):
    """A construct of YAML that is refused, with its line."""

    def __init__(self, line: int, message: str) -> None:
        super().__init__(message)
        self.line = line


class _Loader(yaml.SafeLoader):
    """Resolves plain scalars by YAML 1.2's core schema; refuses what scenes do not need."""

    yaml_implicit_resolvers: dict[str, Any] = {}

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = self._values = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Build the next node, unless a limit is passed."""
        event = self.peek_event()
        line = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise _Refused(
                line, "anchors and aliases (& and *) are not allowed; write the value out"
            )
        if getattr(event, "tag", None):
            raise _Refused(line, f"the tag {event.tag} is not allowed; write the plain value")
        self._values += 1
        if self._values > MOST_VALUES:
            raise _Refused(line, f"more than {MOST_VALUES} values are not allowed")
        if self._depth > DEEPEST:
            raise _Refused(line, f"is nested deeper than {DEEPEST} levels")
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


for _tag, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+", list("-+0123456789")),
    ("float", r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?", list("-+.0123456789")),
    ("float", r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)", list("-+.")),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"),
                                  _first)  # fmt: skip


def read(path: Path) -> tuple[Any, dict[Key, int]]:
    """Content of a file, and the line of every key and item.

    Raises
    ------
    ConfigurationError
        The file cannot be read or is not acceptable YAML.
    """
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise ConfigurationError(f"{path}: is not a file")
        if size > LARGEST_FILE:
            raise ConfigurationError(f"{path}: has {size} bytes; {LARGEST_FILE} are allowed")
        text = path.read_bytes().decode("utf-8-sig")
    except FileNotFoundError:
        raise ConfigurationError(f"{path}: there is no such file") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: is not text in UTF-8") from None
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError:  # a zero byte or half a character
        raise ConfigurationError(f"{path}: is no valid file name") from None
    return parse(text, str(path))


def parse(text: str, name: str) -> tuple[Any, dict[Key, int]]:
    """Content of a YAML text; `name` stands for the file in messages."""
    try:
        loader = _Loader(text)
        try:
            node = loader.get_single_node()
        finally:
            loader.dispose()
    except _Refused as error:
        raise ConfigurationError(f"{name}:{error.line}: {error}") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        at = f":{mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        if "\\t" in problem:
            problem += "; indent with spaces, not tabs"
        if "mapping values are not allowed" in problem:
            problem += (
                "; put text that contains a colon in quotes, indent keys alike, and see whether "
                "the line before lacks its colon"
            )
        if "<block end>" in problem:
            problem += "; begin all entries of a list, and all keys of a mapping, in one column"
        if "expected ',' or" in problem or "<stream end>" in problem:
            problem += "; a bracket or a quote is not closed, or a comma is missing"
        begun = getattr(error, "context_mark", None)
        if mark and begun and begun.line < mark.line:
            problem += f" (after line {begun.line + 1})"
        if "another document" in problem:
            problem = "a second document begins (---); one file holds one scene"
        raise ConfigurationError(f"{name}{at}: this is not YAML: {problem}") from None
    except (RecursionError, ValueError) as error:
        raise ConfigurationError(f"{name}: this is not YAML: {error}") from None
    if node is None:
        raise ConfigurationError(f"{name}: is empty; see configs/ for scenes to start from")
    lines: dict[Key, int] = {}
    return _value(node, (), lines, name), lines


def scalar(text: str, name: str) -> Any:
    """Value of a short YAML text, as given to ``--set``."""
    if not text.strip():
        return None
    try:
        return parse(text, "")[0]
    except ConfigurationError as error:
        problem = re.sub(r"^:([0-9]+:)? ", "", str(error))
        raise ConfigurationError(f"{name}: {problem}") from None


def key_text(path: Sequence[str | int]) -> str:
    """Text such as `bodies[0].material.young` from the parts of a path, on one line."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text if text.isprintable() else repr(text)[1:-1]


def _value(node: yaml.Node, path: Key, lines: dict[Key, int], name: str) -> Any:
    """The Python value of a YAML node; stores the line of each key below it."""
    line = node.start_mark.line + 1
    lines.setdefault(path, line)
    at = f"{name}:{line}: {key_text(path)}".rstrip(": ")
    if isinstance(node, yaml.SequenceNode):
        return [_value(n, (*path, i), lines, name) for i, n in enumerate(node.value)]
    if isinstance(node, yaml.MappingNode):
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                raise ConfigurationError(f"{at}: a key must be a plain word")
            key = key_node.value
            line = key_node.start_mark.line + 1
            if key in result:
                raise ConfigurationError(
                    f"{name}:{line}: {key_text((*path, key))} is given twice, first in line "
                    f"{lines[(*path, key)]}"
                )
            lines[(*path, key)] = line
            result[key] = _value(value_node, (*path, key), lines, name)
        return result
    tag = node.tag.removeprefix("tag:yaml.org,2002:")
    text = node.value
    if tag == "str":
        return text
    if tag == "null":
        return None
    if tag == "bool":
        return text.lower() == "true"
    if tag == "int":
        base = {"0o": 8, "0x": 16}.get(text[:2], 10)
        if len(text) > LONGEST_NUMBER:
            raise ConfigurationError(f"{at}: a whole number of {len(text)} digits is too long")
        return int(text, base)
    if tag == "float":
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    raise ConfigurationError(f"{at}: the tag {node.tag} is not allowed")
