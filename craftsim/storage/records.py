"""Validated records for external data: a format is a type with its bounds in the annotations.

``@record()`` makes a frozen dataclass that is validated whenever one is made: in Python, from YAML
(:mod:`craftsim.storage.yaml`) or from JSON. Conditions between fields are checked in ``__post_init__``, with a
ValueError. Mistakes are reported together, each with its key and with what is allowed.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Final,
    TypeVar,
    Union,
    cast,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import pydantic.dataclasses
from pydantic import ConfigDict, FailFast, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from craftsim.errors import InputError, suggestion
from craftsim.storage.limits import JSON_VALUES, Limits, Range, shorten
from craftsim.storage.reading import read_bytes

_T = TypeVar("_T")
Loc = tuple[str | int, ...]
"""Path to a value: keys, and indices of lists."""
Mistake = tuple[Loc, str]
"""The path of a mistake, and its message."""

Listed = Annotated[tuple[_T, ...], FailFast()]
"""A potentially long list: validated up to its first mistake, to bound memory."""

_STRICT: Final = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
"""No conversion from text to numbers, finite numbers only, no unknown keys."""
_MOST_REPORTED: Final = 5
_DESCRIBED: Final = 50_000
"""Limit of mistakes, to bound memory: with more none is listed."""
_QUOTED: Final = 40
_COMPARED: Final = 100
_UNKNOWN: Final = ("unexpected_keyword_argument", "extra_forbidden")
"""pydantic's names of the error for an unknown key."""
_NOUNS: Final = {int: "an integer", float: "a number", bool: "true or false", str: "a text"}
_LISTS: Final = ("tuple_type", "list_type")
_MAPPINGS: Final = (
    "dataclass_type",
    "dataclass_exact_type",
    "dict_type",
    "mapping_type",
    "model_type",
)


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field,))
def record(kw_only: bool = False) -> Callable[[type[_T]], type[_T]]:
    """Make a frozen dataclass that validates its fields; an invalid one raises InputError, naming class and field."""

    def decorate(kind: type[_T]) -> type[_T]:
        checked: Any = pydantic.dataclasses.dataclass(frozen=True, config=_STRICT, kw_only=kw_only)(
            kind
        )
        make = checked.__init__
        names = [
            field.name for field in dataclasses.fields(checked) if field.init and not field.kw_only
        ]

        @functools.wraps(make)
        def __init__(self: Any, *args: Any, **keywords: Any) -> None:
            try:
                # By name, for messages have no other.
                make(self, *args[len(names) :], **dict(zip(names, args, strict=False)), **keywords)
            except ValidationError as error:
                found_mistakes = mistakes(
                    checked, error, lambda loc: f"{checked.__name__}{_dotted(loc)}"
                )
                raise InputError(_lines(found_mistakes, lambda _, text: text)) from None

        checked.__init__ = __init__
        return checked

    return decorate


@functools.cache
def adapter(kind: Hashable) -> TypeAdapter[Any]:
    """Return the validator of a type, strict by default."""
    if isinstance(kind, type) and not hasattr(kind, "__pydantic_config__"):
        pydantic.with_config(_STRICT)(kind)
    return TypeAdapter(cast(Any, kind))


def to_json(value: Any) -> bytes:
    """Return a record as a JSON text."""
    return adapter(cast(Hashable, type(value))).dump_json(value, indent=1) + b"\n"


def read_json_record(path: Path, kind: type[_T], limits: Limits) -> _T:
    """Return the record in a JSON file; raises as :func:`from_json` and :func:`.read_bytes`."""
    return from_json(kind, read_bytes(path, limits), str(path))


def from_json(kind: type[_T], data: bytes, source: str) -> _T:
    """Return the record in a JSON document.

    Raises InputError for invalid JSON or values, with a line for each of the first mistakes, beginning with ``source``.
    """
    if data.count(b",") > JSON_VALUES:
        raise InputError(f"{source}: holds more than the {JSON_VALUES} values that are allowed")
    try:
        value: _T = adapter(cast(Hashable, kind)).validate_json(data)
    except ValidationError as error:
        raise InputError(
            _lines(mistakes(kind, error), lambda _, text: f"{source}: {text}")
        ) from None
    except InputError as error:
        raise InputError(f"{source}: {error}") from error
    return value


def first_mistake(error: ValidationError, kind: Any = None) -> str:
    """Return the first mistake with its key."""
    return next(iter(mistakes(kind, error)))[1]


def refuse(
    problems: Iterable[Mistake], words: Callable[[Loc, str], str], error: type[InputError]
) -> None:
    """Raise an error with the first few mistakes, a line each, if there are any."""
    lines = _lines(problems, words)
    if lines:
        raise error(lines)


def _lines(problems: Iterable[Mistake], words: Callable[[Loc, str], str]) -> str:
    lines: list[str] = []
    for loc, text in islice(problems, _MOST_REPORTED + 1):
        if len(lines) == _MOST_REPORTED:
            lines.append(words((), "and more"))
        else:
            lines.append(words(loc, text))
    return "\n".join(lines)


def key_words(loc: Loc) -> str:
    """Return the name of a value in messages.

    Example:
        >>> key_words(("block", 0, "x"))
        "key 'block[0].x'"
    """
    return f"key '{_dotted(loc)[1:] or 'document'}'"


def _dotted(loc: Loc) -> str:
    text = ""
    for key in loc:
        if isinstance(key, int):
            text += f"[{key}]"
        else:
            text += f".{_cut(key)}"
    return text


def _cut(text: str) -> str:
    """Return a shortened and escaped text for messages."""
    if not text.isprintable():
        text = repr(text)[1:-1]
    return shorten(text, _QUOTED)


def described(value: object) -> str:
    """Return a short description of a value for messages."""
    if isinstance(value, list | dict | tuple):
        if isinstance(value, dict):
            return "a mapping"
        return "a list"
    if value in (None, ""):
        return "nothing"
    return f"'{_cut(str(value))}'"


def unknown_words(word: str, words: Iterable[str], noun: str = "key", allowed: bool = True) -> str:
    """Return the message for an unknown word, with the closest known one and, by default, all."""
    words = list(words)
    text = f"unknown {noun} '{_cut(word)}'{suggestion(word[:80], words)}"
    if allowed:
        return f"{text}; allowed: {', '.join(words)}"
    return text


def mistakes(
    kind: Any,
    error: ValidationError,
    name: Callable[[Loc], str] = key_words,
    line_of: Callable[[Loc], int] = lambda loc: 0,
) -> Iterator[Mistake]:
    """Yield pydantic's mistakes by path, at most one missing key a mapping; ``name`` names a value in messages."""
    count = error.error_count()
    if count > _DESCRIBED:
        yield (), f"{count} values are missing, wrong or unknown; is it the file that it should be?"
        return
    errors = sorted(error.errors(include_url=False), key=lambda detail: line_of(detail["loc"]))
    unknown = [detail["loc"] for detail in errors if detail["type"] in _UNKNOWN][:_COMPARED]
    lacking: set[Loc] = set()
    listed: set[Loc] = set()
    for detail in errors:
        *before, last = detail["loc"] or ("",)
        parent = tuple(before)
        if detail["type"] in _UNKNOWN:
            inside, _ = type_and_range(kind, parent)
            if isinstance(getattr(inside, str(last), None), property):
                text = "is not given but follows from other parameters; change those"
                yield detail["loc"], f"{name(detail['loc'])}: {text}"
                continue
            # What is allowed in a mapping is said once.
            text = unknown_words(str(last), _keys(inside), allowed=parent not in listed)
            if parent and not line_of(detail["loc"]):
                text = f"{name(parent)}: {text}"
            yield detail["loc"], text
            listed.add(parent)
        elif detail["type"] == "too_short" and len(detail["input"]) >= detail["ctx"]["min_length"]:
            pass  # For want of an entry that is wrong.
        elif detail["type"] != "missing":
            yield detail["loc"], _words(kind, detail, name)
        elif parent not in lacking and not _is_misspelt(parent, str(last), unknown):
            lacking.add(parent)
            yield parent, _words(kind, detail, name)


def _is_misspelt(parent: Loc, key: str, unknown: Iterable[Loc]) -> bool:
    """Return whether one of the unknown keys of a mapping looks like a missing one."""
    siblings = [str(loc[-1])[:80] for loc in unknown if loc[:-1] == parent]
    return any(suggestion(sibling, [key]) for sibling in siblings)


def _words(kind: Any, error: ErrorDetails, name: Callable[[Loc], str]) -> str:
    """Return the message of a mistake, with the allowed values."""
    loc = error["loc"]
    value = error["input"]
    type_ = error["type"]
    if type_ == "missing" and isinstance(loc[-1], int):
        return f"{name(loc[:-1])}: must be a list of {len(get_args(type_and_range(kind, loc[:-1])[0]))} entries"
    if type_ == "missing":
        keys = ", ".join(_keys(type_and_range(kind, loc[:-1])[0], required=True))
        required = ""
        if keys:
            required = f"; required: {keys}"
        if len(loc) == 1:
            return f"{name(loc)} is missing{required}"
        return f"{name(loc[:-1])}: needs '{loc[-1]}'{required}"
    value_type, allowed = type_and_range(kind, loc)
    if type_ == "value_error":
        subject = ""
        if loc or name is not key_words:
            subject = name(loc)
        if subject:
            return f"{subject}: {error['ctx']['error']}"
        return str(error["ctx"]["error"])
    if type_ == "literal_error":
        literals = [str(word) for word in get_args(value_type)]
        if literals:
            if isinstance(value, str | int | float):
                return f"{name(loc)}: {unknown_words(str(value), literals, 'value')}"
            return f"{name(loc)}: must be one of {', '.join(literals)}, not {described(value)}"
    if type_.startswith(("greater_than", "less_than")):
        return f"{name(loc)}: {(allowed or _range_of(error['ctx'])).out(value)}"
    if type_ in _LISTS:
        return f"{name(loc)}: must be a list of entries, not {described(value)}"
    if type_ in _MAPPINGS:
        keys = ", ".join(_keys(value_type))
        return (
            f"{name(loc)}: must be a mapping{keys and ' with keys '}{keys}, not {described(value)}"
        )
    if type_ in ("too_short", "too_long", "string_too_short", "string_too_long"):
        if type_.startswith("string"):
            noun = "characters"
        else:
            noun = "entries"
        if type_.endswith("long"):
            end = "most"
            key = "max_length"
        else:
            end = "least"
            key = "min_length"
        return f"{name(loc)}: has {len(value)} {noun}, allowed: at {end} {error['ctx'][key]}"
    if type_ == "is_instance_of":
        return (
            f"{name(loc)}: must be an instance of {error['ctx']['class']}, not {described(value)}"
        )
    if value_type in _NOUNS:
        range_words = ""
        if allowed:
            range_words = f" {allowed.words}"
        finite = "a finite number"
        if type_ != "finite_number":
            finite = _NOUNS[value_type]
        if type_ == "finite_number" or type_.startswith(value_type.__name__):
            return f"{name(loc)}: must be {finite}{range_words}, not {described(value)}"
    return f"{name(loc)}: {error['msg']}, not {described(value)}"


def _range_of(bound: Mapping[str, Any]) -> Range:
    """Return the range of one of pydantic's bounds."""
    low = bound.get("ge", bound.get("gt", -math.inf))
    high = bound.get("le", bound.get("lt", math.inf))
    return Range(low, high, "gt" in bound, "lt" in bound)


def _keys(kind: Any, required: bool = False) -> list[str]:
    """Return the keys of a record type, or only the required ones."""
    if hasattr(kind, "_field_defaults"):
        return [name for name in kind._fields if not required or name not in kind._field_defaults]
    if not dataclasses.is_dataclass(kind):
        attribute = "__required_keys__" if required else "__annotations__"
        return list(getattr(kind, attribute, ()))
    names = []
    for field in dataclasses.fields(kind):
        if not required or (
            field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        ):
            names.append(field.name)
    return names


def type_and_range(kind: Any, loc: Loc) -> tuple[Any, Range | None]:
    """Return the type of the value at a path in a type (None if it is not unique), and the range of a number."""
    allowed = None
    for key in (None, *loc):
        if key is not None:
            kind = _inside(kind, key)
            allowed = None
        while hasattr(kind, "__metadata__") or NoneType in get_args(kind):
            for item in getattr(kind, "__metadata__", ()):
                if isinstance(item, Range):
                    allowed = item
                    break
            kind = next(inner for inner in get_args(kind) if inner is not NoneType)
    return kind, allowed


def _inside(kind: Any, key: str | int) -> Any:
    """Return the annotation of an inner value; None if it is not unique."""
    origin = get_origin(kind)
    args = get_args(kind)
    if origin in (Union, UnionType) or (args and origin is None):
        return None
    if isinstance(origin, type) and issubclass(origin, Mapping):
        if len(args) == 2:
            return args[1]
        return None
    if isinstance(key, int):
        if args:
            if origin is tuple and Ellipsis not in args:
                return args[key]
            return args[0]
        return None
    if isinstance(kind, type):
        return get_type_hints(kind, include_extras=True).get(key)
    return None
