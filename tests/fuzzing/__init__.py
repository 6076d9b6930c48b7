"""Damage to every file format that comes from outside: each case is read, or refused with our own error."""
