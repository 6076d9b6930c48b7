"""Reading YAML files of unknown origin: bounded in size and time, held to a type, each mistake with its line.

The parser's events are checked one by one before anything is built. Anchors, aliases and tags have no use in our files
and are refused. The keys of several documents in a file are merged.

A format is a dataclass, and ``Annotated[int, Between(0, 3)]`` a number in it: ``read_document(path).to(Format)``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cache
from itertools import islice
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, Final, NoReturn, TypeVar, get_args, get_type_hints

import yaml

from craftsim.errors import InputError, suggestion
from craftsim.storage.limits import YAML, YAML_DEPTH, YAML_VALUES
from craftsim.storage.reading import read_text

if TYPE_CHECKING:
    from pydantic import TypeAdapter
    from pydantic_core import ErrorDetails

T = TypeVar("T")
Loc = tuple[str | int, ...]
"""The keys and numbers in lists that lead to a value."""
Mistake = tuple[Loc, str]
"""Where something is wrong, and what."""

MOST_REPORTED: Final = 5
"""So many mistakes are reported at once."""
_QUOTED: Final = 40
"""Characters of what a message quotes from a file."""
_COMPARED: Final = 100
"""Unknown keys that are compared with one that is missing."""
_UNKNOWN: Final = "unexpected_keyword_argument"
"""What pydantic calls a key that a dataclass does not have."""
_INTEGER: Final = re.compile(r"[-+]?(0|[1-9][0-9]{0,17})")
_FLOAT: Final = re.compile(
    r"[-+]?([0-9]{1,20}\.[0-9]{0,20}|\.[0-9]{1,20}|[0-9]{1,20}(?=[eE]))([eE][-+]?[0-9]{1,3})?"
)
_LOADER: Final = getattr(yaml, "CLoader", yaml.Loader)
"""Only its parser is used, never a constructor: no object is ever made from a tag."""


@dataclass(frozen=True)
class Between:
    """What a number in a format may be, both ends included; a word stands for a bound that the reader is given."""

    low: float | str
    high: float | str

    def __get_pydantic_core_schema__(self, kind: type, handler: Any) -> Any:
        """Return pydantic's schema of such an integer, or float."""
        from pydantic_core import PydanticCustomError, core_schema

        name = "an integer" if kind is int else "a number"

        def check(value: Any, info: core_schema.ValidationInfo) -> Any:
            bounds: Mapping[str, float] = info.context or {}
            low, high = (bounds[end] if isinstance(end, str) else end for end in (self.low, self.high))
            if type(value) not in (int, kind):
                wanted = f"must be {name} from {low} to {high}"
                raise PydanticCustomError("number", "{text}", {"text": f"{wanted}, not {described(value)}"})
            if not low <= value <= high:
                text = f"{value} is out of range, allowed: {low} to {high}"
                raise PydanticCustomError("number", "{text}", {"text": text})
            return kind(value)

        return core_schema.with_info_plain_validator_function(check)


@dataclass(frozen=True)
class Document:
    """A YAML file: what it says, and where."""

    path: Path
    """The file that messages speak of."""
    plain: dict[str, Any] = field(default_factory=dict)
    """Lists, mappings, numbers, texts and None."""
    lines: dict[Loc, int] = field(default_factory=dict)
    """Of each key, and of each value in a list."""
    error: type[InputError] = InputError
    """What its mistakes raise."""
    instead: str = ""
    """What it is where it is no mapping, in words."""

    def fail(self, loc: Loc, message: str) -> NoReturn:
        """Raise the error of a mistake, which begins with the file and, where known, the line."""
        self.fail_in(self.lines.get(loc), message)

    def fail_in(self, line: int | None, message: str) -> NoReturn:
        """Raise the error of a mistake in a line, where that is known."""
        raise self.error(self._with_line(line, message))

    def refuse(self, mistakes: Iterable[Mistake]) -> None:
        """Raise the error of mistakes, the first few of them a line each, if there are any."""
        found = list(islice(mistakes, MOST_REPORTED + 1))
        if found:
            more = [f"{self.path}: and more"] if len(found) > MOST_REPORTED else []
            reported = [
                self._with_line(self.lines.get(loc), message) for loc, message in found[:MOST_REPORTED]
            ]
            raise self.error("\n".join([*reported, *more]))

    def _with_line(self, line: int | None, message: str) -> str:
        return f"{self.path}: {message}" if line is None else f"{self.path}:{line}: {message}"

    def mapping(self, known: Iterable[str], *loc: str | int) -> dict[str, Any]:
        """Return the mapping at a place of a format that has no dataclass; raises its error for keys not known."""
        found: Any = self.plain
        for part in loc:
            found = found[part]
        known = list(known)
        if not isinstance(found, dict) or self.instead:
            wanted = f"a mapping with keys {', '.join(known)}"
            self.fail(loc, f"{key_words(loc)}: must be {wanted}, not {self.instead or described(found)}")
        for key in found:
            if key not in known:
                self.fail((*loc, key), unknown_words(key, known))
        return found

    def to(self, kind: type[T], **bounds: float) -> T:
        """Return what it says as a dataclass; ``bounds`` are the words of :class:`Between`.

        Raises its error, with the first mistakes in the file, for what is not of that format.
        """
        from pydantic import ValidationError

        if self.instead:
            self.mapping(_keys(kind, ()))
        try:
            return _adapter(kind).validate_python(self.plain, context=bounds)  # type: ignore[arg-type]
        except ValidationError as error:
            errors = error.errors(include_url=False, include_context=False)
        # What is missing has no line of its own.
        errors.sort(key=lambda one: self.lines.get(one["loc"], self.lines.get(one["loc"][:-1], 0)))
        self.refuse(_mistakes(kind, errors))
        raise AssertionError("pydantic reported no mistake")


@cache
def _adapter(kind: type) -> TypeAdapter[Any]:
    from pydantic import ConfigDict, TypeAdapter, with_config

    # The dataclasses inside take it over.
    return TypeAdapter(with_config(ConfigDict(extra="forbid"))(kind))


def read_document(path: Path, error: type[InputError] = InputError) -> Document:
    """Read a YAML file; raises ``error`` if it is missing, too large, not UTF-8 text, or as :func:`parse_document`."""
    try:
        text = read_text(path, YAML)
    except InputError as wrong:
        raise error(str(wrong)) from wrong
    return parse_document(text, path, error)


def read_keys(path: Path, known: list[str]) -> Document:
    """Return a YAML file of numbers; raise InputError for one that cannot be read, or has other top-level keys."""
    document = read_document(path)
    document.mapping(known)
    return document


def numbers(document: Document, section: str, known: list[str], *loc: str | int) -> dict[str, float]:
    """Return the numbers of a section at a place; raise InputError for what is no known key or no number."""
    given = document.mapping(known, *loc)
    return {key: number(document, value, f"{section}.{key}", (*loc, key)) for key, value in given.items()}


def number(document: Document, value: object, name: str, loc: Loc) -> float:
    """Return a value as a number; raise InputError for what is none."""
    if not isinstance(value, int | float):
        document.fail(loc, f"{name} must be a number, not {described(value)}")
    if not math.isfinite(value):
        document.fail(loc, f"{name} must be a finite number, not {value}")
    return float(value)


def parse_document(text: str, path: Path, error: type[InputError] = InputError) -> Document:
    """Return a YAML text, of which messages speak as ``path``; raises ``error`` for what is odd or too much."""
    document = Document(path, error=error)
    try:
        _guard(document, text)
        for node in yaml.compose_all(text, Loader=_LOADER):
            if isinstance(node, yaml.MappingNode):
                _merge(document, document.plain, node, ())
            elif node.value:
                document.lines[()] = _line(node)
                return replace(document, instead=described(_value(document, node, ())))
    except yaml.MarkedYAMLError as wrong:
        mark = wrong.problem_mark or wrong.context_mark
        line = mark.line + 1 if mark is not None else None
        document.fail_in(line, f"not valid YAML: {wrong.problem or wrong.context}")
    except yaml.YAMLError as wrong:
        document.fail_in(None, f"not valid YAML: {str(wrong).splitlines()[0]}")
    return document


def _guard(document: Document, text: str) -> None:
    """Refuse, before anything is built, what is too much and what has no use."""
    n_values = depth = 0
    for event in yaml.parse(text, Loader=_LOADER):
        line = _line(event)
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            document.fail_in(line, "anchors and aliases (& and *) are not allowed")
        if getattr(event, "tag", None) is not None:
            document.fail_in(line, "tags (!) are not allowed")
        n_values += isinstance(event, yaml.NodeEvent)
        if n_values > YAML_VALUES:
            document.fail_in(line, f"more than the {YAML_VALUES} values that are allowed")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > YAML_DEPTH:
            document.fail_in(line, f"nested deeper than the {YAML_DEPTH} levels that are allowed")


def _value(document: Document, node: Any, loc: Loc) -> Any:
    """Return a value as Python has it, and note the lines of what is in it."""
    if isinstance(node, yaml.MappingNode):
        return _merge(document, {}, node, loc)
    if isinstance(node, yaml.SequenceNode):
        document.lines.update({(*loc, i): _line(item) for i, item in enumerate(node.value)})
        return [_value(document, item, (*loc, i)) for i, item in enumerate(node.value)]
    return _scalar(node)


def _merge(document: Document, mapping: dict[str, Any], node: yaml.MappingNode, loc: Loc) -> dict[str, Any]:
    """Put the keys of a node into a mapping, and return that."""
    for key, value in node.value:
        at, line = (*loc, key.value), _line(key)
        if not isinstance(key, yaml.ScalarNode):
            document.fail_in(line, f"a key must be a word, not {described(_value(document, key, loc))}")
        if key.value in mapping:
            document.fail_in(
                line, f"{key_words((key.value,))}: given twice, first in line {document.lines[at]}"
            )
        document.lines[at] = line
        mapping[key.value] = _value(document, value, at)
    return mapping


def _line(part: yaml.Node | yaml.Event) -> int:
    mark = part.start_mark
    return 1 if mark is None else int(mark.line) + 1


def _scalar(node: yaml.ScalarNode) -> float | str | None:
    text: str = node.value
    if node.style not in (None, ""):  # It is quoted.
        return text
    if text in ("", "~", "null"):
        return None
    if _INTEGER.fullmatch(text):
        return int(text)
    return float(text) if _FLOAT.fullmatch(text) else text


def dump(plain: Mapping[str, Any], indent: str = "") -> str:
    """Return the text of keys with numbers, lists of flat mappings, one a line, and mappings of such keys."""
    lines = []
    for key, value in plain.items():
        if isinstance(value, list):
            entries = (", ".join(f"{name}: {one}" for name, one in entry.items()) for entry in value)
            lines += [f"{indent}{key}:\n", *(f"{indent}  - {{{entry}}}\n" for entry in entries)]
        elif isinstance(value, Mapping) and value:
            lines += [f"{indent}{key}:\n", dump(value, f"{indent}  ")]
        else:
            lines.append(f"{indent}{key}: {value}\n")
    return "".join(lines)


def described(value: object) -> str:
    """Return a short description of a value for messages."""
    if isinstance(value, list | dict):
        return "a list" if isinstance(value, list) else "a mapping"
    return "nothing" if value in (None, "") else f"'{_cut(str(value))}'"


def unknown_words(word: str, known: Iterable[str], what: str = "key", allowed: bool = True) -> str:
    """Return the message of a word that is not known, with the closest known one and, unless asked not to, all."""
    known = list(known)
    text = f"unknown {what} '{_cut(word)}'{suggestion(word[:80], known)}"
    return f"{text}; allowed: {', '.join(known)}" if allowed else text


def key_words(loc: Loc) -> str:
    """Return how messages name a value.

    Example:
        >>> key_words(("block", 0, "x"))
        "key 'block[0].x'"
    """
    name = "".join(f"[{part}]" if isinstance(part, int) else f".{_cut(part)}" for part in loc)
    return f"key '{name[1:] or 'document'}'"


def _cut(text: str) -> str:
    return text if len(text) <= _QUOTED else f"{text[: _QUOTED - 3]}..."


def _mistakes(kind: Any, errors: list[ErrorDetails]) -> Iterator[Mistake]:
    """Yield what pydantic found; of the keys that a mapping lacks the first, unless it is there, misspelt."""
    unknown = [one["loc"] for one in errors if one["type"] == _UNKNOWN][:_COMPARED]
    lacking: set[Loc] = set()
    listed: set[Loc] = set()
    for one in errors:
        *before, name = one["loc"]
        parent = tuple(before)
        if one["type"] == _UNKNOWN:
            # What is allowed in a mapping is said once.
            yield one["loc"], unknown_words(str(name), _keys(kind, parent), allowed=parent not in listed)
            listed.add(parent)
        elif one["type"] != "missing":
            yield one["loc"], _words(kind, one)
        elif parent not in lacking and not any(
            loc[:-1] == parent and suggestion(str(loc[-1])[:80], [str(name)]) for loc in unknown
        ):
            lacking.add(parent)
            yield parent, _words(kind, one)


def _words(kind: Any, error: ErrorDetails) -> str:
    """Return what is wrong, and what is allowed."""
    loc, value = error["loc"], error["input"]
    if error["type"] == "missing":
        required = ", ".join(_keys(kind, loc[:-1], required=True))
        if len(loc) == 1:
            return f"{key_words(loc)} is missing; required: {required}"
        return f"{key_words(loc[:-1])}: needs '{loc[-1]}'; required: {required}"
    if error["type"] == "literal_error":
        known = [str(word) for word in get_args(_type_at(kind, loc))]
        if isinstance(value, str | int | float):
            return unknown_words(str(value), known, f"value of '{key_words(loc)[5:-1]}'")
        return f"{key_words(loc)}: must be one of {', '.join(known)}, not {described(value)}"
    allowed = {
        "dataclass_type": lambda: f"a mapping with keys {', '.join(_keys(kind, loc))}",
        "tuple_type": lambda: "a list of entries",
        "string_type": lambda: "a text",
    }
    if error["type"] in allowed:
        return f"{key_words(loc)}: must be {allowed[error['type']]()}, not {described(value)}"
    return f"{key_words(loc)}: {error['msg']}"


def _keys(kind: Any, loc: Loc, required: bool = False) -> list[str]:
    """Return the keys of the mapping at a place in a format, or those alone that have no default."""
    return [
        one.name
        for one in fields(_type_at(kind, loc))
        if not required or (one.default is MISSING and one.default_factory is MISSING)
    ]


def _type_at(kind: Any, loc: Loc) -> Any:
    """Return the type of the value at a place in a format."""
    for part in loc:
        kind = get_args(kind)[0] if isinstance(part, int) else get_type_hints(kind, include_extras=True)[part]
        while hasattr(kind, "__metadata__") or NoneType in get_args(kind):
            kind = get_args(kind)[0]
    return kind
