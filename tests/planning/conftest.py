"""Fixtures of worlds, the same as those of tests of the grid."""

from discrete.conftest import car, rng, scene

__all__ = ["car", "rng", "scene"]
