"""Recordings of real motion beside simulation: the contact law on tosses, the drives on a driven robot."""
