"""Attempts that can be repeated bit for bit, from a folder without pickles."""
