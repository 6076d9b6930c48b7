"""craftsim: cooperative construction with smartcars, blocks and foldable slopes in contact physics.

The public names stand in ``__init__.pyi``; each is imported at its first use, so that importing craftsim is quick.
"""

import warnings

import lazy_loader

_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

_RENAMED = {"Site": "PhysicsWorld"}
"""Names of 0.2, which go on working until 0.4: what each is called now."""


def __getattr__(name: str) -> object:
    """Return a public name."""
    if name in _RENAMED:
        now = _RENAMED[name]
        warnings.warn(f"craftsim.{name} is called craftsim.{now} now", DeprecationWarning, stacklevel=2)
        name = now
    return _public(name)
