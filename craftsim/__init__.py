"""craftsim: cooperative construction with smartcars, blocks and foldable slopes in contact physics.

The public names stand in ``__init__.pyi``; each is imported at its first use, so that importing craftsim is quick.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
