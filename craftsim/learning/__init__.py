"""Training cars on the grid or in physics; needs the extra ``train``."""
