"""Runs of plans, lists of actions and policies in physics, with every action checked."""
