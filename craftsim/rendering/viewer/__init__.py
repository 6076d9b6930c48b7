"""The viewer in the browser: recorded runs and running ones; needs the extra ``view``."""
