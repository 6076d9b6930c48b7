"""A small library over numba: one signature a function, a cache named by content, and progress."""
