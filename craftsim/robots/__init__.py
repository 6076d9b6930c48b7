"""Robots: what a machine must offer so that the skills drive it, and how it is reached over a network."""
