"""Logs of what a robot was told and what it measured: their form, reading them from tables and bags, recording."""
