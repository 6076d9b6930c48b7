"""The rules, compiled: which actions are legal, and what follows from them. Two rule sets, one implementation."""

from craftsim.discrete.rules.sets import RULE_SETS, Rules, RuleSet

__all__ = ["RULE_SETS", "RuleSet", "Rules"]
