"""Smartcars, blocks and slopes in MuJoCo: parameters, parts, the composed PhysicsWorld, sensing, state."""
