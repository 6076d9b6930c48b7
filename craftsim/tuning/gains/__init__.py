"""Tuning the gains of the skills under randomization, with seeds held out for the verdict."""
