"""The rules, compiled: which actions are legal, and what follows from them. Two rule sets, one implementation."""

from craftsim.discrete.rules.sets import LAWS, Rules, RuleSet

__all__ = ["LAWS", "RuleSet", "Rules"]
