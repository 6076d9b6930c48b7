"""Mutation of every file format that comes from outside: each case is read, or refused with our own error.

Each module here has ``TARGETS``: functions by name that make one damaged file in a folder and read it as the
commands do.
"""
