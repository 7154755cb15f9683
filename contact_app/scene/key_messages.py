"""Messages that name file, line and key, in words of the scene file, not of pydantic."""

import re
from collections.abc import Sequence
from typing import Any

from pydantic_core import ErrorDetails

from contact_app.scene.schema.base import SMALLEST, Model, shown, suggestion
from contact_app.scene.yaml_reader import Key, key_text


def where(
    path: Sequence[str | int], file: str, lines: dict[Key, int], overridden: dict[Key, str]
) -> str:
    """File, line and key of a place; the option where it is of ``--set``."""
    key = tuple(path)
    for length in range(len(key), 0, -1):
        if key[:length] in overridden:
            return f"{overridden[key[:length]]}: {key_text(path)}"
    for length in range(len(key), -1, -1):
        if key[:length] in lines:
            return f"{file}:{lines[key[:length]]}: {key_text(path)}"
    return f"{file}: {key_text(path)}"


def message(
    details: ErrorDetails, data: Any, file: str, lines: dict[Key, int], overridden: dict[Key, str]
) -> str:
    """One readable line from one of pydantic's errors."""
    path = _real_path(details["loc"], data)
    kind, context = details["type"], details.get("ctx", {})
    value = details["input"]
    if kind == "unknown_key":
        path = (*path, str(context["key"]))
    if kind == "missing":
        allowed = f"is missing in {key_text(path[:-1]) or 'the file'}"
        at = where(path[:-1], file, lines, overridden)
        return f"{at.rsplit(': ', 1)[0]}: {key_text(path)} {allowed}"
    at = where(path, file, lines, overridden)
    text = shown(value)
    if kind in ("unknown_key", "refused"):
        return f"{at} {details['msg']}"
    sections = {section.__name__: section for section in Model.__subclasses__()}
    section, keys = sections.get(str(context.get("class_name"))), ""
    if section is not None:
        keys = f", with the keys {', '.join(section.known_keys())}"
    limit = next((f"{context[k]:g}" for k in ("gt", "ge", "lt", "le") if k in context), "")
    if context.get("ge") == SMALLEST:
        limit = f"{SMALLEST:g}, that is above 0"
    allowed = {
        "finite_number": "a finite number is allowed",
        "float_type": "a number is allowed",
        "int_type": "a whole number is allowed",
        "string_type": "text is allowed",
        "string_unicode": "one line of printable text is allowed",
        "bool_type": "true or false is allowed",
        "list_type": "a list is allowed",
        "model_type": f"a mapping is allowed{keys}",
        "dict_type": "a mapping of keys is allowed",
        "literal_error": f"allowed: {context.get('expected', '')}",
        "greater_than": f"it must be above {limit}",
        "greater_than_equal": f"it must be at least {limit}",
        "less_than": f"it must be below {limit}",
        "less_than_equal": f"it must be at most {limit}",
        "too_short": "it must not be empty",
        "too_long": f"at most {context.get('max_length')} items are allowed",
        "string_too_long": f"at most {context.get('max_length')} characters are allowed",
    }.get(kind, details["msg"])
    if kind == "literal_error" and isinstance(value, str):
        allowed += suggestion(value, re.findall(r"'([^']+)'", allowed))
    if kind in ("float_type", "int_type") and isinstance(value, str):
        allowed += _remedy(value)
    if kind == "list_type" and len(path) == 1:
        allowed += ", with a dash before each entry"
    elif kind == "list_type" and isinstance(value, int | float):
        allowed += ", with a number for each direction"
    return f"{at} is {text}; {allowed}"


def _remedy(text: str) -> str:
    """Advice on a text that begins as a number does."""
    number = re.match(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", text.strip(), re.IGNORECASE)
    if number is None:
        return ""
    rest = text.strip()[number.end() :]
    if not rest:
        return "; write it without quotes"
    if rest.startswith(("_", "*", "^", "/")):
        return "; write it in digits alone, e.g. 2.1e5"
    return "; write it without a unit (of any consistent ones, e.g. mm, N and N/mm²)"


def _real_path(location: Sequence[str | int], data: Any) -> Key:
    """The part of pydantic's location that exists in the data (unions add names of their own)."""
    path: list[str | int] = []
    for part in location:
        if isinstance(data, dict) and isinstance(part, str):
            if part in data:
                data = data[part]
            elif part != location[-1] or part.startswith("{"):
                continue
            path.append(part)
        elif isinstance(data, list) and isinstance(part, int) and part < len(data):
            data = data[part]
            path.append(part)
    return tuple(path)
