"""Recorded episodes: our own, CraftEnv's, and comparing the rules with them."""
