"""Reading small YAML files from people one does not know: bounded in size and time, each value with its line.

The parser's events are turned into plain nodes one by one, so nothing is expanded, nested or built before its
bounds are checked. Anchors, aliases and tags have no use in our files and are refused.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, NoReturn

import yaml

from craftsim.errors import BlueprintError, InputError, suggestion
from craftsim.storage import reading as storage
from craftsim.storage.limits import YAML, YAML_DEPTH, YAML_VALUES, Limits

_INTEGER: Final = re.compile(r"[-+]?(0|[1-9][0-9]{0,8})")
_LOADER: Final = getattr(yaml, "CLoader", yaml.Loader)
"""Only its parser is used, never a constructor: no object is ever made from a tag."""


@dataclass(frozen=True)
class Scalar:
    """A single value as written."""

    text: str
    quoted: bool
    line: int


@dataclass(frozen=True)
class Sequence:
    """A list of nodes."""

    line: int
    items: list[Node] = field(default_factory=list)


@dataclass(frozen=True)
class Mapping:
    """Keys and values in the order written; keys are unique."""

    line: int
    items: dict[str, Node] = field(default_factory=dict)
    key_lines: dict[str, int] = field(default_factory=dict)


Node = Scalar | Sequence | Mapping


@dataclass(frozen=True)
class Source:
    """The file that messages speak of."""

    path: Path

    def fail(self, line: int | None, message: str) -> NoReturn:
        """Raise a BlueprintError that starts with the file and, if known, the line."""
        where = f"{self.path}:{line}" if line is not None else str(self.path)
        raise BlueprintError(f"{where}: {message}")

    def fail_unknown(self, line: int, word: str, known: list[str], what: str = "key") -> NoReturn:
        """Raise for a word that is not known, with what is allowed and the closest known one."""
        shown = word if len(word) <= 40 else word[:37] + "..."
        hint = suggestion(word[:80], known)
        self.fail(line, f"unknown {what} '{shown}'{hint}; allowed: {', '.join(known)}")

    def integer(self, node: Node, key: str, low: int, high: int) -> int:
        """Return a node as an integer within [low, high]."""
        if not isinstance(node, Scalar) or node.quoted or not _INTEGER.fullmatch(node.text):
            wanted = f"an integer from {low} to {high}"
            self.fail(node.line, f"key '{key}': must be {wanted}, not {describe(node)}")
        value = int(node.text)
        if not low <= value <= high:
            self.fail(node.line, f"key '{key}': {value} is out of range, allowed: {low} to {high}")
        return value

    def word(self, node: Node, key: str, known: list[str]) -> str:
        """Return a node as one of the known words."""
        if not isinstance(node, Scalar):
            self.fail(node.line, f"key '{key}': must be one of {', '.join(known)}, not {describe(node)}")
        if node.text not in known:
            self.fail_unknown(node.line, node.text, known, f"value of '{key}'")
        return node.text

    def mapping(self, node: Node, key: str, known: list[str]) -> Mapping:
        """Return a node as a mapping that has no other keys than the known ones."""
        if not isinstance(node, Mapping):
            wanted = f"a mapping with keys {', '.join(known)}"
            self.fail(node.line, f"key '{key}': must be {wanted}, not {describe(node)}")
        for name in node.items:
            if name not in known:
                self.fail_unknown(node.key_lines[name], name, known)
        return node

    def entries(self, node: Node, key: str, known: list[str], required: list[str]) -> list[Mapping]:
        """Return a node as a list of mappings with the required keys and no unknown one; null is empty."""
        if isinstance(node, Scalar) and not node.quoted and node.text in ("", "null", "~"):
            return []
        if not isinstance(node, Sequence):
            self.fail(node.line, f"key '{key}': must be a list of entries, not {describe(node)}")
        entries = [self.mapping(item, f"{key}[{i}]", known) for i, item in enumerate(node.items)]
        for i, entry in enumerate(entries):
            for name in required:
                if name not in entry.items:
                    needed = f"needs '{name}'; required: {', '.join(required)}"
                    self.fail(entry.line, f"key '{key}[{i}]': {needed}")
        return entries


def describe(node: Node) -> str:
    """Return a short description of a node for messages."""
    if isinstance(node, Scalar):
        text = node.text if len(node.text) <= 40 else node.text[:37] + "..."
        return f"'{text}'" if text else "nothing"
    return "a list" if isinstance(node, Sequence) else "a mapping"


def read_text(path: Path, limits: Limits = YAML) -> str:
    """Return a text file of bounded size; raise BlueprintError if it is missing, too large or not UTF-8."""
    try:
        return storage.read_text(path, limits)
    except InputError as error:
        raise BlueprintError(str(error)) from error


def parse_keys(path: Path, text: str, known: list[str]) -> tuple[Source, Mapping]:
    """Return the merged top-level keys of all documents of a YAML text; raise BlueprintError if odd.

    ``path`` is the file that messages speak of.
    """
    source = Source(path)
    merged = Mapping(1)
    for document in _documents(source, text):
        if isinstance(document, Scalar) and document.text == "":
            continue
        mapping = source.mapping(document, "document", known)
        for name, value in mapping.items.items():
            _add(source, merged, name, mapping.key_lines[name], value)
    return source, merged


def _add(source: Source, mapping: Mapping, name: str, line: int, value: Node) -> None:
    if name in mapping.items:
        source.fail(line, f"key '{name}': given twice, first in line {mapping.key_lines[name]}")
    mapping.items[name] = value
    mapping.key_lines[name] = line


class _Builder:
    """Turns parser events into nodes; keeps the open lists and mappings and the key waiting for its value."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.documents: list[Node] = []
        self.open: list[Sequence | Mapping] = []
        self.keys: list[Scalar | None] = []
        self.nodes = 0

    def add(self, node: Node) -> None:
        """Put a finished scalar, or a list or mapping just begun, into what is open."""
        self.nodes += 1
        if self.nodes > YAML_VALUES:
            self.source.fail(node.line, f"more than the {YAML_VALUES} values that are allowed")
        if not self.open:
            self.documents.append(node)
            return
        parent = self.open[-1]
        if isinstance(parent, Sequence):
            parent.items.append(node)
        elif self.keys[-1] is None:
            if not isinstance(node, Scalar):
                self.source.fail(node.line, f"a key must be a word, not {describe(node)}")
            self.keys[-1] = node
        else:
            key = self.keys[-1]
            self.keys[-1] = None
            _add(self.source, parent, key.text, key.line, node)

    def begin(self, node: Sequence | Mapping) -> None:
        """Open a list or mapping."""
        self.add(node)
        self.open.append(node)
        self.keys.append(None)
        if len(self.open) > YAML_DEPTH:
            self.source.fail(node.line, f"nested deeper than the {YAML_DEPTH} levels that are allowed")

    def end(self) -> None:
        """Close the innermost list or mapping."""
        self.open.pop()
        self.keys.pop()


def _documents(source: Source, text: str) -> list[Node]:
    builder = _Builder(source)
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            line = getattr(event.start_mark, "line", 0) + 1
            if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
                source.fail(line, "anchors and aliases (& and *) are not allowed")
            if getattr(event, "tag", None) is not None:
                source.fail(line, "tags (!) are not allowed")
            if isinstance(event, yaml.ScalarEvent):
                builder.add(Scalar(event.value, event.style not in (None, ""), line))
            elif isinstance(event, yaml.SequenceStartEvent):
                builder.begin(Sequence(line))
            elif isinstance(event, yaml.MappingStartEvent):
                builder.begin(Mapping(line))
            elif isinstance(event, yaml.CollectionEndEvent):
                builder.end()
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark is not None else None
        source.fail(line, f"not valid YAML: {error.problem or error.context}")
    except yaml.YAMLError as error:
        source.fail(None, f"not valid YAML: {str(error).splitlines()[0]}")
    return builder.documents
