"""Training cars on the grid world with TorchRL; needs ``pip install 'craftsim[train]'``."""
