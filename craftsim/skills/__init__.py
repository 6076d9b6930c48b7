"""Controllers that perform each discrete action through motors alone, and the executor that runs them."""
