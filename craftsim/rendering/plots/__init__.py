"""Figures of recorded runs and of worlds, for print: vectors, legible without colours."""
