"""Blueprints, designs and plans: reading them, checking them, placing what they leave to chance, writing them."""
