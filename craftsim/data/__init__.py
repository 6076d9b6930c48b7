"""Blueprints, plans and gains that ship with craftsim."""
