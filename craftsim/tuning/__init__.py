"""Better figures for what there is: gains tuned against declared objectives."""
