"""Films of simulated scenes. Nothing else needs it; choose a backend before MuJoCo is imported."""
