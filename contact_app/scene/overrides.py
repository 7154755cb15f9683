"""Overrides of keys of a scene file on the command line, ``--set path.to.key=value``."""

import re
from typing import Any

from contact_app.errors import ConfigurationError
from contact_app.scene import yaml_reader
from contact_app.scene.yaml_reader import Key, key_text


def override(data: Any, text: str, overridden: dict[Key, str]) -> None:
    """Apply one ``--set path.to.key=value`` to the data of a scene file."""
    name = "--set " + (text if len(text) <= 80 else text[:77] + "...")
    key, equals, value_text = text.partition("=")
    words = re.sub(r"\[([0-9]+)\]", r".\1", key.strip()).split(".")  # messages write bodies[0]
    parts = [int(p) if re.fullmatch("[0-9]{1,9}", p) else p for p in words]
    if not equals or not all(p != "" for p in parts):
        raise ConfigurationError(f"{name}: the form path.to.key=value is allowed")
    if len(parts) > yaml_reader.DEEPEST:
        raise ConfigurationError(f"{name}: is nested deeper than {yaml_reader.DEEPEST} levels")
    value = yaml_reader.scalar(value_text, name)
    for depth, (part, following) in enumerate(zip(parts, [*parts[1:], None], strict=True)):
        here = key_text(parts[:depth]) or "the file"
        if isinstance(data, list):
            if not isinstance(part, int) or part > len(data):
                raise ConfigurationError(
                    f"{name}: {here} is a list of length {len(data)}; give the number of an item"
                )
            if part == len(data):
                data.append(None)
        else:
            part = str(part)
            data.setdefault(part, None)
        parts[depth] = part
        if following is None:
            data[part] = value
        elif not isinstance(data[part], (dict, list)):
            data[part] = [] if following == 0 else {}
        else:
            data = data[part]
            continue
        _claim(tuple(parts[: depth + 1]), name, overridden)
        data = data[part]


def _claim(key: Key, name: str, overridden: dict[Key, str]) -> None:
    """Attribute all keys below `key` to the override `name`, for error messages."""
    for earlier in [k for k in overridden if k[: len(key)] == key]:
        del overridden[earlier]
    overridden[key] = name
