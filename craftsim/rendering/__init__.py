"""Films of simulated scenes. Nothing else in the package needs it; choose a backend before MuJoCo is imported."""
