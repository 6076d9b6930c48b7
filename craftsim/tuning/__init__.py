"""Better figures for what there is: gains tuned against declared objectives, and a car's figures from its logs."""
