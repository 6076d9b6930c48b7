"""JSON documents held to a schema: strict, no unknown keys, finite numbers; the first mistake is reported."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from craftsim.errors import InputError
from craftsim.storage.limits import JSON_VALUES, Limits
from craftsim.storage.mistakes import first_mistake
from craftsim.storage.reading import read_bytes

if TYPE_CHECKING:
    from pydantic import TypeAdapter
    from pydantic_core import SchemaValidator

LEFT_OUT_IF_EMPTY: Final = "left_out_if_empty"
"""Key of a dataclass field's metadata: a report says nothing of it where it is empty."""

T = TypeVar("T")

_TOLD: Final = 1000
"""With more mistakes than this none is reported: a description of each would take more memory than the file."""


class Schema(Generic[T]):
    """The schema of JSON documents that hold one dataclass, whose own ``__post_init__`` may refuse more.

    Example:
        >>> from dataclasses import dataclass
        >>> @dataclass(frozen=True)
        ... class Size:
        ...     length: int
        >>> Schema(Size).parse(b'{"length": 3}', "size.json")
        Size(length=3)
    """

    def __init__(self, kind: type[T]) -> None:
        """Take the schema of a dataclass; it is built when it is first used."""
        self.kind = kind

    @cached_property
    def _adapter(self) -> TypeAdapter[T]:
        from pydantic import ConfigDict, TypeAdapter, with_config

        # The dataclasses inside take it over.
        config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
        return TypeAdapter(with_config(config)(self.kind))

    @cached_property
    def _validator(self) -> SchemaValidator:
        from pydantic_core import SchemaValidator

        schema = self._adapter.core_schema
        _stop_at_first(schema)
        return SchemaValidator(schema)

    def text(self, value: T) -> bytes:
        """Return the document of a value, as text for people and machines."""
        return self._adapter.dump_json(value, indent=1) + b"\n"

    def read(self, path: Path, limits: Limits) -> T:
        """Return the value of a JSON file; raises as :meth:`parse` and :func:`~craftsim.storage.reading.read_bytes`."""
        return self.parse(read_bytes(path, limits), str(path))

    def parse(self, data: bytes, where: str) -> T:
        """Return the value of a document.

        Raises InputError, beginning with ``where`` and the key, for what is not JSON or not of the schema.
        """
        from pydantic import ValidationError

        if data.count(b",") > JSON_VALUES:
            raise InputError(f"{where}: holds more than the {JSON_VALUES} values that are allowed")
        try:
            value: T = self._validator.validate_json(data)
        except ValidationError as error:
            if (count := error.error_count()) > _TOLD:
                text = f"{count} values are missing, wrong or unknown; is it the file that it should be?"
                raise InputError(f"{where}: {text}") from None
            raise InputError(f"{where}: {first_mistake(error)}") from None
        except InputError as error:
            raise InputError(f"{where}: {error}") from error
        return value


def _stop_at_first(schema: Any) -> None:
    """Let every list in a schema end at its first mistake: a file may hold a million, each with a message."""
    if isinstance(schema, dict) and schema.get("type") in ("tuple", "list"):
        schema["fail_fast"] = True
    for part in schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ():
        _stop_at_first(part)
