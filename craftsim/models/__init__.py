"""Smartcars, blocks and slopes in MuJoCo: parameters, parts, the composed Site, sensing, state."""
