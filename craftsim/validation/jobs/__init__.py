"""Whole plans and long episodes in physics."""
