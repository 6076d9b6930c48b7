"""From a start and a goal to a plan: what goes where in which order, by which car, and every move of it.

The names stand in ``__init__.pyi``; each is imported at its first use, so that help of commands is quick.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
