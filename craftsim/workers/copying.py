"""Copies and pickles of objects that refer to what Python cannot copy.

Arrays of a PhysicsWorld are views of MuJoCo's memory, and machine code is bound to their addresses. A copy that
takes them over would move the original. :class:`Copyable` leaves them out of copies and pickles, and binds the copy to
its own. What cannot be had twice, such as a process or a connection, is :class:`NotCopyable`.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Collection
from typing import Any, ClassVar, NoReturn, Self

from craftsim.errors import CraftsimError


class Copyable:
    """An object whose copies, shallow ones too, and pickles share nothing with it that changes.

    A copy refers to a copy of the PhysicsWorld; what several objects share, their copies share if all are copied in one
    call of ``copy.deepcopy`` or in one pickle.
    """

    _bound: ClassVar[Collection[str]] = ()
    """Attributes that :meth:`_bind` makes from the others: views of MuJoCo's memory, and what is bound to addresses."""

    def _bind(self) -> None:
        """Make the attributes of ``_bound`` from the others; called by the constructor, and for each copy."""

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name not in self._bound}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._bind()

    def __copy__(self) -> Self:
        """Return a whole copy: a shallow one would go on moving the original's world."""
        return copy.deepcopy(self)


class NotCopyable:
    """An object that holds a process, a connection, an open file, or memory that belongs to another object."""

    _instead: ClassVar[str]
    """Advice what to do instead, as the end of a sentence."""

    def __reduce_ex__(self, _: object) -> NoReturn:
        raise TypeError(
            f"{type(self).__name__} objects cannot be copied or pickled; {self._instead}"
        )


class OfOneProcess(NotCopyable):
    """An object that works in the process that made it, and in none that is forked from that.

    A forked process has the same pipes and sockets, and would take what the other one is sent; it has none of its
    threads.
    """

    _made_in: int

    def __new__(cls, *_: Any, **__: Any) -> Self:
        """Note the process."""
        new = super().__new__(cls)
        new._made_in = os.getpid()
        return new

    @property
    def is_forked(self) -> bool:
        """Whether this process was forked from the one that made it."""
        return self._made_in != os.getpid()

    def check_process(self) -> None:
        """Raise CraftsimError in a forked process."""
        if self.is_forked:
            kind = type(self).__name__
            raise CraftsimError(
                f"{kind} objects work only in the process that made them, from which this one was forked; "
                f"{self._instead}"
            )
