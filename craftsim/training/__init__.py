"""Training cars on the grid world with TorchRL; needs the extra ``train``."""
