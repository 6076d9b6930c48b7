"""Reading of untrusted YAML files: bounded in size and time, validated by type, each mistake with its line.

The parser's events are checked before anything is built; anchors, aliases and tags are refused, and the keys of several
documents in a file merged. A format is a record: ``read_document(path).to(Format)``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Hashable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, NoReturn, TypeVar, cast

import yaml
from pydantic import ValidationError
from pydantic_core import to_json

from craftsim.errors import InputError
from craftsim.storage.limits import YAML, YAML_DEPTH, YAML_VALUES
from craftsim.storage.reading import read_text
from craftsim.storage.records import Loc, Mistake, adapter, described, key_words, mistakes, refuse

_T = TypeVar("_T")

_INTEGER: Final = re.compile(r"[-+]?(0|[1-9][0-9]{0,17})")
_FLOAT: Final = re.compile(
    r"[-+]?([0-9]{1,20}\.[0-9]{0,20}|\.[0-9]{1,20}|[0-9]{1,20}(?=[eE]))([eE][-+]?[0-9]{1,3})?"
)
_LOADER: Final = getattr(yaml, "CLoader", yaml.Loader)
"""Only the parser is used, never a constructor, so no object is made from a tag."""


@dataclass(frozen=True)
class Document:
    """The content of a YAML file with its line numbers."""

    path: Path
    """The file, for messages."""
    plain: dict[str, Any] = field(default_factory=dict)
    lines: dict[Loc, int] = field(default_factory=dict)
    """Line of each key and list item, by path."""
    error: type[InputError] = InputError
    instead: Any = None
    """The content if it is not a mapping."""

    def fail(self, loc: Loc, message: str) -> NoReturn:
        """Raise the error of a mistake, beginning with the file and, if known, the line."""
        self.fail_in(self.lines.get(loc), message)

    def fail_in(self, line: int | None, message: str) -> NoReturn:
        """Raise the error of a mistake in a line, if known."""
        raise self.error(self._with_line(line, message))

    def refuse(self, mistakes: Iterable[Mistake]) -> None:
        """Raise an error with the first few mistakes, a line each, if there are any."""
        refuse(mistakes, lambda loc, text: self._with_line(self.lines.get(loc), text), self.error)

    def _with_line(self, line: int | None, message: str) -> str:
        if line is None:
            return f"{self.path}: {message}"
        return f"{self.path}:{line}: {message}"

    def over(self, nominal: Mapping[str, Any]) -> Document:
        """Return this document with missing keys taken from another; lists are not merged."""
        return replace(self, plain=_over(nominal, self.plain))

    def to(self, kind: type[_T], **context: Any) -> _T:
        """Return the content as a record, ``context`` for its validators; raises the document's error."""
        plain = self.instead
        if plain is None:
            plain = self.plain
        try:
            # As JSON, where a mapping stands for a record and a list for a tuple, and nothing else for anything else.
            data = to_json(plain, inf_nan_mode="constants")
            value: _T = adapter(cast(Hashable, kind)).validate_json(data, context=context)
        except ValidationError as error:
            # A missing key has no line.
            lines = self.lines
            found_mistakes = list(
                mistakes(kind, error, line_of=lambda loc: lines.get(loc, lines.get(loc[:-1], 0)))
            )
            # Mistakes in this file before those in values that were taken from another one.
            self.refuse(
                mistake for mistake in found_mistakes if not mistake[0] or mistake[0] in self.lines
            )
            self.refuse(found_mistakes)
            raise AssertionError("pydantic reported no mistake") from None
        except InputError as error:
            raise self.error(self._with_line(None, str(error))) from error
        return value


def _over(nominal: Mapping[str, Any], plain: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(nominal)
    for key, value in plain.items():
        are_mappings = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        if are_mappings:
            merged[key] = _over(merged[key], value)
        else:
            merged[key] = value
    return merged


def read_document(path: Path, error: type[InputError] = InputError) -> Document:
    """Read a YAML file; raises ``error`` if it is missing, too large, not UTF-8 text, or as :func:`parse_document`."""
    try:
        text = read_text(path, YAML)
    except InputError as wrong:
        raise error(str(wrong)) from wrong
    return parse_document(text, path, error)


def parse_document(text: str, path: Path, error: type[InputError] = InputError) -> Document:
    """Parse a YAML text; messages name ``path``. Raises ``error`` if it is invalid or too large."""
    document = Document(path, error=error)
    try:
        _guard(document, text)
        for node in yaml.compose_all(text, Loader=_LOADER):
            if isinstance(node, yaml.MappingNode):
                _merge(document, document.plain, node, ())
            elif node.value:
                document.lines[()] = _line(node)
                return replace(document, instead=_value(document, node, ()))
    except yaml.MarkedYAMLError as wrong:
        mark = wrong.problem_mark or wrong.context_mark
        if mark is not None:
            line = mark.line + 1
        else:
            line = None
        document.fail_in(line, f"not valid YAML: {wrong.problem or wrong.context}")
    except yaml.YAMLError as wrong:
        document.fail_in(None, f"not valid YAML: {str(wrong).splitlines()[0]}")
    return document


def _guard(document: Document, text: str) -> None:
    """Refuse oversized input, anchors, aliases and tags before anything is built."""
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
    """Return the Python value of a node, and record the lines of its parts."""
    text = node.value
    if isinstance(node, yaml.MappingNode):
        return _merge(document, {}, node, loc)
    if isinstance(node, yaml.SequenceNode):
        document.lines.update({(*loc, i): _line(item) for i, item in enumerate(text)})
        return [_value(document, item, (*loc, i)) for i, item in enumerate(text)]
    if node.style not in (None, ""):  # It is quoted.
        return text
    if text in ("", "~", "null"):
        return None
    if _INTEGER.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    return text


def _merge(
    document: Document, mapping: dict[str, Any], node: yaml.MappingNode, loc: Loc
) -> dict[str, Any]:
    """Merge the keys of a node into a mapping, and return it."""
    for key, value in node.value:
        at = (*loc, key.value)
        line = _line(key)
        if not isinstance(key, yaml.ScalarNode):
            document.fail_in(
                line, f"a key must be a word, not {described(_value(document, key, loc))}"
            )
        if key.value in mapping:
            first = document.lines[at]
            document.fail_in(line, f"{key_words((key.value,))}: given twice, first in line {first}")
        document.lines[at] = line
        mapping[key.value] = _value(document, value, at)
    return mapping


def _line(node: yaml.Node | yaml.Event) -> int:
    mark = node.start_mark
    if mark is None:
        return 1
    return int(mark.line) + 1


def quoted(text: str) -> str:
    """Return a text in quotes, on one line, as a YAML file has it."""
    line: str = yaml.safe_dump(text, default_style='"', allow_unicode=True, width=math.inf)
    return line.rstrip("\n")


def dump(plain: Mapping[str, Any], indent: str = "") -> str:
    """Return the text of keys with numbers, lists of flat mappings, one a line, and mappings of such keys."""
    lines = []
    for key, value in plain.items():
        if isinstance(value, list):
            lines.append(f"{indent}{key}:\n")
            for entry in value:
                words = ", ".join(f"{name}: {number}" for name, number in entry.items())
                lines.append(f"{indent}  - {{{words}}}\n")
        elif isinstance(value, Mapping) and value:
            lines += [f"{indent}{key}:\n", dump(value, f"{indent}  ")]
        else:
            lines.append(f"{indent}{key}: {value}\n")
    return "".join(lines)
