"""craftsim: cooperative construction with smartcars, blocks and foldable slopes in contact physics."""

from importlib.metadata import version

__version__ = version("craftsim")
