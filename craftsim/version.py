"""The version of craftsim that is installed."""

from importlib.metadata import version

__version__ = version("craftsim")
