"""Worlds that nobody drew: a generator of legal worlds, random play that prefers the rare, and what it covered."""
