"""Experiments: any set of trials, each recorded once for good; statistics, comparison and replay of the records."""
