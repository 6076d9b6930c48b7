"""Films and pictures of simulated scenes. Nothing else needs it."""
