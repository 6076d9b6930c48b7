"""Checking what really happened: plans run in physics, each action against the rules' prediction."""
